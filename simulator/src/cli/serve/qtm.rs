//! `mocapd-sim serve --protocol qtm`: a simulated QTM on the network.

use mocapd_cli::stop::stop_on_signal;
use mocapd_simulator::qtm::{QtmDevice, QtmError, QtmListener, QtmSettings, ServeError};
use mocapd_simulator::source::RecordedSignals;

use super::{DeviceProtocol, ServeArgs, input, refused, serve_at};
use crate::cli::{Failure, notify};

/// Serves a QTM until it is stopped.
pub(super) fn run(args: &ServeArgs) -> Result<(), Failure> {
    let port = check(args)?;
    let motion = input::motion(args)?;
    let n_markers = motion.info.markers.len();
    let RecordedSignals { sampled, bodies, .. } = input::network_signals(args)?;
    let settings = QtmSettings {
        rate_hz: args.rate,
        speed: args.speed,
        looping: args.looping,
        faults: input::script(args)?,
        sampled,
        bodies,
    };
    let mut device = QtmDevice::new(motion, settings).map_err(|error| match error {
        QtmError::Device(error) => refused(error),
        _ => Failure::usage(error),
    })?;
    let stop = stop_on_signal()?;
    let mut listener = QtmListener::open(port).map_err(|error| match error {
        ServeError::Listen { .. } => Failure::usage(error),
        _ => Failure::from(error),
    })?;
    if !listener.answer_searches() {
        notify("`mocapd devices` does not find it: another program uses UDP port 22226 alone");
    }
    let (uri, motion) = (listener.uri(), (n_markers, device.rate_millihertz()));
    serve_at(args, &uri, motion, |options| listener.serve(&mut device, options, &stop))
}

/// Refuses options that a QTM does not have. Returns the port; 0 for any.
fn check(args: &ServeArgs) -> Result<u16, Failure> {
    let usage = |message: String| Err(Failure::usage_message(message));
    if args.protocol != DeviceProtocol::Qtm {
        return usage(
            "--tcp needs --protocol qtm: other devices are on a line, such as --pty".to_owned(),
        );
    }
    if args.line.is_chosen() {
        return usage(
            "a QTM is on the network: give --tcp, or nothing, in place of the line".to_owned(),
        );
    }
    let port = args.line.tcp.flatten();
    let options = [
        ("--wire", args.wire.is_some()),
        ("--tool", !args.tool.is_empty()),
        ("--no-bx2", args.no_bx2),
        ("--batch", args.batch().is_some()),
        ("--drift-ppm", args.drift_ppm != 0.0),
        ("--batch-log", args.batch_log.is_some()),
    ];
    match options.iter().find(|(_, is_set)| *is_set) {
        Some((option, _)) => usage(format!("{option} does not apply to a QTM: remove it")),
        None => Ok(port.unwrap_or(0)),
    }
}
