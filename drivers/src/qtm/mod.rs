//! Qualisys Track Manager (QTM) over its RT protocol, both ends: `docs/qtm.md`.
//!
//! [`QtmHost`] is the client's end, sans-io; it sends [line commands](crate::transport::polled). What a server says and
//! understands is in the same modules, so that both ends have one description of every message.

mod bodies;
mod body_settings;
mod bring_up;
mod command;
pub(crate) mod discovery;
mod frame;
mod groups;
mod host;
mod named_bodies;
mod packet;
mod renewal;
mod rotation;
mod run;
mod sampled;
mod server;
mod settings;
mod stream_run;
mod xml;

pub use self::{
    bodies::{BodyComponent, BodyComponentKind, ServedBody},
    body_settings::BodySettings,
    command::{
        ClientCommand, Components, DatagramTarget, SettingsRequest, StreamRate, StreamRequest,
        VERSIONS, WELCOME,
    },
    discovery::{
        DISCOVERY_PORT, DiscoveredServer, discovery_reply, discovery_request, read_discovery_reply,
        read_discovery_request,
    },
    frame::{
        ComponentToSend, FrameComponent, FrameHeader, MarkerComponent, MarkerComponentKind,
        WireMarker, put_frame, read_components, read_frame,
    },
    host::QtmHost,
    packet::{
        Event, HEADER_BYTES, MISSING, OutOfStep, PACKET_BYTES_MAX, Packet, PacketKind,
        PacketReader, put_event, put_packet, put_text,
    },
    sampled::{DeviceSamples, FORCE_VALUES, SampledComponentKind, SamplesToSend},
    server::{
        CLIENTS_MAX, ClientId, ClientReport, Datagram, Delivery, OwnerCommand, OwnerRequest,
        QtmServer, ServedFrame,
    },
    settings::{AnalogDevice, ForcePlate, ForceUnits, LABELS_MAX, ServedSettings, Settings},
};
use crate::{
    axis,
    device::{Claim, Family},
    marker_ids as labels,
    transport::polled::line_command_channel,
    uri::{Location, NetworkAddress},
};

pub(crate) const FAMILY: Family = Family {
    name: "qtm",
    claims: |candidate| match candidate.location {
        Location::Network(NetworkAddress { family: "qtm", .. }) => Claim::Certain,
        _ => Claim::No,
    },
    protocol: |location| {
        // A sender without a receiver, until `attach` connects the protocol to a line.
        let (sender, _) = line_command_channel();
        Box::new(QtmHost::new(location, sender, None))
    },
};
