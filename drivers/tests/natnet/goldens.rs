//! Messages whose bytes are known from elsewhere: those that Motive 2.1 and `NatNetLib` 3.0 sent, as published with `python_natnet`
//! (<https://github.com/mje-nz/python_natnet/tree/master/test_data>). Their values are written out here; the checksum says
//! that the bytes are the same as there. A frame of Motive 1.9 is published with `natnet-decode`.

use std::net::Ipv4Addr;

use mocapd_drivers::natnet::{
    AssetKind, Bitstream, FrameEnd, FrameOfData, FrameToSend, HAS_MODEL, MEASURED, Message,
    MessageKind, Model, NatNetMarker, OCCLUDED, ServerInfo, SetToSend, StreamInfo, UNLABELLED,
    WireBody, put_discovery, put_echo, put_frame, put_message, read_echo_reply,
};

const V3_0: Bitstream = Bitstream::new(3, 0);

/// The CRC-32 of a file.
#[track_caller]
fn is_file(bytes: &[u8], len: usize, crc: u32) {
    assert_eq!(bytes.len(), len);
    let mut found = u32::MAX;
    for byte in bytes {
        found ^= u32::from(*byte);
        for _ in 0..8 {
            found = (found >> 1) ^ (0xEDB8_8320 & (found & 1).wrapping_neg());
        }
    }
    assert_eq!(!found, crc, "the bytes are not those of the published file");
}

fn floats<const N: usize>(bits: [u32; N]) -> [f32; N] {
    bits.map(f32::from_bits)
}

fn marker(id: u32, bits: [u32; 4], flags: u16, residual: u32) -> NatNetMarker {
    let [x, y, z, size_m] = floats(bits);
    let residual_m = f32::from_bits(residual);
    NatNetMarker { id, position_m: [x, y, z], size_m, flags, residual_m }
}

#[test]
fn commands_have_their_bytes() {
    let mut discovery = Vec::new();
    put_discovery("NatNetLib", [3, 0, 0, 0], V3_0, &mut discovery);
    is_file(&discovery, 268, 0x0E64_BD00);
    let mut request = Vec::new();
    put_message(MessageKind::RequestModel, &mut request, |_| {});
    is_file(&request, 4, 0xAE26_484B);
    let mut echo = Vec::new();
    put_echo(0x109A_664E, None, &mut echo);
    is_file(&echo, 12, 0x6564_C0BD);
    // As NatNetClient.py of the SDK (Apache-2.0) and PyPI's natnet (MIT) write it.
    let mut connect = Vec::new();
    mocapd_drivers::natnet::put_text(MessageKind::Connect, "Ping", &mut connect);
    assert_eq!(connect, *b"\0\0\x05\0Ping\0");
    // As that of the SDK of Motive 3 writes it, for any version of the bitstream.
    connect.clear();
    mocapd_drivers::natnet::put_connect(None, &mut connect);
    assert_eq!((&connect[..9], connect.len()), (&b"\0\0\x0f\x01Ping\0"[..], 4 + 271));
    assert!(connect[8..].iter().all(|byte| *byte == 0));
}

#[test]
fn an_echo_has_its_bytes() {
    let mut reply = Vec::new();
    put_echo(0x109A_664E, Some(0x0149_CDE4_8504), &mut reply);
    is_file(&reply, 20, 0x5F04_3C66);
    let message = Message::of(&reply).unwrap();
    assert_eq!(message.kind, Some(MessageKind::EchoReply));
    assert_eq!(read_echo_reply(message.body), Some((0x109A_664E, 0x0149_CDE4_8504)));
}

#[test]
fn a_servers_words_have_their_bytes() {
    let info = ServerInfo {
        name: "Motive".to_owned(),
        app_version: [2, 1, 0, 0],
        bitstream: V3_0,
        stream: Some(StreamInfo {
            clock_hz: 3_312_787,
            port: 1511,
            is_multicast: true,
            group: Ipv4Addr::new(239, 255, 42, 99),
        }),
    };
    let mut bytes = Vec::new();
    info.put(&mut bytes);
    // With zeros behind the name, where the published file has what was in Motive's memory.
    is_file(&bytes, 283, 0x8C1B_E228);
    let message = Message::of(&bytes).unwrap();
    assert_eq!(ServerInfo::read(message.body), Some(info.clone()));
    assert_eq!(info.app_version_text(), "2.1");
    // A server of 2.10 ends behind the versions.
    let old = ServerInfo::read(&message.body[..264]).unwrap();
    assert_eq!((old.bitstream, old.stream), (V3_0, None));
    for cut in 0..264 {
        assert_eq!(ServerInfo::read(&message.body[..cut]), None, "{cut}");
    }
    for junk in [*b"Motive\0ib\0", *b"Motive\0\xFF\xFE\x01"] {
        bytes[4..14].copy_from_slice(&junk);
        let message = Message::of(&bytes).unwrap();
        assert_eq!(ServerInfo::read(message.body).unwrap().name, "Motive");
    }
}

