//! The report of `info`, documented in docs/json.md.

use std::path::{Path, PathBuf};

use mocapd_acquire::{
    health::TakeHealth,
    inspect::{Summary, size_ratio},
    ledger::LedgerDocument,
};
use mocapd_take::{
    interchange::ReadOptions,
    reader::TakeBytes,
    record::{Device, Header, ImportSource},
    recovery::RECOVERED,
};
use serde::Serialize;

use super::{sampled::SampledGroupReport, subject::SubjectReport};
use crate::cli::{clock::ClockReport, damage::DamageReport, ledger::OutagesReport};

#[derive(Debug, Serialize)]
pub(super) struct InfoReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    pub(super) take: PathBuf,
    pub(super) finished: bool,
    pub(super) problems: Vec<String>,
    pub(super) damage: Vec<DamageReport>,
    pub(super) recovered: Option<String>,
    pub(super) health: TakeHealth,
    pub(super) ending: Option<&'static str>,
    pub(super) ending_detail: Option<String>,
    pub(super) software: String,
    pub(super) created: Option<String>,
    #[serde(skip)]
    pub(super) created_unix_ms: Option<i64>,
    pub(super) resampler: String,
    pub(super) tolerance_mm: f64,
    pub(super) up_axis: Option<&'static str>,
    pub(super) device: Option<Device>,
    pub(super) source: Option<ImportSourceReport>,
    pub(super) subject: Option<SubjectReport>,
    pub(super) foreign_parts: Vec<ForeignReport>,
    pub(super) sampled_groups: Vec<SampledGroupReport>,
    pub(super) frames: u64,
    pub(super) seconds: f64,
    pub(super) markers: usize,
    pub(super) rate_hz: f64,
    pub(super) samples: u64,
    pub(super) raw_bytes: u64,
    pub(super) file_bytes: u64,
    pub(super) bytes: TakeBytes,
    pub(super) ratio: f64,
    pub(super) max_error_mm: f64,
    pub(super) stretches: u64,
    pub(super) sr1: Option<f64>,
    pub(super) sr2: Option<f64>,
    pub(super) ledger: Option<LedgerDocument>,
    pub(super) outages: OutagesReport,
    pub(super) clock: Option<ClockReport>,
    pub(super) events: Vec<EventReport>,
    pub(super) channels: Vec<ChannelReport>,
}

#[derive(Debug, Serialize)]
pub(super) struct ImportSourceReport {
    #[serde(flatten)]
    pub(super) file: ImportSource,
    /// Size of the file.
    pub(super) bytes: Option<u64>,
    /// The value of `import --unit`, if given.
    pub(super) unit_given: Option<String>,
    /// The value of `import --up`, if given.
    pub(super) up_given: Option<String>,
}

#[derive(Debug, Serialize)]
pub(super) struct ForeignReport {
    pub(super) kind: String,
    pub(super) bytes: u64,
    pub(super) stored_bytes: u64,
}

#[derive(Debug, Serialize)]
pub(super) struct EventReport {
    pub(super) kind: &'static str,
    pub(super) frame: u64,
    pub(super) device_ticks: u64,
    pub(super) input: u8,
    pub(super) text: String,
}

#[derive(Debug, Serialize)]
pub(super) struct ChannelReport {
    pub(super) label: String,
    pub(super) labelled: bool,
    pub(super) samples: u64,
    pub(super) gaps: u64,
    pub(super) knots: u64,
    pub(super) max_error_mm: f64,
    pub(super) frames_damaged: u64,
}

