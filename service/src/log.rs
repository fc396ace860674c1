//! The log of the service: to the journal with fields, or to stderr without a journal. Messages are filtered by level, and
//! repeated ones are limited; a thread that may wait for the journal logs how many were suppressed.
//!
//! Threads that must not wait do not log directly: the reader's messages go through the engine's watcher
//! (`engine/watcher.rs`).
//!
//! Text from outside is escaped ([`mocapd_take::escape`]): on stderr by the layer that writes lines. The journal keeps
//! fields apart, so that entries cannot be forged, but shows their bytes unchanged; text from outside is therefore
//! also escaped where it is logged.

use std::{
    collections::HashMap,
    fmt::{self, Write},
    hash::{DefaultHasher, Hash, Hasher},
    io,
    str::FromStr,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU8, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::Context;
use crossbeam_channel::{RecvTimeoutError, Sender, bounded};
use mocapd_acquire::threads;
use mocapd_take::escape::visible;
use tracing::{
    Event, Metadata, Subscriber,
    field::{Field, Visit},
    level_filters::LevelFilter,
    subscriber::Interest,
};
use tracing_subscriber::{
    Layer, Registry,
    field::MakeExt,
    fmt::{MakeWriter, format, time::FormatTime},
    layer::{self, SubscriberExt},
    util::SubscriberInitExt,
};

use crate::units;

/// Prefix of our fields in the journal: `MOCAPD_RIG`, `MOCAPD_TAKE`, `MOCAPD_DEVICE`.
const PREFIX: &str = "MOCAPD";

/// How much is logged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Level {
    /// Errors.
    Error,
    /// Errors and warnings.
    Warn,
    /// Also normal events: takes that start and stop, devices that connect and disconnect.
    #[default]
    Info,
    /// Also details.
    Debug,
    /// Everything.
    Trace,
}

impl Level {
    /// From the fewest messages to the most.
    pub const ALL: [Self; 5] = [Self::Error, Self::Warn, Self::Info, Self::Debug, Self::Trace];

    /// The names used in the configuration.
    pub(crate) const NAMES: [&str; 5] = ["error", "warn", "info", "debug", "trace"];

    fn filter(self) -> LevelFilter {
        use LevelFilter as Filter;
        [Filter::ERROR, Filter::WARN, Filter::INFO, Filter::DEBUG, Filter::TRACE][self as usize]
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(Self::NAMES[*self as usize])
    }
}

impl FromStr for Level {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|level| level.to_string() == text);
        found.ok_or_else(|| format!("no level '{text}': use error, warn, info, debug or trace"))
    }
}

/// The running log. Dropping it logs what the rate limit left out.
#[derive(Debug)]
pub struct Log {
    filter: Arc<LogFilter>,
    _summaries: SummaryThread,
}

impl Log {
    /// Sends everything logged through `tracing` to the journal if stderr is the journal, and otherwise to `stderr`.
    /// `rig` becomes a field of every journal entry.
    ///
    /// # Errors
    /// A log is running already, or its thread cannot be started.
    pub fn start<W>(level: Level, rig: &str, stderr: W) -> anyhow::Result<Self>
    where
        W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
    {
        let filter = Arc::new(LogFilter::new(level));
        let out: Box<dyn Layer<Registry> + Send + Sync> =
            match stderr_is_the_journal().then(|| journal(rig)).and_then(Result::ok) {
                Some(journal) => Box::new(journal),
                None => Box::new(lines(stderr)),
            };
        let layer = FilterLayer(Arc::clone(&filter));
        let registry = tracing_subscriber::registry().with(out).with(layer);
        registry.try_init().context("the log is already running")?;
        let summaries = SummaryThread::start(Arc::clone(&filter))?;
        Ok(Self { filter, _summaries: summaries })
    }

    /// Changes the level.
    pub fn set_level(&self, level: Level) {
        self.filter.set_level(level);
    }
}