/// A frame of a rigid body of five markers, of which one is listed as hidden and one not at all.
#[test]
fn a_frame_has_its_bytes_in_both_directions() {
    let places_m = [
        [0xBE2C_86EB, 0x3E90_FDD7, 0x3EFB_4ADC],
        [0xBE0F_4271, 0x3EF2_7EE2, 0x3EE2_24C2],
        [0xBDF6_545A, 0x3E3A_303B, 0x3EEC_DEDA],
        [0xBE77_3690, 0x3E5B_A3D0, 0x3EEF_5E27],
        [0xBDCD_FA71, 0x3E85_EFF4, 0x3EFB_39EC],
    ]
    .map(floats);
    let sets = ["FakeTree", "all"].map(|name| SetToSend { name, positions_m: &places_m });
    let body = WireBody {
        id: 7,
        position_m: floats([0xBE1D_D4AA, 0x3E90_DE24, 0x3EF0_FAEA]),
        quaternion_xyzw: floats([0xB9AF_132D, 0xB91B_698F, 0x3BAB_FC3F, 0xBF7F_FF18]),
        error_m: f32::from_bits(0x31D5_5555),
        is_tracked: true,
    };
    let seen = HAS_MODEL | MEASURED;
    let place = |index: usize, size| {
        let [x, y, z] = places_m[index].map(f32::to_bits);
        [x, y, z, size]
    };
    let labelled = [
        marker(0x7_0002, place(1, 0x3CAA_9F92), seen | OCCLUDED, 0x3855_6E3E),
        marker(0x7_0003, place(2, 0x3CC0_667C), seen, 0x3A0E_DA4A),
        marker(0x7_0004, place(3, 0x3CB1_D3C1), seen, 0x3917_E288),
        marker(0x7_0005, place(4, 0x3CC0_C119), seen, 0x3A03_42DC),
    ];
    let end = FrameEnd {
        timestamp_s: f64::from_bits(0x40C1_8373_3333_3333),
        ticks: [8_642_283_567_331, 8_642_283_582_567, 8_642_283_586_925],
        ..FrameEnd::default()
    };
    let frame = FrameToSend {
        number: 269_007,
        sets: &sets,
        bodies: &[body],
        labelled: &labelled,
        end,
        ..FrameToSend::default()
    };
    let mut bytes = Vec::new();
    put_frame(&frame, V3_0, &mut bytes);
    is_file(&bytes, 365, 0x2B02_B7EB);

    let message = Message::of(&bytes).unwrap();
    let read = FrameOfData::read(message.body, V3_0).unwrap();
    assert_eq!((read.number, read.n_bodies, read.end), (269_007, [1, 0, 0], end));
    assert_eq!(read.markers().collect::<Vec<_>>(), labelled);
    assert_eq!(read.bodies().collect::<Vec<_>>(), [body]);
    let names: Vec<_> = read.marker_sets().map(|(name, places)| (name, places.get(4))).collect();
    assert_eq!(names, [(&b"FakeTree"[..], Some(places_m[4])), (b"all", Some(places_m[4]))]);
    // No other layout fits it.
    for other in [Bitstream::OLDEST, Bitstream::new(2, 11), Bitstream::NEWEST] {
        assert!(FrameOfData::read(message.body, other).is_none(), "{other}");
    }
    for cut in 0..message.body.len() {
        let is_tag = message.body.len() - cut == 4;
        let read = FrameOfData::read(&message.body[..cut], V3_0);
        assert_eq!(read.is_some(), is_tag, "{cut}");
    }
}

