//! Residuals of markers beside their positions: every row of a take has those of its frame, or says that they are lost.

use std::{io::Cursor, ops::Range};

use mocapd_acquire::{
    inspect::Summary,
    pipeline::{Intake, PipelineConfig, PreRollConfig},
};
use mocapd_codec::Settings;
use mocapd_drivers::device::{
    Frame, MarkerInfo, MarkerSample, SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo,
};
use mocapd_take::{
    TakeFrames, TakeMap,
    compare::compare_samples,
    edit::{EditContext, SourceTake, concat, cut, repack},
    interchange::{Format, residuals_10um, write_c3d},
    motion::{FrameSource, Motion, MotionFrames, is_gap},
    record::GroupLedger,
    recovery::RecoveryScan,
    sampled::Recording,
};

use super::{
    poses::assert_clean,
    takes::{PRE_ROLL, ended, header, new_take},
};
use crate::support::{TICK_HZ, config, crowd, dense, jump, lossless, samples, start};

/// What the device reports: every marker has values of its own, small and large ones, and none now and then.
fn residual(marker: usize, frame: usize) -> u8 {
    match (marker * 7 + frame) % 31 {
        0..=1 => 0,
        2 => 255,
        n => (1 + (marker * 5) % 90 + n) as u8,
    }
}

fn markers(motion: &Motion, frame: usize) -> Vec<MarkerSample> {
    let mut all = samples(motion.frame(frame));
    for (marker, sample) in all.iter_mut().enumerate() {
        sample.residual_10um = residual(marker, frame);
    }
    all
}

/// Sends a frame at its time; the clock counts from `ticks_before`.
fn send_at(intake: &mut Intake, motion: &Motion, frame: usize, (seq, ticks_before): (u32, u64)) {
    let after = (frame as f64 * TICK_HZ as f64 / motion.info.rate_hz).round() as u64;
    let device_ticks = ticks_before + after;
    let markers = markers(motion, frame);
    let sent = Frame { seq, device_ticks, timecode: None, markers: &markers };
    intake.frame(&sent, 5_000_000 + after * 1000);
}

fn send(intake: &mut Intake, motion: &Motion, frame: usize) {
    wait_for_room(intake);
    send_at(intake, motion, frame, (frame as u32, 0));
}

fn wait_for_room(intake: &mut Intake) {
    while intake.is_full() {
        std::thread::yield_now();
    }
}

fn with_residuals(motion: &Motion, codec: Settings) -> PipelineConfig {
    PipelineConfig { residuals: true, ..config(motion, codec) }
}

fn map_of(take: &[u8]) -> TakeMap {
    TakeMap::scan(&mut Cursor::new(take)).unwrap()
}

/// The residuals of the take, row by row.
fn read(take: &[u8]) -> Vec<Vec<u8>> {
    let map = map_of(take);
    let Some(recording) = Recording::open(&map, Cursor::new(take.to_vec())).unwrap() else {
        return Vec::new();
    };
    let (n_rows, n_markers) = (map.n_rows, map.channels.len());
    let mut rows = recording.residuals(&(0..n_rows), n_markers).unwrap();
    (0..n_rows).map(|_| rows.next_row().unwrap().to_vec()).collect()
}

/// What frame `frame` comes to in a take: nothing where a marker is not seen.
fn expected(motion: &Motion, frame: usize) -> Vec<u8> {
    let of = |sample: &MarkerSample| if sample.occluded { 0 } else { sample.residual_10um };
    markers(motion, frame).iter().map(of).collect()
}

/// Asserts that the rows of a take have the residuals of these frames, and nothing those that are `None`.
#[track_caller]
fn assert_has(take: &[u8], motion: &Motion, frames: impl IntoIterator<Item = Option<usize>>) {
    let found = read(take);
    let frames: Vec<Option<usize>> = frames.into_iter().collect();
    assert_eq!(found.len(), frames.len());
    for (row, (found, frame)) in found.iter().zip(frames).enumerate() {
        let n = found.len();
        let wanted = frame.map_or(vec![0; n], |frame| expected(motion, frame));
        assert_eq!(found, &wanted, "row {row}, frame {frame:?}");
    }
}

fn record(motion: &Motion, codec: Settings, frames: impl Iterator<Item = usize>) -> Vec<u8> {
    let (mut intake, pipeline) = start(&with_residuals(motion, codec), Vec::new());
    frames.for_each(|frame| send(&mut intake, motion, frame));
    intake.finish();
    pipeline.finish().unwrap().1
}

fn all(frames: Range<usize>) -> impl Iterator<Item = Option<usize>> {
    frames.map(Some)
}

