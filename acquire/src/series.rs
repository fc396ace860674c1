//! Records to a series of takes: a recording that is divided by time or by size.
//!
//! Each take is complete. Its header states the series and which rows of the recording the take holds. A thread receives
//! the results of the takes, in order, and finds where their files are now, so that the writer need not.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use anyhow::bail;
use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_take::{
    motion::frame_at,
    record::{
        FIRST_FRAME_SETTING, Header, Ledger, PART_SETTING, SERIES_SETTING, SPLIT_SETTING,
        SampleLedger, Subject,
    },
};

use crate::{
    files::{FileId, FileState, NameTaken, SettledFile, TakeFile},
    header,
    pipeline::{
        NewTake, NextTake, NothingRecorded, Pipeline, Split, SplitAt, TakeAccount, TakeResult,
        TakeSeries, check_disk_space,
    },
    record::{RecordOptions, Recorded, explain_early_end, nothing_recorded},
    rig::{ReaderOutcome, Rig},
    threads,
};

/// Takes whose files are still to be settled. That takes no time unless a removed take is being copied; the writer then
/// waits with the take after these, as for a slow disk.
const UNSETTLED_MAX: usize = 8;

/// Names that are tried for a take, at a system call each: more than other recordings leave in a folder.
const NAMES_TRIED_MAX: u64 = 10_000;

/// When a take of a series is long enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TakeLength {
    /// After this time, as a number of frames at the device's rate.
    Time(Duration),
    /// At the first end of a stretch at which the file has this many bytes.
    Bytes(u64),
}

/// How to divide a recording.
#[derive(Debug, Clone)]
pub struct SeriesOptions {
    /// When a take is long enough.
    pub length: TakeLength,
    /// The length as requested, for the header.
    pub length_text: String,
    /// The names of the takes.
    pub names: TakeNames,
}

/// A finished recording of several takes.
#[derive(Debug)]
pub struct RecordedSeries {
    /// The takes in order; at least one.
    pub takes: Vec<SeriesTake>,
    /// The recording as a whole: what its takes count, added up; clock, disk and ending of the last take; the state of
    /// the first file that is not in its place, if there is one.
    pub total: Recorded,
}

/// Records until the device ends, the length is reached, or `stop` is set.
///
/// # Errors
/// When nothing was recorded (no file is left then), or a take could not be written to its end. The takes before it are
/// complete.
pub fn record_series(
    rig: Rig,
    options: &mut RecordOptions<'_>,
    series: &SeriesOptions,
) -> anyhow::Result<RecordedSeries> {
    check_disk_space(&series.names.path(1), options.keep_free_bytes)?;
    let config = rig.pipeline_config(options.codec);
    let header = rig.take_header(&config)?;
    let (rate_hz, markers) = (config.rate_hz, config.channels.len());
    let at = match series.length {
        TakeLength::Time(time) => SplitAt::Rows {
            rows: frame_at(time, rate_hz).max(u64::from(config.stretch_rows())),
            end_row: options.length.map(|length| frame_at(length, rate_hz)),
        },
        TakeLength::Bytes(bytes) => SplitAt::Bytes(bytes),
    };
    let (started_in, started) = bounded(UNSETTLED_MAX);
    let collector = threads::spawn("mocapd-takes", move || collect(&started))?;
    let takes = Box::new(Series::new(header, options, series, started_in));
    let run = Pipeline::start_series(&config, Split { at, takes }).map(|(intake, pipeline)| {
        let progress = Arc::clone(pipeline.progress());
        (options.started)(&progress);
        let recording = rig.read(intake, &options.read_options(rate_hz));
        let joined = pipeline.join();
        progress.take_notices().iter().for_each(|text| (options.notify)(text));
        (recording, joined, progress.failed.load(Ordering::Relaxed))
    });
    // The series is gone with the writer: its takes have all ended.
    let mut collected = threads::join(collector)?;
    let (recording, joined, has_failed) = match run {
        Ok(run) => run,
        Err(error) => return Err(collected.discard(error)),
    };
    // A take that could not begin is not a failure when the one before it continued.
    let failure = collected.failure.take().filter(|_| has_failed).or(joined.err());
    let recording = match (failure, recording) {
        (Some(error), _) | (None, Err(error)) => return Err(collected.explain(error)),
        (None, Ok(recording)) => recording,
    };
    if collected.takes.is_empty() {
        return Err(collected.explain(nothing_recorded(recording.ending)));
    }
    let takes = collected.takes;
    let total = total(&takes, recording, rate_hz, markers);
    Ok(RecordedSeries { takes, total })
}

