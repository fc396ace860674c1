//! Who may say what: by level, and how often the same. What was left out is told, by a thread that may wait for the
//! journal.

use std::{
    collections::HashMap,
    fmt::{self, Write},
    hash::{DefaultHasher, Hash, Hasher},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU8, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use crossbeam_channel::{RecvTimeoutError, Sender, bounded};
use mocapd_acquire::threads;
use mocapd_take::escape::visible;
use tracing::{
    Event, Metadata, Subscriber,
    field::{Field, Visit},
    subscriber::Interest,
};
use tracing_subscriber::layer::Context;

use super::Level;

/// Of the same message so many in so long a time: who reads sees that it happens again and again, and a device that
/// fails a hundred times a second fills no disk.
const BURST: u32 = 10;
const PER: Duration = Duration::from_secs(60);

/// Messages told apart: there are fewer places in the source that say something. What comes beyond is counted as one.
const MESSAGES_MAX: usize = 256;

/// As much of a message as its summary repeats.
const SAMPLE_BYTES_MAX: usize = 160;

/// Where summaries come from: they are not held back themselves.
pub(super) const SUMMARY: &str = "mocapd_service::log::summary";

/// Decides, for every thread.
#[derive(Debug)]
pub(super) struct Gate {
    level: AtomicU8,
    limiter: Mutex<Limiter>,
}

impl Gate {
    pub(super) fn new(level: Level) -> Self {
        Self { level: AtomicU8::new(level as u8), limiter: Mutex::default() }
    }

    pub(super) fn set_level(&self, level: Level) {
        self.level.store(level as u8, Ordering::Relaxed);
        tracing::callsite::rebuild_interest_cache();
    }

    fn level(&self) -> Level {
        Level::ALL[usize::from(self.level.load(Ordering::Relaxed)).min(Level::ALL.len() - 1)]
    }

    /// What was left out and is over, or all of it: how many, and one of them.
    pub(super) fn left_out(&self, now: Instant, all: bool) -> Vec<(u64, String)> {
        self.limiter.lock().unwrap_or_else(PoisonError::into_inner).left_out(now, all)
    }
}

/// The gate as the subscriber asks it.
#[derive(Debug)]
pub(super) struct Layer(pub(super) Arc<Gate>);

impl<S: Subscriber> tracing_subscriber::Layer<S> for Layer {
    fn register_callsite(&self, _: &'static Metadata<'static>) -> Interest {
        // The level may change.
        Interest::sometimes()
    }

    fn enabled(&self, metadata: &Metadata<'_>, _: Context<'_, S>) -> bool {
        metadata.is_span() || *metadata.level() <= self.0.level().filter()
    }

    fn event_enabled(&self, event: &Event<'_>, _: Context<'_, S>) -> bool {
        if event.metadata().target() == SUMMARY {
            return true;
        }
        let mut said = Said::default();
        event.record(&mut said);
        let mut hasher = DefaultHasher::new();
        event.metadata().callsite().hash(&mut hasher);
        // `back after 3.1 s` and `back after 7.4 s` are the same message.
        said.0.bytes().filter(|b| !b.is_ascii_digit()).for_each(|b| b.hash(&mut hasher));
        let mut limiter = self.0.limiter.lock().unwrap_or_else(PoisonError::into_inner);
        limiter.may_pass(hasher.finish(), &said.0, Instant::now())
    }
}

/// An event's message.
#[derive(Default)]
struct Said(String);

impl Visit for Said {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            // A string takes everything.
            write!(self.0, "{value:?}").ok();
        }
    }
}

#[derive(Debug, Default)]
struct Limiter {
    messages: HashMap<u64, Told>,
}

#[derive(Debug)]
struct Told {
    since: Instant,
    told: u32,
    left_out: u64,
    sample: String,
}

impl Limiter {
    fn may_pass(&mut self, message: u64, words: &str, now: Instant) -> bool {
        // What is over and was told in full is forgotten; what was not is kept until somebody has told of it.
        if self.messages.len() >= MESSAGES_MAX {
            self.messages.retain(|_, told| told.left_out > 0 || !told.is_over(now));
        }
        let is_full = self.messages.len() >= MESSAGES_MAX && !self.messages.contains_key(&message);
        let key = if is_full { 0 } else { message };
        let told = self.messages.entry(key).or_insert_with(|| Told::new(now));
        if told.left_out == 0 && told.is_over(now) {
            *told = Told::new(now);
        }
        if told.told < BURST {
            told.told += 1;
            return true;
        }
        told.left_out += 1;
        if told.sample.is_empty() {
            told.sample = words.chars().take(SAMPLE_BYTES_MAX / 4).collect();
        }
        false
    }

    fn left_out(&mut self, now: Instant, all: bool) -> Vec<(u64, String)> {
        let mut found = Vec::new();
        self.messages.retain(|_, told| {
            let is_due = all || told.is_over(now);
            if is_due && told.left_out > 0 {
                found.push((told.left_out, std::mem::take(&mut told.sample)));
            }
            !is_due
        });
        found
    }
}

