//! A recording with a status display, ended by Ctrl-C or by its limits; with `--split`, when its next take begins;
//! with `--raw`, the log of the bytes of the line beside the take.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use mocapd::outcome::UsageError;
use mocapd_acquire::{
    pipeline::PipelineProgress,
    raw_log::{RawLog, RawLogged},
    record::{RecordOptions, Recorded, record},
    rig::Rig,
    series::{RecordedSeries, SeriesOptions, TakeLength, TakeNames, record_series},
    setting::{self, Setting, SettingRefused},
};
use mocapd_codec::Settings;
use mocapd_service::{subject::unused_part_notes, units};
use mocapd_take::record::Subject;
use serde::Serialize;

use crate::cli::{
    output::{Progress, notify, plain_path},
    paths,
    values::{bytes, thousands},
};

/// The limits that end a recording, and the subject of its take.
#[derive(Debug)]
pub(crate) struct Limits {
    /// End after this time.
    pub(crate) length: Option<Duration>,
    /// End when no more than this is free on the disk.
    pub(crate) keep_free_bytes: u64,
    /// Size of the raw log, if it grows on the same disk.
    pub(crate) raw_log_bytes: Option<Arc<AtomicU64>>,
    /// The subject to store in the take.
    pub(crate) subject: Option<Subject>,
}

/// Records `rig` to `take` and shows the progress on stderr.
pub(crate) fn record_and_watch(
    rig: Rig,
    take: &Path,
    codec: Settings,
    limits: &Limits,
    stop: &AtomicBool,
) -> anyhow::Result<Recorded> {
    watched(rig, take, codec, limits, stop, record)
}

/// Records `rig` to a series of takes and shows the progress on stderr.
pub(super) fn record_series_and_watch(
    rig: Rig,
    output: &Path,
    series: &SeriesOptions,
    codec: Settings,
    limits: &Limits,
    stop: &AtomicBool,
) -> anyhow::Result<RecordedSeries> {
    let record = |rig, options: &mut RecordOptions<'_>| record_series(rig, options, series);
    watched(rig, output, codec, limits, stop, record)
}

