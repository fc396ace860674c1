//! Commands over many files: they keep every core busy, continue after a file that fails, and report each file in a
//! line and all of them in a table.
//!
//! A command finds its [`Inputs`], decides the [`Destination`] of its outputs, and passes both to [`run`] with the
//! function that processes one file. For a single file the report is the command's own, in full; for several it is a
//! line for each, in the order of the inputs, or with `--json` a document for each (JSON Lines).

pub(crate) mod inputs;
pub(crate) mod outputs;

use std::{
    cell::RefCell,
    collections::BTreeMap,
    fmt::Write,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
};

use anyhow::anyhow;
use mocapd::outcome::Outcome;
use mocapd_acquire::{pipeline::offline::in_order, threads};
use serde::Serialize;

pub(crate) use self::{
    inputs::{FileKinds, Input, InputArgs, Inputs},
    outputs::Destination,
};
use super::{
    output::{Progress, eprint, json_line, notify, pretty_json, print, print_json_text},
    remote,
};
use crate::cli::values::{bytes, length_of_time, thousands};

/// The report of a command on one file.
#[derive(Debug, Default)]
pub(crate) struct FileReport {
    /// Why the file failed, although there is a report of it.
    pub(crate) failure: Option<String>,
    /// Whether data was lost.
    pub(crate) data_lost: bool,
    /// The whole report, for a single file; empty for a command that is silent when all is well.
    pub(crate) text: String,
    /// The report in one line, for one of many files.
    pub(crate) line: String,
    /// The report as JSON.
    pub(crate) json: String,
    /// The figures that the table adds up.
    pub(crate) figures: Figures,
}

/// The figures of a file that the table adds up.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Figures {
    /// Frames of the motion, lost ones included.
    pub(crate) frames: u64,
    /// Length of the motion, in seconds.
    pub(crate) seconds: f64,
    /// Size of the input, in bytes.
    pub(crate) bytes_read: u64,
    /// Size of the output, in bytes; 0 for a command that writes none.
    pub(crate) bytes_written: u64,
    /// Whether the output existed already, with the same content.
    pub(crate) is_unchanged: bool,
}

/// How to run a command over its files.
#[derive(Debug)]
pub(crate) struct Batch<'a> {
    /// The files to process.
    pub(crate) inputs: &'a Inputs,
    /// The output of each file; empty for a command that writes none.
    pub(crate) outputs: &'a [PathBuf],
    /// Whether the reports are JSON.
    pub(crate) json: bool,
    /// Whether text reports go to standard error, because standard output carries the output file.
    pub(crate) text_to_stderr: bool,
    /// Whether the lines and the table of several files go to standard error, because standard output has data.
    pub(crate) lines_to_stderr: bool,
    /// Threads for all files together.
    pub(crate) threads: usize,
    /// The participle for the progress display: `importing`.
    pub(crate) doing: &'static str,
    /// The participle for the table: `imported`.
    pub(crate) done: &'static str,
    /// Whether the table has the ratio of bytes read to bytes written.
    pub(crate) is_compression: bool,
}

impl<'a> Batch<'a> {
    /// A command that writes no file, on all cores.
    pub(crate) fn of_reports(
        inputs: &'a Inputs,
        json: bool,
        [doing, done]: [&'static str; 2],
    ) -> Self {
        Self {
            inputs,
            outputs: &[],
            json,
            text_to_stderr: false,
            lines_to_stderr: false,
            threads: thread_count(None),
            doing,
            done,
            is_compression: false,
        }
    }
}

/// The work on one file: its paths, its share of the threads, and where its messages and its progress go.
#[derive(Debug)]
pub(crate) struct Job<'a> {
    /// The input.
    pub(crate) input: &'a Input,
    /// The output; `None` for a command that writes none.
    pub(crate) output: Option<&'a Path>,
    /// Threads to use.
    pub(crate) threads: usize,
    /// Whether it is the only file; its whole report is then printed.
    pub(crate) is_single: bool,
    /// Whether the report is JSON.
    pub(crate) is_json: bool,
    messages: RefCell<Vec<String>>,
    progress: Arc<FileProgress>,
}

