//! OptiTrack systems through NatNet, both ends: `docs/natnet.md`.
//!
//! [`NatNetHost`] is the client's end, sans-io; it sends [line commands](crate::transport::polled). What a server says and
//! understands is in the same modules, so that both ends have one description of every message.

mod assets;
mod bodies;
mod bring_up;
pub(crate) mod discovery;
mod frame;
mod host;
mod message;
mod model;
mod names;
mod run;
mod sampled;
mod server;
mod stream_run;

use std::net::Ipv4Addr;

pub use self::{
    assets::{AssetTable, ServedMarker, in_m},
    discovery::find_servers,
    frame::{
        ACTIVE, ChannelSamples, FrameEnd, FrameOfData, FrameToSend, HAS_MODEL, MEASURED,
        MODEL_FILLED, MODELS_CHANGED, NatNetMarker, OCCLUDED, SampledData, SampledToSend,
        SetPositions, SetToSend, UNLABELLED, WireBody, put_frame,
    },
    host::NatNetHost,
    message::{
        Bitstream, HEADER_BYTES, MESSAGE_BYTES_MAX, Message, MessageKind, ServerInfo, StreamInfo,
        put_discovery, put_echo, put_message, put_text, read_echo_reply, read_wanted_version,
    },
    model::{Asset, AssetKind, MarkerSet, Model, ModelError, SampledDescription},
    server::{
        CLIENTS_MAX, DatagramContent, NatNetServer, ServedStream, ServerDatagram, ServerSettings,
        StreamReport,
    },
};
use crate::{
    device::{Claim, Family},
    transport::polled::line_command_channel,
    uri::{Location, NetworkAddress},
};

/// UDP port of commands.
pub const COMMAND_PORT: u16 = 1510;

/// UDP port of frames, unless the server states another.
pub const DATA_PORT: u16 = 1511;

/// The multicast group of frames, unless the server states another.
pub const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 42, 99);

pub(crate) const FAMILY: Family = Family {
    name: "natnet",
    claims: |candidate| match candidate.location {
        Location::Network(NetworkAddress { family: "natnet", .. }) => Claim::Certain,
        _ => Claim::No,
    },
    protocol: |location| {
        // A sender without a receiver, until `attach` connects the protocol to a line.
        let (sender, _) = line_command_channel();
        Box::new(NatNetHost::new(location, sender))
    },
};
