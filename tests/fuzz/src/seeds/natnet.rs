//! Seeds of `read_natnet`.

use mocapd_drivers::natnet::{
    Asset, AssetKind, Bitstream, FrameToSend, HAS_MODEL, MEASURED, MarkerSet, MessageKind, Model,
    NatNetMarker, SampledDescription, SampledToSend, SetToSend, WireBody, put_echo, put_frame,
    put_text,
};

/// Messages of both directions, of each layout, with and without the length in front of them.
pub(super) fn messages() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for (index, version) in [(2, 10), (2, 11), (3, 0), (4, 0), (4, 1), (4, 2)].iter().enumerate() {
        let version = Bitstream::new(version.0, version.1);
        let mut definitions = Vec::new();
        model().put(version, &mut definitions);
        let frame = frame(version);
        let how = (index as u8) << 1;
        // Behind their headers.
        seeds.push([&[how], &frame[4..]].concat());
        seeds.push([&[how], &definitions[4..]].concat());
        let mut wire = vec![how | 1];
        for message in [&definitions, &frame, &frame] {
            let mut message = message.clone();
            message.resize(message.len().next_multiple_of(8), 0);
            wire.push((message.len() / 8) as u8);
            wire.extend(message);
        }
        seeds.push(wire);
    }
    let mut wire = vec![1];
    for text in ["FrameRate", "Bitstream,3.1", "AnalogSamplesPerMocapFrame"] {
        let mut message = Vec::new();
        put_text(MessageKind::Request, text, &mut message);
        message.resize(message.len().next_multiple_of(8), 0);
        wire.push((message.len() / 8) as u8);
        wire.extend(message);
    }
    let mut echo = Vec::new();
    put_echo(1, Some(2), &mut echo);
    echo.resize(24, 0);
    wire.push(3);
    wire.extend(echo);
    seeds.push(wire);
    seeds
}

fn model() -> Model {
    let name = "Anna".to_owned();
    Model {
        sets: vec![MarkerSet { name: name.clone(), markers: vec!["head".to_owned()] }],
        assets: vec![Asset { kind: AssetKind::RigidBody, id: 1, name, markers: Vec::new() }],
        sampled: vec![SampledDescription {
            is_plate: true,
            id: 1,
            name: "plate".to_owned(),
            data_type: 0,
            channels: vec!["Fx".to_owned(), "Fy".to_owned()],
        }],
        ..Model::default()
    }
}

fn frame(version: Bitstream) -> Vec<u8> {
    let position_m = [0.5, 1.5, -0.25];
    let flags = HAS_MODEL | MEASURED;
    let marker = NatNetMarker { id: 0x1_0001, position_m, flags, ..NatNetMarker::default() };
    let body = WireBody {
        id: 1,
        position_m,
        quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
        ..WireBody::default()
    };
    let frame = FrameToSend {
        number: 5,
        sets: &[SetToSend { name: "Anna", positions_m: &[position_m] }],
        bodies: &[body],
        skeletons: &[2],
        labelled: &[marker],
        unlabelled: &[NatNetMarker { id: 1000, flags: 0x12, ..marker }],
        plates: &[SampledToSend { id: 1, n_channels: 2, samples: &[1.0, 2.0] }],
        ..FrameToSend::default()
    };
    let mut bytes = Vec::new();
    put_frame(&frame, version, &mut bytes);
    bytes
}
