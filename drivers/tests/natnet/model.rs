//! Definitions and frames in every layout, written by the server and read by the driver.

use mocapd_drivers::natnet::{
    Asset, AssetKind, Bitstream, FrameOfData, FrameToSend, Message, MessageKind, Model, ModelError,
    NatNetServer, SampledToSend, ServedStream, put_frame, put_message,
};

use crate::pair::{GROUP, frame_bytes, model, settings};

pub(crate) const VERSIONS: [Bitstream; 8] = [
    Bitstream::new(2, 10),
    Bitstream::new(2, 11),
    Bitstream::new(2, 12),
    Bitstream::new(3, 0),
    Bitstream::new(3, 1),
    Bitstream::new(4, 0),
    Bitstream::new(4, 1),
    Bitstream::new(4, 2),
];

#[test]
fn definitions_of_every_version_read_back() {
    let body = |id, name: &str| Asset {
        kind: AssetKind::RigidBody,
        id,
        name: name.to_owned(),
        markers: Vec::new(),
    };
    for version in VERSIONS {
        let mut sent = model();
        sent.assets.insert(0, body(3, "wand"));
        let mut bytes = Vec::new();
        sent.put(version, &mut bytes);
        let message = Message::of(&bytes).unwrap();
        let read = Model::read(message.body, version).unwrap();
        if version.major < 3 {
            sent.sampled.clear();
        }
        assert_eq!(read, sent, "{version}");
        for cut in 0..message.body.len() {
            assert!(Model::read(&message.body[..cut], version).is_err(), "{version} {cut}");
        }
    }
}

#[test]
fn descriptions_that_state_their_size_are_skipped_and_others_refused() {
    let unknown = |version: Bitstream| {
        let mut out = Vec::new();
        put_message(MessageKind::Model, &mut out, |out| {
            out.extend(2_u32.to_le_bytes());
            out.extend(77_u32.to_le_bytes());
            if version.has_sizes() {
                out.extend(5_u32.to_le_bytes());
            }
            out.extend(*b"abcde");
            out.extend(0_u32.to_le_bytes());
            if version.has_sizes() {
                out.extend(12_u32.to_le_bytes());
            }
            out.extend(*b"set\0\x01\0\0\0one\0");
        });
        Model::read(Message::of(&out).unwrap().body, version)
    };
    let model = unknown(Bitstream::NEWEST).unwrap();
    assert_eq!((model.n_unknown, &*model.sets[0].markers[0]), (1, "one"));
    assert_eq!(unknown(Bitstream::new(3, 1)), Err(ModelError::UnknownType(77)));
}

/// A rigid body as both samples of the vendor's SDK 4.2 read it: from 4.2 on, four floats of a rotation stand between its
/// position and its markers.
#[test]
fn a_rigid_bodys_markers_are_behind_its_rotation_from_4_2_on() {
    let described = |rotation: usize| {
        let mut out = Vec::new();
        put_message(MessageKind::Model, &mut out, |out| {
            out.extend([1_u32, 1].into_iter().flat_map(u32::to_le_bytes));
            let mut body = b"wand\0\x05\0\0\0\xFF\xFF\xFF\xFF".to_vec();
            body.extend([0; 12]);
            body.extend(std::iter::repeat_n(0x3F, rotation));
            body.extend(2_u32.to_le_bytes());
            body.extend([1; 2 * 16]);
            body.extend(*b"tip\0tail\0");
            out.extend((body.len() as u32).to_le_bytes());
            out.extend(body);
        });
        out
    };
    let read = |bytes: &[u8], version| Model::read(Message::of(bytes).unwrap().body, version);
    // Servers of either version that have the other's layout are told by the size.
    for rotation in [0, 16] {
        for version in [Bitstream::new(4, 1), Bitstream::NEWEST] {
            let model = read(&described(rotation), version).unwrap();
            assert_eq!(model.assets[0].markers, ["tip", "tail"], "{version} {rotation}");
        }
    }
    // What we write has that of its version: a reader that knows no other finds the number of markers.
    let mut sent = Model::default();
    let (kind, id, name) = (AssetKind::RigidBody, 5, "wand".to_owned());
    sent.assets.push(Asset { kind, id, name, markers: Vec::new() });
    for (version, rotation) in [(Bitstream::new(4, 1), 0), (Bitstream::NEWEST, 16)] {
        let mut bytes = Vec::new();
        sent.put(version, &mut bytes);
        let fixed = 4 + 4 + 8 + 5 + 4 + 4 + 12;
        assert_eq!(bytes.len(), fixed + rotation + 4, "{version}");
    }
}

/// A device that has just started, or samples that come later than their frame.
#[test]
fn a_frame_without_samples_has_its_channels() {
    let plates = [SampledToSend { id: 1, n_channels: 6, samples: &[] }];
    let frame = FrameToSend { plates: &plates, ..FrameToSend::default() };
    for version in VERSIONS {
        let mut bytes = Vec::new();
        put_frame(&frame, version, &mut bytes);
        let read = FrameOfData::read(Message::of(&bytes).unwrap().body, version).unwrap();
        let plate = read.sampled().next().unwrap();
        let counts: Vec<_> = plate.channels().map(|channel| channel.count()).collect();
        assert_eq!((plate.n_channels, counts), (6, vec![0; 6]), "{version}");
    }
}

#[test]
fn frames_of_every_version_read_back() {
    for version in VERSIONS {
        let stream = ServedStream::Multicast(GROUP);
        let mut server = NatNetServer::new(settings(version, stream));
        frame_bytes(3, &[50_007], 0, &mut server);
        let datagram = server.take_datagrams().remove(0);
        let body = Message::of(&datagram.bytes).unwrap().body;
        let frame = FrameOfData::read(body, version).unwrap();
        let has_ticks = version.has_ticks();
        assert_eq!(frame.number, 3);
        assert_eq!(frame.markers().count(), 4 + usize::from(has_ticks), "{version}");
        assert_eq!(frame.other_positions_m().count(), usize::from(!has_ticks), "{version}");
        assert_eq!(frame.n_bodies, [0, 2, 0]);
        let sampled: Vec<_> = frame.sampled().map(|data| (data.is_plate, data.id)).collect();
        let all = [(true, 1), (false, 1)];
        assert_eq!(sampled, all[..1 + usize::from(version.has_devices())]);
        let plate = frame.sampled().next().unwrap();
        let last = plate.channels().last().unwrap();
        assert_eq!((last.count(), last.get(1), last.get(2)), (2, Some(9.5), None));
        for cut in 0..body.len() {
            let read = FrameOfData::read(&body[..cut], version);
            // The tag at the end, and the network clock, may be missing.
            assert!(read.is_none() || [4, 8, 12].contains(&(body.len() - cut)), "{version}");
        }
        // One layout fits, and those that are the same.
        let same = |other: Bitstream| {
            (other.has_ticks(), other.has_devices(), other.has_sizes())
                == (version.has_ticks(), version.has_devices(), version.has_sizes())
        };
        for other in VERSIONS {
            let read = FrameOfData::read(body, other).filter(|frame| frame.has_tag);
            assert_eq!(read.is_some(), same(other), "{version} {other}");
        }
    }
}