#[test]
fn every_row_has_the_residuals_of_its_frame_and_without_the_option_there_are_none() {
    let motion = crowd(1, 200.0, 12.0);
    for codec in [lossless(), dense(0.5)] {
        let take = record(&motion, codec, 0..2400);
        assert_has(&take, &motion, all(0..2400));
        let map = map_of(&take);
        let groups: Vec<_> = map.recorded_groups().map(|found| &found.group).collect();
        assert_eq!(groups.iter().map(|of| of.number).collect::<Vec<_>>(), [32, 33, 34]);
        let channels = groups.iter().flat_map(|group| &group.channels);
        for (marker, (found, channel)) in map.channels.iter().zip(channels).enumerate() {
            assert_eq!(channel.name, format!("{}.residual", found.label));
            assert_eq!((channel.index, &channel.unit[..]), (marker as u32, "mm"));
            assert!((channel.value(255.0) - 2.55).abs() < 1e-12);
        }
        for ledger in assert_clean(&take) {
            assert_eq!((ledger.taken, ledger.stored, ledger.lost()), (2400, 2400, 0));
        }
    }
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    (0..100).for_each(|frame| send(&mut intake, &motion, frame));
    intake.finish();
    let take = pipeline.finish().unwrap().1;
    assert_eq!(map_of(&take).sample_groups().count(), 0);
}

#[test]
fn a_marker_without_a_residual_has_nan_as_other_readers_see_it() {
    let motion = jump(2, 200.0, 1.0);
    let take = record(&motion, lossless(), 0..200);
    let map = map_of(&take);
    let group = map.recorded_groups().next().unwrap();
    let undecodable = group.read(&mut Cursor::new(&take), |first, n, found| {
        let found = found.unwrap();
        for (marker, column) in found.chunks_exact(n as usize).enumerate() {
            for (frame, &stored) in (first as usize..).zip(column) {
                match expected(&motion, frame)[marker] {
                    0 => assert!(stored.is_nan()),
                    count => assert_eq!(stored, f32::from(count)),
                }
            }
        }
        Ok(())
    });
    assert_eq!(undecodable.unwrap(), []);
}

#[test]
fn rows_whose_frames_are_lost_have_lost_residuals_with_the_cause_of_the_frames() {
    let motion = jump(3, 200.0, 6.0);
    let is_lost = |frame: &usize| (100..110).contains(frame) || frame.is_multiple_of(97);
    let take = record(&motion, lossless(), (1..1200).filter(|frame| !is_lost(frame)));
    let rows = (1..1200).map(|frame| Some(frame).filter(|frame| !is_lost(frame)));
    // The last frame of all is not one of them.
    assert_has(&take, &motion, rows);
    let summary = Summary::read(&take[..]).unwrap();
    let frames = summary.take.ledger.clone().unwrap();
    let ledger = assert_clean(&take)[0];
    assert_eq!((ledger.stored, ledger.lost_on_link), (frames.recorded, frames.lost_on_link));
    assert_eq!((ledger.taken, ledger.lost()), (1199, frames.lost_on_link));
}

#[test]
fn a_device_that_starts_again_or_whose_clock_jumps_keeps_every_row_in_step() {
    let motion = jump(4, 200.0, 6.0);
    let (mut intake, pipeline) = start(&with_residuals(&motion, dense(0.5)), Vec::new());
    for frame in 0..1200 {
        wait_for_room(&mut intake);
        match frame {
            0..400 => send(&mut intake, &motion, frame),
            // Its clock goes on an hour later.
            400..800 => {
                send_at(&mut intake, &motion, frame, (frame as u32, 3600 * TICK_HZ));
            }
            // It counts anew, and its clock, too.
            _ => send_at(&mut intake, &motion, frame, (frame as u32 - 800, 0)),
        }
    }
    intake.finish();
    let take = pipeline.finish().unwrap().1;
    let map = map_of(&take);
    assert_eq!(map.n_rows, 1200);
    assert_has(&take, &motion, all(0..1200));
    // Readers that know nothing of rows find the time of each frame.
    let clock = map.recorded_groups().next().unwrap().clock(TICK_HZ);
    for frame in 0..1200 {
        let before = if (400..800).contains(&frame) { 3600 * TICK_HZ } else { 0 };
        let time = clock.at(frame).unwrap();
        assert_eq!(time.device_ticks, before + frame * TICK_HZ / 200, "frame {frame}");
    }
    // The counter jumped, which the ledger of the frames says.
    let ledger = Summary::read(&take[..]).unwrap().take.sample_ledger.unwrap().groups[0];
    assert_eq!((ledger.taken, ledger.stored, ledger.jumps), (1200, 1200, 0));
}

