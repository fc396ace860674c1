//! Poses by row: every row has the poses of its frame, whatever was lost, and whatever was done with the take.

use std::{io::Cursor, ops::Range};

use mocapd_acquire::pipeline::Intake;
use mocapd_drivers::device::{Frame, PoseFrame, PoseStatus};
use mocapd_take::{
    TakeMap,
    chunk::{self, ChunkParse, types},
    edit::{EditContext, SourceTake, concat, cut},
    motion::Motion,
    poses::{Pose as StoredPose, PoseState, PosesByRow, RowPoses},
};

use super::poses::{assert_clean, bodies, pose, with_bodies};
use crate::support::{Seeded, TICK_HZ, jump, lossless, samples, start};

const RATE_HZ: u64 = 200;

/// The time of a frame: up to 0.4 frames from where it is due, so that no line leads through the times of frames.
fn ticks(frame: u32) -> u64 {
    let noise = u64::from(frame.wrapping_mul(2_654_435_761) >> 20) % 801;
    1_000_000 + u64::from(frame) * TICK_HZ / RATE_HZ + noise * TICK_HZ / RATE_HZ / 1000
}

fn feed_frame(intake: &mut Intake, motion: &Motion, frame: u32) {
    while intake.is_full() {
        std::thread::yield_now();
    }
    let markers = &samples(motion.frame(frame as usize));
    let device_ticks = ticks(frame);
    let frame = Frame { seq: frame, device_ticks, timecode: None, markers };
    intake.frame(&frame, 5_000_000 + device_ticks * 1_000_000_000 / TICK_HZ);
}

fn feed_poses(intake: &mut Intake, frame: u32, number: u32) {
    let infos = bodies();
    let poses: Vec<_> = infos.iter().filter_map(|body| pose(body, frame)).collect();
    let device_ticks = ticks(frame);
    intake.poses(&PoseFrame { seq: frame, number, device_ticks, poses: &poses });
}

fn by_row(take: &[u8]) -> PosesByRow {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    PosesByRow::read(Cursor::new(take), &map).unwrap().unwrap()
}

/// The poses of some rows, `n` rows at a time.
fn read(take: &[u8], index: &PosesByRow, rows: Range<u64>, n: u64) -> Vec<StoredPose> {
    let (mut all, mut poses) = (Vec::new(), Vec::new());
    let mut reader = index.rows(rows.clone());
    let mut next = rows.start;
    while let Some(found) = reader.next(&mut Cursor::new(take), n, &mut poses).unwrap() {
        assert_eq!(found.start, next);
        assert_eq!(poses.len() as u64, (found.end - found.start) * index.bodies().len() as u64);
        next = found.end;
        all.extend_from_slice(&poses);
    }
    assert_eq!(next, rows.end.min(index.n_rows()).max(rows.start));
    all
}

/// Asserts that each row has exactly the poses of the frame that `frame_of` gives, or none. Returns the number of poses.
#[track_caller]
fn assert_rows(take: &[u8], frame_of: impl Fn(u64) -> Option<u32>) -> usize {
    let (index, infos) = (by_row(take), bodies());
    assert!(index.bodies().iter().map(|body| &body.name).eq(infos.iter().map(|body| &body.name)));
    let all = read(take, &index, 0..u64::MAX, RowPoses::ROWS_AT_ONCE);
    let mut n = 0;
    for (row, poses) in (0..).zip(all.chunks_exact(infos.len())) {
        for (info, got) in infos.iter().zip(poses) {
            let Some(frame) = frame_of(row) else {
                assert_eq!(got.state, PoseState::Missing, "row {row}");
                continue;
            };
            n += 1;
            let expected = pose(info, frame);
            let state = match expected.map(|pose| pose.status) {
                None => PoseState::Unlisted,
                Some(PoseStatus::Tracked) => PoseState::Tracked,
                Some(PoseStatus::Lost) => PoseState::Lost,
                Some(PoseStatus::Rejected) => PoseState::Rejected,
                Some(PoseStatus::Other(_)) => PoseState::Other,
            };
            assert_eq!(got.state, state, "row {row}, frame {frame}, {}", info.name);
            match expected.filter(|_| got.is_tracked()) {
                Some(sent) => assert_eq!(got.position_mm, sent.position_mm, "row {row}"),
                None => assert!(got.position_mm[0].is_nan()),
            }
        }
    }
    n
}

/// Which frames are not recorded, and which of their poses are not sent or lost on the link.
const FRAMES_LOST: [Range<u32>; 4] = [0..3, 200..201, 600..655, 1997..2000];
const POSES_DROPPED: Range<u32> = 420..450;
const POSES_LOST: [Range<u32>; 2] = [700..704, 630..640];

fn has_poses(frame: u32) -> bool {
    !POSES_DROPPED.contains(&frame) && !POSES_LOST.iter().any(|lost| lost.contains(&frame))
}

