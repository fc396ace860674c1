//! The messages of the Foxglove WebSocket protocol (`foxglove.websocket.v1`, which Foxglove itself calls `foxglove.sdk.v1`):
//! JSON in text, samples and times in binary.

use data_encoding::BASE64;
use serde::{Deserialize, Serialize};

use super::web_socket::{put_binary, put_text};

/// The subprotocols that are spoken, which are the same in everything that is sent here: that of the published protocol, with
/// its libraries and Lichtblick, and that of Foxglove's present programs.
pub(super) const SUBPROTOCOLS: [&str; 2] = ["foxglove.websocket.v1", "foxglove.sdk.v1"];

/// Opcodes of binary messages.
const MESSAGE_DATA: u8 = 1;
const TIME: u8 = 2;

/// A channel that clients can subscribe to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Channel {
    pub(super) topic: String,
    /// The full name of its message type.
    pub(super) schema_name: String,
    /// Its `FileDescriptorSet`.
    pub(super) schema: Vec<u8>,
}

/// What a client requests.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub(super) enum ClientMessage {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    /// What this server does not advertise the capability for.
    #[serde(other)]
    Other,
}

/// A subscription: the client's number for it, by which it is sent messages.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Subscription {
    pub(super) id: u32,
    pub(super) channel_id: u32,
}

#[derive(Serialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum ServerMessage<'a> {
    #[serde(rename_all = "camelCase")]
    ServerInfo {
        name: &'a str,
        /// It sends times, and does nothing else beyond the protocol's minimum.
        capabilities: [&'static str; 1],
        session_id: &'a str,
    },
    Status {
        /// 0 for information, 1 for a warning, 2 for an error.
        level: u8,
        message: &'a str,
    },
    Advertise {
        channels: Vec<AdvertisedChannel<'a>>,
    },
    #[serde(rename_all = "camelCase")]
    Unadvertise {
        channel_ids: &'a [u32],
    },
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct AdvertisedChannel<'a> {
    id: u32,
    topic: &'a str,
    encoding: &'static str,
    schema_name: &'a str,
    schema: String,
    schema_encoding: &'static str,
}

/// Appends the greeting.
pub(super) fn put_server_info(name: &str, session_id: &str, out: &mut Vec<u8>) {
    put(&ServerMessage::ServerInfo { name, capabilities: ["time"], session_id }, out);
}

/// Appends an error message for the person at the client.
pub(super) fn put_error(message: &str, out: &mut Vec<u8>) {
    put(&ServerMessage::Status { level: 2, message }, out);
}

/// Appends the announcement of channels with their numbers.
pub(super) fn put_advertise<'a>(
    channels: impl IntoIterator<Item = (u32, &'a Channel)>,
    out: &mut Vec<u8>,
) {
    let advertised = |(id, channel): (u32, &'a Channel)| AdvertisedChannel {
        id,
        topic: &channel.topic,
        encoding: "protobuf",
        schema_name: &channel.schema_name,
        schema: BASE64.encode(&channel.schema),
        schema_encoding: "protobuf",
    };
    let channels: Vec<_> = channels.into_iter().map(advertised).collect();
    if !channels.is_empty() {
        put(&ServerMessage::Advertise { channels }, out);
    }
}

/// Appends the end of channels.
pub(super) fn put_unadvertise(channel_ids: &[u32], out: &mut Vec<u8>) {
    if !channel_ids.is_empty() {
        put(&ServerMessage::Unadvertise { channel_ids }, out);
    }
}

/// Appends a message of a channel.
pub(super) fn put_message(subscription: u32, time_ns: u64, message: &[u8], out: &mut Vec<u8>) {
    let (id, time) = (subscription.to_le_bytes(), time_ns.to_le_bytes());
    put_binary(&[&[MESSAGE_DATA], &id, &time, message], out);
}

/// Appends the time of what follows.
pub(super) fn put_time(time_ns: u64, out: &mut Vec<u8>) {
    put_binary(&[&[TIME], &time_ns.to_le_bytes()], out);
}

fn put(message: &ServerMessage<'_>, out: &mut Vec<u8>) {
    // Texts and numbers can always be written as JSON.
    if let Ok(text) = serde_json::to_string(message) {
        put_text(&text, out);
    }
}
