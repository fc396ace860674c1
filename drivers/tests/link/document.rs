//! The code encodes and decodes the examples of docs/link-protocol.md exactly.

use mocapd_drivers::link::{DeviceLink, HostLink};

use crate::{device_commands, examples, host_events};

const DOCUMENT: &str = include_str!("../../../docs/link-protocol.md");

/// The blocks ```` ```hex NAME ````: their names and bytes. A `#` starts a comment.
fn hex_blocks() -> Vec<(&'static str, Vec<u8>)> {
    let mut blocks = Vec::new();
    for part in DOCUMENT.split("\n```hex ").skip(1) {
        let (name, rest) = part.split_once('\n').unwrap();
        let (body, _) = rest.split_once("\n```").unwrap();
        let words =
            body.lines().flat_map(|line| line.split('#').next().unwrap().split_whitespace());
        let bytes = words.map(|word| u8::from_str_radix(word, 16).unwrap()).collect();
        blocks.push((name, bytes));
    }
    blocks
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

#[test]
fn every_example_is_documented_as_encoded() {
    let blocks = hex_blocks();
    let examples = examples::all();
    for example in &examples {
        let wire = blocks.iter().find(|(name, _)| *name == format!("{} wire", example.name));
        let documented = wire.map(|(_, bytes)| hex(bytes)).unwrap_or_default();
        assert_eq!(documented, hex(&example.wire), "{} wire", example.name);

        let segment =
            example.wire.split(|&byte| byte == 0).find(|piece| !piece.is_empty()).unwrap();
        let mut message = segment.to_vec();
        let n = cobs::decode_in_place(&mut message).unwrap();
        let plain = blocks.iter().find(|(name, _)| *name == format!("{} message", example.name));
        let documented = plain.map(|(_, bytes)| hex(bytes)).unwrap_or_default();
        assert_eq!(documented, hex(&message[..n]), "{} message", example.name);
    }
    assert_eq!(blocks.len(), 2 * examples.len(), "a block without an example");
}

#[test]
fn every_documented_wire_decodes_as_documented() {
    for example in examples::all() {
        let (_, wire) = hex_blocks()
            .into_iter()
            .find(|(name, _)| *name == format!("{} wire", example.name))
            .unwrap();
        let decoded = if example.is_command {
            device_commands(&mut DeviceLink::new(), &wire)
        } else {
            host_events(&mut HostLink::new(), &wire)
        };
        assert_eq!(decoded, [example.decoded], "{}", example.name);
    }
}
