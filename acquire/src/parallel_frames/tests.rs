use std::{f64::consts::TAU, fs, io::Cursor, path::PathBuf, sync::atomic::AtomicU64};

use mocapd_codec::{Effort, ResamplerKind, Settings, Tolerance};
use mocapd_take::motion::{Marker, Motion, is_gap};
use mocapd_testkit::random::Random;

use super::*;
use crate::{header, pipeline::offline};

/// 64 s of 70 markers at 50 Hz that swing, each at a frequency of its own, and are hidden now and then.
fn motion() -> Motion {
    let mut random = Random::new(3);
    let swings: [_; 70] = std::array::from_fn(|_| (random.between(0.2, 2.0), random.unit()));
    let mut hidden_until = [0; 70];
    let mut positions_mm = Vec::new();
    for frame in 0..3200 {
        let time_s = f64::from(frame) / 50.0;
        for ((frequency_hz, phase), hidden_until) in swings.iter().zip(&mut hidden_until) {
            if random.one_in(100) {
                *hidden_until = frame + 10;
            }
            let turns = frequency_hz * time_s + phase;
            let at = [0.0, 0.25, 0.6].map(|axis| (300.0 * (TAU * (turns + axis)).sin()) as f32);
            positions_mm.push(if frame < *hidden_until { GAP } else { at });
        }
    }
    let marker = |i| Marker { label: format!("m{i}"), labelled: true };
    let markers = (0..70).map(marker).collect();
    let info = MotionInfo { rate_hz: 50.0, n_frames: 3200, markers, ..MotionInfo::default() };
    Motion { info, positions_mm }
}

/// A take of several key stretches and two groups of channels.
fn take(kind: &str, folder: &Path) -> PathBuf {
    let motion = motion();
    let kind: ResamplerKind = kind.parse().unwrap();
    let codec = Settings { kind, tolerance: Tolerance::from_mm(1.0).unwrap() };
    let mut header = header::of_import(&codec, 50.0);
    header.channels = header::channels(&motion.info.markers);
    header.stretch_rows = offline::stretch_rows(&codec, 50.0, motion.n_frames(), 70) as u32;
    let (_, bytes) =
        offline::write_take(&motion, &header, 2, &AtomicU64::new(0), Vec::new()).unwrap();
    let path = folder.join("a.take");
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn a_take_is_the_same_for_any_number_of_encoding_threads() {
    let motion = motion();
    let codec =
        Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(1.0).unwrap() };
    let mut header = header::of_import(&codec, 50.0);
    header.channels = header::channels(&motion.info.markers);
    header.stretch_rows = offline::stretch_rows(&codec, 50.0, motion.n_frames(), 70) as u32;
    let mut sizes = Vec::new();
    for level in [1, 4] {
        header.set_effort(Effort::new(level).unwrap());
        let take = |n_workers| {
            let progress = AtomicU64::new(0);
            offline::write_take(&motion, &header, n_workers, &progress, Vec::new()).unwrap().1
        };
        let alone = take(1);
        assert!(take(2) == alone && take(5) == alone, "effort {level}");
        sizes.push(alone.len());
    }
    assert!(sizes[1] < sizes[0], "{sizes:?}");
}

fn open(path: &Path) -> TakeFrames<Cursor<Vec<u8>>> {
    TakeFrames::open(Cursor::new(fs::read(path).unwrap())).unwrap()
}

fn rows(frames: &mut dyn FrameSource) -> Vec<Vec<[u32; 3]>> {
    let mut row = vec![GAP; frames.info().markers.len()];
    let mut all = Vec::new();
    while frames.next_frame(&mut row).unwrap() {
        let bits = |&p: &Position| if is_gap(p) { [0; 3] } else { p.map(f32::to_bits) };
        all.push(row.iter().map(bits).collect());
    }
    all
}

#[test]
fn the_same_frames_for_any_number_of_threads() {
    for kind in ["dense", "fast", "lossless", "lossless:predictive"] {
        let folder = tempfile::tempdir().unwrap();
        let path = take(kind, folder.path());
        let mut frames = open(&path);
        let expected = rows(&mut frames);
        assert_eq!(expected.len(), 3200);
        for n_threads in [1, 2, 3, 9] {
            let pieces = frames.map().pieces(&(0..3200), 4);
            let mut parallel =
                ParallelFrames::with_threads(&path, &frames, pieces, n_threads).unwrap();
            assert!(rows(&mut parallel) == expected, "{kind}, {n_threads} threads");
            assert!(!parallel.is_damaged());
        }
    }
}

