//! `--raw`: a log of the line beside the take.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use mocapd_acquire::raw_log::{RawLog, RawLogged};
use serde::Serialize;

use crate::cli::{
    output::{say, shown},
    values::bytes,
};

/// What came of a log, as docs/json.md has it.
#[derive(Debug, Serialize)]
pub(crate) struct RawLogReport {
    log: PathBuf,
    file_bytes: u64,
    line_bytes: u64,
    missing_bytes: u64,
    error: Option<String>,
}

impl RawLogReport {
    fn new(path: &Path, logged: &RawLogged) -> Self {
        let RawLogged { file_bytes, line_bytes, missing_bytes, ref error } = *logged;
        // What was written of the last block is in the file, too.
        let found = path.metadata().map_or(file_bytes, |found| found.len());
        let file_bytes = if error.is_some() { found } else { file_bytes };
        let error = error.as_ref().map(ToString::to_string);
        Self { log: path.to_owned(), file_bytes, line_bytes, missing_bytes, error }
    }

    /// Nobody knows what is in it: a take does not end for that.
    fn of_nothing(path: &Path, error: &anyhow::Error) -> Self {
        let file_bytes = path.metadata().map_or(0, |found| found.len());
        let error = Some(format!("{error:#}"));
        Self { log: path.to_owned(), file_bytes, line_bytes: 0, missing_bytes: 0, error }
    }

    /// Whether it has less than the line had.
    pub(crate) fn lost(&self) -> bool {
        self.missing_bytes > 0 || self.error.is_some()
    }

    /// In one line.
    pub(crate) fn words(&self) -> String {
        let what = if self.lost() { "not every byte" } else { "every byte" };
        let [file, line] = [self.file_bytes, self.line_bytes].map(bytes);
        format!("{}: {what} of the line, {line}, in a raw log of {file}\n", shown(&self.log))
    }

    /// What it has not, in one line; `None` when that is nothing.
    pub(crate) fn losses(&self) -> Option<String> {
        let missing = bytes(self.missing_bytes);
        match &self.error {
            Some(error) => Some(format!(
                "the raw log {} ends early, and {missing} of the line are not in it: {error}; what is in it can be replayed",
                self.log.display()
            )),
            None if self.missing_bytes > 0 => {
                Some(format!("{missing} of the line are not in the raw log: its disk is too slow"))
            }
            None => None,
        }
    }
}

/// Records with a log where one is asked for, and tells what the log has not. What came of it stands beside what was
/// recorded.
///
/// # Errors
/// Those of the recording, and that no log can be made. A log that ends early is told, and the take stays.
pub(super) fn with_log<T>(
    path: Option<&Path>,
    take: &Path,
    sync_every: Duration,
    record: impl FnOnce(Option<&RawLog>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Option<RawLogReport>)> {
    let Some(path) = path else { return record(None).map(|recorded| (recorded, None)) };
    let log = RawLog::start(path, sync_every)?;
    let recorded = record(Some(&log));
    let logged = log.finish();
    if recorded.is_err() && !take.exists() {
        // No frame came: as with the take, a log of it helps nobody.
        std::fs::remove_file(path).ok();
        return recorded.map(|recorded| (recorded, None));
    }
    let report = match logged {
        Ok(logged) => RawLogReport::new(path, &logged),
        Err(error) => RawLogReport::of_nothing(path, &error),
    };
    if let Some(losses) = report.losses() {
        say(&losses);
    }
    recorded.map(|recorded| (recorded, Some(report)))
}