/// A ring that is full costs all groups the same rows, whose frames are in the take.
#[test]
fn residuals_that_do_not_fit_are_lost_as_a_whole_and_counted() {
    let motion = crowd(5, 200.0, 12.0);
    let mut config = with_residuals(&motion, lossless());
    // The residuals have rings of two seconds, and the markers longer ones; no thread is as fast as the loop below.
    config.stretch = std::time::Duration::from_secs(10);
    let (mut intake, pipeline) = start(&config, Vec::new());
    (0..2400).for_each(|frame| send_at(&mut intake, &motion, frame, (frame as u32, 0)));
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledgers = assert_clean(&take);
    let counts = |ledger: &GroupLedger| GroupLedger { group: 0, ..*ledger };
    assert!(ledgers.iter().all(|ledger| counts(ledger) == counts(&ledgers[0])), "{ledgers:?}");
    let ledger = ledgers[0];
    assert_eq!(ledger.taken, written.ledger.recorded + written.ledger.lost_ring_full);
    assert_eq!(ledger.lost(), ledger.lost_ring_full);
    let found = read(&take);
    let is_there = |(frame, row): (usize, &Vec<u8>)| *row == expected(&motion, frame);
    let n_there = found.iter().enumerate().filter(|&at| is_there(at)).count() as u64;
    assert!(n_there >= ledger.stored, "{n_there} of {}", ledger.stored);
    let are_none = |row: &Vec<u8>| row.iter().all(|count| *count == 0);
    assert!(found.iter().enumerate().all(|at| is_there(at) || are_none(at.1)));
    // An export that writes them as 0 says so.
    let lacking = (0..).zip(&found).filter(|(_, row)| are_none(row));
    let seen = |frame: usize| motion.frame(frame).iter().filter(|at| !is_gap(**at)).count();
    let n_lacking: usize = lacking.map(|(frame, _)| seen(frame)).sum();
    let (_, remarks) = to_c3d(&mut open(&take));
    let told: Vec<&String> =
        remarks.iter().filter(|remark| remark.contains("lack the residual")).collect();
    match n_lacking {
        0 => assert!(told.is_empty(), "{told:?}"),
        n => assert!(told.len() == 1 && told[0].starts_with(&format!("{n} sample")), "{told:?}"),
    }
}

fn open(take: &[u8]) -> TakeFrames<Cursor<Vec<u8>>> {
    let mut frames = TakeFrames::open(Cursor::new(take.to_vec())).unwrap();
    frames.open_recording(Cursor::new(take.to_vec()), false).unwrap();
    frames
}

/// The file, and what the export says.
fn to_c3d(frames: &mut dyn FrameSource) -> (Vec<u8>, Vec<String>) {
    let mut file = Vec::new();
    let remarks = write_c3d(frames, &mut file).unwrap();
    (file, remarks)
}

/// Markers that appear after the start: their ids, and the frame with which each is announced.
struct Late(Vec<(u16, usize)>);

impl Late {
    /// Three times, three of them together.
    fn few() -> Self {
        Self(vec![(900, 17), (901, 25), (902, 25), (903, 25), (904, 40)])
    }

    /// At as many times as a recording has room for, the last of them before the frame `from`; one more with that frame, and
    /// another one 50 frames later.
    fn too_many(from: usize) -> Self {
        let fitting = (0..16).map(|n| (700 + n as u16, from - 16 + n));
        Self(fitting.chain([(900, from), (901, from + 50)]).collect())
    }

    fn residual(id: u16, frame: usize) -> u8 {
        residual(usize::from(id), frame)
    }

    /// Those of a row of `n_markers`, the late ones behind the others.
    fn row(&self, motion: &Motion, frame: usize, n_markers: usize) -> Vec<u8> {
        let late = self.0.iter().map(|&(id, from)| match frame < from {
            true => 0,
            false => Self::residual(id, frame),
        });
        expected(motion, frame).into_iter().chain(late).take(n_markers).collect()
    }

    fn send(&self, intake: &mut Intake, motion: &Motion, frame: usize) {
        wait_for_room(intake);
        let mut markers = markers(motion, frame);
        for &(id, from) in &self.0 {
            if frame == from {
                let label = format!("late {id}");
                intake.announce(&[MarkerInfo { id, label, labelled: true }]);
            }
            if frame >= from {
                let residual_10um = Self::residual(id, frame);
                let (position_mm, occluded) = ([1.0, 2.0, 3.0], false);
                markers.push(MarkerSample { id, occluded, residual_10um, position_mm });
            }
        }
        let device_ticks = frame as u64 * TICK_HZ / 200;
        let sent = Frame { seq: frame as u32, device_ticks, timecode: None, markers: &markers };
        intake.frame(&sent, 5_000_000 + device_ticks * 1000);
    }

