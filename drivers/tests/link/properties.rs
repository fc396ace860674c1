//! Properties of every message.

use mocapd_drivers::{
    device::{
        Command, DeviceEvent, Frame, Hello, LinkBudget, MarkerInfo, MarkerSample, Pong, Protocol,
        Status, Trigger,
    },
    link::{
        COMMAND_WIRE_BYTES_MAX, DeviceLink, FrameForm, HostLink, MARKERS_MESSAGE_BYTES_MAX,
        frame_bytes_in_volume, frame_bytes_max,
    },
};
use proptest::{collection::vec, prelude::*, sample::Index};

use crate::{FORMS, device_commands, host_events, with_envelope};

fn any_form() -> impl Strategy<Value = FrameForm> {
    any::<Index>().prop_map(|index| *index.get(&FORMS))
}

/// Ids ascending with or without gaps; positions near, far or absurd, including all bit patterns of f32.
fn any_markers() -> impl Strategy<Value = Vec<MarkerSample>> {
    let coordinate = prop_oneof![
        8 => -4000.0f32..4000.0,
        1 => -3.0e6f32..3.0e6,
        1 => any::<u32>().prop_map(f32::from_bits),
    ];
    let marker = (
        prop_oneof![9 => Just(1u16), 1 => 2u16..50],
        any::<bool>(),
        0u8..4,
        [coordinate.clone(), coordinate.clone(), coordinate],
    );
    (any::<u16>(), vec(marker, 0..600)).prop_map(|(first, markers)| {
        let mut next = Some(first % 40_000);
        let mut out = Vec::new();
        for (step, occluded, residual_10um, position_mm) in markers {
            let Some(id) = next else { break };
            next = id.checked_add(step);
            out.push(MarkerSample { id, occluded, residual_10um, position_mm });
        }
        out
    })
}

