//! The simulated device of `bench pipeline`, in a separate process so that its processor time is counted separately.

use std::{sync::atomic::Ordering, time::Duration};

use mocapd::outcome::{Outcome, UsageError};
use mocapd_service::units;
use mocapd_simulator::{
    device::{Device, DeviceSettings},
    generator::{JumpSpec, SAMPLES_MAX},
    pty::{ServeOptions, serve_pty},
};
use mocapd_take::motion::Motion;

use crate::cli::{output::print, stop::stop_on_signal};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[arg(long)]
    markers: usize,
    #[arg(long, value_parser = units::rate_hz)]
    rate: f64,
    #[arg(long, value_parser = units::duration)]
    seconds: Duration,
}

/// Checks that the motion of a benchmark fits into memory.
///
/// # Errors
/// A usage error with its number of samples.
pub(super) fn check(markers: u16, rate_hz: f64, seconds: f64) -> Result<(), UsageError> {
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
pub(super) fn motion(markers: usize, rate_hz: f64, seconds: f64) -> anyhow::Result<Motion> {
    let spec = JumpSpec { seconds: Some(seconds), n_markers: markers, ..JumpSpec::new(1, rate_hz) };
    Ok(spec.generate()?.motion)
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let stop = stop_on_signal()?;
    let motion = motion(args.markers, args.rate, args.seconds.as_secs_f64())?;
    let mut device = Device::new(motion, DeviceSettings::default())?;
    let log = serve_pty(&mut device, None, ServeOptions::default(), &stop, |path| {
        print(&format!("{}\n", path.display())).ok();
    })?;
    stop.store(true, Ordering::Relaxed);
    print(&format!("{}\n", log.total.frames_produced))?;
    Ok(Outcome::Done)
}