/// Whether stderr is the journal: systemd gives its device and inode in `JOURNAL_STREAM`.
fn stderr_is_the_journal() -> bool {
    let Ok(stat) = rustix::fs::fstat(rustix::stdio::stderr()) else { return false };
    std::env::var("JOURNAL_STREAM")
        .is_ok_and(|stream| stream == format!("{}:{}", stat.st_dev, stat.st_ino))
}

fn journal(rig: &str) -> io::Result<tracing_journald::Layer> {
    use tracing_journald::{Priority, PriorityMappings};
    let priorities = PriorityMappings {
        info: Priority::Informational,
        debug: Priority::Debug,
        ..PriorityMappings::new()
    };
    Ok(tracing_journald::layer()?
        .with_field_prefix(Some(PREFIX.to_owned()))
        .with_custom_fields([(format!("{PREFIX}_RIG"), rig)])
        .with_priority_mappings(priorities)
        .with_syslog_identifier("mocapd".to_owned()))
}

/// The time in front of each line on stderr; the journal has its own.
struct LocalTime;

impl FormatTime for LocalTime {
    fn format_time(&self, out: &mut format::Writer<'_>) -> fmt::Result {
        out.write_str(&units::local_now())
    }
}

fn lines<W>(writer: W) -> impl Layer<Registry> + Send + Sync
where
    W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
{
    // Any field, especially the message, may quote a mark, a name or a device: each event stays on one line.
    let fields = format::debug_fn(|out, field, value| {
        let text = format!("{value:?}");
        match field.name() {
            "message" => write!(out, "{}", visible(&text)),
            name => write!(out, "{name}={}", visible(&text)),
        }
    });
    tracing_subscriber::fmt::layer()
        .with_timer(LocalTime)
        .with_target(false)
        .with_ansi(false)
        .fmt_fields(fields.delimited(" "))
        .with_writer(writer)
}

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
const SUMMARY: &str = "mocapd_service::log::summary";

/// The level and rate limit of all threads.
#[derive(Debug)]
struct LogFilter {
    level: AtomicU8,
    limiter: Mutex<RateLimiter>,
}

impl LogFilter {
    fn new(level: Level) -> Self {
        Self { level: AtomicU8::new(level as u8), limiter: Mutex::default() }
    }

    fn set_level(&self, level: Level) {
        self.level.store(level as u8, Ordering::Relaxed);
        tracing::callsite::rebuild_interest_cache();
    }

    fn level(&self) -> Level {
        Level::ALL[usize::from(self.level.load(Ordering::Relaxed)).min(Level::ALL.len() - 1)]
    }

    /// Numbers of suppressed messages, with a sample of each, whose time window is over; or of all windows.
    fn take_suppressed(&self, now: Instant, all: bool) -> Vec<(u64, String)> {
        self.limiter.lock().unwrap_or_else(PoisonError::into_inner).take_suppressed(now, all)
    }
}

/// The filter as a layer of the subscriber.
#[derive(Debug)]
struct FilterLayer(Arc<LogFilter>);

impl<S: Subscriber> Layer<S> for FilterLayer {
    fn register_callsite(&self, _: &'static Metadata<'static>) -> Interest {
        // The level may change later.
        Interest::sometimes()
    }

    fn enabled(&self, metadata: &Metadata<'_>, _: layer::Context<'_, S>) -> bool {
        metadata.is_span() || *metadata.level() <= self.0.level().filter()
    }

    fn event_enabled(&self, event: &Event<'_>, _: layer::Context<'_, S>) -> bool {
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
struct SummaryThread {
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
    fn start(filter: Arc<LogFilter>) -> anyhow::Result<Self> {
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
    fn levels_have_names() {
        for level in Level::ALL {
            assert_eq!(level.to_string().parse(), Ok(level));
        }
        let error = "loud".parse::<Level>().unwrap_err();
        let names = Level::ALL.map(|level| level.to_string());
        assert!(
            error.contains("'loud'") && names.iter().all(|name| error.contains(name)),
            "{error}"
        );
    }

    #[test]
    fn a_terminal_is_not_the_journal() {
        assert!(!stderr_is_the_journal());
    }

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