/// What a host must decode of a marker sent as f32.
fn as_sent(marker: &MarkerSample) -> MarkerSample {
    if marker.occluded || !marker.position_mm.iter().all(|mm| mm.is_finite()) {
        return MarkerSample { id: marker.id, occluded: true, ..MarkerSample::default() };
    }
    *marker
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn every_frame_round_trips(
        form in any_form(),
        seq in any::<u32>(),
        device_ticks in any::<u64>(),
        timecode in any::<Option<[u8; 4]>>(),
        markers in any_markers(),
    ) {
        let frame = Frame { seq, device_ticks, timecode, markers: &markers };
        let mut wire = Vec::new();
        DeviceLink::new().frame(form, &frame, &mut wire).unwrap();
        prop_assert!(wire.len() <= frame_bytes_max(markers.len()));
        let mut n_frames = 0;
        let mut host = HostLink::new();
        host.push(&wire, &mut |event| {
            let DeviceEvent::Frame(got) = event else { panic!("{event:?}") };
            assert_eq!((got.seq, got.device_ticks, got.timecode), (seq, device_ticks, timecode));
            assert_eq!(got.markers.len(), markers.len());
            for (got, sent) in got.markers.iter().zip(markers.iter().map(as_sent)) {
                assert_eq!((got.id, got.occluded, got.residual_10um), (sent.id, sent.occluded, sent.residual_10um));
                for (got, sent) in got.position_mm.into_iter().zip(sent.position_mm) {
                    if form == FrameForm::Float {
                        assert_eq!(got.to_bits(), sent.to_bits());
                    } else {
                        let limit = 0.0005 + f64::from(sent.abs()) * f64::from(f32::EPSILON);
                        assert!((f64::from(got) - f64::from(sent)).abs() <= limit, "{sent} came as {got}");
                    }
                }
            }
            n_frames += 1;
        });
        prop_assert_eq!(n_frames, 1);
    }

    #[test]
    fn every_hello_and_table_round_trips(
        (model, serial, firmware) in ("\\PC{0,16}", "\\PC{0,16}", "\\PC{0,16}"),
        mut rates in [1u32.., 1u32.., 1u32..],
        tick_hz in 1u64..,
        (up_axis, markers_max, n_frames) in (0u8..=3, 0u16..=10_000, any::<u64>()),
        table in vec((any::<u16>(), "\\PC{0,60}", any::<bool>()), 0..200),
    ) {
        rates.sort_unstable();
        let [rate_min_millihertz, rate_millihertz, rate_max_millihertz] = rates;
        let hello = Hello {
            model, serial, firmware, rate_millihertz, rate_min_millihertz, rate_max_millihertz, tick_hz, up_axis, markers_max, n_frames,
        };
        let table = table
            .into_iter()
            .map(|(id, label, labelled)| MarkerInfo { id, label, labelled })
            .collect::<Vec<_>>();
        let mut wire = Vec::new();
        let mut device = DeviceLink::new();
        device.hello(&hello, &mut wire).unwrap();
        device.markers(&table, &mut wire).unwrap();
        let (mut n_hellos, mut got) = (0, Vec::new());
        let mut host = HostLink::new();
        host.push(&wire, &mut |event| match event {
            DeviceEvent::Hello(decoded) => { assert_eq!(decoded, &hello); n_hellos += 1; }
            DeviceEvent::Markers(markers) => got.extend_from_slice(markers),
            other => panic!("{other:?}"),
        });
        prop_assert_eq!((n_hellos, got), (1, table));
        prop_assert_eq!(host.counters().bytes_skipped, 0);
        let longest = wire.split(|&byte| byte == 0).map(<[u8]>::len).max();
        prop_assert!(longest.unwrap() <= MARKERS_MESSAGE_BYTES_MAX + 5);
    }

    #[test]
    fn every_small_message_round_trips(a in any::<u64>(), b in any::<u64>(), c in any::<u32>(), d in any::<i16>(), e in any::<[u8; 2]>()) {
        let status = Status { frames_produced: a, frames_dropped: b, temperature_c_100: d };
        let budget = LinkBudget { needed_bytes_per_s: a, available_bytes_per_s: b, rate_fits_millihertz: c };
        let trigger = Trigger { device_ticks: a, input: e[0], kind: e[1] };
        let pong = Pong { host_ns: a, device_ticks: b };
        let mut device = DeviceLink::new();
        let mut wire = Vec::new();
        device.status(status, &mut wire);
        device.end_of_stream(status, &mut wire);
        device.started(budget, &mut wire);
        device.refused(budget, &mut wire);
        device.trigger(trigger, &mut wire);
        device.pong(pong, &mut wire);
        device.rate_set(c, &mut wire);
        let events = [
            DeviceEvent::Status(status), DeviceEvent::EndOfStream(status), DeviceEvent::Started(budget),
            DeviceEvent::Refused(budget), DeviceEvent::Trigger(trigger), DeviceEvent::Pong(pong), DeviceEvent::RateSet(c),
        ];
        prop_assert_eq!(host_events(&mut HostLink::new(), &wire), events.map(|event| format!("{event:?}")));

        let commands = [
            Command::Identify, Command::Start { line_bytes_per_s: a }, Command::Stop, Command::SetRate(c), Command::Ping { host_ns: b },
        ];
        let mut wire = Vec::new();
        for command in commands {
            let start = wire.len();
            HostLink::new().command(command, &mut wire);
            prop_assert!(wire.len() - start <= COMMAND_WIRE_BYTES_MAX);
        }
        prop_assert_eq!(device_commands(&mut DeviceLink::new(), &wire), commands.map(|command| format!("{command:?}")));
    }

    #[test]
    fn garbage_between_messages_affects_no_message(
        pieces in vec((vec(any::<u8>(), 0..300), vec(any::<Index>(), 0..4)), 1..8),
    ) {
        let mut wire = Vec::new();
        DeviceLink::new().rate_set(120_000, &mut wire);
        let mut host = HostLink::new();
        let mut decoded = 0;
        for (garbage, splits) in &pieces {
            let mut bytes = garbage.clone();
            bytes.push(0);
            bytes.extend_from_slice(&wire);
            let mut cuts = splits.iter().map(|index| index.index(bytes.len())).collect::<Vec<_>>();
            cuts.extend([0, bytes.len()]);
            cuts.sort_unstable();
            for cut in cuts.windows(2) {
                decoded += host_events(&mut host, &bytes[cut[0]..cut[1]]).len();
            }
        }
        let skipped = pieces.iter().flat_map(|(garbage, _)| garbage.split(|&byte| byte == 0))
            .map(|segment| if segment.is_empty() { 0 } else { segment.len() as u64 + 1 })
            .sum::<u64>();
        prop_assert_eq!(decoded, pieces.len());
        prop_assert_eq!(host.counters().bytes_skipped, skipped);
    }

    #[test]
    fn a_valid_envelope_around_anything_never_panics(kind in any::<u8>(), mut payload in vec(any::<u8>(), 0..200), flags in 0u8..4, n in 0u16..20) {
        // Plausible frame headers get past the first checks.
        if let Some(header) = payload.get_mut(12..15) {
            header[0] = flags;
            header[1..].copy_from_slice(&n.to_le_bytes());
        }
        let wire = with_envelope(1, kind, &payload);
        let mut host = HostLink::new();
        let decoded = host_events(&mut host, &wire).len() as u64;
        let counters = host.counters();
        prop_assert_eq!(decoded, counters.messages);
        prop_assert_eq!(counters.messages + counters.messages_damaged + counters.messages_unknown, 1);
        device_commands(&mut DeviceLink::new(), &wire);
    }

    #[test]
    fn frames_in_a_volume_stay_within_its_bound(
        n in 0usize..700,
        first in 0u16..1000,
        positions in vec([-4194.0f32..4194.0, -4194.0f32..4194.0, -4194.0f32..4194.0], 700),
    ) {
        let markers = (first..).zip(&positions).take(n)
            .map(|(id, &position_mm)| MarkerSample { id, occluded: false, residual_10um: 9, position_mm })
            .collect::<Vec<_>>();
        let frame = Frame { seq: u32::MAX, device_ticks: u64::MAX, timecode: Some([23; 4]), markers: &markers };
        for form in FORMS {
            let mut wire = Vec::new();
            DeviceLink::new().frame(form, &frame, &mut wire).unwrap();
            prop_assert!(wire.len() <= frame_bytes_in_volume(form, n), "{:?}: {} bytes", form, wire.len());
        }
    }
}