impl Job<'_> {
    /// Prints a message about the file on standard error: immediately for a single file, else before its line.
    pub(crate) fn notify(&self, message: &str) {
        self.notify_of(&self.input.name, message);
    }

    /// Prints a message about an output, as [`notify`](Self::notify) does.
    pub(crate) fn notify_of(&self, path: &Path, message: &str) {
        let line = format!("{}: {message}", path.display());
        if self.is_single { notify(&line) } else { self.messages.borrow_mut().push(line) }
    }

    /// Begins a phase of `total` steps. The counter that it returns drives the progress display until dropped.
    pub(crate) fn phase(&self, doing: &'static str, total: u64) -> Phase {
        let counter = Arc::new(AtomicU64::new(0));
        if self.is_single {
            let display = Progress::follow(doing, &counter, total);
            return Phase { counter, _display: Some(display) };
        }
        self.progress.begin(&counter, total);
        Phase { counter, _display: None }
    }

    /// A report as JSON: indented for a single file, a line for one of many; empty unless it was asked for.
    ///
    /// # Errors
    /// If it cannot be serialised.
    pub(crate) fn json(&self, report: &impl Serialize) -> anyhow::Result<String> {
        if !self.is_json {
            return Ok(String::new());
        }
        if self.is_single { pretty_json(report) } else { json_line(report) }
    }
}

/// A phase of the work on a file; see [`Job::phase`].
#[derive(Debug)]
pub(crate) struct Phase {
    /// Steps done.
    pub(crate) counter: Arc<AtomicU64>,
    _display: Option<Progress>,
}

/// How much of a file is done.
#[derive(Debug, Default)]
struct FileProgress {
    /// The counter of the current phase, and its total.
    phase: Mutex<(Arc<AtomicU64>, u64)>,
}

impl FileProgress {
    fn begin(&self, counter: &Arc<AtomicU64>, total: u64) {
        *self.phase.lock().unwrap_or_else(PoisonError::into_inner) = (Arc::clone(counter), total);
    }

    /// The fraction of the current phase that is done, 0 to 1.
    fn share(&self) -> f64 {
        let phase = self.phase.lock().unwrap_or_else(PoisonError::into_inner);
        let done = phase.0.load(Ordering::Relaxed) as f64;
        if phase.1 == 0 { 0.0 } else { (done / phase.1 as f64).min(1.0) }
    }
}