/// A frame that has an unlabelled marker, and the labelled ones also among those without a set. Our server does not write
/// these, so that the bytes are put together here.
#[test]
fn a_frame_with_an_unlabelled_marker_reads() {
    let labelled = [
        marker(0x2_0001, [0x3E02_44F8, 0x3FC0_A4BE, 0xBF62_C5A6, 0x3CAF_A290], 10, 0x3959_8FC0),
        marker(0x2_0002, [0x3E56_0038, 0x3FBD_DC24, 0xBF36_51DD, 0x3CAB_1694], 10, 0x3A0D_5038),
        marker(0x2_0003, [0xBD3B_5B96, 0x3FB7_2C6A, 0xBF54_D039, 0x3CAA_77CB], 10, 0x3A34_A5E5),
        marker(0x2_0004, [0x3E39_B0BE, 0x3FB7_C967, 0xBF27_51F4, 0x3C9D_DB16], 10, 0x39C9_2F03),
        marker(0x2_0005, [0x3EA4_8E66, 0x3FB5_134B, 0xBF40_C194, 0x3CAD_DF82], 10, 0x3A26_A7B5),
        marker(0x0_C357, [0x3E2E_E940, 0x3FC0_FAF9, 0xBF57_199E, 0x3CA5_2104], 18, 0x3A12_A33E),
    ];
    let mut bytes = Vec::new();
    put_message(MessageKind::Frame, &mut bytes, |out| {
        let mut words = vec![162_734, 0, 5];
        for marker in &labelled[..5] {
            words.extend(marker.position_m.map(f32::to_bits));
        }
        words.extend([1, 2, 0x3E32_A224, 0x3FB9_3B9A, 0xBF3B_FB59]);
        words.extend([0xBD5F_9E34, 0x3F02_8BF7, 0x3D33_0284, 0xBF5B_7BCB, 0x3A07_0FDA]);
        out.extend(words.into_iter().flat_map(u32::to_le_bytes));
        out.extend(1_u16.to_le_bytes());
        out.extend([0, 6_u32].into_iter().flat_map(u32::to_le_bytes));
        for marker in &labelled {
            out.extend(marker.id.to_le_bytes());
            out.extend(marker.position_m.into_iter().flat_map(f32::to_le_bytes));
            out.extend(marker.size_m.to_le_bytes());
            out.extend(marker.flags.to_le_bytes());
            out.extend(marker.residual_m.to_le_bytes());
        }
        // Force plates, devices, timecode and its part.
        out.extend([0; 16]);
        out.extend(0x4095_3077_7777_7777_u64.to_le_bytes());
        for ticks in [1_416_497_730_518_u64, 1_416_497_745_808, 1_416_497_748_722] {
            out.extend(ticks.to_le_bytes());
        }
        out.extend([0; 6]);
    });
    is_file(&bytes, 336, 0xDC19_4137);
    let frame = FrameOfData::read(Message::of(&bytes).unwrap().body, V3_0).unwrap();
    assert_eq!(frame.number, 162_734);
    assert_eq!(frame.markers().collect::<Vec<_>>(), labelled);
    assert_eq!(labelled[5].flags, UNLABELLED | MEASURED);
    assert_eq!(frame.other_positions_m().count(), 5);
    let body = frame.bodies().next().unwrap();
    assert!(body.id == 2 && body.is_tracked);
    assert_eq!(body.quaternion_xyzw, floats([0xBD5F_9E34, 0x3F02_8BF7, 0x3D33_0284, 0xBF5B_7BCB]));
    assert_eq!(frame.end.ticks[0], 1_416_497_730_518);
    // The seconds of SampleClient's own output for this frame.
    assert!((frame.end.timestamp_s - 1356.12).abs() < 0.005);
}

#[test]
fn definitions_read() {
    let mut bytes = Vec::new();
    put_message(MessageKind::Model, &mut bytes, |out| {
        let words = |out: &mut Vec<u8>, words: &[u32]| {
            out.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        };
        words(out, &[3, 1]);
        out.extend(b"RaceQuad\0");
        words(out, &[2, u32::MAX, 0, 0, 0, 5]);
        words(out, &[0x3E25_06DD, 0x3D0F_9244, 0xBD03_D08A, 0xBCFC_7821, 0x3D22_F258]);
        words(out, &[0xBCB4_2495, 0x3E40_0820, 0xBD08_BCED, 0x3E17_A28C, 0xBD99_563B]);
        words(out, &[0x388C_3791, 0x3D06_DA95, 0xBD6D_B977, 0xBD02_D582, 0xBE0C_1722]);
        words(out, &[0; 5]);
        words(out, &[0]);
        out.extend(b"RaceQuad\0");
        words(out, &[5]);
        out.extend(b"Marker1\0Marker2\0Marker3\0Marker4\0Marker5\0");
        words(out, &[0]);
        out.extend(b"all\0");
        words(out, &[5]);
        out.extend(b"RaceQuad_1\0RaceQuad_2\0RaceQuad_3\0RaceQuad_4\0RaceQuad_5\0");
    });
    is_file(&bytes, 249, 0xF899_08DF);
    let body = Message::of(&bytes).unwrap().body;
    let model = Model::read(body, V3_0).unwrap();
    assert_eq!(model.assets.len(), 1);
    let asset = &model.assets[0];
    assert_eq!((asset.kind, asset.id, &*asset.name), (AssetKind::RigidBody, 2, "RaceQuad"));
    let sets: Vec<_> = model.sets.iter().map(|set| (&*set.name, &*set.markers[4])).collect();
    assert_eq!(sets, [("RaceQuad", "Marker5"), ("all", "RaceQuad_5")]);
    for cut in 0..body.len() {
        assert!(Model::read(&body[..cut], V3_0).is_err(), "{cut}");
    }
}

