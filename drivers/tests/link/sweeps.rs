//! Every cut and every changed byte of a stream that holds every message.

use mocapd_drivers::{device::Protocol, link::HostLink};

use crate::{
    device_hears,
    examples::{self, Example},
    host_hears,
};

fn stream_of(examples: &[Example]) -> Vec<u8> {
    examples.iter().flat_map(|example| example.wire.iter().copied()).collect()
}

/// What must come of a damaged stream, worked out without the decoder: a segment counts if and only
/// if an example has it, byte for byte.
#[derive(Debug, Default, PartialEq)]
struct Expected {
    heard: Vec<String>,
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
            Some(example) => expected.heard.push(example.heard.clone()),
            None => {
                expected.damaged += 1;
                expected.skipped += segment.len() as u64 + 1;
            }
        }
    }
    expected
}

fn heard(stream: &[u8]) -> Expected {
    let mut host = HostLink::new();
    let heard = host_hears(&mut host, stream);
    let counters = host.counters();
    assert_eq!(counters.bytes, stream.len() as u64);
    assert_eq!(counters.messages, heard.len() as u64);
    assert_eq!(counters.messages_unknown, 0);
    Expected { heard, damaged: counters.messages_damaged, skipped: counters.bytes_skipped }
}

#[test]
fn an_undamaged_stream_is_heard_whole() {
    let examples = examples::of_devices();
    let got = heard(&stream_of(&examples));
    let all = examples.iter().map(|example| example.heard.clone()).collect::<Vec<_>>();
    assert_eq!(got, Expected { heard: all, damaged: 0, skipped: 0 });
}

#[test]
fn every_changed_byte_costs_its_message_and_nothing_else() {
    let examples = examples::of_devices();
    let clean = stream_of(&examples);
    for position in 0..clean.len() {
        for change in 1..=255 {
            let mut stream = clean.clone();
            stream[position] ^= change;
            assert_eq!(heard(&stream), expected(&stream, &examples), "byte {position} ^ {change}");
        }
    }
}

#[test]
fn every_lost_byte_costs_its_message_and_nothing_else() {
    let examples = examples::of_devices();
    let clean = stream_of(&examples);
    for position in 0..clean.len() {
        let mut stream = clean.clone();
        stream.remove(position);
        assert_eq!(heard(&stream), expected(&stream, &examples), "byte {position}");
    }
}

#[test]
fn after_a_cut_at_any_byte_the_next_boundary_is_back_in_step() {
    let examples = examples::of_devices();
    let clean = stream_of(&examples);
    for cut in 0..=clean.len() {
        let mut stream = clean[..cut].to_vec();
        assert_eq!(heard(&stream), expected(&stream, &examples), "cut at {cut}");
        stream.extend_from_slice(&clean);
        let got = heard(&stream);
        assert_eq!(got, expected(&stream, &examples), "cut at {cut}, and on");
        assert!(got.damaged <= 1, "cut at {cut}");
        assert!(got.heard.ends_with(&[examples.last().unwrap().heard.clone()]));
    }
}

#[test]
fn every_split_in_two_and_single_bytes_are_heard_the_same() {
    let clean = stream_of(&examples::of_devices());
    let whole = host_hears(&mut HostLink::new(), &clean);
    for split in 0..=clean.len() {
        let mut host = HostLink::new();
        let mut events = host_hears(&mut host, &clean[..split]);
        events.extend(host_hears(&mut host, &clean[split..]));
        assert_eq!(events, whole, "split at {split}");
    }
    let mut host = HostLink::new();
    let events = clean.iter().flat_map(|&byte| host_hears(&mut host, &[byte])).collect::<Vec<_>>();
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
            let got = device_hears(&mut device, &stream);
            let want = expected(&stream, &commands);
            assert_eq!(got, want.heard, "byte {position} ^ {change}");
            assert_eq!(device.counters().bytes_skipped, want.skipped);
            assert_eq!(device.counters().messages_damaged, want.damaged);
        }
    }
}
