//! The search for servers on the networks of this machine.

use std::{io, net::SocketAddrV4, time::Duration};

use super::{
    COMMAND_PORT,
    message::{Bitstream, Message, MessageKind, ServerInfo, put_discovery},
};
use crate::{
    device::Candidate,
    transport::network::search,
    uri::{Location, NetworkAddress},
};

/// Time that servers have for a reply: they take milliseconds.
const WAIT: Duration = Duration::from_millis(300);

/// The servers that answer a search at a port.
///
/// # Errors
/// The system's, when no socket can be opened.
pub fn find_servers(port: u16) -> io::Result<Vec<(SocketAddrV4, ServerInfo)>> {
    let mut message = Vec::new();
    put_discovery("mocapd", [0, 1, 0, 0], Bitstream::NEWEST, &mut message);
    let replies = search(|_| message.clone(), port, WAIT)?;
    let server = |(from, bytes): &(SocketAddrV4, Vec<u8>)| {
        let message = Message::of(bytes)?;
        let info = (message.kind == Some(MessageKind::ServerInfo))
            .then(|| ServerInfo::read(message.body))??;
        Some((*from, info))
    };
    Ok(replies.iter().filter_map(server).collect())
}

/// The servers on the networks of this machine as devices. A machine without a network has none.
pub(crate) fn candidates() -> Vec<Candidate> {
    let servers = find_servers(COMMAND_PORT).unwrap_or_default();
    let candidate = |(from, info): (SocketAddrV4, ServerInfo)| {
        let host = from.ip().to_string();
        let address = NetworkAddress::new("natnet", &host, COMMAND_PORT);
        let (app, version) = (info.app_version_text(), info.bitstream);
        Candidate {
            product: Some(format!("{} {app}, NatNet {version}", info.name)),
            ..Candidate::at(Location::Network(address))
        }
    };
    servers.into_iter().map(candidate).collect()
}
