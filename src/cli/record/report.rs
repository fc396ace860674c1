//! The report of `record`, of one take or of a divided recording, as JSON (docs/json.md) and as text.

use std::path::{Path, PathBuf};

use mocapd_acquire::{
    files::FileState,
    ledger::{LedgerDocument, SampleLedgerDocument},
    record::Recorded,
    series::{SeriesOptions, SeriesTake},
};
use mocapd_codec::Settings;
use mocapd_service::process;
use mocapd_take::record::EndingKind;
use serde::{Deserialize, Serialize};

use super::watch::RawLogReport;
use crate::cli::{
    ledger::{self, ClockReport, OutagesReport},
    output::plain_path,
    values::{SizeReport, bytes, count, frames_of, rate, thousands},
};

#[derive(Debug, Serialize)]
pub(crate) struct RecordReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    ending: &'static str,
    file_state: FileState,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text_or_null")]
    file_path: Option<PathBuf>,
    frames: u64,
    seconds: f64,
    markers: usize,
    #[serde(skip)]
    markers_appeared: u64,
    pub(super) rate_hz: f64,
    #[serde(flatten)]
    size: SizeReport,
    ring_latency_us: LatencyReport,
    process: ProcessReport,
    disk: DiskReport,
    raw_log: Option<RawLogReport>,
    pub(super) outages: OutagesReport,
    clock: Option<ClockReport>,
    ledger: LedgerDocument,
    sample_ledger: Option<SampleLedgerDocument>,
}

#[derive(Debug, Serialize)]
struct DiskReport {
    free_bytes: Option<u64>,
    seconds_left: Option<f64>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct LatencyReport {
    pub(crate) p50: f64,
    pub(crate) p99: f64,
    pub(crate) max: f64,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct ProcessReport {
    pub(crate) cpu_s: f64,
    pub(crate) peak_memory_bytes: u64,
}

impl RecordReport {
    pub(crate) fn new(take: &Path, recorded: &Recorded, codec: &Settings) -> Self {
        let written = &recorded.written;
        let (latency, counts) = (&recorded.recording.ring_latency, &recorded.recording.counts);
        let (ledger, disk, rate_hz) = (&written.ledger, &written.disk, recorded.rate_hz);
        let us = |ns: u64| ns as f64 / 1e3;
        let process::Usage { cpu_s, peak_memory_bytes } = process::usage(None).unwrap_or_default();
        Self {
            take: take.to_owned(),
            ending: match recorded.recording.ending {
                EndingKind::DeviceEnded => "end of stream",
                EndingKind::DeviceGone => "disconnected",
                EndingKind::Length => "stopped",
                EndingKind::CutOff => "writer failed",
                ending => ending.name(),
            },
            file_state: recorded.file.state,
            file_path: recorded.file.path.clone(),
            frames: ledger.recorded,
            seconds: ledger.frames_sent as f64 / rate_hz,
            markers: recorded.markers,
            markers_appeared: counts.markers_appeared,
            rate_hz,
            size: SizeReport::new(written, codec),
            ring_latency_us: LatencyReport {
                p50: us(latency.quantile_ns(0.5)),
                p99: us(latency.quantile_ns(0.99)),
                max: us(latency.max_ns()),
            },
            process: ProcessReport { cpu_s, peak_memory_bytes },
            disk: DiskReport { free_bytes: disk.free_bytes, seconds_left: disk.left_s },
            raw_log: None,
            outages: OutagesReport::new(counts.outages, ledger.unknown_after_disconnect, rate_hz),
            clock: ClockReport::new(&written.clock, &written.clock_lines),
            ledger: LedgerDocument::from(ledger),
            sample_ledger: written.sample_ledger.as_ref().map(SampleLedgerDocument::from),
        }
    }

    /// Adds the report of the raw log.
    pub(super) fn with_log(self, raw_log: Option<RawLogReport>) -> Self {
        Self { raw_log, ..self }
    }

    /// Whether the raw log lacks bytes of the line.
    pub(super) fn log_lost(&self) -> bool {
        self.raw_log.as_ref().is_some_and(RawLogReport::lost)
    }

    /// What was lost, by cause and in one line.
    pub(crate) fn losses(&self) -> Option<String> {
        ledger::losses(&self.ledger)
    }

    /// The samples of sampled channels that were lost, one line per group.
    pub(crate) fn sample_losses(&self) -> Vec<String> {
        self.sample_ledger.as_ref().map(ledger::sample_losses).unwrap_or_default()
    }

    fn samples_text(&self) -> String {
        self.sample_ledger.as_ref().map(ledger::samples_text).unwrap_or_default()
    }

    /// Why the ledger does not close, in one line.
    pub(crate) fn not_closing(&self) -> Option<String> {
        ledger::not_closing(&self.ledger)
    }

    /// The warning that the take ended because the disk is full.
    pub(crate) fn disk_full(&self) -> String {
        let free = self.disk.free_bytes.map_or("little".to_owned(), bytes);
        format!(
            "the disk is nearly full ({free} left): the take was closed early and is intact; free some space before the next"
        )
    }

    /// The number of markers. Unlabelled markers are not announced: they appear during the recording, and the same one
    /// may reappear under another number.
    fn markers_text(&self) -> String {
        let announced = count(self.markers as u64, "marker");
        match self.markers_appeared {
            0 => announced,
            more => format!("{announced} announced and {} that appeared later", thousands(more)),
        }
    }

    pub(crate) fn text(&self) -> String {
        self.text_of(&plain_path(&self.take))
    }

    /// The text, with a name for what was recorded.
    fn text_of(&self, name: &str) -> String {
        format!(
            "{name}: {} of {} at {}, {}\n{}{}{}",
            frames_of(self.frames, self.ledger.frames_sent),
            self.markers_text(),
            rate(self.rate_hz),
            self.size.text(),
            self.raw_log.as_ref().map(RawLogReport::text).unwrap_or_default(),
            ledger::text(&self.ledger) + &self.samples_text(),
            self.clock.as_ref().map(ClockReport::text).unwrap_or_default()
        )
    }
}

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
    sample_ledger: Option<SampleLedgerDocument>,
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
            sample_ledger: written.sample_ledger.as_ref().map(SampleLedgerDocument::from),
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
