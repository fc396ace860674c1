//! Compares the recorder's ledger with the simulator's log.

use anyhow::{Context, ensure};
use serde_json::Value;

use crate::simulator::Sent;

/// The parts of a recording's report that scenarios check.
#[derive(Debug, Clone)]
pub(crate) struct LedgerReport {
    pub(crate) ending: String,
    pub(crate) recorded: u64,
    pub(crate) frames_sent: u64,
    pub(crate) lost: u64,
    pub(crate) unknown: u64,
    pub(crate) away_s: f64,
    pub(crate) samples: u64,
    pub(crate) damaged: u64,
    contradictions: usize,
    closes: bool,
}

impl LedgerReport {
    pub(crate) fn of(report: &Value) -> anyhow::Result<Self> {
        let ledger = &report["ledger"];
        let number =
            |name: &str| ledger[name].as_u64().with_context(|| format!("{name}: {ledger}"));
        Ok(Self {
            ending: report["ending"].as_str().unwrap_or_default().to_owned(),
            recorded: number("recorded")?,
            frames_sent: number("frames_sent")?,
            lost: number("lost_on_link")?
                .saturating_add(number("dropped_by_device")?)
                .saturating_add(number("lost_ring_full")?)
                .saturating_add(number("lost_other")?),
            unknown: number("unknown_after_disconnect")?,
            away_s: report["outages"]["seconds"].as_f64().context("outages.seconds")?,
            samples: number("samples_present")?,
            damaged: number("link_messages_damaged")?,
            contradictions: ledger["contradictions"].as_array().map_or(0, Vec::len),
            closes: ledger["closes"] == true,
        })
    }

    /// Fails unless the ledger closes without contradictions.
    pub(crate) fn closes(&self) -> anyhow::Result<()> {
        ensure!(self.closes && self.contradictions == 0, "the ledger does not close: {self:?}");
        Ok(())
    }

    /// Fails unless the take has every frame and sample that the simulator sent.
    pub(crate) fn ensure_complete(&self, sent: &Sent) -> anyhow::Result<()> {
        self.closes()?;
        ensure!(
            self.recorded == sent.produced && self.samples == sent.samples && self.lost == 0,
            "{self:?} of {sent:?}"
        );
        Ok(())
    }
}
