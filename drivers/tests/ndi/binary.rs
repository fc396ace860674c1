//! Frames, composed byte by byte.

use mocapd_drivers::device::{BodyInfo, Command, Pose, PoseStatus};
use mocapd_testkit::random::Random;

use super::script::{Script, binary, text};

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// A visible tool, a hidden one, a disabled one, and two strays.
fn bx_block(number: u32) -> Vec<u8> {
    let mut block = vec![3];
    block.extend([1, 1]);
    block.extend(floats(&[0.5, -0.5, 0.5, -0.5, 100.5, -200.25, -1500.0, 0.31]));
    block.extend([0x31, 0, 0, 0]);
    block.extend(number.to_le_bytes());
    block.extend([2, 2]);
    block.extend([0x31, 0, 0, 0]);
    block.extend(number.to_le_bytes());
    block.extend([3, 4]);
    block.push(2);
    block.push(0);
    block.extend(floats(&[1.0, 2.0, -1000.0, -4.0, 5.0, -2000.0]));
    block.extend([0, 0]);
    block
}

#[test]
fn a_frame_of_bx() {
    let mut number = 600;
    let mut script = Script::new(move |request| match request {
        b"APIREV:443E\r" => Some(text("D.001.007")),
        b"BX:10013E6C\r" => {
            number += 1;
            Some(binary(&bx_block(number)))
        }
        _ => None,
    })
    .started();
    script.read(3);
    let (seq, ticks, markers) = &script.frames[0];
    assert_eq!((*seq, *ticks), (601, 601_000));
    let got: Vec<_> =
        markers.iter().map(|m| (m.id, m.occluded, m.residual_10um, m.position_mm)).collect();
    assert_eq!(
        got,
        [
            (1, false, 31, [100.5, -200.25, -1500.0]),
            (2, true, 0, [0.0; 3]),
            (0x100, false, 0, [1.0, 2.0, -1000.0]),
            (0x101, false, 0, [-4.0, 5.0, -2000.0]),
        ]
    );
    assert_eq!(script.frames[1].0, 602);
    assert_eq!(script.bodies, [BodyInfo { id: 1, name: "8700449".to_owned() }]);
    let (seq, number, ticks, poses) = &script.poses[0];
    assert_eq!((*seq, *number, *ticks), (601, 1, 601_000));
    // The disabled tool is not there.
    let first = Pose {
        body: 1,
        status: PoseStatus::Tracked,
        position_mm: [100.5, -200.25, -1500.0],
        quaternion: [0.5, -0.5, 0.5, -0.5],
        residual_mm: 0.31,
    };
    assert_eq!(poses[0], first);
    assert_eq!((poses.len(), poses[1].body, poses[1].status), (2, 2, PoseStatus::Lost));
    assert_eq!((script.poses[1].0, script.poses[1].1), (602, 2));
}

#[test]
fn frame_numbers_are_divided_when_every_second_frame_is_tracked() {
    let mut number = 600;
    let mut script = Script::new(move |request| match request {
        b"APIREV:443E\r" => Some(text("D.001.007")),
        b"GET:Param.Tracking.Track FrequencyDD48\r" => {
            Some(text("Param.Tracking.Track Frequency=1"))
        }
        b"BX:10013E6C\r" => {
            number += 2;
            Some(binary(&bx_block(number)))
        }
        _ => None,
    })
    .started();
    script.read(3);
    let numbers: Vec<_> = script.frames.iter().map(|frame| frame.0).collect();
    assert_eq!(numbers, [301, 302, 303]);
    let hello = script.hello.unwrap();
    assert_eq!((hello.rate_millihertz, hello.tick_hz), (30_000, 60_000));
    assert_eq!(script.frames[0].1, 602_000, "10.03 s of a counter at 60 Hz");
}

/// A component: kind, size including this header, option, items.
fn component(kind: u16, items: u32, body: &[u8]) -> Vec<u8> {
    let mut out = kind.to_le_bytes().to_vec();
    out.extend((12 + body.len() as u32).to_le_bytes());
    out.extend([0, 0]);
    out.extend(items.to_le_bytes());
    out.extend(body);
    out
}

