//! Arbitrary bytes on the link, decoded by the host and by the device.

use mocapd_drivers::{
    device::{DeviceEvent, LinkCounters, Protocol},
    link::{DeviceLink, HostLink, LINK_VERSION, MARKERS_MAX},
};

use crate::Input;

/// Decodes the bytes at both ends, whole and in pieces, with equal results. The first byte selects whether they are
/// used unchanged, or as messages that first get valid checksums, which a fuzzer cannot guess.
pub fn hear(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let how = input.byte();
    let rest = input.take(usize::MAX);
    let wire = if how & 1 == 1 { sealed(rest) } else { rest.to_vec() };
    let piece = [wire.len().max(1), 1, 7, 64][usize::from(how >> 1 & 3)];
    let whole = hosts(&wire, wire.len().max(1));
    assert_eq!(whole, hosts(&wire, piece), "the pieces change what a host hears");
    assert_eq!(whole.1.bytes, wire.len() as u64);
    assert!(whole.1.bytes_skipped <= whole.1.bytes);
    assert_eq!(devices(&wire, wire.len().max(1)), devices(&wire, piece));
}

/// The host's events, reduced to kinds and sizes for comparison, and its counters.
fn hosts(wire: &[u8], piece: usize) -> (Vec<(u8, usize)>, LinkCounters) {
    let (mut link, mut heard) = (HostLink::new(), Vec::new());
    for bytes in wire.chunks(piece) {
        link.push(bytes, &mut |event| {
            heard.push(match event {
                DeviceEvent::Frame(frame) => {
                    assert!(frame.markers.len() <= MARKERS_MAX);
                    let finite = |p: &[f32; 3]| p.iter().all(|coordinate| coordinate.is_finite());
                    let seen = frame.markers.iter().filter(|marker| !marker.occluded);
                    assert!(seen.clone().all(|marker| finite(&marker.position_mm)));
                    (0, frame.markers.len())
                }
                DeviceEvent::Markers(markers) => {
                    assert!(markers.len() <= MARKERS_MAX);
                    (1, markers.len())
                }
                DeviceEvent::Hello(hello) => (2, hello.model.len() + hello.serial.len()),
                other => (3, format!("{other:?}").len()),
            });
        });
    }
    let counters = link.counters();
    (heard, counters)
}

fn devices(wire: &[u8], piece: usize) -> (Vec<String>, LinkCounters) {
    let (mut link, mut heard) = (DeviceLink::new(), Vec::new());
    for bytes in wire.chunks(piece) {
        link.push(bytes, &mut |command| heard.push(format!("{command:?}")));
    }
    (heard, link.counters())
}

/// Encodes a sequence of `{type, length in 2 bytes, payload}` as messages.
fn sealed(bytes: &[u8]) -> Vec<u8> {
    let mut input = Input::new(bytes);
    let mut wire = Vec::new();
    while !input.is_empty() {
        let mut message = vec![LINK_VERSION, input.byte()];
        let len = input.pair();
        message.extend_from_slice(input.take(len));
        let checksum = crc32fast::hash(&message);
        message.extend_from_slice(&checksum.to_le_bytes());
        let start = wire.len();
        wire.resize(start + cobs::max_encoding_length(message.len()), 0);
        let n = cobs::encode(&message, &mut wire[start..]);
        wire.truncate(start + n);
        wire.push(0);
    }
    wire
}