/// The recording as a whole.
fn total(takes: &[SeriesTake], recording: ReaderOutcome, rate_hz: f64, markers: usize) -> Recorded {
    let mut written = TakeAccount {
        ledger: Ledger { finished: true, ..Ledger::default() },
        ..TakeAccount::default()
    };
    let mut clock_lines = BTreeMap::new();
    for take in takes {
        let part = &take.written;
        add_ledger(&mut written.ledger, &part.ledger, take);
        if let Some(samples) = &part.sample_ledger {
            let none = SampleLedger { finished: true, ..SampleLedger::default() };
            let sum = written.sample_ledger.get_or_insert(none);
            sum.finished &= samples.finished;
            sum.add_counters(samples);
        }
        written.file_bytes += part.file_bytes;
        written.samples += part.samples;
        written.kept += part.kept;
        written.max_error_mm = written.max_error_mm.max(part.max_error_mm);
        // The last take may be too short to fit a line.
        if part.clock.line.is_some() || written.clock.line.is_none() {
            written.clock = part.clock;
        }
        written.disk = part.disk;
        written.ending.clone_from(&part.ending);
        // The line of a segment that continues is better known in the next take.
        clock_lines.extend(part.clock_lines.iter().copied());
    }
    written.clock_lines = clock_lines.into_iter().collect();
    let displaced =
        takes.iter().map(|take| &take.file).find(|file| file.state != FileState::InPlace);
    let file = displaced.map_or_else(SettledFile::default, |file| SettledFile {
        state: file.state,
        ..SettledFile::default()
    });
    Recorded { written, recording, file, rate_hz, markers }
}

fn add_ledger(sum: &mut Ledger, part: &Ledger, take: &SeriesTake) {
    sum.finished &= part.finished;
    sum.add_counters(part);
    let named = |text: &String| format!("{}: {text}", take.path.display());
    sum.contradictions.extend(part.contradictions.iter().map(named));
    sum.clock = part.clock.or(sum.clock);
}

/// Creates the takes of a series. Belongs to the writer.
struct Series {
    names: TakeNames,
    /// The header of the first take, with the settings that all takes have.
    header: Header,
    subject: Option<Arc<Subject>>,
    keep_free_bytes: u64,
    next_part: u64,
    /// The number in the next name, which differs from `next_part` after names that were taken.
    next_number: u64,
    started: Sender<StartedTake>,
}

impl Series {
    fn new(
        mut header: Header,
        options: &RecordOptions<'_>,
        series: &SeriesOptions,
        started: Sender<StartedTake>,
    ) -> Self {
        header.settings.push((SPLIT_SETTING.to_owned(), series.length_text.clone()));
        header.settings.push((SERIES_SETTING.to_owned(), header.take_id_text()));
        Self {
            names: series.names.clone(),
            header,
            subject: options.subject.cloned().map(Arc::new),
            keep_free_bytes: options.keep_free_bytes,
            next_part: 1,
            next_number: 1,
            started,
        }
    }

    /// Creates the file of the next take, under the next free name. The first take has the first name.
    fn create_file(&mut self) -> anyhow::Result<(TakeFile, PathBuf)> {
        for _ in 0..NAMES_TRIED_MAX {
            let path = self.names.path(self.next_number);
            match TakeFile::create(&path) {
                Err(error) if self.next_part > 1 && error.is::<NameTaken>() => {
                    self.next_number += 1;
                }
                created => {
                    let file = created?;
                    self.next_number += 1;
                    return Ok((file, path));
                }
            }
        }
        bail!(
            "no free name for the next take: all names up to {} exist already; move those files, or record under another name",
            self.names.path(self.next_number).display()
        )
    }

    fn header(&self, first_row: u64) -> anyhow::Result<Header> {
        let mut header = self.header.clone();
        if self.next_part > 1 {
            header.take_id = header::new_take_id()?;
        }
        let since_first_ms = first_row as f64 / header.rate_hz * 1e3;
        header.created_unix_ms = header.created_unix_ms.saturating_add(since_first_ms as i64);
        header.settings.push((PART_SETTING.to_owned(), self.next_part.to_string()));
        header.settings.push((FIRST_FRAME_SETTING.to_owned(), first_row.to_string()));
        Ok(header)
    }
}

impl TakeSeries for Series {
    fn next_take(&mut self, first_row: u64) -> anyhow::Result<NextTake> {
        let header = self.header(first_row)?;
        let wanted = self.names.path(self.next_number);
        let (file, path) = self.create_file()?;
        let notice = (path != wanted).then(|| {
            let (wanted, path) = (wanted.display(), path.display());
            format!("{wanted} exists already: the recording continues in {path}")
        });
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (ended, result) = bounded(1);
        let (part, id) = (self.next_part, file.id());
        self.next_part += 1;
        let take = NewTake {
            subject: self.subject.clone(),
            keep_free_bytes: self.keep_free_bytes,
            ..NewTake::new(file, header)
        };
        // The collector ends after this series.
        self.started.send(StartedTake { path, id, part, first_row, result }).ok();
        Ok(NextTake { take, name, ended, notice })
    }
}

/// Digits of the numbers in the names, at least.
const DIGITS_MIN: usize = 3;

/// Numbers that [`TakeNames::any_exists`] looks for, at a system call each: a day of takes of ten seconds.
const NAMES_SOUGHT_MAX: u64 = 8640;

/// The names of the takes of a series: `run-001.take`, `run-002.take` and so on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TakeNames {
    base: PathBuf,
    digits: usize,
}

