//! Filters log messages by level and limits repeated ones. A thread that may wait for the journal logs how many were
//! suppressed.

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

/// At most this many of the same message in this time: enough to show the repetition, while a device that fails a
/// hundred times a second does not fill the disk.
const BURST: u32 = 10;
const WINDOW: Duration = Duration::from_secs(60);

/// Maximum number of messages that are distinguished: the source has fewer log statements. Any others are counted
/// together.
const MESSAGES_MAX: usize = 256;

/// Longest sample of a message in a summary.
const SAMPLE_BYTES_MAX: usize = 160;

/// The target of summaries, which are not limited themselves.
pub(super) const SUMMARY: &str = "mocapd_service::log::summary";

/// The level and rate limit of all threads.
#[derive(Debug)]
pub(super) struct LogFilter {
    level: AtomicU8,
    limiter: Mutex<RateLimiter>,
}

impl LogFilter {
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

    /// Numbers of suppressed messages, with a sample of each, whose time window is over; or of all windows.
    pub(super) fn take_suppressed(&self, now: Instant, all: bool) -> Vec<(u64, String)> {
        self.limiter.lock().unwrap_or_else(PoisonError::into_inner).take_suppressed(now, all)
    }
}

/// The filter as a layer of the subscriber.
#[derive(Debug)]
pub(super) struct FilterLayer(pub(super) Arc<LogFilter>);

impl<S: Subscriber> tracing_subscriber::Layer<S> for FilterLayer {
    fn register_callsite(&self, _: &'static Metadata<'static>) -> Interest {
        // The level may change later.
        Interest::sometimes()
    }

    fn enabled(&self, metadata: &Metadata<'_>, _: Context<'_, S>) -> bool {
        metadata.is_span() || *metadata.level() <= self.0.level().filter()
    }

    fn event_enabled(&self, event: &Event<'_>, _: Context<'_, S>) -> bool {
        if event.metadata().target() == SUMMARY {
            return true;
        }
        let mut visitor = MessageVisitor::default();
        event.record(&mut visitor);
        let mut hasher = DefaultHasher::new();
        event.metadata().callsite().hash(&mut hasher);
        // `back after 3.1 s` and `back after 7.4 s` are the same message.
        visitor.0.bytes().filter(|b| !b.is_ascii_digit()).for_each(|b| b.hash(&mut hasher));
        let mut limiter = self.0.limiter.lock().unwrap_or_else(PoisonError::into_inner);
        limiter.allows(hasher.finish(), &visitor.0, Instant::now())
    }
}

/// Extracts the message of an event.
#[derive(Default)]
struct MessageVisitor(String);

impl Visit for MessageVisitor {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            // Writing into a String does not fail.
            write!(self.0, "{value:?}").ok();
        }
    }
}

#[derive(Debug, Default)]
struct RateLimiter {
    messages: HashMap<u64, MessageCount>,
}

#[derive(Debug)]
struct MessageCount {
    since: Instant,
    passed: u32,
    suppressed: u64,
    sample: String,
}

impl RateLimiter {
    fn allows(&mut self, message: u64, text: &str, now: Instant) -> bool {
        // Windows that are over are forgotten once their suppressed messages have been logged.
        if self.messages.len() >= MESSAGES_MAX {
            self.messages.retain(|_, count| count.suppressed > 0 || !count.is_over(now));
        }
        let is_full = self.messages.len() >= MESSAGES_MAX && !self.messages.contains_key(&message);
        let key = if is_full { 0 } else { message };
        let count = self.messages.entry(key).or_insert_with(|| MessageCount::new(now));
        if count.suppressed == 0 && count.is_over(now) {
            *count = MessageCount::new(now);
        }
        if count.passed < BURST {
            count.passed += 1;
            return true;
        }
        count.suppressed += 1;
        if count.sample.is_empty() {
            count.sample = text.chars().take(SAMPLE_BYTES_MAX / 4).collect();
        }
        false
    }

    fn take_suppressed(&mut self, now: Instant, all: bool) -> Vec<(u64, String)> {
        let mut found = Vec::new();
        self.messages.retain(|_, count| {
            let is_due = all || count.is_over(now);
            if is_due && count.suppressed > 0 {
                found.push((count.suppressed, std::mem::take(&mut count.sample)));
            }
            !is_due
        });
        found
    }
}

impl MessageCount {
    fn new(since: Instant) -> Self {
        Self { since, passed: 0, suppressed: 0, sample: String::new() }
    }

    fn is_over(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.since) >= WINDOW
    }
}

