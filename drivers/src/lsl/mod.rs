//! Streams of the Lab Streaming Layer (LSL): `docs/lsl.md`.
//!
//! Discovery, the handshake of a feed and time probes are those of the crate `labstream-core`, sans-io; bounds and what
//! becomes of samples are here. The [transport](crate::transport::lsl) finds the streams and merges what they send into one
//! stream of [messages](StreamMessage), which [`LslHost`] decodes.

mod axis;
mod decoder;
mod description;
mod envelope;
mod host;
mod layout;
mod outlet;
mod values;

pub(crate) use self::{
    description::clean,
    envelope::{DATA_HEADER_BYTES, data_header},
};
pub use self::{
    description::{
        ChannelDescription, DESCRIPTION_BYTES_MAX, Publisher, StreamDescription, StreamInfo,
        hostname,
    },
    envelope::{LineRequest, MessageReader, StreamMessage, put_message},
    host::LslHost,
    layout::{GroupLayout, Layout, MarkerColumns, StreamRole},
    outlet::{INLETS_MAX, InletId, InletReport, OutletServer},
    values::ValueFormat,
};
use crate::{
    device::{Claim, Family},
    stream_query::StreamQuery,
    uri::Location,
};

pub(crate) const FAMILY: Family = Family {
    name: "lsl",
    claims: |candidate| match candidate.location {
        Location::Streams(_) => Claim::Certain,
        _ => Claim::No,
    },
    protocol: |location| {
        let query = match location {
            Location::Streams(query) => query.clone(),
            _ => StreamQuery::default(),
        };
        Box::new(LslHost::new(query))
    },
};