/// A frame item: 6D data of tools, 3D data of strays and of a tool's markers, an alert.
fn frame_item(number: u32, seconds: u32, ns: u32) -> Vec<u8> {
    let mut item = vec![2, 9, 0, 0];
    item.extend(number.to_le_bytes());
    item.extend(seconds.to_le_bytes());
    item.extend(ns.to_le_bytes());
    item.extend([1, 0, 3, 0]);
    let mut tools = vec![1, 0, 0, 0];
    tools.extend(floats(&[-0.6, 0.0, 0.8, 0.0, 10.0, 20.0, -30.0, 9.9]));
    tools.extend([2, 0, 0x00, 0x01]);
    tools.extend([3, 0, 0x03, 0x00]);
    tools.extend(floats(&[1.0, 0.0, 0.0, 0.0, 11.0, 21.0, -31.0, 0.2]));
    item.extend(component(2, 3, &tools));
    let mut markers = vec![0xFF, 0xFF, 4, 0];
    markers.extend([0, 0, 0, 0]);
    markers.extend(floats(&[7.0, 8.0, -9.0]));
    markers.extend([1, 0, 1, 0]);
    markers.extend([4, 0, 2, 0]);
    markers.extend(floats(&[70.0, 80.0, -90.0]));
    markers.extend([0, 0, 3, 0]);
    markers.extend(floats(&[f32::NAN, 0.0, 0.0]));
    markers.extend([1, 0, 1, 0, 0, 0, 0, 0]);
    markers.extend(floats(&[0.5, 0.5, 0.5]));
    item.extend(component(3, 2, &markers));
    item.extend(component(0x12, 1, &[1, 2, 3]));
    item
}

fn bx2_block(items: &[Vec<u8>]) -> Vec<u8> {
    let mut block = vec![1, 0, 1, 0];
    block.extend(component(1, items.len() as u32, &items.concat()));
    block
}

fn bx2_script(mut blocks: Vec<Vec<u8>>) -> Script {
    blocks.reverse();
    Script::new(move |request| match request {
        b"BX2 --6d=tools --3d=strays\r" => Some(blocks.pop().unwrap_or_default()),
        _ => None,
    })
    .started()
}

#[test]
fn a_frame_of_bx2() {
    let whole = binary(&bx2_block(&[frame_item(77, 12, 345_678_901)]));
    let mut script = bx2_script(vec![whole]);
    script.read(1);
    let (seq, ticks, markers) = &script.frames[0];
    assert_eq!((*seq, *ticks), (77, 12_345_678_901));
    let got: Vec<_> =
        markers.iter().map(|m| (m.id, m.occluded, m.residual_10um, m.position_mm)).collect();
    // Tool 3 is partly out of the volume, one stray entirely, and one stray is NaN.
    assert_eq!(
        got,
        [
            (1, false, 255, [10.0, 20.0, -30.0]),
            (2, true, 0, [0.0; 3]),
            (3, true, 0, [0.0; 3]),
            (0x100, false, 0, [7.0, 8.0, -9.0]),
        ]
    );
    assert_eq!(script.counters().samples_not_finite, 1);
    let (seq, number, ticks, poses) = &script.poses[0];
    assert_eq!((*seq, *number, *ticks), (77, 1, 12_345_678_901));
    let states: Vec<_> = poses.iter().map(|pose| (pose.body, pose.status)).collect();
    let expected = [PoseStatus::Tracked, PoseStatus::Lost, PoseStatus::Rejected];
    assert_eq!(states, [(1, expected[0]), (2, expected[1]), (3, expected[2])]);
    assert_eq!((poses[0].quaternion, poses[0].residual_mm), ([-0.6, 0.0, 0.8, 0.0], 9.9));
    assert_eq!(poses[0].position_mm, [10.0, 20.0, -30.0]);
}