/// Runs a command over its files.
///
/// # Errors
/// For a single file the error of `process`. For several, its errors are printed, and the outcome is `Failed`.
pub(crate) fn run(
    batch: &Batch<'_>,
    process: impl Fn(&Job<'_>) -> anyhow::Result<FileReport> + Sync,
) -> anyhow::Result<Outcome> {
    if batch.inputs.is_single
        && let [input] = batch.inputs.files.as_slice()
    {
        return run_single(batch, input, process);
    }
    let files = &batch.inputs.files;
    let workers = batch.threads.clamp(1, files.len().max(1));
    let threads = (batch.threads / workers).max(1);
    let progress = Arc::new(BatchProgress::default());
    let display = display(batch.doing, files.len(), &progress);
    let mut table = Table::default();
    for message in &batch.inputs.unreadable {
        notify(message);
        table.add_failure();
    }
    for (name, other) in &batch.inputs.repeated {
        notify(&format!("{}: left out, it is {}", name.display(), other.display()));
        table.add_repeated();
    }
    let worker = || {
        |&index: &usize| {
            let job = Job {
                input: &files[index],
                output: batch.outputs.get(index).map(PathBuf::as_path),
                threads,
                is_single: false,
                is_json: batch.json,
                messages: RefCell::default(),
                progress: progress.begin_file(index),
            };
            let result = catch_unwind(AssertUnwindSafe(|| process(&job)));
            remote::release(&files[index].path);
            job.output.into_iter().for_each(remote::release);
            let result = result
                .unwrap_or_else(|_| Err(anyhow!("its processing failed: please report this bug")));
            progress.end_file(index);
            Ok((result, job.messages.into_inner()))
        }
    };
    in_order(0..files.len(), workers, worker, |&index, (result, messages)| {
        display.suspend(|| {
            messages.iter().for_each(|message| notify(message));
            print_result(batch, &files[index].name, result, &mut table)
        })
    })?;
    drop(display);
    if !batch.json {
        print_line(batch, &table.text(batch.done, batch.is_compression))?;
    }
    Ok(table.outcome())
}

fn run_single(
    batch: &Batch<'_>,
    input: &Input,
    process: impl Fn(&Job<'_>) -> anyhow::Result<FileReport>,
) -> anyhow::Result<Outcome> {
    let job = Job {
        input,
        output: batch.outputs.first().map(PathBuf::as_path),
        threads: batch.threads,
        is_single: true,
        is_json: batch.json,
        messages: RefCell::default(),
        progress: Arc::default(),
    };
    remote::fetch(&[&input.path])?;
    let report = process(&job)?;
    if batch.json {
        print_json_text(&report.json)?;
    } else if batch.text_to_stderr {
        eprint(&report.text);
    } else {
        print(&report.text)?;
    }
    report.failure.map_or_else(|| Ok(Outcome::of(report.data_lost)), |why| Err(anyhow!(why)))
}

/// The line of a file that failed, among JSON Lines.
#[derive(Debug, Serialize)]
struct FailureReport<'a> {
    file: &'a str,
    error: &'a str,
}

/// Whether a message names a file, not only as a part of another word.
fn names(message: &str, file: &str) -> bool {
    let is_of_path = |c: char| c.is_alphanumeric() || "/._-".contains(c);
    message.match_indices(file).any(|(at, _)| {
        let (before, after) = (&message[..at], &message[at + file.len()..]);
        // A full stop ends a sentence, or begins an extension.
        let after = after.strip_prefix('.').unwrap_or(after);
        !before.ends_with(is_of_path) && !after.starts_with(is_of_path)
    })
}

/// Prints the result of one of many files, and adds it to the table.
fn print_result(
    batch: &Batch<'_>,
    name: &Path,
    result: anyhow::Result<FileReport>,
    table: &mut Table,
) -> anyhow::Result<()> {
    let report = match result {
        Ok(report) => report,
        Err(error) => {
            let name = name.to_string_lossy();
            let mut reason = mocapd_cli::failure_message(&error);
            if !names(&reason, &name) {
                reason = format!("{name}: {reason}");
            }
            table.add_failure();
            notify(&reason);
            return match batch.json {
                true => {
                    print_json_text(&json_line(&FailureReport { file: &name, error: &reason })?)
                }
                false => Ok(()),
            };
        }
    };
    match &report.failure {
        None => table.add(&report),
        Some(why) => {
            table.add_failure();
            notify(why);
        }
    }
    if batch.json { print_json_text(&report.json) } else { print_line(batch, &report.line) }
}

fn print_line(batch: &Batch<'_>, line: &str) -> anyhow::Result<()> {
    if batch.lines_to_stderr {
        eprint(line);
        return Ok(());
    }
    print(line)
}

/// The progress of all files together.
#[derive(Debug, Default)]
struct BatchProgress {
    finished: AtomicUsize,
    /// The files that are being processed, by index: one for each worker.
    running: Mutex<BTreeMap<usize, Arc<FileProgress>>>,
}

impl BatchProgress {
    fn running(&self) -> MutexGuard<'_, BTreeMap<usize, Arc<FileProgress>>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn begin_file(&self, index: usize) -> Arc<FileProgress> {
        Arc::clone(self.running().entry(index).or_default())
    }

    fn end_file(&self, index: usize) {
        self.running().remove(&index);
        self.finished.fetch_add(1, Ordering::Relaxed);
    }

    /// The number of files done, including fractions of those that are being processed.
    fn n_done(&self) -> f64 {
        let shares: f64 = self.running().values().map(|file| file.share()).sum();
        self.finished.load(Ordering::Relaxed) as f64 + shares
    }
}

fn display(doing: &'static str, n_files: usize, progress: &Arc<BatchProgress>) -> Progress {
    let (progress, shares) = (Arc::clone(progress), Arc::clone(progress));
    Progress::share(
        move || {
            format!("{doing}: {} of {n_files} files", progress.finished.load(Ordering::Relaxed))
        },
        move || shares.n_done() / n_files.max(1) as f64,
    )
}

/// The number of threads for all files: `--threads`, or one per core, at most eight.
pub(crate) fn thread_count(given: Option<u16>) -> usize {
    given.map_or_else(threads::default_workers, usize::from)
}