fn record(motion: &Motion) -> Vec<u8> {
    let (mut intake, pipeline) = start(&with_bodies(motion, lossless()), Vec::new());
    let mut number = 0;
    for frame in 0..2000 {
        if !FRAMES_LOST[..3].iter().any(|lost| lost.contains(&frame)) {
            feed_frame(&mut intake, motion, frame);
        }
        if has_poses(frame) {
            feed_poses(&mut intake, frame, number);
        }
        number += u32::from(!POSES_DROPPED.contains(&frame));
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    take
}

/// The frame of a row: the take begins with the first frame that was recorded.
fn frame_of(row: u64) -> Option<u32> {
    let frame = row as u32 + FRAMES_LOST[0].end;
    Some(frame).filter(|&frame| has_poses(frame))
}

#[test]
fn every_row_has_the_poses_of_its_frame_in_windows_of_any_size() {
    let motion = jump(1, 200.0, 10.0);
    let take = record(&motion);
    let n = assert_rows(&take, frame_of);
    assert_eq!(n, (2000 - 3 - 30 - 14) * bodies().len());
    let index = by_row(&take);
    let bits = |poses: &[StoredPose]| format!("{poses:?}");
    let all = read(&take, &index, 0..u64::MAX, 1 << 20);
    let mut random = Seeded::new(5);
    for n in [1, 7, 100, 256] {
        let rows = random.below(1900) as u64;
        let rows = rows..rows + 60 + random.below(300) as u64;
        let first = rows.start as usize * bodies().len();
        let found = read(&take, &index, rows, n);
        let expected = &all[first..(first + found.len())];
        assert_eq!(bits(&found), bits(expected), "{n}");
    }
    assert!(read(&take, &index, 5000..6000, 10).is_empty());
}

#[test]
fn parts_and_joined_parts_have_the_poses_of_their_rows() {
    let motion = jump(2, 200.0, 10.0);
    let take = record(&motion);
    let new_scratch = || Err(std::io::ErrorKind::Unsupported.into());
    let context = EditContext { software: "test", new_scratch: &new_scratch, on_rows: &|_| () };
    let source = |take: &[u8]| SourceTake::read(&mut Cursor::new(take)).unwrap();
    let n_rows = by_row(&take).n_rows();
    // Single rows, one within a block, two that end and begin among lost frames, and one that begins among lost poses.
    let ends = [0, 1, 2, 190, 198, 420, 610, 699, 700, 1111, n_rows];
    let mut parts = Vec::new();
    let mut n = 0;
    for pair in ends.windows(2) {
        let mut part = Vec::new();
        cut(&source(&take), Cursor::new(&take), pair[0]..pair[1], &mut part, &context).unwrap();
        n += assert_rows(&part, |row| frame_of(pair[0] + row));
        parts.push(part);
    }
    assert_eq!(n, assert_rows(&take, frame_of));
    // A part of a part, too.
    let mut part = Vec::new();
    cut(&source(&parts[9]), Cursor::new(&parts[9]), 100..300, &mut part, &context).unwrap();
    assert_rows(&part, |row| frame_of(1211 + row));
    let sources: Vec<SourceTake> = parts.iter().map(|part| source(part)).collect();
    let mut joined = Vec::new();
    let open = |i: usize| Ok(Cursor::new(parts[i].clone()));
    concat(&sources, open, &mut joined, &context).unwrap();
    assert_eq!(assert_rows(&joined, frame_of), n);
}

/// Its clock counts again from where it did, so that the frames before and after have the same times.
#[test]
fn after_an_outage_rows_have_the_poses_of_their_own_frames() {
    let motion = jump(3, 200.0, 4.0);
    let (mut intake, pipeline) = start(&with_bodies(&motion, lossless()), Vec::new());
    for frame in 0..300 {
        feed_frame(&mut intake, &motion, frame);
        feed_poses(&mut intake, frame, frame);
    }
    intake.rejoin();
    for frame in 0..400 {
        let markers = &samples(motion.frame(frame as usize));
        let sent = Frame { seq: frame, device_ticks: ticks(frame), timecode: None, markers };
        while intake.is_full() {
            std::thread::yield_now();
        }
        intake.frame(&sent, 4_000_000_000 + ticks(frame) * 1_000_000_000 / TICK_HZ);
        feed_poses(&mut intake, frame, frame);
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    assert_clean(&take);
    let n_rows = by_row(&take).n_rows();
    assert!(n_rows > 1000, "{n_rows}");
    let n = assert_rows(&take, |row| match row {
        0..300 => Some(row as u32),
        _ => row.checked_sub(n_rows - 400).map(|frame| frame as u32),
    });
    assert_eq!(n, 700 * bodies().len());
}

/// A byte of one chunk after the other is changed: the poses that are left are at the rows where they were.
#[test]
fn damage_costs_poses_and_moves_none() {
    let motion = jump(4, 200.0, 4.0);
    let (mut intake, pipeline) = start(&with_bodies(&motion, lossless()), Vec::new());
    for frame in 0..800 {
        feed_frame(&mut intake, &motion, frame);
        feed_poses(&mut intake, frame, frame);
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let whole = read(&take, &by_row(&take), 0..u64::MAX, 256);
    let (mut at, mut n_damaged, mut n_lost) = (chunk::MAGIC.len(), 0, 0);
    while let ChunkParse::Whole { kind, len, .. } = chunk::parse(&take[at..]) {
        if matches!(kind, types::SAMPLES | types::SAMPLE_TIMES) {
            let mut damaged = take.clone();
            damaged[at + len / 2] ^= 0x55;
            let map = TakeMap::scan(&mut Cursor::new(&damaged)).unwrap();
            let index = PosesByRow::read(Cursor::new(&damaged), &map).unwrap().unwrap();
            let found = read(&damaged, &index, 0..u64::MAX, 256);
            assert_eq!(found.len(), whole.len());
            for (got, sent) in found.iter().zip(&whole) {
                let is_lost = got.state == PoseState::Missing;
                assert!(is_lost || format!("{got:?}") == format!("{sent:?}"), "{at}");
                n_lost += usize::from(is_lost);
            }
            n_damaged += 1;
        }
        at += len;
    }
    assert!(n_damaged > 20 && n_lost > 0, "{n_damaged} {n_lost}");
}
