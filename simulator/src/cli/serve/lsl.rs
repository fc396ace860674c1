//! `mocapd-sim serve --protocol lsl`: a motion, its events and sampled channels as streams of the Lab Streaming Layer.

use mocapd_cli::stop::stop_on_signal;
use mocapd_simulator::lsl::{LslDevice, LslError, LslOutlets, LslSettings};

use super::{ServeArgs, input, refused, serve_at};
use crate::cli::Failure;

/// Serves the streams until it is stopped.
pub(super) fn run(args: &ServeArgs) -> Result<(), Failure> {
    check(args)?;
    let motion = input::motion(args)?;
    let n_markers = motion.info.markers.len();
    let settings = LslSettings {
        name: format!("mocapd-sim-{}", args.serial),
        rate_hz: args.rate,
        speed: args.speed,
        looping: args.looping,
        faults: input::script(args)?,
        sampled: input::network_sampled(args)?,
    };
    let mut device = LslDevice::new(motion, settings).map_err(|error| match error {
        LslError::Device(error) => refused(error),
        _ => Failure::usage(error),
    })?;
    let stop = stop_on_signal()?;
    let outlets = LslOutlets::open(&device)?;
    let (uri, motion) = (outlets.uri(), (n_markers, device.rate_millihertz()));
    serve_at(args, &uri, motion, |options| outlets.serve(&mut device, options, &stop))
}

/// Refuses options that streams do not have.
fn check(args: &ServeArgs) -> Result<(), Failure> {
    let usage = |message: String| Err(Failure::usage_message(message));
    if args.line.is_chosen() || args.line.tcp.is_some() {
        return usage("LSL's streams are on the network: remove the line".to_owned());
    }
    let options = [
        ("--wire", args.wire.is_some()),
        ("--tool", !args.tool.is_empty()),
        ("--no-bx2", args.no_bx2),
        ("--batch", args.batch().is_some()),
        ("--batch-log", args.batch_log.is_some()),
        ("--baud", args.baud.is_some()),
        ("--drift-ppm", args.drift_ppm != 0.0),
    ];
    match options.iter().find(|(_, is_set)| *is_set) {
        Some((option, _)) => usage(format!("{option} does not apply to LSL: remove it")),
        None => Ok(()),
    }
}