    fn record(&self, motion: &Motion, frames: Range<usize>) -> Vec<u8> {
        let (mut intake, pipeline) = start(&with_residuals(motion, lossless()), Vec::new());
        frames.for_each(|frame| self.send(&mut intake, motion, frame));
        intake.finish();
        pipeline.finish().unwrap().1
    }

    #[track_caller]
    fn assert_in(&self, take: &[u8], motion: &Motion, frames: Range<usize>) {
        let found = read(take);
        assert_eq!(found.len(), frames.len());
        for (row, frame) in found.iter().zip(frames) {
            assert_eq!(row, &self.row(motion, frame, row.len()), "frame {frame}");
        }
    }
}

fn group_numbers(take: &[u8]) -> Vec<u32> {
    map_of(take).recorded_groups().map(|found| found.group.number).collect()
}

#[test]
fn markers_that_appear_later_have_residuals_from_their_first_row_on() {
    let motion = jump(6, 200.0, 2.0);
    let n_markers = motion.info.markers.len();
    let late = Late::few();
    let take = late.record(&motion, 0..400);
    late.assert_in(&take, &motion, 0..400);
    assert_eq!((told_at(&take), group_numbers(&take)), (vec![], vec![32, 33, 34, 35]));
    let map = map_of(&take);
    let groups = map.recorded_groups().skip(1).map(|found| &found.group);
    let channels: Vec<_> = groups.flat_map(|group| &group.channels).collect();
    assert_eq!(channels.len(), 5);
    for (channel, index) in channels.iter().zip(n_markers..) {
        assert_eq!(channel.name, format!("{}.residual", map.channels[index].label));
        assert_eq!(channel.index as usize, index);
    }
    let taken: Vec<u64> = assert_clean(&take).iter().map(|ledger| ledger.taken).collect();
    assert_eq!(taken, [400, 383, 375, 360]);

    // In files, in parts, and in these joined again.
    let (file, remarks) = to_c3d(&mut open(&take));
    assert_eq!(remarks, [""; 0]);
    let counts = residuals_10um(&Format::C3d.read(&file).unwrap().info).unwrap().unwrap();
    let at = 399 * (n_markers + 5) + n_markers;
    assert_eq!(counts[at..at + 5], late.row(&motion, 399, n_markers + 5)[n_markers..]);
    let new_scratch = || Err(std::io::ErrorKind::Unsupported.into());
    let context = context(&new_scratch);
    let source = |take: &[u8]| SourceTake::read(&mut Cursor::new(take)).unwrap();
    for rows in [0..10, 0..20, 20..400, 39..41, 200..400] {
        let (mut part, range) = (Vec::new(), rows.start as u64..rows.end as u64);
        cut(&source(&take), Cursor::new(&take), range, &mut part, &context).unwrap();
        late.assert_in(&part, &motion, rows);
        assert_clean(&part);
    }
    let mut repacked = Vec::new();
    repack(&source(&take), Cursor::new(&take), None, &mut repacked, &context).unwrap();
    late.assert_in(&repacked, &motion, 0..400);
}

#[test]
fn takes_have_the_residuals_of_markers_that_appeared_before_or_in_them() {
    let motion = jump(6, 200.0, 6.0);
    let config = with_residuals(&motion, lossless());
    let late = Late(vec![(900, 130), (901, 130), (902, 200), (903, 410)]);
    let parts = super::splits::record_parts((&motion, &config), 100, |intake| {
        (0..500).for_each(|frame| late.send(intake, &motion, frame));
    });
    assert_eq!(parts.len(), 5);
    for (part, from) in parts.iter().zip((0..).step_by(100)) {
        late.assert_in(part, &motion, from..from + 100);
        assert_eq!(told_at(part), [0; 0]);
        assert_clean(part);
    }
    assert_eq!(group_numbers(&parts[1]), [32, 33]);
    assert_eq!(group_numbers(&parts[2]), [32, 33, 34]);
    // Joined again, they have all of them.
    let sources: Vec<SourceTake> =
        parts.iter().map(|part| SourceTake::read(&mut Cursor::new(part)).unwrap()).collect();
    let new_scratch = || Err(std::io::ErrorKind::Unsupported.into());
    let (mut joined, open) = (Vec::new(), |i: usize| Ok(Cursor::new(parts[i].clone())));
    concat(&sources, open, &mut joined, &context(&new_scratch)).unwrap();
    late.assert_in(&joined, &motion, 0..500);
    assert_eq!(group_numbers(&joined), [32, 33, 34, 35]);
    assert_clean(&joined);

    let mut armed = with_residuals(&motion, dense(1.0));
    armed.pre_roll = Some(PreRollConfig { ..PRE_ROLL });
    let (mut intake, pipeline, mut handles) =
        mocapd_acquire::pipeline::Pipeline::arm(&armed, &header(&motion)).unwrap();
    (0..300).for_each(|frame| late.send(&mut intake, &motion, frame));
    // Its pre-roll begins before two of them.
    let pre_roll = std::time::Duration::from_secs(1);
    let begun = handles.takes.begin(new_take(&motion, pre_roll, 300)).unwrap();
    (300..450).for_each(|frame| late.send(&mut intake, &motion, frame));
    handles.takes.end(mocapd_take::record::EndingKind::Stopped).unwrap();
    late.send(&mut intake, &motion, 450);
    let (_, take) = ended(&begun);
    let n_rows = map_of(&take).n_rows as usize;
    assert!(n_rows >= 350, "{n_rows}");
    late.assert_in(&take, &motion, 450 - n_rows..450);
    assert_clean(&take);
    intake.finish();
    pipeline.join().unwrap();
}

