//! `bench`: speed of the codec and of the recording pipeline on this machine.

mod codec;
mod network;
mod pipeline;

use std::{
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use anyhow::Context;
use clap::Subcommand;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_drivers::{device::Command, registry, uri::DeviceUri};
use mocapd_service::{process, units};
use mocapd_simulator::{
    NetworkOptions,
    device::{Device, DeviceSettings},
    generator::{JumpSpec, SAMPLES_MAX},
    pty::{ServeOptions, serve_pty},
    qtm::{QtmDevice, QtmListener, QtmSettings},
    sampled::{Electrodes, SampledSource},
};
use mocapd_take::motion::Motion;

use crate::cli::{output::print, stop::stop_on_signal};

#[derive(Debug, Subcommand)]
pub(crate) enum Bench {
    /// Measure size, error and speed of the resamplers on your own files, on one core
    Codec(codec::Args),
    /// Measure a recording from a simulated device over a pty to disk, and the pipeline alone
    Pipeline(pipeline::Args),
    /// Measure the delays of frames of a simulated QTM: to the rings, beside a serial line, and through the service to a client
    Network(network::Args),
    /// Run the device that `bench pipeline` and `bench network` record
    #[command(hide = true)]
    Device(DeviceArgs),
}

pub(crate) fn run(bench: &Bench) -> anyhow::Result<Outcome> {
    match bench {
        Bench::Codec(args) => codec::run(args),
        Bench::Pipeline(args) => pipeline::run(args),
        Bench::Network(args) => network::run(args),
        Bench::Device(args) => serve_device(args),
    }
}

/// The median; for an even number of values, the lower of the two in the middle.
fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut sorted: Vec<_> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len().saturating_sub(1) / 2).copied().unwrap_or(f64::NAN)
}

/// Shortest measurement: long compared with the resolution of the clock and the time slices of the scheduler.
const MEASUREMENT_MIN: Duration = Duration::from_millis(20);

/// The median time of a run over `repeats` measurements, each the mean of as many runs as fill [`MEASUREMENT_MIN`]; the
/// first run warms up and is not measured.
fn median_time(
    repeats: u8,
    mut run: impl FnMut() -> anyhow::Result<()>,
) -> anyhow::Result<Duration> {
    let started = Instant::now();
    run()?;
    let first = started.elapsed().max(Duration::from_nanos(1));
    let runs = (MEASUREMENT_MIN.as_secs_f64() / first.as_secs_f64()).round().max(1.0) as u32;
    let mut times = Vec::new();
    for _ in 0..repeats.max(1) {
        let started = Instant::now();
        for _ in 0..runs {
            run()?;
        }
        times.push(started.elapsed() / runs);
    }
    times.sort_unstable();
    Ok(times[times.len() / 2])
}

/// Reads a device for `length` and discards the bytes: the processor time that the line alone costs, in percent of one
/// core.
pub(super) fn bare_read_cpu_percent(uri: &DeviceUri, length: Duration) -> anyhow::Result<f64> {
    let mut opened = registry::open(uri)?;
    let mut command = Vec::new();
    opened.protocol.command(Command::Start { line_bytes_per_s: 0 }, &mut command);
    opened.transport.write_all(&command)?;
    let before = process::usage(None).context("cannot read the processor time from /proc")?;
    let mut buffer = vec![0; 64 << 10];
    let started = Instant::now();
    while started.elapsed() < length {
        opened.transport.read(&mut buffer)?;
    }
    let after = process::usage(None).context("cannot read the processor time from /proc")?;
    command.clear();
    opened.protocol.command(Command::Stop, &mut command);
    opened.transport.write_all(&command)?;
    Ok(100.0 * (after.cpu_s - before.cpu_s) / started.elapsed().as_secs_f64())
}

/// Copies `bytes` once; the speed in GB/s.
pub(super) fn copy_gb_per_s(bytes: &[u8]) -> f64 {
    let started = Instant::now();
    let copy = std::hint::black_box(bytes.to_vec());
    let seconds = started.elapsed().as_secs_f64();
    copy.len() as f64 / seconds / 1e9
}

#[derive(Debug, clap::Args)]
pub(crate) struct DeviceArgs {
    #[arg(long)]
    markers: usize,
    #[arg(long, value_parser = units::rate_hz)]
    rate: f64,
    #[arg(long, value_parser = units::duration)]
    seconds: Duration,
    #[arg(long)]
    emg: Vec<Electrodes>,
    #[arg(long, conflicts_with = "emg")]
    qtm: bool,
}

/// Checks that the motion of a benchmark fits into memory.
///
/// # Errors
/// A usage error with its number of samples.
fn check(markers: u16, rate_hz: f64, seconds: f64) -> Result<(), UsageError> {
    let samples = f64::from(markers) * rate_hz * seconds;
    if samples <= SAMPLES_MAX as f64 {
        return Ok(());
    }
    Err(UsageError(format!(
        "{markers} markers at {rate_hz} Hz for {seconds} s are {samples:.0} samples, more than {SAMPLES_MAX}: \
         reduce the time, the rate or the markers"
    )))
}

/// The motion that every benchmark records.
fn motion(markers: usize, rate_hz: f64, seconds: f64) -> anyhow::Result<Motion> {
    let spec = JumpSpec { seconds: Some(seconds), n_markers: markers, ..JumpSpec::new(1, rate_hz) };
    Ok(spec.generate()?.motion)
}

/// Serves the simulated device of `bench pipeline` and `bench network`, which is a process of its own so that its processor time is counted
/// separately.
fn serve_device(args: &DeviceArgs) -> anyhow::Result<Outcome> {
    let stop = stop_on_signal()?;
    let motion = motion(args.markers, args.rate, args.seconds.as_secs_f64())?;
    if args.qtm {
        let listener = QtmListener::open(0)?;
        let mut device = QtmDevice::new(motion, QtmSettings::default())?;
        print(&format!("{}\n", listener.uri()))?;
        listener.serve(&mut device, NetworkOptions::default(), &stop)?;
        return Ok(Outcome::Done);
    }
    let sampled = (0..).zip(&args.emg);
    let sampled = sampled.map(|(id, of)| SampledSource::electrodes(id, *of, id.into()));
    let sampled = sampled.collect::<Result<Vec<_>, _>>()?;
    let mut device = Device::new(motion, DeviceSettings { sampled, ..Default::default() })?;
    let log = serve_pty(&mut device, None, ServeOptions::default(), &stop, |path| {
        print(&format!("{}\n", path.display())).ok();
    })?;
    stop.store(true, Ordering::Relaxed);
    print(&format!("{}\n", log.total.frames_produced))?;
    Ok(Outcome::Done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_of_odd_and_even_counts() {
        assert!((median([3.0, 1.0, 2.0]) - 2.0).abs() < 1e-9);
        assert!((median([4.0, 1.0, 2.0, 3.0]) - 2.0).abs() < 1e-9);
        assert!(median([]).is_nan());
    }
}