/// Runs a recording with a status display.
fn watched<T>(
    rig: Rig,
    take: &Path,
    codec: Settings,
    limits: &Limits,
    stop: &AtomicBool,
    record: impl FnOnce(Rig, &mut RecordOptions<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let mut display = None;
    let mut started = |progress: &Arc<PipelineProgress>| {
        let progress = Arc::clone(progress);
        if let Some(bytes) = &limits.raw_log_bytes {
            // This cannot fail: the pipeline is new, so the cell is empty.
            progress.raw_log_bytes.set(Arc::clone(bytes)).ok();
        }
        display = Some(Progress::status(move || {
            let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
            format!(
                "recording{}: {} frames, {} lost, {} on disk{}{}",
                part(progress.takes_begun.load(Ordering::Relaxed)),
                thousands(get(&progress.frames)),
                thousands(get(&progress.lost)),
                bytes(get(&progress.file_bytes)),
                disk_left(get(&progress.disk_left_s)),
                clock(&progress)
            )
        }));
    };
    let &Limits { length, keep_free_bytes, .. } = limits;
    let channels = rig.pipeline_config(codec).channels;
    let labels: Vec<String> = channels.into_iter().map(|channel| channel.label).collect();
    // Without labels there is nothing to compare yet: the device may announce its markers later.
    if !labels.is_empty() {
        unused_part_notes(limits.subject.as_ref(), &labels).iter().for_each(|note| notify(note));
    }
    let mut options = RecordOptions {
        take,
        codec,
        subject: limits.subject.as_ref(),
        length,
        keep_free_bytes,
        stop,
        notify: &notify,
        how_to_end: "; Ctrl-C finishes the take",
        how_to_set: with_option,
        started: &mut started,
    };
    let recorded = record(rig, &mut options);
    drop(display);
    recorded.map_err(name_option)
}

/// Rewrites a refused setting to name the command-line option that solves it.
pub(super) fn name_option(error: anyhow::Error) -> anyhow::Error {
    if !error.is::<SettingRefused>() {
        return error;
    }
    anyhow::Error::msg(setting::message(&error, with_option))
}

fn with_option(setting: Setting) -> String {
    match setting {
        Setting::Rate(Some(rate_hz)) => format!("record with --rate {rate_hz}"),
        Setting::Rate(None) => "omit --rate".to_owned(),
        Setting::KeepFree => "lower --keep-free".to_owned(),
    }
}

/// The number of the take that is being written, if the recording is divided.
fn part(takes_begun: u32) -> String {
    if takes_begun == 0 { String::new() } else { format!(" part {takes_begun}") }
}

/// How long the free disk space lasts at the current rate, in hours and minutes; empty while unknown.
fn disk_left(left_s: u64) -> String {
    const LONG_H: u64 = 1000;
    let (hours, minutes) = (left_s / 3600, left_s / 60 % 60);
    match left_s {
        u64::MAX => String::new(),
        _ if hours >= LONG_H => format!(", disk space for more than {LONG_H} h"),
        _ => format!(", disk space for {hours}:{minutes:02} h"),
    }
}

/// Drift and jitter of the device's clock; empty while unknown.
fn clock(progress: &PipelineProgress) -> String {
    let p99_us = progress.jitter_p99_us.load(Ordering::Relaxed);
    if p99_us == 0 {
        return String::new();
    }
    let drift_ppm = progress.drift_ppb.load(Ordering::Relaxed) as f64 / 1e3;
    format!(", drift {drift_ppm:+.1} ppm, jitter {:.1} ms (p99)", p99_us as f64 * 1e-3)
}

/// The shortest take: two stretches of the default length. Shorter ones would consist mostly of the header, the key
/// stretch and the end that every take has.
const TIME_MIN: Duration = Duration::from_secs(1);

/// The smallest take, for the same reason: a device of many markers fills it in about a second.
const BYTES_MIN: u64 = 1_000_000;

/// The value of `--split`.
#[derive(Debug, Clone)]
pub(super) struct SplitValue {
    length: TakeLength,
    text: String,
}

/// Parses the length of a take: a time or a size, told apart by the unit.
///
/// # Errors
/// What is wrong, and what to type instead.
pub(super) fn parse_split(text: &str) -> Result<SplitValue, String> {
    let text = text.trim();
    let value = |length| Ok(SplitValue { length, text: text.to_owned() });
    if text.ends_with('B') {
        let bytes = units::size_bytes(text)?;
        if bytes < BYTES_MIN {
            return Err(format!(
                "takes of '{text}' would be mostly header and key stretch: give at least 1MB"
            ));
        }
        return value(TakeLength::Bytes(bytes));
    }
    if !text.ends_with(char::is_alphabetic) {
        return Err(format!(
            "'{text}' has no unit: give a time such as 10s, or a size such as 500MB"
        ));
    }
    let time = units::duration(text)
        .map_err(|error| format!("{error}, or a size in B, kB, MB, GB, MiB or GiB"))?;
    if time < TIME_MIN {
        return Err(format!(
            "takes of '{text}' would be mostly header and key stretch: give at least 1s"
        ));
    }
    value(TakeLength::Time(time))
}

impl SplitValue {
    /// How to divide a recording to `output` that ends after `length`, with stretches of this length.
    ///
    /// # Errors
    /// A usage error for takes shorter than a stretch, and for an output that cannot be numbered.
    pub(super) fn options(
        &self,
        output: &Path,
        length: Option<Duration>,
        stretch: Duration,
    ) -> anyhow::Result<SeriesOptions> {
        if paths::is_dash(output) || output.is_dir() {
            let output = output.display();
            return Err(UsageError(format!(
                "--output {output} cannot be numbered: with --split, give a name such as run.take"
            ))
            .into());
        }
        let mut n_takes_max = None;
        if let TakeLength::Time(time) = self.length {
            if time < stretch {
                let split = &self.text;
                return Err(UsageError(format!(
                    "takes of {split} are shorter than a stretch of {stretch:?}: give a longer --split, or a shorter --stretch"
                ))
                .into());
            }
            n_takes_max = length.map(|length| length.as_nanos().div_ceil(time.as_nanos()) as u64);
        }
        let names = TakeNames::new(output, n_takes_max);
        Ok(SeriesOptions { length: self.length, length_text: self.text.clone(), names })
    }
}

/// The result of a raw log, documented in docs/json.md.
#[derive(Debug, Serialize)]
pub(crate) struct RawLogReport {
    log: PathBuf,
    file_bytes: u64,
    line_bytes: u64,
    missing_bytes: Option<u64>,
    error: Option<String>,
}

impl RawLogReport {
    fn new(path: &Path, logged: &RawLogged) -> Self {
        let RawLogged { file_bytes, line_bytes, missing_bytes, ref error } = *logged;
        // The file also holds the part of the last block that was written before the error.
        let found = path.metadata().map_or(file_bytes, |found| found.len());
        let file_bytes = if error.is_some() { found } else { file_bytes };
        let error = error.as_ref().map(ToString::to_string);
        let missing_bytes = Some(missing_bytes);
        Self { log: path.to_owned(), file_bytes, line_bytes, missing_bytes, error }
    }

    /// The report of a log whose counts are unknown because its writer failed; the take is not affected.
    fn of_failed(path: &Path, error: &anyhow::Error) -> Self {
        let file_bytes = path.metadata().map_or(0, |found| found.len());
        let error = Some(format!("{error:#}"));
        Self { log: path.to_owned(), file_bytes, line_bytes: 0, missing_bytes: None, error }
    }

    /// Whether bytes of the line are missing.
    pub(crate) fn lost(&self) -> bool {
        self.missing_bytes.is_none_or(|n| n > 0) || self.error.is_some()
    }

    /// One line with the log's size.
    pub(crate) fn text(&self) -> String {
        let what = if self.lost() { "incomplete raw log" } else { "raw log" };
        let [file, line] = [self.file_bytes, self.line_bytes].map(bytes);
        format!("{}: {what}, {file} with {line} of line data\n", plain_path(&self.log))
    }

    /// The missing bytes, in one line; `None` if the log is complete.
    pub(crate) fn losses(&self) -> Option<String> {
        let missing =
            self.missing_bytes.map_or_else(|| "an unknown number of bytes".to_owned(), bytes);
        match &self.error {
            Some(error) => Some(format!(
                "the raw log {} ends early, {missing} of line data are missing: {error}; the rest can be replayed",
                self.log.display()
            )),
            None if self.lost() => {
                Some(format!("{missing} of line data are missing from the raw log: disk too slow"))
            }
            None => None,
        }
    }
}

/// Records with a raw log at `path`, if given; returns the log's report with the recording, and prints what the log
/// lacks. After an error the log is removed unless `has_take` finds a take.
///
/// # Errors
/// Those of the recording, or if the log cannot be created. A log that ends early is not an error.
pub(super) fn with_raw_log<T>(
    path: Option<&Path>,
    has_take: impl FnOnce() -> bool,
    sync_every: Duration,
    record: impl FnOnce(Option<&RawLog>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Option<RawLogReport>)> {
    let Some(path) = path else { return record(None).map(|recorded| (recorded, None)) };
    let log = RawLog::start(path, sync_every)?;
    let recorded = record(Some(&log));
    let logged = log.finish();
    if recorded.is_err() && !has_take() {
        // No frame arrived: as with the take, no file is left behind.
        std::fs::remove_file(path).ok();
        return recorded.map(|recorded| (recorded, None));
    }
    let report = match logged {
        Ok(logged) => RawLogReport::new(path, &logged),
        Err(error) => RawLogReport::of_failed(path, &error),
    };
    if let Some(losses) = report.losses() {
        notify(&losses);
    }
    recorded.map(|recorded| (recorded, Some(report)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_tells_a_time_from_a_size() {
        for (text, length) in [
            ("10s", TakeLength::Time(Duration::from_secs(10))),
            ("1500ms", TakeLength::Time(Duration::from_millis(1500))),
            ("2min", TakeLength::Time(Duration::from_secs(120))),
            ("10m", TakeLength::Time(Duration::from_secs(600))),
            ("1h", TakeLength::Time(Duration::from_secs(3600))),
            ("500MB", TakeLength::Bytes(500_000_000)),
            ("2 GiB", TakeLength::Bytes(2 << 30)),
        ] {
            assert_eq!(parse_split(text).unwrap().length, length, "{text}");
        }
        for text in ["10", "", "0s", "999ms", "999kB", "-1s", "-5MB", "1 floppy", "MB", "s"] {
            assert!(parse_split(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_numbers_have_digits_for_all_takes() {
        let options = |split_text: &str, length| {
            let length = Some(Duration::from_secs(length));
            let stretch = Duration::from_secs(2);
            parse_split(split_text).unwrap().options(Path::new("a.take"), length, stretch)
        };
        let first = |options: SeriesOptions| options.names.path(1);
        assert_eq!(first(options("10s", 9990).unwrap()), Path::new("a-001.take"));
        assert_eq!(first(options("10s", 9991).unwrap()), Path::new("a-0001.take"));
        assert_eq!(first(options("10MB", 9991).unwrap()), Path::new("a-001.take"));
        assert!(options("1s", 10).unwrap_err().is::<UsageError>(), "shorter than a stretch");
    }
}