#[test]
fn an_empty_reply_is_not_a_frame_and_the_newer_of_two_parts_counts() {
    let parts = [frame_item(78, 12, 7), frame_item(79, 12, 9)];
    let mut script = bx2_script(vec![
        binary(&[1, 0, 0, 0]),
        binary(&bx2_block(&[])),
        binary(&bx2_block(&parts)),
    ]);
    script.read(3);
    assert_eq!(script.frames.len(), 1);
    assert_eq!((script.frames[0].0, script.frames[0].1), (79, 12_000_000_009));
    assert_eq!(script.counters().messages_damaged, 0);
}

#[test]
fn a_length_of_32_bits_is_understood() {
    let block = bx2_block(&[frame_item(5, 0, 0)]);
    let mut long = vec![0xC8, 0xA5];
    long.extend((block.len() as u32).to_le_bytes());
    long.extend(super::script::crc(&long).to_le_bytes());
    long.extend(&block);
    long.extend(super::script::crc(&block).to_le_bytes());
    let mut script = bx2_script(vec![long]);
    script.read(1);
    assert_eq!(script.frames.len(), 1);
}

#[test]
fn invalid_blocks_under_a_valid_checksum_are_damage() {
    let good = bx2_block(&[frame_item(5, 0, 0)]);
    let mut bad = vec![Vec::new(), vec![1], vec![2, 0, 0, 0], vec![1, 0, 0xFF, 0xFF]];
    bad.extend((1..good.len()).map(|n| good[..n].to_vec()));
    // Counts and sizes, each as large as it can be.
    for at in [2, 6, 8, 12, 14, 32, 34, 38, 40, 44] {
        let mut lie = good.clone();
        lie[at..at + 2].fill(0xFF);
        bad.push(lie);
    }
    bad.push([good.as_slice(), &[0]].concat());
    for block in bad {
        let mut script = bx2_script(vec![binary(&block)]);
        script.read(1);
        assert!(script.frames.is_empty(), "{block:?}");
        assert_eq!(script.counters().messages_damaged, 1, "{block:?}");
    }
}

#[test]
fn a_device_that_left_tracking_by_itself_has_ended() {
    let mut script = bx2_script(vec![binary(&bx2_block(&[frame_item(5, 0, 0)])), text("ERROR0C")]);
    script.read(2);
    assert!(script.ended && script.failed.is_none());
    script.command(Command::Start { line_bytes_per_s: 0 });
    script.read(2);
    assert_eq!(script.sent.iter().filter(|request| *request == "TSTART:5423\r").count(), 2);
}

#[test]
fn random_blocks_under_a_valid_checksum_are_handled() {
    for (bx2, good) in [(true, bx2_block(&[frame_item(5, 0, 0)])), (false, bx_block(5))] {
        let (mut random, mut turn) = (Random::new(1), 0);
        let mut script = Script::new(move |request| {
            if request.starts_with(b"APIREV") && !bx2 {
                return Some(text("D.001.007"));
            }
            if !request.starts_with(b"BX") {
                return None;
            }
            turn += 1;
            let mut block = good.clone();
            if turn % 3 > 0 {
                for _ in 0..=random.below(4) {
                    let at = random.below(block.len());
                    match random.below(5) {
                        0 => block[at] = 0xFF,
                        1 => block[at] = random.byte(),
                        2 => block.truncate(at + 1),
                        3 => block.insert(at, random.byte()),
                        _ => {
                            let n = random.below(300);
                            block.extend(random.bytes(n));
                        }
                    }
                }
            }
            Some(binary(&block))
        })
        .started();
        script.read(60_000);
        assert!(script.failed.is_none());
        let counters = script.counters();
        assert!(counters.messages_damaged > 2_000 && counters.messages > 10_000, "{counters:?}");
        for (_, _, markers) in &script.frames {
            assert!(markers.iter().all(|m| m.position_mm.iter().all(|v| v.is_finite())));
            assert!(markers.len() < 6_000, "more markers than fit into a block");
        }
    }
}
