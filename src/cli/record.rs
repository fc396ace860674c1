//! `record`: a device into a take.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use anyhow::Context;
use mocapd::{
    inspect::size_ratio,
    outcome::{Outcome, UsageError},
    process,
    record::{RecordOptions, Recorded, record},
    rig::{Ending, Rig},
    units,
};
use mocapd_drivers::uri::DeviceUri;
use serde::{Deserialize, Serialize};
use signal_hook::consts::{SIGINT, SIGTERM};

use super::{
    codec_args::CodecArgs,
    info::LedgerReport,
    output::{bytes, print, print_json, say, thousands},
    progress::Progress,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// serial:PATH[@BAUD] or usb:VID:PID[:SERIAL], with ?driver=NAME where needed
    #[arg(short, long, value_name = "URI")]
    device: String,
    /// The take to write; it must not exist
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    /// Stop after so long; without it at the end of a replay, or on Ctrl-C
    #[arg(long, value_name = "TIME", value_parser = units::duration)]
    seconds: Option<Duration>,
    /// Ask the device for this frame rate
    #[arg(long, value_name = "HZ", value_parser = units::rate_hz)]
    rate: Option<f64>,
    #[command(flatten)]
    codec: CodecArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
pub(crate) struct Report {
    take: PathBuf,
    ending: &'static str,
    frames: u64,
    seconds: f64,
    markers: usize,
    rate_hz: f64,
    samples: u64,
    raw_bytes: u64,
    file_bytes: u64,
    ratio: f64,
    tolerance_mm: f64,
    max_error_mm: f64,
    recoded_blocks: u64,
    ring_latency_us: LatencyReport,
    process: ProcessReport,
    ledger: LedgerReport,
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

impl Report {
    pub(crate) fn new(take: PathBuf, recorded: &Recorded, tolerance_mm: f64) -> Self {
        let ledger = &recorded.written.ledger;
        let latency = &recorded.recording.ring_latency;
        let us = |ns: u64| ns as f64 / 1e3;
        let rows = ledger.frames_sent;
        let usage = process::usage(None).unwrap_or_default();
        Self {
            take,
            ending: match recorded.recording.ending {
                Ending::EndOfStream => "end of stream",
                Ending::Stopped => "stopped",
                Ending::Disconnected => "disconnected",
                Ending::WriterFailed => "writer failed",
            },
            frames: ledger.recorded,
            seconds: rows as f64 / recorded.rate_hz,
            markers: recorded.markers,
            rate_hz: recorded.rate_hz,
            samples: recorded.written.samples,
            raw_bytes: 12 * recorded.written.samples,
            file_bytes: recorded.written.file_bytes,
            ratio: size_ratio(recorded.written.samples, recorded.written.file_bytes),
            tolerance_mm,
            max_error_mm: recorded.written.max_error_mm,
            recoded_blocks: recorded.written.recoded,
            ring_latency_us: LatencyReport {
                p50: us(latency.quantile_ns(0.5)),
                p99: us(latency.quantile_ns(0.99)),
                max: us(latency.max_ns()),
            },
            process: ProcessReport {
                cpu_s: usage.cpu_s,
                peak_memory_bytes: usage.peak_memory_bytes,
            },
            ledger: LedgerReport::new(ledger),
        }
    }

    pub(crate) fn words(&self) -> String {
        let bound = if self.tolerance_mm > 0.0 {
            format!("max error {:.4} mm <= {} mm", self.max_error_mm, self.tolerance_mm)
        } else {
            "bit-exact".to_owned()
        };
        format!(
            "{}: {} frames of {} markers at {} Hz, {} raw -> {} on disk ({:.1}:1), {bound}\n{}",
            self.take.display(),
            thousands(self.frames),
            self.markers,
            self.rate_hz,
            bytes(self.raw_bytes),
            bytes(self.file_bytes),
            self.ratio,
            self.ledger.words()
        )
    }
}

/// Set by Ctrl-C or SIGTERM; a second Ctrl-C ends the process at once.
pub(crate) fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
            .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
            .context("cannot watch for Ctrl-C")?;
    }
    Ok(stop)
}

/// Records `rig` into `take`, showing how it goes.
pub(crate) fn record_and_watch(
    rig: Rig,
    take: &std::path::Path,
    codec: mocapd_codec::Settings,
    length: Option<Duration>,
    stop: &AtomicBool,
) -> anyhow::Result<Recorded> {
    let mut watching = None;
    let recorded = record(
        rig,
        RecordOptions {
            take,
            codec,
            length,
            stop,
            say: &say,
            started: &mut |progress| {
                let progress = Arc::clone(progress);
                watching = Some(Progress::status(move || {
                    let get = |n: &std::sync::atomic::AtomicU64| n.load(Ordering::Relaxed);
                    format!(
                        "recording: {} frames, {} lost, {} on disk",
                        thousands(get(&progress.frames)),
                        thousands(get(&progress.lost)),
                        bytes(get(&progress.file_bytes))
                    )
                }));
            },
        },
    );
    drop(watching);
    recorded
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let uri: DeviceUri = args.device.parse().map_err(|error| UsageError(format!("{error}")))?;
    let codec = args.codec.live_settings()?;
    if args.output.symlink_metadata().is_ok() {
        // Said before the device is woken.
        mocapd::files::create_new(&args.output)?;
    }
    let stop = stop_on_signal()?;
    let mut rig = Rig::open(&uri)?;
    if let Some(rate_hz) = args.rate {
        rig.set_rate(rate_hz)?;
    }
    let recorded = record_and_watch(rig, &args.output, codec, args.seconds, &stop)?;
    let tolerance_mm = if codec.kind.is_lossless() { 0.0 } else { codec.tolerance.mm() };
    let report = Report::new(args.output.clone(), &recorded, tolerance_mm);
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.words())?;
    }
    let disconnected = recorded.recording.ending == Ending::Disconnected;
    if disconnected {
        say("the device was disconnected: the take ends there");
    }
    let ledger = &recorded.written.ledger;
    Ok(Outcome::of(ledger.lost_anything() || !ledger.closes() || disconnected))
}