impl TakeNames {
    /// Names made from `base`, such as `run.take`. The numbers have at least three digits; if the largest number of
    /// takes is known, as many as it, so that the names sort in the order of the takes.
    #[must_use]
    pub fn new(base: &Path, n_takes_max: Option<u64>) -> Self {
        let digits = n_takes_max.map_or(0, |n| n.to_string().len());
        Self { base: base.to_owned(), digits: digits.max(DIGITS_MIN) }
    }

    /// The path of the take with this number, from 1.
    #[must_use]
    pub fn path(&self, number: u64) -> PathBuf {
        let mut name = self.base.file_stem().unwrap_or_default().to_owned();
        name.push(format!("-{number:0digits$}", digits = self.digits));
        if let Some(extension) = self.base.extension() {
            name.push(".");
            name.push(extension);
        }
        self.base.with_file_name(name)
    }

    /// Whether a file has one of these names. Takes that were moved away are not counted.
    #[must_use]
    pub fn any_exists(&self) -> bool {
        (1..=NAMES_SOUGHT_MAX).any(|number| self.path(number).exists())
    }
}

/// A take whose file was created.
#[derive(Debug)]
struct StartedTake {
    path: PathBuf,
    id: FileId,
    part: u64,
    first_row: u64,
    result: Receiver<TakeResult>,
}

/// A take of a series that was written to its end.
#[derive(Debug)]
pub struct SeriesTake {
    /// The name under which it was created.
    pub path: PathBuf,
    /// Its number in the series, from 1.
    pub part: u64,
    /// The row of the recording that is its row 0.
    pub first_row: u64,
    /// What is on disk.
    pub written: TakeAccount,
    /// Where its file is now.
    pub file: SettledFile,
}

/// The takes of a series, after all have ended.
#[derive(Debug, Default)]
struct CollectedTakes {
    /// Those that were written to their end.
    takes: Vec<SeriesTake>,
    /// Why one was not.
    failure: Option<anyhow::Error>,
    /// The last one, if its writer ended without a result.
    unanswered: Option<(PathBuf, FileId)>,
    /// A file without a frame that cannot be removed.
    problem: Option<String>,
}

/// Collects until the series has ended.
fn collect(started: &Receiver<StartedTake>) -> CollectedTakes {
    let mut collected = CollectedTakes::default();
    for take in started {
        collected.add(take);
    }
    collected
}

impl CollectedTakes {
    fn add(&mut self, take: StartedTake) {
        let StartedTake { path, id, part, first_row, result } = take;
        match result.recv() {
            Ok(Ok((written, mut output))) if written.ledger.recorded > 0 => {
                let file = output.settle();
                self.takes.push(SeriesTake { path, part, first_row, written, file });
            }
            // A take without a frame is useless.
            Ok(Ok(_)) => self.remove((path, id)),
            Ok(Err(failed)) if failed.error.is::<NothingRecorded>() => {
                self.remove((path, id));
                self.failure.get_or_insert(failed.error);
            }
            Ok(Err(mut failed)) => {
                let output = failed.output.as_deref_mut();
                self.failure = Some(explain_early_end(&path, failed.error, output));
            }
            Err(_) => self.unanswered = Some((path, id)),
        }
    }

    fn remove(&mut self, (path, id): (PathBuf, FileId)) {
        if let Err(error) = id.remove(&path) {
            let path = path.display();
            self.problem = Some(format!("cannot remove the empty file {path} ({error})"));
        }
    }

    /// The error of a recording that did not start: the file of its first take is removed.
    fn discard(mut self, error: anyhow::Error) -> anyhow::Error {
        if let Some(file) = self.unanswered.take() {
            self.remove(file);
        }
        let error = self.failure.take().unwrap_or(error);
        self.explain(error)
    }

    /// Adds to an error how many takes are complete, and what is left besides.
    fn explain(self, error: anyhow::Error) -> anyhow::Error {
        let error = match self.problem {
            Some(problem) => error.context(problem),
            None => error,
        };
        match self.takes.len() {
            0 => error,
            1 => error.context("the recording ends early, after one complete take"),
            n => error.context(format!("the recording ends early, after {n} complete takes")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_their_number_before_the_extension() {
        let name = |base: &str, n_max, number| {
            TakeNames::new(Path::new(base), n_max).path(number).to_str().unwrap().to_owned()
        };
        assert_eq!(name("a/run.take", None, 1), "a/run-001.take");
        assert_eq!(name("run.1.take", Some(6), 42), "run.1-042.take");
        assert_eq!(name("run", Some(999), 999), "run-999");
        assert_eq!(name("run.take", Some(1000), 7), "run-0007.take");
        assert_eq!(name("run.take", None, 1000), "run-1000.take");
    }

    #[test]
    fn a_later_take_is_found_when_the_first_was_moved() {
        let folder = tempfile::tempdir().unwrap();
        let names = TakeNames::new(&folder.path().join("run.take"), None);
        assert!(!names.any_exists());
        std::fs::write(names.path(3), b"").unwrap();
        assert!(names.any_exists());
    }

    #[test]
    fn names_sort_in_the_order_of_the_takes() {
        let names = TakeNames::new(Path::new("run.take"), Some(2000));
        assert!((1..=2000).map(|number| names.path(number)).is_sorted());
    }
}