impl Told {
    fn new(since: Instant) -> Self {
        Self { since, told: 0, left_out: 0, sample: String::new() }
    }

    fn is_over(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.since) >= PER
    }
}

/// How often what was left out is looked at.
const SUM_UP_EVERY: Duration = Duration::from_secs(5);

/// The thread that tells what was left out. Dropping it tells the rest.
#[derive(Debug)]
pub(super) struct Summaries {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Summaries {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

impl Summaries {
    pub(super) fn start(gate: Arc<Gate>) -> anyhow::Result<Self> {
        let (stop, stopped) = bounded::<()>(1);
        // A subscriber that holds for this thread alone holds for the new one, too: so it is in tests.
        let dispatch = tracing::dispatcher::get_default(Clone::clone);
        let run = move || {
            while stopped.recv_timeout(SUM_UP_EVERY) == Err(RecvTimeoutError::Timeout) {
                sum_up(&gate, false);
            }
            sum_up(&gate, true);
        };
        let thread = threads::spawn("mocapd-log", move || {
            tracing::dispatcher::with_default(&dispatch, run);
        })?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

fn sum_up(gate: &Gate, all: bool) {
    for (n, sample) in gate.left_out(Instant::now(), all) {
        tracing::warn!(target: SUMMARY, left_out = n, "{n} more like this were left out: {}", visible(&sample));
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io::{self, Write},
        sync::Mutex,
    };

    use tracing_subscriber::{fmt::MakeWriter, layer::SubscriberExt};

    use super::*;
    use crate::log::lines;

    #[test]
    fn the_same_is_said_ten_times_a_minute_and_the_rest_is_counted() {
        let (mut limiter, start) = (Limiter::default(), Instant::now());
        let passed = (0..100).filter(|_| limiter.may_pass(1, "it stalls", start)).count();
        assert_eq!(passed, 10);
        assert!(limiter.may_pass(2, "something else", start), "another message");
        assert_eq!(limiter.left_out(start + PER / 2, false), [], "not over");
        let later = start + PER;
        assert_eq!(limiter.left_out(later, false), [(90, "it stalls".to_owned())]);
        assert!(limiter.may_pass(1, "it stalls", later), "a new minute");
        assert_eq!(limiter.left_out(later, true), [], "nothing was left out since");
    }

    #[test]
    fn what_is_left_out_is_told_even_when_messages_are_many() {
        let (mut limiter, start) = (Limiter::default(), Instant::now());
        let mut passed = 0;
        for message in 1..=10_000 {
            passed += u64::from(limiter.may_pass(message, "m", start));
        }
        assert!(limiter.messages.len() <= MESSAGES_MAX + 1, "{}", limiter.messages.len());
        let left_out: u64 = limiter.left_out(start, true).iter().map(|(n, _)| n).sum();
        assert_eq!(passed + left_out, 10_000);
        assert!(limiter.messages.is_empty());
    }

    #[derive(Debug, Clone, Default)]
    struct Memory(Arc<Mutex<Vec<u8>>>);

    impl Write for Memory {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl<'a> MakeWriter<'a> for Memory {
        type Writer = Self;

        fn make_writer(&'a self) -> Self {
            self.clone()
        }
    }

    /// Runs `scene` with a log, and gives what it wrote until it ended.
    fn logged(level: Level, scene: impl FnOnce(&Gate)) -> String {
        let (memory, gate) = (Memory::default(), Arc::new(Gate::new(level)));
        let registry = tracing_subscriber::registry()
            .with(lines(memory.clone()))
            .with(Layer(Arc::clone(&gate)));
        tracing::subscriber::with_default(registry, || {
            let _running = Summaries::start(Arc::clone(&gate)).unwrap();
            scene(&gate);
        });
        String::from_utf8(memory.0.lock().unwrap().clone()).unwrap()
    }

    #[test]
    fn words_come_with_their_fields_and_by_level() {
        let text = logged(Level::Info, |_| {
            tracing::info!(take = "jump.take", device = "usb:1209:0001", "a take has begun");
            tracing::debug!("nobody asked");
        });
        let line = text.lines().find(|line| line.contains("a take has begun")).unwrap();
        assert!(line.contains("take=\"jump.take\" device=\"usb:1209:0001\""), "{line}");
        assert!(!text.contains("nobody asked"), "{text}");
    }

    #[test]
    fn the_level_can_change() {
        let text = logged(Level::Error, |gate| {
            tracing::debug!("before");
            gate.set_level(Level::Debug);
            tracing::debug!("after");
        });
        assert!(!text.contains("before") && text.contains("after"), "{text}");
    }

    #[test]
    fn what_is_said_again_and_again_is_counted_and_told() {
        let text = logged(Level::Info, |_| {
            for n in 0..50 {
                tracing::warn!("the device stalled {n} times");
            }
        });
        assert_eq!(text.matches("WARN the device stalled").count(), 10, "{text}");
        // One line more says how many were left out, and which message they repeat.
        let rest: Vec<_> = text.lines().filter(|line| line.contains("left_out=40")).collect();
        assert!(rest.len() == 1 && rest[0].contains("the device stalled"), "{text}");
    }
}
