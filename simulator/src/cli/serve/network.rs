//! `mocapd-sim serve --protocol natnet`, `qtm` or `lsl`: a simulated Motive or QTM on the network, or a motion, its events
//! and sampled channels as streams of the Lab Streaming Layer.

use std::net::SocketAddrV4;

use clap::Args;
use mocapd_cli::stop::stop_on_signal;
use mocapd_drivers::natnet::{Bitstream, DATA_PORT, ServedStream};
use mocapd_simulator::{
    lsl::{LslDevice, LslError, LslOutlets, LslSettings},
    natnet::{NatNetDevice, NatNetError, NatNetListener, NatNetServeError, NatNetSettings},
    qtm::{QtmDevice, QtmError, QtmListener, QtmSettings, ServeError},
    source::RecordedSignals,
};

use super::{DeviceProtocol, ServeArgs, input, refused, serve_at};
use crate::cli::{Failure, notify};

/// The options of a simulated Motive.
#[derive(Debug, Args)]
pub(super) struct NatNetArgs {
    /// With --protocol natnet: take commands at this UDP port of this machine only [default: any free one]
    #[arg(long, value_name = "PORT")]
    udp: Option<u16>,
    /// With --protocol natnet: send frames to this group and port, by default 239.255.42.99:1511, and not to each client
    #[arg(long, value_name = "GROUP:PORT", num_args = 0..=1, value_parser = group)]
    multicast: Option<Option<SocketAddrV4>>,
    /// With --protocol natnet, and without --multicast: send frames to this port of each client, too [default: 1511]
    #[arg(long, value_name = "PORT", conflicts_with = "multicast")]
    data_port: Option<u16>,
    /// With --protocol natnet: version of the bitstream, 2.10 to 4.2 [default: 4.2]
    #[arg(long, value_name = "VERSION")]
    bitstream: Option<Bitstream>,
    /// With --protocol natnet: the markers whose labels begin with NAME: are a rigid body, and not a skeleton (repeatable)
    #[arg(long, value_name = "NAME")]
    rigid_body: Vec<String>,
}

impl NatNetArgs {
    /// The first of the options that is given.
    pub(super) fn first_given(&self) -> Option<&'static str> {
        let options = [
            ("--udp", self.udp.is_some()),
            ("--multicast", self.multicast.is_some()),
            ("--data-port", self.data_port.is_some()),
            ("--bitstream", self.bitstream.is_some()),
            ("--rigid-body", !self.rigid_body.is_empty()),
        ];
        options.iter().find(|(_, is_given)| *is_given).map(|(option, _)| *option)
    }
}

/// Parses a group and its port.
fn group(text: &str) -> Result<SocketAddrV4, String> {
    let address = text.parse::<SocketAddrV4>().ok().filter(|address| address.ip().is_multicast());
    address.ok_or_else(|| {
        format!("'{text}' is not a multicast group and a port: give one such as 239.255.42.99:1511")
    })
}

/// Serves a Motive until it is stopped.
pub(super) fn run_natnet(args: &ServeArgs) -> Result<(), Failure> {
    check_natnet(args)?;
    let motion = input::motion(args)?;
    let n_markers = motion.info.markers.len();
    let natnet = &args.natnet;
    let stream = match natnet.multicast {
        Some(group) => ServedStream::Multicast(group.unwrap_or_else(NatNetSettings::default_group)),
        None => ServedStream::Unicast(natnet.data_port.unwrap_or(DATA_PORT)),
    };
    let settings = NatNetSettings {
        rate_hz: args.rate,
        speed: args.speed,
        looping: args.looping,
        bitstream: natnet.bitstream.unwrap_or(Bitstream::NEWEST),
        rigid_bodies: natnet.rigid_body.clone(),
        sampled: input::network_sampled(args)?,
        faults: input::script(args)?,
        residuals: input::residuals(args, &motion)?,
        ..NatNetSettings::new(stream)
    };
    let mut device = NatNetDevice::new(motion, settings).map_err(|error| match error {
        NatNetError::Device(error) => refused(error),
        _ => Failure::usage(error),
    })?;
    let stop = stop_on_signal()?;
    let listener = NatNetListener::open(natnet.udp.unwrap_or(0)).map_err(|error| match error {
        NatNetServeError::Open { .. } => Failure::usage(error),
        _ => Failure::from(error),
    })?;
    let (uri, motion) = (listener.uri(), (n_markers, device.rate_millihertz()));
    serve_at(args, &uri, motion, |options| listener.serve(&mut device, options, &stop))
}

/// Refuses options that a Motive does not have.
fn check_natnet(args: &ServeArgs) -> Result<(), Failure> {
    let usage = |message: String| Err(Failure::usage_message(message));
    if args.line.is_chosen() || args.line.tcp.is_some() {
        return usage(
            "a NatNet server is on the network by UDP: give --udp, or nothing, in place of the line"
                .to_owned(),
        );
    }
    let options = [
        ("--wire", args.wire.is_some()),
        ("--tool", !args.tool.is_empty()),
        ("--no-bx2", args.no_bx2),
        ("--batch", args.batch().is_some()),
        ("--batch-log", args.batch_log.is_some()),
        ("--drift-ppm", args.drift_ppm != 0.0),
    ];
    match options.iter().find(|(_, is_set)| *is_set) {
        Some((option, _)) => {
            usage(format!("{option} does not apply to a NatNet server: remove it"))
        }
        None => Ok(()),
    }
}

/// Whether a protocol has the options of a Motive.
pub(super) fn check_natnet_options(args: &ServeArgs) -> Result<(), Failure> {
    match args.natnet.first_given().filter(|_| args.protocol != DeviceProtocol::Natnet) {
        Some(option) => {
            Err(Failure::usage_message(format!("{option} needs --protocol natnet: add it")))
        }
        None => Ok(()),
    }
}

/// Serves a QTM until it is stopped.
pub(super) fn run_qtm(args: &ServeArgs) -> Result<(), Failure> {
    let port = check_qtm(args)?;
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
        residuals: input::residuals(args, &motion)?,
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
fn check_qtm(args: &ServeArgs) -> Result<u16, Failure> {
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

/// Serves the streams until it is stopped.
pub(super) fn run_lsl(args: &ServeArgs) -> Result<(), Failure> {
    check_lsl(args)?;
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
fn check_lsl(args: &ServeArgs) -> Result<(), Failure> {
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
        ("--residuals", args.residuals),
        ("--drift-ppm", args.drift_ppm != 0.0),
    ];
    match options.iter().find(|(_, is_set)| *is_set) {
        Some((option, _)) => usage(format!("{option} does not apply to LSL: remove it")),
        None => Ok(()),
    }
}
