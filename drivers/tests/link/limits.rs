//! The limits, and input that is neither a message nor damage.

use mocapd_drivers::{
    device::{DeviceEvent, Frame, Hello, MarkerInfo, MarkerSample, Protocol},
    link::{DeviceLink, EncodeError, FrameForm, HostLink, MARKERS_MAX, WIRE_BYTES_MAX},
};

use crate::{FORMS, host_events, with_envelope};

#[test]
fn the_largest_frame_fits_and_one_more_marker_is_refused() {
    let marker = |id| MarkerSample {
        id,
        occluded: false,
        residual_10um: 1,
        position_mm: [3.0e9, -3.0e9, 1.0],
    };
    let mut markers = (0..10_000).map(marker).collect::<Vec<_>>();
    let mut device = DeviceLink::new();
    let mut wire = Vec::new();
    for form in FORMS {
        let frame = Frame { seq: 1, device_ticks: 2, timecode: Some([1; 4]), markers: &markers };
        device.frame(form, &frame, &mut wire).unwrap();
    }
    assert!(wire.len() <= 3 * WIRE_BYTES_MAX);
    let mut host = HostLink::new();
    assert_eq!(host_events(&mut host, &wire).len(), 3);
    assert_eq!(host.counters().bytes_skipped, 0);

    markers.push(marker(10_000));
    let (before, frame) =
        (wire.len(), Frame { seq: 1, device_ticks: 2, timecode: None, markers: &markers });
    let refused = device.frame(FrameForm::Float, &frame, &mut wire);
    assert_eq!(refused, Err(EncodeError::TooManyMarkers { found: 10_001, max: MARKERS_MAX }));
    assert_eq!(wire.len(), before);
}

#[test]
fn a_stream_without_an_end_is_bounded_and_counted() {
    let mut host = HostLink::new();
    for _ in 0..100 {
        assert!(host_events(&mut host, &[0x55; 10_000]).is_empty());
    }
    let mut wire = vec![0];
    DeviceLink::new().rate_set(1, &mut wire);
    assert_eq!(host_events(&mut host, &wire).len(), 1);
    assert_eq!(host.counters().bytes_skipped, 1_000_001);
    assert_eq!(host.counters().messages_damaged, 1);
}

#[test]
fn invalid_values_are_refused_and_nothing_is_written() {
    let mut device = DeviceLink::new();
    let mut wire = Vec::new();
    let twice = [MarkerSample { id: 3, ..MarkerSample::default() }; 2];
    let frame = Frame { seq: 0, device_ticks: 0, timecode: None, markers: &twice };
    assert_eq!(
        device.frame(FrameForm::Compact, &frame, &mut wire),
        Err(EncodeError::IdsNotAscending { previous: 3, id: 3 })
    );

    let good = MarkerInfo { id: 0, label: "x".repeat(255), labelled: true };
    let mut table = vec![good; 10];
    for label in ["x".repeat(256), "left\tknee".to_owned()] {
        table[9].label = label;
        assert!(matches!(
            device.markers(&table, &mut wire),
            Err(EncodeError::Text { field: "label", .. })
        ));
    }
    assert!(matches!(device.hello(&Hello::default(), &mut wire), Err(EncodeError::Hello(_))));
    assert!(wire.is_empty());
}

#[test]
fn an_empty_table_is_announced_too() {
    let mut wire = Vec::new();
    DeviceLink::new().markers(&[], &mut wire).unwrap();
    assert_eq!(host_events(&mut HostLink::new(), &wire), ["Markers([])"]);
}

#[test]
fn other_versions_and_types_are_unknown_and_not_damage() {
    for (version, kind) in [(2, 0x10), (1, 0x77), (1, 0x80)] {
        let mut wire = with_envelope(version, kind, &[5, 5]);
        DeviceLink::new().rate_set(1, &mut wire);
        let mut host = HostLink::new();
        assert_eq!(host_events(&mut host, &wire).len(), 1);
        let counters = host.counters();
        assert_eq!(
            (counters.messages_unknown, counters.messages_damaged, counters.bytes_skipped),
            (1, 0, 0)
        );
    }
}

#[test]
fn positions_that_are_not_finite_are_occluded_and_counted() {
    let mut payload = Vec::new();
    payload.extend_from_slice(&1u32.to_le_bytes());
    payload.extend_from_slice(&2u64.to_le_bytes());
    payload.extend_from_slice(&[0, 3, 0]);
    for (id, x) in [(0u16, f32::NAN), (1, 1.0), (2, f32::NEG_INFINITY)] {
        payload.extend_from_slice(&id.to_le_bytes());
        payload.push(0);
        payload.extend_from_slice(&x.to_le_bytes());
        payload.extend_from_slice(&[0; 8]);
    }
    let mut host = HostLink::new();
    let mut occluded = Vec::new();
    host.push(&with_envelope(1, 0x10, &payload), &mut |event| {
        let DeviceEvent::Frame(frame) = event else { panic!("{event:?}") };
        occluded.extend(frame.markers.iter().map(|marker| marker.occluded));
        assert!(
            frame.markers.iter().all(|marker| marker.position_mm.iter().all(|mm| mm.is_finite()))
        );
    });
    assert_eq!(occluded, [true, false, true]);
    assert_eq!(host.counters().samples_not_finite, 2);
}
