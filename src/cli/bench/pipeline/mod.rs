//! `bench pipeline`: simulator -> pty -> record -> disk, each in a process of its own, and the pipeline
//! alone; each figure the median of the runs, with a reference from the same run beside it.

mod over_pty;
mod report;

use std::{path::PathBuf, sync::atomic::Ordering, time::Duration};

use anyhow::{bail, ensure};
use mocapd::outcome::Outcome;
use mocapd_service::units;

use self::{
    over_pty::over_pty,
    report::{InProcessReport, Report},
};
use super::{device, in_process};
use crate::cli::{
    codec_args::{CodecArgs, tolerance_mm},
    output::{print, print_json, say},
    stop::stop_on_signal,
    values,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Markers of the simulated device
    #[arg(long, value_name = "N", default_value = "200", value_parser = clap::value_parser!(u16).range(1..=10_000))]
    markers: u16,
    /// Its frame rate: 240, 240Hz, 1kHz
    #[arg(long, value_name = "HZ", default_value = "1000Hz", value_parser = units::rate_hz,
          allow_hyphen_values = true)]
    rate: f64,
    /// Length of each recording: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = values::length,
          allow_hyphen_values = true)]
    seconds: Duration,
    /// Runs; the medians are told
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u16).range(1..=99))]
    runs: u16,
    /// Folder where the takes are written; they are removed again
    #[arg(long, value_name = "DIR", default_value = ".")]
    dir: PathBuf,
    #[command(flatten)]
    codec: CodecArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Length of the in-process motion: long enough to be past the start, short enough for memory.
const IN_PROCESS_S: f64 = 10.0;

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let codec = args.codec.live_settings()?;
    ensure!(args.dir.is_dir(), "{} is no folder: create it first", args.dir.display());
    device::check(args.markers, args.rate, args.seconds.as_secs_f64().max(IN_PROCESS_S))?;
    let stop = stop_on_signal()?;
    let motion = device::motion(args.markers.into(), args.rate, IN_PROCESS_S)?;
    let wire = in_process::wire(&motion)?;
    let mut alone = Vec::new();
    let mut pty = Vec::new();
    for run in 1..=args.runs {
        if !args.json {
            say(&format!("recording {} s, {run} of {}", args.seconds.as_secs_f64(), args.runs));
        }
        alone.push(in_process::run(&motion, &wire, codec)?);
        pty.push(over_pty(args, &codec)?);
        if stop.load(Ordering::Relaxed) {
            bail!("interrupted after {run} of {} runs: nothing is told", args.runs);
        }
    }
    let report = Report {
        markers: args.markers,
        rate_hz: args.rate,
        seconds: args.seconds.as_secs_f64(),
        runs: args.runs,
        resampler: codec.kind.to_string(),
        tolerance_mm: tolerance_mm(&codec),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        pty,
        in_process: InProcessReport {
            wire_bytes: alone.first().map_or(0, |run| run.wire_bytes),
            frames_lost: alone.iter().map(|run| run.frames_lost).sum(),
            times_real_time: alone.iter().map(|run| run.times_real_time).collect(),
            copy_gb_per_s: alone.iter().map(|run| run.copy_gb_per_s).collect(),
        },
    };
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.words())?;
    }
    Ok(Outcome::of(report.lost_anything()))
}
