//! What `bench pipeline` says, as docs/json.md has it, and for people.

use serde::Serialize;

use super::super::median;
use crate::cli::record::LatencyReport;

#[derive(Debug, Clone, Serialize)]
pub(super) struct PtyRun {
    pub(super) frames_sent: u64,
    pub(super) frames_recorded: u64,
    pub(super) ledger_closes: bool,
    pub(super) record_cpu_percent: f64,
    pub(super) record_peak_memory_mb: f64,
    pub(super) bare_read_cpu_percent: f64,
    pub(super) simulator_cpu_percent: f64,
    pub(super) ring_latency_us: LatencyReport,
    pub(super) ratio: f64,
    pub(super) max_error_mm: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct InProcessReport {
    pub(super) wire_bytes: u64,
    pub(super) frames_lost: u64,
    pub(super) times_real_time: Vec<f64>,
    pub(super) copy_gb_per_s: Vec<f64>,
}

#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) markers: u16,
    pub(super) rate_hz: f64,
    pub(super) seconds: f64,
    pub(super) runs: u16,
    pub(super) resampler: String,
    pub(super) tolerance_mm: f64,
    pub(super) cores: usize,
    pub(super) pty: Vec<PtyRun>,
    pub(super) in_process: InProcessReport,
}

impl Report {
    /// Whether anything was lost that should not be.
    pub(super) fn lost_anything(&self) -> bool {
        let lost = self.pty.iter().any(|run| run.frames_recorded < run.frames_sent);
        lost || self.in_process.frames_lost > 0
    }

    pub(super) fn words(&self) -> String {
        let of = |figure: fn(&PtyRun) -> f64| median(self.pty.iter().map(figure));
        let sent: u64 = self.pty.iter().map(|run| run.frames_sent).sum();
        let recorded: u64 = self.pty.iter().map(|run| run.frames_recorded).sum();
        let open = self.pty.iter().filter(|run| !run.ledger_closes).count();
        let alone = &self.in_process;
        format!(
            "{} markers at {} Hz, {} s, {} {} mm, {} cores; medians of {} runs\n\
             over a pty to disk\n\
             \x20 frames lost                   {:>9}   of {sent} sent; ledgers that do not close: {open}\n\
             \x20 record, processor             {:>9.1} % of one core; reference: {:.1} % for reading the line alone\n\
             \x20 simulator, processor          {:>9.1} % of one core\n\
             \x20 record, peak memory           {:>9.1} MB\n\
             \x20 last byte of a frame to rings {:>9.1} us at p99; p50 {:.1} us, max {:.1} us\n\
             \x20 ratio, max error              {:>9.1} :1, {:.4} mm\n\
             in one process, no pty, {:.1} MB of frames\n\
             \x20 speed                         {:>9.1} times real time; reference: {:.1} GB/s for copying the frames; {} frames lost\n",
            self.markers,
            self.rate_hz,
            self.seconds,
            self.resampler,
            self.tolerance_mm,
            self.cores,
            self.runs,
            sent.saturating_sub(recorded),
            of(|run| run.record_cpu_percent),
            of(|run| run.bare_read_cpu_percent),
            of(|run| run.simulator_cpu_percent),
            of(|run| run.record_peak_memory_mb),
            of(|run| run.ring_latency_us.p99),
            of(|run| run.ring_latency_us.p50),
            of(|run| run.ring_latency_us.max),
            of(|run| run.ratio),
            of(|run| run.max_error_mm),
            alone.wire_bytes as f64 / 1e6,
            median(alone.times_real_time.iter().copied()),
            median(alone.copy_gb_per_s.iter().copied()),
            alone.frames_lost,
        )
    }
}