/// Time between checks for suppressed messages.
const SUMMARY_INTERVAL: Duration = Duration::from_secs(5);

/// The thread that logs how many messages were suppressed. Dropping it logs the rest.
#[derive(Debug)]
pub(super) struct SummaryThread {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for SummaryThread {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

impl SummaryThread {
    pub(super) fn start(filter: Arc<LogFilter>) -> anyhow::Result<Self> {
        let (stop, stopped) = bounded::<()>(1);
        // Tests set a subscriber for the current thread only: the new thread inherits it.
        let dispatch = tracing::dispatcher::get_default(Clone::clone);
        let run = move || {
            while stopped.recv_timeout(SUMMARY_INTERVAL) == Err(RecvTimeoutError::Timeout) {
                log_summaries(&filter, false);
            }
            log_summaries(&filter, true);
        };
        let thread = threads::spawn("mocapd-log", move || {
            tracing::dispatcher::with_default(&dispatch, run);
        })?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

fn log_summaries(filter: &LogFilter, all: bool) {
    for (n, sample) in filter.take_suppressed(Instant::now(), all) {
        tracing::warn!(target: SUMMARY, left_out = n, "{n} similar messages suppressed: {}", visible(&sample));
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
    fn a_message_passes_ten_times_a_minute_and_the_rest_is_counted() {
        let (mut limiter, start) = (RateLimiter::default(), Instant::now());
        let passed = (0..100).filter(|_| limiter.allows(1, "it stalls", start)).count();
        assert_eq!(passed, 10);
        assert!(limiter.allows(2, "something else", start), "another message");
        assert_eq!(limiter.take_suppressed(start + WINDOW / 2, false), [], "not over");
        let later = start + WINDOW;
        assert_eq!(limiter.take_suppressed(later, false), [(90, "it stalls".to_owned())]);
        assert!(limiter.allows(1, "it stalls", later), "a new minute");
        assert_eq!(limiter.take_suppressed(later, true), [], "nothing was left out since");
    }

    #[test]
    fn suppressed_messages_are_counted_even_when_there_are_many() {
        let (mut limiter, start) = (RateLimiter::default(), Instant::now());
        let mut passed = 0;
        for message in 1..=10_000 {
            passed += u64::from(limiter.allows(message, "m", start));
        }
        assert!(limiter.messages.len() <= MESSAGES_MAX + 1, "{}", limiter.messages.len());
        let left_out: u64 = limiter.take_suppressed(start, true).iter().map(|(n, _)| n).sum();
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

    /// Runs `scene` with a log, and returns what it wrote.
    fn logged(level: Level, scene: impl FnOnce(&LogFilter)) -> String {
        let (memory, filter) = (Memory::default(), Arc::new(LogFilter::new(level)));
        let registry = tracing_subscriber::registry()
            .with(lines(memory.clone()))
            .with(FilterLayer(Arc::clone(&filter)));
        tracing::subscriber::with_default(registry, || {
            let _running = SummaryThread::start(Arc::clone(&filter)).unwrap();
            scene(&filter);
        });
        String::from_utf8(memory.0.lock().unwrap().clone()).unwrap()
    }

    #[test]
    fn messages_have_their_fields_and_are_filtered_by_level() {
        let text = logged(Level::Info, |_| {
            tracing::info!(take = "jump.take", device = "usb:1209:0001", "a take has begun");
            tracing::debug!("below the level");
        });
        let line = text.lines().find(|line| line.contains("a take has begun")).unwrap();
        assert!(line.contains("take=\"jump.take\" device=\"usb:1209:0001\""), "{line}");
        assert!(!text.contains("below the level"), "{text}");
    }

    #[test]
    fn the_level_can_change() {
        let text = logged(Level::Error, |filter| {
            tracing::debug!("before");
            filter.set_level(Level::Debug);
            tracing::debug!("after");
        });
        assert!(!text.contains("before") && text.contains("after"), "{text}");
    }

    #[test]
    fn repeated_messages_are_counted_and_summarised() {
        let text = logged(Level::Info, |_| {
            for n in 0..50 {
                tracing::warn!("the device stalled {n} times");
            }
        });
        assert_eq!(text.matches("WARN the device stalled").count(), 10, "{text}");
        // One more line has the number of suppressed messages, and a sample.
        let rest: Vec<_> = text.lines().filter(|line| line.contains("left_out=40")).collect();
        assert!(rest.len() == 1 && rest[0].contains("the device stalled"), "{text}");
    }
}
