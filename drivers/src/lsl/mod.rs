//! Streams of the Lab Streaming Layer (LSL): `docs/lsl.md`.
//!
//! Discovery, the handshake of a feed and time probes are those of the crate `labstream-core`, sans-io; sockets, bounds and
//! what becomes of samples are here. [`LslTransport`] finds the streams and merges what they send into one stream of bytes
//! ([`envelope`]), [`LslHost`] decodes it.

mod axis;
mod convention;
mod decoder;
mod description;
mod discovery;
mod envelope;
mod feed;
mod host;
mod layout;
mod line;
mod values;

pub use self::{
    description::{ChannelDescription, DESCRIPTION_BYTES_MAX, StreamDescription},
    discovery::{FoundStream, streams},
    envelope::{LineRequest, Message, MessageReader, put_message},
    host::LslHost,
    layout::{GroupLayout, Layout, MarkerColumns, StreamRole},
    line::LslTransport,
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