#[test]
fn a_take_with_late_residuals_that_is_cut_off_anywhere_can_be_recovered() {
    let motion = jump(9, 200.0, 0.3);
    let late = Late::few();
    let take = late.record(&motion, 0..60);
    for cut in 0..take.len() {
        let part = &take[..cut];
        let Ok(map) = TakeMap::scan(&mut Cursor::new(part)) else { continue };
        let found = if map.sample_groups().next().is_some() { read(part) } else { continue };
        for (frame, row) in found.iter().enumerate() {
            let wanted = late.row(&motion, frame, row.len());
            let is_there = |(found, wanted): (&u8, &u8)| found == wanted || *found == 0;
            assert!(row.iter().zip(&wanted).all(is_there), "{cut}: frame {frame}");
        }
        let mut recovered = Vec::new();
        let scan = RecoveryScan::read(part).unwrap();
        scan.write(Cursor::new(part), &mut recovered, "test").unwrap();
        assert_eq!(read(&recovered), found, "{cut}");
        assert_clean(&recovered);
    }
}

#[test]
fn markers_that_appear_later_than_there_is_room_for_have_no_residuals_and_the_take_says_so() {
    let motion = jump(6, 200.0, 2.0);
    let late = Late::too_many(100);
    let take = late.record(&motion, 0..400);
    assert_clean(&take);
    let n_with = motion.info.markers.len() + 16;
    for (frame, row) in read(&take).iter().enumerate() {
        assert_eq!(row[..n_with], late.row(&motion, frame, n_with));
        assert_eq!(row[n_with..], [0, 0]);
    }
    assert_eq!(told_at(&take), [100]);
}

/// The rows at which a take says that residuals are not recorded.
fn told_at(take: &[u8]) -> Vec<u64> {
    let events = map_of(take).events;
    let told = events.iter().filter(|event| event.text.contains("residuals are not recorded"));
    told.map(|event| event.row).collect()
}

#[test]
fn every_take_and_part_says_once_that_markers_are_without_residuals() {
    let motion = jump(6, 200.0, 6.0);
    let config = with_residuals(&motion, lossless());
    let parts = super::splits::record_parts((&motion, &config), 100, |intake| {
        (0..400).for_each(|frame| Late::too_many(130).send(intake, &motion, frame));
    });
    let told: Vec<Vec<u64>> = parts.iter().map(|part| told_at(part)).collect();
    assert_eq!(told, [vec![], vec![30], vec![0], vec![0]]);
    // A part that begins with the marker.
    let parts = super::splits::record_parts((&motion, &config), 100, |intake| {
        (0..200).for_each(|frame| Late::too_many(100).send(intake, &motion, frame));
    });
    let told: Vec<Vec<u64>> = parts.iter().map(|part| told_at(part)).collect();
    assert_eq!(told, [vec![], vec![0]]);

    // They appear while no take is open, and before the pre-roll of the second one.
    let armed = PipelineConfig { pre_roll: Some(PreRollConfig { ..PRE_ROLL }), ..config };
    let (mut intake, pipeline, mut handles) =
        mocapd_acquire::pipeline::Pipeline::arm(&armed, &header(&motion)).unwrap();
    let mut record = |rows: Range<usize>, pre_roll_s| {
        let from = intake.next_row() as usize;
        (from..rows.start).for_each(|frame| Late::too_many(150).send(&mut intake, &motion, frame));
        let pre_roll = std::time::Duration::from_secs(pre_roll_s);
        let begun = handles.takes.begin(new_take(&motion, pre_roll, rows.start)).unwrap();
        rows.clone().for_each(|frame| Late::too_many(150).send(&mut intake, &motion, frame));
        handles.takes.end(mocapd_take::record::EndingKind::Stopped).unwrap();
        Late::too_many(150).send(&mut intake, &motion, rows.end);
        told_at(&ended(&begun).1)
    };
    assert_eq!(record(50..100, 0), [0; 0]);
    let in_pre_roll = record(250..300, 1);
    assert!(matches!(in_pre_roll[..], [row] if row < 200), "{in_pre_roll:?}");
    assert_eq!([record(400..450, 0), record(700..750, 1)], [[0], [0]]);
    intake.finish();
    pipeline.join().unwrap();
}

