//! The report of a recording that was divided, as JSON (docs/json.md) and as text.

use std::path::PathBuf;

use mocapd_acquire::{
    files::FileState,
    ledger::LedgerDocument,
    series::{SeriesOptions, SeriesTake},
};
use serde::Serialize;

use super::report::RecordReport;
use crate::cli::{
    output::plain_path,
    values::{bytes, count, frames_of},
};

/// The report of the recording as a whole, and of each take.
#[derive(Debug, Serialize)]
pub(super) struct SeriesReport<'a> {
    #[serde(flatten)]
    total: &'a RecordReport,
    split: &'a str,
    parts: Vec<PartReport>,
}

/// One take of the series.
#[derive(Debug, Serialize)]
struct PartReport {
    part: u64,
    first_frame: u64,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    ending: &'static str,
    file_state: FileState,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text_or_null")]
    file_path: Option<PathBuf>,
    frames: u64,
    seconds: f64,
    samples: u64,
    file_bytes: u64,
    max_error_mm: f64,
    ledger: LedgerDocument,
}

impl PartReport {
    fn new(take: &SeriesTake, rate_hz: f64) -> Self {
        let SeriesTake { path, part, first_row, written, file } = take;
        let ledger = &written.ledger;
        Self {
            part: *part,
            first_frame: *first_row,
            take: path.clone(),
            ending: written.ending.kind.name(),
            file_state: file.state,
            file_path: file.path.clone(),
            frames: ledger.recorded,
            seconds: ledger.frames_sent as f64 / rate_hz,
            samples: written.samples,
            file_bytes: written.file_bytes,
            max_error_mm: written.max_error_mm,
            ledger: LedgerDocument::from(ledger),
        }
    }

    fn text(&self) -> String {
        let frames = frames_of(self.frames, self.ledger.frames_sent);
        let path = plain_path(&self.take);
        format!("{path}: {frames} from frame {}, {}\n", self.first_frame, bytes(self.file_bytes))
    }
}

impl<'a> SeriesReport<'a> {
    pub(super) fn new(
        total: &'a RecordReport,
        options: &'a SeriesOptions,
        takes: &[SeriesTake],
    ) -> Self {
        let parts = takes.iter().map(|take| PartReport::new(take, total.rate_hz));
        Self { total, split: &options.length_text, parts: parts.collect() }
    }

    pub(super) fn text(&self) -> String {
        let parts: String = self.parts.iter().map(PartReport::text).collect();
        let all = count(self.parts.len() as u64, "take");
        format!("{parts}{}", self.total.text_of(&all))
    }
}