/// A frame that Motive 1.9 sent, whose bitstream 2.9 has the layout of 2.10: a rigid body with its markers, and these as
/// labelled ones. Published with `natnet-decode` (MIT,
/// <https://github.com/nordmoen/natnet-decode/tree/master/tests/data>, `frame-motive-1.9.0-001.bin`).
#[test]
fn a_frame_before_3_0_has_its_bytes() {
    let places = [
        [0x3EB0_3BD4, 0x3C77_F097, 0x3E1A_284B],
        [0x3E46_7D13, 0x3C78_6AC9, 0x3E1E_FA87],
        [0x3E4C_E0F5, 0x3C85_694E, 0x3EB5_F746],
    ];
    let sizes: [u32; 3] = [0x3CB6_6188, 0x3CAB_1B18, 0x3CB6_DBEC];
    let body: [u32; 7] =
        [0x3E7B_3A3A, 0x3C8A_F031, 0x3E61_71B9, 0x3AFB_046E, 0xBC83_9F32, 0xB996_3E29, 0xBF7F_F76B];
    let mut bytes = Vec::new();
    put_message(MessageKind::Frame, &mut bytes, |out| {
        fn put(out: &mut Vec<u8>, values: &[u32]) {
            values.iter().for_each(|value| out.extend(value.to_le_bytes()));
        }
        put(out, &[11_823_217, 2]);
        for name in [&b"Triangle\0"[..], b"all\0"] {
            out.extend(name);
            put(out, &[3]);
            put(out, places.as_flattened());
        }
        // No others, one rigid body, and its markers, their numbers and sizes.
        put(out, &[0, 1, 2]);
        put(out, &body);
        put(out, &[3]);
        put(out, places.as_flattened());
        put(out, &[1, 2, 3]);
        put(out, &sizes);
        put(out, &[0x38F2_7800]);
        out.extend(1_u16.to_le_bytes());
        // No skeletons, and the labelled markers.
        put(out, &[0, 3]);
        for (index, (place, size)) in places.iter().zip(sizes).enumerate() {
            put(out, &[0x2_0001 + index as u32]);
            put(out, place);
            put(out, &[size]);
            out.extend((HAS_MODEL | MEASURED).to_le_bytes());
        }
        // No force plates; latency, timecode, time stamp, flags and tag.
        put(out, &[0, 0x47C0_6F67, 0, 0]);
        out.extend(98_526.808_333_333_33_f64.to_le_bytes());
        out.extend([0; 6]);
    });
    is_file(&bytes, 319, 0xFCD5_9236);
    let body_read = Message::of(&bytes).unwrap().body;
    let frame = FrameOfData::read(body_read, Bitstream::OLDEST).unwrap();
    assert_eq!((frame.number, frame.n_bodies), (11_823_217, [1, 0, 0]));
    let labelled: Vec<_> = frame.markers().collect();
    let expected: Vec<_> = places
        .iter()
        .zip(sizes)
        .enumerate()
        .map(|(index, (place, size_m))| NatNetMarker {
            id: 0x2_0001 + index as u32,
            position_m: floats(*place),
            size_m: f32::from_bits(size_m),
            flags: HAS_MODEL | MEASURED,
            residual_m: 0.0,
        })
        .collect();
    assert_eq!(labelled, expected);
    let [x, y, z, qx, qy, qz, qw] = floats(body);
    let read: Vec<_> = frame.bodies().collect();
    assert_eq!(
        read,
        [WireBody {
            id: 2,
            position_m: [x, y, z],
            quaternion_xyzw: [qx, qy, qz, qw],
            error_m: f32::from_bits(0x38F2_7800),
            is_tracked: true,
        }]
    );
    assert!((frame.end.timestamp_s - 98_526.808_333).abs() < 1e-6 && frame.has_tag);
    for other in [Bitstream::new(2, 11), Bitstream::new(3, 0), Bitstream::new(4, 1)] {
        assert!(FrameOfData::read(body_read, other).is_none_or(|read| !read.has_tag), "{other}");
    }
}
