//! The report of `recover`, as JSON (docs/json.md) and as text.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
};

use mocapd_acquire::ledger::LedgerDocument;
use mocapd_take::recovery::{ChunkKindCount, RecoveryScan};
use serde::Serialize;

use crate::cli::{
    damage::{self, DamageReport},
    output::plain,
    values::{bytes, count, thousands},
};

#[derive(Debug, Serialize)]
pub(super) struct RecoverReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    take: PathBuf,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    output: PathBuf,
    lost: bool,
    finished: bool,
    pub(super) problems: Vec<String>,
    chunks: Vec<ChunkReport>,
    frames: u64,
    pub(super) frames_recovered: u64,
    frames_damaged: u64,
    samples: u64,
    damage: Vec<DamageReport>,
    markers: Vec<RecoveredMarkerReport>,
    take_bytes: u64,
    discarded_bytes: u64,
    output_bytes: u64,
    ledger: LedgerDocument,
}

#[derive(Debug, Serialize)]
struct ChunkReport {
    kind: &'static str,
    recovered: u64,
    discarded: u64,
}

#[derive(Debug, Serialize)]
struct RecoveredMarkerReport {
    label: String,
    samples: u64,
    frames_damaged: u64,
}

impl RecoverReport {
    pub(super) fn new(
        [take, output]: [&Path; 2],
        scan: &RecoveryScan,
        problems: Vec<String>,
        take_bytes: u64,
        output_bytes: u64,
    ) -> Self {
        let chunk = |count: &ChunkKindCount| ChunkReport {
            kind: count.kind.name(),
            recovered: count.recovered,
            discarded: count.discarded,
        };
        let there = |count: &&ChunkKindCount| count.recovered + count.discarded > 0;
        let channels = scan.channels.iter().zip(&scan.per_channel);
        let markers = channels.map(|(channel, found)| RecoveredMarkerReport {
            label: channel.label.clone(),
            samples: found.samples,
            frames_damaged: found.rows_damaged,
        });
        Self {
            take: take.to_owned(),
            output: output.to_owned(),
            lost: scan.lost_anything(),
            finished: scan.finished,
            problems,
            chunks: scan.kinds.iter().filter(there).map(chunk).collect(),
            frames: scan.rows,
            frames_recovered: scan.recorded,
            frames_damaged: scan.rows_damaged(),
            samples: scan.per_channel.iter().map(|channel| channel.samples).sum(),
            damage: DamageReport::all(&scan.damage),
            markers: markers.collect(),
            take_bytes,
            discarded_bytes: scan.discarded_bytes,
            output_bytes,
            ledger: LedgerDocument::from(&scan.ledger),
        }
    }

    /// The report in one line.
    pub(super) fn line(&self) -> String {
        format!(
            "{}: {} of {}, {}, {} of the {} read\n",
            plain(&self.output.display().to_string()),
            count(self.frames_recovered, "frame"),
            count(self.markers.len() as u64, "marker"),
            count(self.samples, "sample"),
            bytes(self.take_bytes.saturating_sub(self.discarded_bytes)),
            bytes(self.take_bytes),
        )
    }

    /// The whole report.
    pub(super) fn text(&self) -> String {
        let mut out = self.line();
        writeln!(out, "{:<15} {:>10} {:>10}", "chunks", "recovered", "discarded").ok();
        for ChunkReport { kind, recovered, discarded } in &self.chunks {
            let (recovered, discarded) = (thousands(*recovered), thousands(*discarded));
            writeln!(out, "  {kind:<13} {recovered:>10} {discarded:>10}").ok();
        }
        let (recovered, damaged) =
            (thousands(self.frames_recovered), thousands(self.frames_damaged));
        writeln!(out, "  {:<13} {recovered:>10} {damaged:>10}", "frames").ok();
        for line in damage::lines(&self.damage) {
            writeln!(out, "lost {line}").ok();
        }
        let damaged = self.markers.iter().map(|m| (m.label.as_str(), m.frames_damaged));
        out += &damage::by_marker(&damaged.collect::<Vec<_>>());
        out
    }
}