/// The files with one result, and their sums.
#[derive(Debug, Default)]
struct Row {
    files: u64,
    sums: Figures,
}

/// The results of the files.
#[derive(Debug, Default)]
struct Table {
    done: Row,
    unchanged: Row,
    lossy: Row,
    failed: Row,
    /// Other names of files that were read.
    repeated: Row,
}

impl Table {
    /// Counts a file whose report is complete.
    fn add(&mut self, report: &FileReport) {
        let row = match (report.data_lost, report.figures.is_unchanged) {
            (true, _) => &mut self.lossy,
            (false, true) => &mut self.unchanged,
            (false, false) => &mut self.done,
        };
        row.files += 1;
        row.sums.add(&report.figures);
    }

    /// Counts a file, or a folder, that failed.
    fn add_failure(&mut self) {
        self.failed.files += 1;
    }

    /// Counts another name of a file, such as a link to it, which is left out.
    fn add_repeated(&mut self) {
        self.repeated.files += 1;
    }

    /// The outcome of all files together: the worst of them.
    fn outcome(&self) -> Outcome {
        if self.failed.files > 0 { Outcome::Failed } else { Outcome::of(self.lossy.files > 0) }
    }

    /// The table as text; `done` is what was done, such as `imported`. With `has_ratio` it has the ratio
    /// of bytes read to bytes written.
    fn text(&self, done: &str, has_ratio: bool) -> String {
        let rows = [
            (done, &self.done),
            ("unchanged", &self.unchanged),
            ("data lost", &self.lossy),
            ("failed", &self.failed),
            ("same file", &self.repeated),
        ];
        let writes = rows.iter().any(|(_, row)| row.sums.bytes_written > 0);
        let mut out =
            format!("{:<12}{:>8}{:>14}{:>14}{:>11}", "", "files", "frames", "length", "read");
        out += if writes { "    written" } else { "" };
        out += if writes && has_ratio { "   ratio\n" } else { "\n" };
        for (name, Row { files, sums }) in
            rows.into_iter().filter(|(name, row)| row.files > 0 || *name == done)
        {
            write!(out, "{name:<12}{:>8}", thousands(*files)).ok();
            if sums.bytes_read > 0 {
                let (frames, length) = (thousands(sums.frames), length_of_time(sums.seconds));
                write!(out, "{frames:>14}{length:>14}{:>11}", bytes(sums.bytes_read)).ok();
            }
            if sums.bytes_written > 0 {
                write!(out, "{:>11}", bytes(sums.bytes_written)).ok();
                if has_ratio {
                    let ratio = sums.bytes_read as f64 / sums.bytes_written as f64;
                    write!(out, "{ratio:>8.1}").ok();
                }
            }
            out.push('\n');
        }
        out
    }
}

impl Figures {
    fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.seconds += other.seconds;
        self.bytes_read += other.bytes_read;
        self.bytes_written += other.bytes_written;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(data_lost: bool, is_unchanged: bool) -> FileReport {
        let figures = Figures {
            frames: 600,
            seconds: 10.0,
            bytes_read: 36_000,
            bytes_written: 1_200,
            is_unchanged,
        };
        FileReport { data_lost, figures, ..FileReport::default() }
    }

    #[test]
    fn results_are_counted_and_summed_and_the_worst_decides() {
        let mut table = Table::default();
        (0..3).for_each(|_| table.add(&report(false, false)));
        assert_eq!(table.outcome(), Outcome::Done);
        table.add(&report(false, true));
        table.add(&report(true, false));
        assert_eq!(table.outcome(), Outcome::DataLost);
        table.add_repeated();
        assert_eq!(table.outcome(), Outcome::DataLost);
        table.add_failure();
        assert_eq!(table.outcome(), Outcome::Failed);
        assert_eq!(
            table.text("imported", true),
            "               files        frames        length       read    written   ratio\n\
             imported           3         1 800        30.0 s   108.0 kB    3 600 B    30.0\n\
             unchanged          1           600        10.0 s    36.0 kB    1 200 B    30.0\n\
             data lost          1           600        10.0 s    36.0 kB    1 200 B    30.0\n\
             failed             1\n\
             same file          1\n"
        );
    }
}
