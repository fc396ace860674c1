//! `mocapd-sim serve --protocol lsl`: a motion, its events and sampled channels as streams of the Lab Streaming Layer.

use std::io::BufWriter;

use mocapd_cli::{numbers::count, stop::stop_on_signal};
use mocapd_simulator::lsl::{LslDevice, LslError, LslOptions, LslOutlets, LslSettings};

use super::report::{LineReport, SentReport};
use super::{ServeArgs, input, refused};
use crate::cli::output::{notify, print, print_json_line};
use crate::cli::{Failure, files};

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
        sampled: input::sampled(args)?,
    };
    let mut device = LslDevice::new(motion, settings).map_err(|error| match error {
        LslError::Device(error) => refused(error),
        _ => Failure::usage(error),
    })?;
    let stop = stop_on_signal()?;
    let outlets = LslOutlets::open(&device)?;
    let mut options = LslOptions { once: args.once, log: None };
    if let Some(path) = &args.log {
        // Recordings are checked against a log: never overwrite one.
        options.log = Some(Box::new(BufWriter::new(files::create(path)?)));
    }
    let hz = f64::from(device.rate_millihertz()) / 1000.0;
    notify(&format!("{} at {hz} Hz, Ctrl-C to stop", count(n_markers as u64, "marker")));
    let uri = outlets.uri();
    if args.json {
        print_json_line(&LineReport { path: &uri })?;
    } else {
        print(&format!("{uri}\n"))?;
    }
    let sent = outlets.serve(&mut device, options, &stop)?;
    let report = SentReport::new(&sent, true);
    if args.json {
        print_json_line(&report)?;
    } else {
        report.text(args.protocol).lines().for_each(notify);
    }
    Ok(())
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