#[test]
fn threads_end_when_a_channel_is_disconnected() {
    let folder = tempfile::tempdir().unwrap();
    let path = take("fast", folder.path());
    let map = open(&path).map().clone();
    let traversal =
        || TakeTraversal::from_map(File::open(&path).unwrap(), &map, Decode::All).unwrap();
    // The receiver of the rows is gone: the thread ends instead of waiting.
    let (jobs, to_do) = bounded(2);
    for _ in 0..2 {
        let (decoded, from_job) = bounded(1);
        drop(from_job);
        jobs.send(Job { rows: 0..3200, decoded }).unwrap();
    }
    work(traversal(), 70, &to_do);
    assert_eq!(to_do.len(), 1);
    // The sender of jobs is gone.
    drop(jobs);
    let worker = threads::spawn("test", {
        let take = traversal();
        move || work(take, 70, &to_do)
    });
    threads::join(worker.unwrap()).unwrap();
}

#[test]
fn a_damaged_take_is_not_decoded_in_parallel() {
    let folder = tempfile::tempdir().unwrap();
    let path = take("fast", folder.path());
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 40]).unwrap();
    assert!(ParallelFrames::start(&path, &open(&path), 0, 4).unwrap().is_none());
}

/// A repeated section between two jobs would be seen by neither thread.
#[test]
fn a_repeated_section_is_reported_and_read_by_one_thread() {
    let folder = tempfile::tempdir().unwrap();
    let path = take("fast", folder.path());
    let keys = open(&path).map().keys.clone();
    let [from, to] = [keys[1], keys[2]].map(|key| key.offset as usize);
    let mut bytes = fs::read(&path).unwrap();
    let again = bytes[from..to].to_vec();
    drop(bytes.splice(to..to, again));
    fs::write(&path, &bytes).unwrap();
    let frames = open(&path);
    let problems: Vec<String> = frames.problems().iter().map(ToString::to_string).collect();
    assert!(problems.iter().any(|text| text.contains("it comes twice")), "{problems:?}");
    assert!(ParallelFrames::start(&path, &frames, 0, 4).unwrap().is_none());
}

#[test]
fn stretches_that_fill_the_memory_are_read_by_one_thread() {
    let folder = tempfile::tempdir().unwrap();
    // A whole take in one stretch: 70 markers of 3200 rows are 5 MB a thread.
    let path = take("spline", folder.path());
    let frames = open(&path);
    let memory = MEMORY_MAX / (70 * 3200 * SAMPLE_BYTES);
    assert_eq!(threads_max(frames.map(), 70) as u64, memory);
    assert!(ParallelFrames::start(&path, &frames, 0, 1000).unwrap().is_some());
    assert!(ParallelFrames::start(&path, &frames, 0, 1).unwrap().is_none());
}

#[test]
fn a_file_that_shrinks_while_it_is_read_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let path = take("fast", folder.path());
    let frames = open(&path);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..100]).unwrap();
    let mut parallel = ParallelFrames::start(&path, &frames, 0, 2).unwrap().unwrap();
    let mut row = vec![GAP; 70];
    assert!(parallel.next_frame(&mut row).is_err());
    assert!(parallel.is_damaged());
}

/// A file that changes, or a disk that returns other bytes, after the take was opened: none of it may become a gap.
#[test]
fn a_byte_that_changes_while_it_is_read_is_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = take("fast", folder.path());
    let (frames, bytes) = (open(&path), fs::read(&path).unwrap());
    for at in (bytes.len() / 3..bytes.len() - 200).step_by(bytes.len() / 7) {
        let mut wrong = bytes.clone();
        wrong[at] ^= 0x10;
        fs::write(&path, &wrong).unwrap();
        let mut parallel = ParallelFrames::start(&path, &frames, 0, 2).unwrap().unwrap();
        let mut row = vec![GAP; 70];
        let end = loop {
            match parallel.next_frame(&mut row) {
                Ok(true) => {}
                end => break end,
            }
        };
        assert!(end.is_err() && parallel.is_damaged(), "byte {at}");
    }
}
