//! A stream with every message, cut at every byte and changed in every byte.

use mocapd_drivers::{device::Protocol, link::HostLink};

use crate::{
    device_commands,
    examples::{self, Example},
    host_events,
};

fn stream_of(examples: &[Example]) -> Vec<u8> {
    examples.iter().flat_map(|example| example.wire.iter().copied()).collect()
}

/// The expected result of decoding a damaged stream, computed without the decoder: a segment counts if and
/// only if an example has the same bytes.
#[derive(Debug, Default, PartialEq)]
struct Expected {
    decoded: Vec<String>,
    damaged: u64,
    skipped: u64,
}

fn expected(stream: &[u8], examples: &[Example]) -> Expected {
    let mut expected = Expected::default();
    let mut segments = stream.split(|&byte| byte == 0).collect::<Vec<_>>();
    segments.pop();
    for segment in segments.into_iter().filter(|segment| !segment.is_empty()) {
        let of = |wire: &[u8]| {
            wire.strip_suffix(&[0]).map(|wire| wire.strip_prefix(&[0]).unwrap_or(wire))
                == Some(segment)
        };
        match examples.iter().find(|example| of(&example.wire)) {
            Some(example) => expected.decoded.push(example.decoded.clone()),
            None => {
                expected.damaged += 1;
                expected.skipped += segment.len() as u64 + 1;
            }
        }
    }
    expected
}

fn decode(stream: &[u8]) -> Expected {
    let mut host = HostLink::new();
    let decoded = host_events(&mut host, stream);
    let counters = host.counters();
    assert_eq!(counters.bytes, stream.len() as u64);
    assert_eq!(counters.messages, decoded.len() as u64);
    assert_eq!(counters.messages_unknown, 0);
    Expected { decoded, damaged: counters.messages_damaged, skipped: counters.bytes_skipped }
}

#[test]
fn an_undamaged_stream_decodes_completely() {
    let examples = examples::of_devices();
    let got = decode(&stream_of(&examples));
    let all = examples.iter().map(|example| example.decoded.clone()).collect::<Vec<_>>();
    assert_eq!(got, Expected { decoded: all, damaged: 0, skipped: 0 });
}

#[test]
fn every_changed_byte_costs_its_message_and_nothing_else() {
    let examples = examples::of_devices();
    let clean = stream_of(&examples);
    let mut stream = clean.clone();
    for position in 0..clean.len() {
        // Each bit, a delimiter, all bits; every change at some places: the checksum finds all within one byte alike.
        let bits = (0..8).map(|bit| 1 << bit).chain([clean[position], 0xFF]);
        let changes: Vec<u8> = if position % 8 == 0 { (1..=255).collect() } else { bits.collect() };
        for change in changes {
            stream[position] = clean[position] ^ change;
            assert_eq!(decode(&stream), expected(&stream, &examples), "byte {position} ^ {change}");
        }
        stream[position] = clean[position];
    }
}

#[test]
fn every_lost_byte_costs_its_message_and_nothing_else() {
    let examples = examples::of_devices();
    let clean = stream_of(&examples);
    for position in 0..clean.len() {
        let mut stream = clean.clone();
        stream.remove(position);
        assert_eq!(decode(&stream), expected(&stream, &examples), "byte {position}");
    }
}

#[test]
fn the_decoder_resynchronises_after_a_cut_at_any_byte() {
    let examples = examples::of_devices();
    let clean = stream_of(&examples);
    for cut in 0..=clean.len() {
        let mut stream = clean[..cut].to_vec();
        assert_eq!(decode(&stream), expected(&stream, &examples), "cut at {cut}");
        stream.extend_from_slice(&clean);
        let got = decode(&stream);
        assert_eq!(got, expected(&stream, &examples), "cut at {cut}, and on");
        assert!(got.damaged <= 1, "cut at {cut}");
        assert!(got.decoded.ends_with(&[examples.last().unwrap().decoded.clone()]));
    }
}

#[test]
fn every_split_and_single_bytes_decode_alike() {
    let clean = stream_of(&examples::of_devices());
    let whole = host_events(&mut HostLink::new(), &clean);
    for split in 0..=clean.len() {
        let mut host = HostLink::new();
        let mut events = host_events(&mut host, &clean[..split]);
        events.extend(host_events(&mut host, &clean[split..]));
        assert_eq!(events, whole, "split at {split}");
    }
    let mut host = HostLink::new();
    let events = clean.iter().flat_map(|&byte| host_events(&mut host, &[byte])).collect::<Vec<_>>();
    assert_eq!(events, whole);
}

#[test]
fn a_device_survives_every_changed_byte_of_its_commands() {
    let commands =
        examples::all().into_iter().filter(|example| example.is_command).collect::<Vec<_>>();
    let clean = stream_of(&commands);
    for position in 0..clean.len() {
        for change in 1..=255 {
            let mut stream = clean.clone();
            stream[position] ^= change;
            let mut device = mocapd_drivers::link::DeviceLink::new();
            let got = device_commands(&mut device, &stream);
            let want = expected(&stream, &commands);
            assert_eq!(got, want.decoded, "byte {position} ^ {change}");
            assert_eq!(device.counters().bytes_skipped, want.skipped);
            assert_eq!(device.counters().messages_damaged, want.damaged);
        }
    }
}
