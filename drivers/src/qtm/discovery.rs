//! The search for QTM servers by broadcast, both ends: a datagram asks, and each server answers.

use std::time::Duration;

use super::packet::{HEADER_BYTES, Packet, PacketKind, printable, put_packet};
use crate::{
    device::Candidate,
    transport::network::search,
    uri::{Location, NetworkAddress},
};

/// The UDP port on which servers are searched for, whatever their other ports are.
pub const DISCOVERY_PORT: u16 = 22_226;

/// Time that servers have to answer: on a local network they need some milliseconds.
const WAIT: Duration = Duration::from_millis(300);

/// A server that answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DiscoveredServer {
    /// Host, version and number of cameras, as it states them.
    pub info: String,
    /// Its little-endian port.
    pub port: u16,
}

/// The question; servers answer to this port of the asking machine.
#[must_use]
pub fn discovery_request(reply_port: u16) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + 2);
    put_packet(PacketKind::Discover, &mut bytes, |out| {
        // In network byte order, unlike all else.
        out.extend_from_slice(&reply_port.to_be_bytes());
    });
    bytes
}

/// Reads a question: the port to answer to; `None` if it is none.
#[must_use]
pub fn read_discovery_request(datagram: &[u8]) -> Option<u16> {
    let packet = Packet::of(datagram).filter(|p| p.kind == Some(PacketKind::Discover))?;
    let port = u16::from_be_bytes(*packet.body.as_array()?);
    (port > 0).then_some(port)
}

/// The answer of a server whose little-endian port is `port`.
#[must_use]
pub fn discovery_reply(host: &str, version: &str, port: u16) -> Vec<u8> {
    let mut bytes = Vec::new();
    put_packet(PacketKind::Command, &mut bytes, |out| {
        let info = format!("{host}, {version}, 0 cameras");
        out.extend(info.bytes().filter(|byte| *byte != 0));
        out.push(0);
        // Other ports are counted from the base port.
        out.extend_from_slice(&port.wrapping_sub(1).to_be_bytes());
    });
    bytes
}

/// Reads an answer; `None` if it is none.
#[must_use]
pub fn read_discovery_reply(datagram: &[u8]) -> Option<DiscoveredServer> {
    let packet = Packet::of(datagram).filter(|p| p.kind == Some(PacketKind::Command))?;
    let (info, base_port) = packet.body.split_last_chunk::<2>()?;
    let port = u16::from_be_bytes(*base_port).checked_add(1)?;
    let info = printable(&String::from_utf8_lossy(info.strip_suffix(&[0])?));
    Some(DiscoveredServer { info, port })
}

/// The servers on the networks of this machine as devices; none is connected to. A machine without a network has none.
pub(crate) fn candidates() -> Vec<Candidate> {
    let answers = search(discovery_request, DISCOVERY_PORT, WAIT).unwrap_or_default();
    let candidate = |host: String, answer: &[u8]| {
        let found = read_discovery_reply(answer)?;
        let address = NetworkAddress::new("qtm", &host, found.port);
        Some(Candidate { product: Some(found.info), ..Candidate::at(Location::Network(address)) })
    };
    let found = answers.iter().filter_map(|(from, bytes)| candidate(from.ip().to_string(), bytes));
    let mut found: Vec<Candidate> = found.collect();
    found.sort_by_key(|candidate| candidate.location.to_string());
    // A server answers once for each network that leads to it.
    found.dedup_by_key(|candidate| candidate.location.to_string());
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The layouts of "Discover packet" and "Discover response packet" in the documents, with their example.
    #[test]
    fn question_and_answer_have_the_documented_bytes() {
        assert_eq!(discovery_request(0x1234), [10, 0, 0, 0, 7, 0, 0, 0, 0x12, 0x34]);
        assert_eq!(read_discovery_request(&discovery_request(0x1234)), Some(0x1234));
        let mut answer = vec![53, 0, 0, 0, 1, 0, 0, 0];
        answer.extend_from_slice(b"MyComputer, QTM 2.5 (build 568), 5 cameras\0");
        answer.extend_from_slice(&[0x56, 0xCE]);
        answer[0] = answer.len() as u8;
        let info = "MyComputer, QTM 2.5 (build 568), 5 cameras".to_owned();
        assert_eq!(read_discovery_reply(&answer), Some(DiscoveredServer { info, port: 22_223 }));
        let ours = read_discovery_reply(&discovery_reply("lab", "mocapd 1", 5000)).unwrap();
        assert_eq!((ours.info.as_str(), ours.port), ("lab, mocapd 1, 0 cameras", 5000));
    }

    #[test]
    fn anything_else_is_neither() {
        let (request, reply) = (discovery_request(9), discovery_reply("lab", "1", 9));
        for bytes in [&request, &reply] {
            for cut in 0..bytes.len() {
                assert_eq!(read_discovery_request(&bytes[..cut]), None);
                assert_eq!(read_discovery_reply(&bytes[..cut]), None);
            }
        }
        assert_eq!(read_discovery_request(&reply), None);
        assert_eq!(read_discovery_reply(&request), None);
        assert_eq!(read_discovery_request(&discovery_request(0)), None);
    }
}