/// Rows that are stamped alike have their own residuals, wherever they are in a block.
#[test]
fn where_the_clock_stands_every_row_has_the_residuals_of_its_frame() {
    let motion = jump(11, 200.0, 6.0);
    let record = |ticks_of: &dyn Fn(u64) -> u64| {
        let (mut intake, pipeline) = start(&with_residuals(&motion, lossless()), Vec::new());
        for frame in 0..1200_u64 {
            wait_for_room(&mut intake);
            let markers = markers(&motion, frame as usize);
            let (seq, device_ticks) = (frame as u32, ticks_of(frame) * TICK_HZ / 200);
            let sent = Frame { seq, device_ticks, timecode: None, markers: &markers };
            intake.frame(&sent, 5_000_000 + frame * 5_000_000);
        }
        intake.finish();
        pipeline.finish().unwrap().1
    };
    let n_runs = |take: &[u8]| {
        let map = map_of(take);
        let group = map.recorded_groups().next().unwrap();
        let mut runs: Vec<u64> = group.anchors().iter().map(|anchor| anchor.run_start).collect();
        runs.dedup();
        runs.len()
    };
    // It stands for a few frames: at the start, at the ends of blocks, and in between.
    for n in [2, 3, 7] {
        for first in [0, 50, 97, 98, 99, 100, 101, 197, 199, 333, 1197] {
            let take =
                record(&|frame| if (first..first + n).contains(&frame) { first } else { frame });
            assert_has(&take, &motion, all(0..1200));
            assert_eq!(n_runs(&take), 1, "{n} from {first}");
            assert_clean(&take);
        }
    }
    // It counts slower than frames come, and never goes on.
    for n in [2, 3, 4] {
        assert_has(&record(&|frame| frame - frame % n), &motion, all(0..1200));
    }
    // Its steps are uneven, and forty times those of its rate: a run ends where the host finds that the clock jumped, and not
    // with each row.
    let take = record(&|frame| 40 * frame + 5 * (frame % 3));
    assert_has(&take, &motion, all(0..1200));
    assert!(n_runs(&take) < 12, "{}", n_runs(&take));
    // One that goes back begins a run.
    let take = record(&|frame| if frame < 600 { 10_000 + frame } else { 10_000 + frame - 2 });
    assert_has(&take, &motion, all(0..1200));
    assert_eq!(n_runs(&take), 2);
}

#[test]
fn takes_of_a_recording_that_is_divided_or_armed_have_the_residuals_of_their_frames() {
    let motion = jump(7, 200.0, 8.0);
    let config = with_residuals(&motion, lossless());
    let takes = super::splits::record_parts((&motion, &config), 100, |intake| {
        // Two parts begin with, and end in, lost frames.
        let frames = (0..600).filter(|frame| !(195..203).contains(frame));
        frames.for_each(|frame| send(intake, &motion, frame));
    });
    let mut from = 0;
    for take in &takes {
        let n_rows = Summary::read(&take[..]).unwrap().take.n_rows as usize;
        let frame = |frame| Some(frame).filter(|frame| !(195..203).contains(frame));
        assert_has(take, &motion, (from..from + n_rows).map(frame));
        let ledger = assert_clean(take)[0];
        assert_eq!(ledger.taken, n_rows as u64);
        from += n_rows;
    }
    assert_eq!((takes.len(), from), (6, 600));

    let mut armed = with_residuals(&motion, dense(1.0));
    armed.pre_roll = Some(PreRollConfig { ..PRE_ROLL });
    let (mut intake, pipeline, mut handles) =
        mocapd_acquire::pipeline::Pipeline::arm(&armed, &header(&motion)).unwrap();
    (0..700).for_each(|frame| send(&mut intake, &motion, frame));
    let pre_roll = std::time::Duration::from_secs(2);
    let begun = handles.takes.begin(new_take(&motion, pre_roll, 700)).unwrap();
    (700..900).for_each(|frame| send(&mut intake, &motion, frame));
    handles.takes.end(mocapd_take::record::EndingKind::Stopped).unwrap();
    (900..1000).for_each(|frame| send(&mut intake, &motion, frame));
    let (_, take) = ended(&begun);
    let n_rows = Summary::read(&take[..]).unwrap().take.n_rows as usize;
    assert!(n_rows >= 600, "{n_rows}");
    assert_has(&take, &motion, all(900 - n_rows..900));
    assert_clean(&take);
    intake.finish();
    pipeline.join().unwrap();
}