impl InfoReport {
    pub(super) fn new(take: &Path, summary: &Summary, file_bytes: u64) -> Self {
        let header = &summary.take.header;
        let channels = summary.take.channels.iter().zip(&summary.per_channel);
        let channels = channels.map(|(channel, found)| ChannelReport {
            label: channel.label.clone(),
            labelled: channel.labelled,
            samples: found.samples,
            gaps: found.gaps,
            knots: found.knots,
            max_error_mm: found.max_error_mm,
            frames_damaged: found.rows_damaged,
        });
        let bytes = summary.bytes;
        let events = summary.take.events.iter().map(|event| EventReport {
            kind: event.kind.name(),
            frame: event.row,
            device_ticks: event.device_ticks,
            input: event.input,
            text: event.text.clone(),
        });
        let parts = summary.take.foreign.iter();
        let foreign_parts = parts.map(|part| ForeignReport {
            kind: part.kind.clone(),
            bytes: part.data_bytes(),
            stored_bytes: part.stored_bytes(),
        });
        let options = ReadOptions::from_settings(&header.settings);
        Self {
            take: take.to_owned(),
            finished: summary.take.finished,
            problems: summary.take.problems.iter().map(ToString::to_string).collect(),
            damage: DamageReport::all(&summary.take.damage),
            recovered: recovered(header),
            health: summary.health(),
            ending: summary.take.ending.as_ref().map(|ending| ending.kind.name()),
            ending_detail: detail(summary),
            software: header.software.clone(),
            created: created_unix_ms(header).and_then(utc),
            created_unix_ms: created_unix_ms(header),
            resampler: header.resampler.clone(),
            tolerance_mm: header.tolerance_mm,
            up_axis: header.up_axis.name(),
            device: header.device.clone(),
            source: header.source.clone().map(|file| ImportSourceReport {
                file,
                bytes: header.source_bytes(),
                unit_given: options.unit.map(|unit| unit.to_string()),
                up_given: options.up.map(|up| up.to_string()),
            }),
            subject: summary.take.subject.as_ref().map(SubjectReport::new),
            foreign_parts: foreign_parts.collect(),
            sampled_groups: SampledGroupReport::all(&summary.take.foreign),
            frames: summary.take.n_rows,
            seconds: summary.take.n_rows as f64 / header.rate_hz,
            markers: summary.take.channels.len(),
            rate_hz: header.rate_hz,
            samples: summary.samples(),
            raw_bytes: summary.raw_bytes(),
            file_bytes,
            bytes: TakeBytes { framing: bytes.framing + bytes.lengths, ..bytes },
            ratio: size_ratio(summary.samples(), file_bytes),
            max_error_mm: summary.max_error_mm(),
            stretches: summary.stretches,
            sr1: summary.statistics.sr1(),
            sr2: summary.statistics.sr2(),
            ledger: summary.take.ledger.as_ref().map(LedgerDocument::from),
            outages: OutagesReport::new(summary.outages.0, summary.outages.1, header.rate_hz),
            clock: ClockReport::new(&summary.clock, &summary.take.clock_lines),
            events: events.collect(),
            channels: channels.collect(),
        }
    }

    /// Recorded frames, by the final ledger; `None` for a take that was cut off, whose last ledger may count too few.
    pub(super) fn frames_recorded(&self) -> Option<u64> {
        self.ledger.as_ref().filter(|_| self.finished).map(|ledger| ledger.recorded)
    }
}

/// Details of why the take ended, if it states any.
fn detail(summary: &Summary) -> Option<String> {
    let detail = &summary.take.ending.as_ref()?.detail;
    (!detail.is_empty()).then(|| detail.clone())
}

/// When the recording began; `None` for an import.
fn created_unix_ms(header: &Header) -> Option<i64> {
    Some(header.created_unix_ms).filter(|&unix_ms| unix_ms != 0)
}

fn utc(unix_ms: i64) -> Option<String> {
    Some(jiff::Timestamp::from_millisecond(unix_ms).ok()?.to_string())
}

/// The remarks of all recoveries of the take; `None` if it was never recovered.
fn recovered(header: &Header) -> Option<String> {
    let remarks = header.settings.iter().filter(|(key, _)| key == RECOVERED);
    remarks.map(|(_, text)| text.clone()).reduce(|all, next| format!("{all}; again {next}"))
}
