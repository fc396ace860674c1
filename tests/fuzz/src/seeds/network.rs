//! Seeds of `read_qtm`.

use mocapd_drivers::qtm::{
    ComponentToSend, Event, FrameHeader, MISSING, MarkerComponentKind, PacketKind, ServedSettings,
    SettingsRequest, WELCOME, WireMarker, put_event, put_frame, put_packet, put_text,
};

/// Packets of both directions: for a driver that waits for its greeting, and for one that requested frames.
pub(super) fn packets() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for how in 0..8_u8 {
        for wire in [frames(), bring_up(), events(), commands()] {
            seeds.push([&[how], &wire[..]].concat());
        }
        seeds.push([&[how], settings(1).as_bytes()].concat());
        let mut xml = Vec::new();
        put_text(PacketKind::Xml, &settings(3), &mut xml);
        seeds.push([&[how], &xml[..]].concat());
    }
    // Another byte order, text, and a size that is too large.
    for bytes in [&[0, 0, 0, 35, 0, 0, 0, 1][..], b"HTTP/1.1 400", &[255; 12]] {
        seeds.push([&[0], bytes].concat());
    }
    seeds
}

fn settings(n_labels: usize) -> String {
    let labels = (0..n_labels).map(|k| format!("label <{k}>")).collect();
    let request =
        SettingsRequest { general: true, markers: true, bodies: true, analog: true, force: true };
    ServedSettings { frequency_hz: 100.0, up_axis: "-Z", labels, ..ServedSettings::default() }
        .to_xml(28, request)
        .unwrap_or_default()
}

fn frames() -> Vec<u8> {
    let mut wire = Vec::new();
    for number in 0..3 {
        let marker =
            |id| WireMarker { position_mm: [1.5, id as f32, MISSING], id, residual_mm: 0.1 };
        let markers = [marker(1), marker(2), WireMarker { position_mm: [0.5; 3], ..marker(3) }];
        let n = 2 + usize::from(number == 2);
        let components = MarkerComponentKind::ALL.map(|kind| ComponentToSend {
            kind,
            rates: [number as u16, 0],
            markers: &markers[..n],
        });
        let time_us = u64::from(number) * 10_000;
        put_frame(FrameHeader { time_us, number }, &components, &mut wire);
    }
    wire
}

fn bring_up() -> Vec<u8> {
    let mut wire = Vec::new();
    put_text(PacketKind::Command, WELCOME, &mut wire);
    put_text(PacketKind::Command, "Version set to 1.28", &mut wire);
    put_text(PacketKind::Command, "QTM Version is 2.3 (build 464)", &mut wire);
    put_text(PacketKind::Command, "Byte order is little endian", &mut wire);
    put_event(Event::Connected, &mut wire);
    for _ in 0..2 {
        put_text(PacketKind::Xml, &settings(2), &mut wire);
    }
    for _ in 0..3 {
        put_text(PacketKind::Error, "Parameters not available", &mut wire);
    }
    wire
}

fn events() -> Vec<u8> {
    let mut wire = frames();
    for event in [Event::CaptureStarted, Event::RtFromFileStarted, Event::RtFromFileStopped] {
        put_event(event, &mut wire);
    }
    put_packet(PacketKind::NoMoreData, &mut wire, |_| {});
    wire
}

fn commands() -> Vec<u8> {
    let mut wire = Vec::new();
    for command in [
        "Version 1.25",
        "GetParameters All",
        "StreamFrames FrequencyDivisor:2 UDP:127.0.0.1:5000 3D 6D",
        "GetCurrentFrame 3DRes",
        "TakeControl",
        "Stop",
        "New",
        "Start",
        "Close",
    ] {
        put_text(PacketKind::Command, command, &mut wire);
    }
    wire
}
