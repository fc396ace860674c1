//! The log of the service: to the journal with fields, or to stderr without a journal.
//!
//! Threads that must not wait do not log directly: the reader's messages go through the engine's watcher
//! (`engine/events.rs`).
//!
//! Text from outside is escaped ([`mocapd_take::escape`]): on stderr by the layer that writes lines. The journal keeps
//! fields apart, so that entries cannot be forged, but shows their bytes unchanged; text from outside is therefore
//! also escaped where it is logged.

mod rate_limit;

use std::{fmt, io, str::FromStr, sync::Arc};

use anyhow::Context;
use mocapd_take::escape::visible;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::{
    Layer, Registry,
    field::MakeExt,
    fmt::{MakeWriter, format, time::FormatTime},
    layer::SubscriberExt,
    util::SubscriberInitExt,
};

use self::rate_limit::{LogFilter, SummaryThread};
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
        let layer = rate_limit::FilterLayer(Arc::clone(&filter));
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
