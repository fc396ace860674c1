//! `--raw`: logs the bytes of the line beside the take.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use mocapd_acquire::raw_log::{RawLog, RawLogged};
use serde::Serialize;

use crate::cli::{
    output::{notify, plain_path},
    values::bytes,
};

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
pub(super) fn with_log<T>(
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