fn context<'a>(
    new_scratch: &'a dyn Fn() -> std::io::Result<
        std::sync::Arc<dyn mocapd_take::foreign::content::ScratchFile>,
    >,
) -> EditContext<'a> {
    EditContext { software: "test", new_scratch, on_rows: &|_| () }
}

#[test]
fn parts_have_the_residuals_of_their_frames_and_joined_again_they_are_those_of_the_take() {
    let motion = jump(8, 200.0, 12.0);
    let is_lost = |frame: &usize| (1000..1013).contains(frame);
    let take = record(&motion, dense(0.5), (0..2400).filter(|frame| !is_lost(frame)));
    let frames = |rows: Range<usize>| rows.map(|frame| Some(frame).filter(|at| !is_lost(at)));
    let new_scratch = || Err(std::io::ErrorKind::Unsupported.into());
    let context = context(&new_scratch);
    let source = |take: &[u8]| SourceTake::read(&mut Cursor::new(take)).unwrap();
    let cut_to = |rows: Range<u64>| {
        let mut part = Vec::new();
        cut(&source(&take), Cursor::new(&take), rows, &mut part, &context).unwrap();
        part
    };
    let parts = [cut_to(0..777), cut_to(777..778), cut_to(778..1005), cut_to(1005..2400)];
    for (part, rows) in parts.iter().zip([0..777, 777..778, 778..1005, 1005..2400]) {
        assert_eq!(assert_clean(part)[0].taken, rows.len() as u64);
        assert_has(part, &motion, frames(rows));
    }
    let sources: Vec<SourceTake> = parts.iter().map(|part| source(part)).collect();
    let (mut joined, mut repacked) = (Vec::new(), Vec::new());
    concat(&sources, |i| Ok(Cursor::new(parts[i].clone())), &mut joined, &context).unwrap();
    repack(&source(&take), Cursor::new(&take), None, &mut repacked, &context).unwrap();
    for other in [&joined, &repacked] {
        assert_has(other, &motion, frames(0..2400));
        assert_clean(other);
    }
}

/// Joined takes that do not have the same residuals lack these alone, and compared they differ in nothing else.
#[test]
fn residuals_that_only_one_take_has_cost_no_other_sampled_channels() {
    let motion = jump(12, 200.0, 2.0);
    let channel = |name: &str| SampledChannelInfo {
        name: name.to_owned(),
        unit: "V".to_owned(),
        scale: 1.0,
        offset: 0.0,
    };
    let group = SampledGroupInfo {
        id: 3,
        form: SampleForm::Float32,
        rate_millihertz: 200_000,
        channels: vec![channel("trigger"), channel("light")],
    };
    let record = |residuals| {
        let config = with_residuals(&motion, lossless());
        let config = PipelineConfig { residuals, sampled: vec![group.clone()], ..config };
        let (mut intake, pipeline) = start(&config, Vec::new());
        for frame in 0..400 {
            send(&mut intake, &motion, frame);
            let samples = [frame as f32, 1.0];
            intake.samples(&SampleBatch {
                group: 3,
                number: frame as u32,
                first: frame as u64,
                device_ticks: frame as u64 * TICK_HZ / 200,
                form: SampleForm::Float32,
                n_channels: 2,
                samples: &samples,
            });
        }
        intake.finish();
        pipeline.finish().unwrap().1
    };
    let takes = [record(true), record(false)];
    let new_scratch = || Err(std::io::ErrorKind::Unsupported.into());
    let context = context(&new_scratch);
    for (order, groups) in [([0, 1], vec![3]), ([1, 0], vec![3]), ([0, 0], vec![3, 32])] {
        let of = |i: usize| &takes[order[i]];
        let sources = [0, 1].map(|i| SourceTake::read(&mut Cursor::new(of(i))).unwrap());
        let mut joined = Vec::new();
        let open = |i: usize| Ok(Cursor::new(of(i).clone()));
        let report = concat(&sources, open, &mut joined, &context).unwrap();
        let map = map_of(&joined);
        let found: Vec<u32> = map.recorded_groups().map(|of| of.group.number).collect();
        assert_eq!(found, groups);
        assert_eq!(map.recorded_groups().next().unwrap().n_samples(), 800);
        let ledger: Vec<u32> = assert_clean(&joined).iter().map(|ledger| ledger.group).collect();
        assert_eq!(ledger, groups);
        let is_told = report.left_out.iter().any(|what| what.contains("residuals of the markers"));
        assert_eq!(is_told, groups.len() == 1, "{:?}", report.left_out);
    }
    for (ours, theirs, n_skipped) in [(0, 1, 1), (1, 0, 1), (0, 0, 0)] {
        let maps = [&takes[ours], &takes[theirs]].map(|take| map_of(take));
        let (ours, theirs) = (&mut Cursor::new(&takes[ours]), &mut Cursor::new(&takes[theirs]));
        let found = compare_samples((&maps[0], ours), (&maps[1], theirs)).unwrap().unwrap();
        assert!(found.is_within() && found.samples >= 800, "{found:?}");
        assert_eq!(found.residual_groups_skipped, n_skipped);
    }
}

#[test]
fn a_take_that_is_cut_off_anywhere_is_true_and_can_be_recovered() {
    let motion = jump(9, 200.0, 0.3);
    let take = record(&motion, lossless(), 0..60);
    let mut longest = 0;
    for cut in 0..take.len() {
        let part = &take[..cut];
        let Ok(map) = TakeMap::scan(&mut Cursor::new(part)) else { continue };
        if map.sample_groups().next().is_none() {
            continue;
        }
        let (frames, are_none) = (read(part), |row: &Vec<u8>| row.iter().all(|count| *count == 0));
        // Blocks of residuals may be behind or before the stretch of their rows.
        let n = frames.iter().take_while(|row| !are_none(row)).count();
        assert!(frames[n..].iter().all(are_none), "{cut}");
        let same = (0..n).all(|frame| frames[frame] == expected(&motion, frame));
        assert!(same && n >= longest, "{cut}: what was readable stays so");
        longest = n;
        let mut recovered = Vec::new();
        let scan = RecoveryScan::read(part).unwrap();
        scan.write(Cursor::new(part), &mut recovered, "test").unwrap();
        assert_eq!(read(&recovered), frames, "{cut}");
        assert_clean(&recovered);
    }
    assert_eq!(longest, 60);
}

/// A C3D file has them in its points, in steps of 10 micrometres, and as nothing else.
#[test]
fn an_export_to_c3d_has_the_residuals_in_its_points() {
    let motion = crowd(10, 200.0, 2.0);
    let take = record(&motion, lossless(), (0..400).filter(|frame| *frame != 50));
    let mut frames = open(&take);
    let (file, remarks) = to_c3d(&mut frames);
    assert!(remarks.is_empty(), "{remarks:?}");
    let found = Format::C3d.read(&file).unwrap();
    assert_eq!(found.info.source.warnings, [""; 0]);
    let counts = residuals_10um(&found.info).unwrap().unwrap();
    let n_markers = motion.info.markers.len();
    for (frame, counts) in counts.chunks_exact(n_markers).enumerate() {
        for (marker, &count) in counts.iter().enumerate() {
            if frame == 50 || is_gap(motion.frame(frame)[marker]) {
                assert!(is_gap(found.frame(frame)[marker]));
                continue;
            }
            assert_eq!(count, residual(marker, frame), "frame {frame} marker {marker}");
        }
    }
    // The fourth word is a count, and its unit that of a count.
    let kinds: Vec<&str> = found.info.foreign.iter().map(|part| &part.kind[..]).collect();
    assert!(kinds.contains(&"c3d/residuals") && !kinds.contains(&"c3d/analog"), "{kinds:?}");
    assert_eq!(frames.info().markers.len(), n_markers);
}

/// A take that has the residuals of an imported file, too, gives that file back, in its own unit.
#[test]
fn residuals_of_an_imported_file_are_written_before_those_of_the_recording() {
    let motion = jump(13, 200.0, 1.0);
    let take = record(&motion, lossless(), 0..200);
    let (mut file, _) = to_c3d(&mut open(&take));
    // As if the file counted tenths of a millimetre.
    let scale = |of: f32| [&b"SCALE\x09\0\x04\0"[..], &of.to_le_bytes()].concat();
    let place_of = |file: &[u8], scale: &[u8]| file.windows(scale.len()).position(|at| at == scale);
    let place = place_of(&file, &scale(-0.01)).expect("POINT:SCALE");
    file[place..place + 13].copy_from_slice(&scale(-0.1));
    let mut imported = Format::C3d.read(&file).unwrap();
    let kept = residuals_10um(&imported.info).unwrap().unwrap();
    assert_eq!(kept[2], expected(&motion, 0)[2].saturating_mul(10));

    let other = record(&motion, lossless(), 50..200);
    imported.info.recording.clone_from(&open(&other).info().recording);
    let (both, remarks) = to_c3d(&mut MotionFrames::new(&imported));
    assert_eq!(remarks.len(), 1, "{remarks:?}");
    assert!(remarks[0].starts_with("The residuals of the recording were left out"), "{remarks:?}");
    assert!(place_of(&both, &scale(-0.1)).is_some(), "POINT:SCALE is that of the file");
    let found = Format::C3d.read(&both).unwrap();
    assert_eq!(residuals_10um(&found.info).unwrap().unwrap(), kept);
}
