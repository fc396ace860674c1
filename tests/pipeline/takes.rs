//! Takes that begin and end while the device runs: with a pre-roll, without one, and one after another.

use std::{io, time::Duration};

use mocapd_acquire::{
    inspect::Summary,
    pipeline::{
        ArmedHandles, Intake, NewTake, Pipeline, PreRollConfig, TakeAccount, TakeHandle, TakeOutput,
    },
};
use mocapd_take::{
    motion::{Motion, Position, is_gap},
    record::EndingKind,
};

use crate::support::{
    TICK_HZ, chunks, config, crowd, dense, distance_mm, feed, jump, output_of, rows,
};

pub(super) const PRE_ROLL: PreRollConfig =
    PreRollConfig { time: Duration::from_secs(5), bytes_max: 64 << 20 };

pub(super) fn header(motion: &Motion) -> mocapd_take::record::Header {
    let config = config(motion, dense(1.0));
    let mut header = mocapd_acquire::header::new(&config.codec, config.rate_hz).unwrap();
    header.stretch_rows = config.stretch_rows();
    header.device = Some(mocapd_take::record::Device { tick_hz: TICK_HZ, ..Default::default() });
    header
}

pub(super) fn arm(motion: &Motion, pre_roll: PreRollConfig) -> (Intake, Pipeline, ArmedHandles) {
    let mut config = config(motion, dense(1.0));
    config.pre_roll = Some(pre_roll);
    Pipeline::arm(&config, &header(motion)).unwrap()
}

/// The arrival time of frame `seq`, as `feed` sets it.
pub(super) fn arrival_ns(motion: &Motion, seq: usize) -> u64 {
    5_000_000 + (seq as f64 * 1e9 / motion.info.rate_hz).round() as u64
}

pub(super) fn new_take(motion: &Motion, pre_roll: Duration, seq: usize) -> NewTake {
    let requested_ns = arrival_ns(motion, seq);
    NewTake { pre_roll, requested_ns, ..NewTake::new(Vec::new(), header(motion)) }
}

pub(super) fn feed_all(
    intake: &mut Intake,
    motion: &Motion,
    seqs: impl IntoIterator<Item = usize>,
) {
    for seq in seqs {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(intake, motion, seq);
    }
}

pub(super) fn ended(handle: &TakeHandle) -> (TakeAccount, Vec<u8>) {
    end_of(handle)
}

fn end_of<W: TakeOutput>(handle: &TakeHandle) -> (TakeAccount, W) {
    let (written, output) = handle.ended.recv_timeout(Duration::from_secs(60)).unwrap().unwrap();
    (written, output_of(output))
}

/// Asserts that the take has exactly these frames of `motion`, and that all its statements are true.
fn assert_has(take: &[u8], motion: &Motion, seqs: impl ExactSizeIterator<Item = usize>) {
    let (found, problems) = rows(take);
    assert!(problems.is_empty(), "{problems:?}");
    assert_eq!(found.len(), seqs.len());
    let same = |&(&got, &expected): &(&Position, &Position)| {
        is_gap(got) == is_gap(expected) && (is_gap(got) || distance_mm(got, expected) <= 1.0)
    };
    for (row, seq) in found.iter().zip(seqs) {
        let pairs: Vec<_> = row.iter().zip(motion.frame(seq)).collect();
        assert!(pairs.iter().all(same), "frame {seq}");
    }
    let summary = Summary::read(take).unwrap();
    assert_eq!((summary.take.problems.as_slice(), summary.contradictions()), (&[][..], &[][..]));
    let ledger = summary.take.ledger.unwrap();
    assert!(ledger.finished && ledger.closes(), "{ledger:?}");
    assert_eq!(ledger.recorded, found.len() as u64);
    assert!(chunks(take).finished);
}

#[test]
fn takes_begin_and_end_at_the_next_frame() {
    let motion = crowd(11, 200.0, 20.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..333);
    for (from, to) in [(333, 500), (900, 1000), (1001, 2777)] {
        let next = intake.next_row() as usize;
        feed_all(&mut intake, &motion, next..from);
        let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, from)).unwrap();
        feed_all(&mut intake, &motion, from..to);
        let first = handle.first.recv_timeout(Duration::from_secs(30)).unwrap();
        assert_eq!(first.arrival_ns, arrival_ns(&motion, from));
        assert_eq!((first.row, first.device_ticks), (from as u64, from as u64 * 5000));
        armed.takes.end(EndingKind::Stopped).unwrap();
        feed_all(&mut intake, &motion, to..=to);
        let (written, take) = ended(&handle);
        assert_has(&take, &motion, from..to);
        assert_eq!(written.file_bytes, take.len() as u64);
    }
    drop(intake);
    pipeline.join().unwrap();
}

#[test]
fn a_take_of_a_requested_length_ends_by_itself_at_exactly_that_row() {
    let motion = crowd(17, 200.0, 20.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    let timed =
        |seq, rows| NewTake { length_rows: Some(rows), ..new_take(&motion, Duration::ZERO, seq) };
    feed_all(&mut intake, &motion, 0..333);
    for (from, rows) in [(333, 1), (334, 100), (600, 999)] {
        let next = intake.next_row() as usize;
        feed_all(&mut intake, &motion, next..from);
        let handle = armed.takes.begin(timed(from, rows as u64)).unwrap();
        // The last frame alone ends it.
        feed_all(&mut intake, &motion, from..from + rows);
        let (written, take) = ended(&handle);
        assert_eq!(written.ending.kind, EndingKind::Length);
        assert_has(&take, &motion, from..from + rows);
    }
    // A take that follows at once is another one, and an end in between has no effect.
    let handle = armed.takes.begin(timed(1599, 50)).unwrap();
    feed_all(&mut intake, &motion, 1599..1649);
    armed.takes.end(EndingKind::Stopped).unwrap();
    let next = armed.takes.begin(timed(1649, 7)).unwrap();
    feed_all(&mut intake, &motion, 1649..1700);
    assert_has(&ended(&handle).1, &motion, 1599..1649);
    assert_has(&ended(&next).1, &motion, 1649..1656);
    // One that is stopped earlier does not shorten the next.
    let handle = armed.takes.begin(timed(1700, 100)).unwrap();
    feed_all(&mut intake, &motion, 1700..1750);
    armed.takes.end(EndingKind::Stopped).unwrap();
    let next = armed.takes.begin(new_take(&motion, Duration::ZERO, 1750)).unwrap();
    feed_all(&mut intake, &motion, 1750..1900);
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_all(&mut intake, &motion, 1900..1901);
    assert_eq!(ended(&handle).0.ending.kind, EndingKind::Stopped);
    assert_has(&ended(&next).1, &motion, 1750..1900);
    drop(intake);
    pipeline.join().unwrap();
}

#[test]
fn frames_lost_at_the_end_of_a_requested_length_belong_to_the_take_up_to_it() {
    let motion = crowd(18, 200.0, 20.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..400);
    let pre_roll = Duration::from_secs(1);
    let take = NewTake { length_rows: Some(100), ..new_take(&motion, pre_roll, 400) };
    let handle = armed.takes.begin(take).unwrap();
    feed_all(&mut intake, &motion, (400..480).chain(520..530));
    let first = handle.first.recv_timeout(Duration::from_secs(30)).unwrap();
    let (written, take) = ended(&handle);
    assert_eq!(written.ending.kind, EndingKind::Length);
    assert!(written.ledger.closes() && first.row <= 200, "{first:?} {:?}", written.ledger);
    assert_eq!((written.ledger.recorded, written.ledger.frames_lost()), (480 - first.row, 20));
    let (rows, problems) = rows(&take);
    assert!(problems.is_empty(), "{problems:?}");
    assert_eq!(rows.len() as u64, 500 - first.row, "its pre-roll, and a hundred rows");
    drop(intake);
    pipeline.join().unwrap();
}

#[test]
fn a_take_begins_before_its_request_as_far_as_the_pre_roll_reaches() {
    let motion = jump(12, 100.0, 30.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..1203);
    // Keys come every second, counted from the first frame: the take begins at the last one that is old enough.
    let handle = armed.takes.begin(new_take(&motion, Duration::from_secs(2), 1203)).unwrap();
    feed_all(&mut intake, &motion, 1203..1500);
    let first = handle.first.recv_timeout(Duration::from_secs(30)).unwrap();
    assert!((903..=1003).contains(&first.row), "{first:?}");
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_all(&mut intake, &motion, 1500..1600);
    assert_has(&ended(&handle).1, &motion, first.row as usize..1500);
    // A request for more than is buffered gets everything buffered.
    let handle = armed.takes.begin(new_take(&motion, Duration::from_secs(600), 1600)).unwrap();
    feed_all(&mut intake, &motion, 1600..1650);
    let first = handle.first.recv_timeout(Duration::from_secs(30)).unwrap();
    assert!((900..1100).contains(&first.row), "{first:?}");
    drop(intake);
    assert_has(&ended(&handle).1, &motion, first.row as usize..1650);
    pipeline.join().unwrap();
}

#[test]
fn the_pre_roll_is_saved_while_a_take_continues() {
    let motion = jump(13, 100.0, 30.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..800);
    let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 800)).unwrap();
    feed_all(&mut intake, &motion, 800..1000);
    let saved = armed.takes.save(new_take(&motion, Duration::from_secs(3), 1000)).unwrap();
    feed_all(&mut intake, &motion, 1000..1200);
    let (written, take) = ended(&saved);
    let first = 1000 - written.ledger.recorded as usize;
    assert!((600..=700).contains(&first), "{first}");
    assert_has(&take, &motion, first..1000);
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_all(&mut intake, &motion, 1200..1201);
    assert_has(&ended(&handle).1, &motion, 800..1200);
    drop(intake);
    pipeline.join().unwrap();
}

/// Loss that becomes known with the next frame belongs to the take that has that frame.
#[test]
fn each_take_has_the_loss_of_its_own_rows() {
    let motion = jump(14, 100.0, 12.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, (0..300).filter(|seq| seq % 50 != 49));
    // Frame 299 is lost, which is not known yet.
    let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 300)).unwrap();
    feed_all(&mut intake, &motion, (300..600).filter(|seq| seq % 100 != 0 && seq % 100 != 99));
    feed_all(&mut intake, &motion, [598, 597]);
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_all(&mut intake, &motion, 601..700);
    let (written, take) = ended(&handle);
    let ledger = &written.ledger;
    // Row 299 did not exist when the take began; row 300 is its first, and lost as well. Row 599, its last, belongs to
    // the next take.
    assert_eq!((ledger.recorded, ledger.lost_on_link, ledger.duplicates), (294, 6, 2));
    assert!(ledger.closes() && ledger.finished, "{ledger:?}");
    let (found, _) = rows(&take);
    assert_eq!(found.len(), 300);
    let summary = Summary::read(&take[..]).unwrap();
    assert_eq!(summary.contradictions(), &[] as &[String]);
    drop(intake);
    pipeline.join().unwrap();
}

#[test]
fn markers_that_appeared_before_a_take_are_in_its_table_and_later_ones_when_they_come() {
    let motion = crowd(15, 100.0, 10.0);
    let first_100: Vec<_> = motion.info.markers[..100].to_vec();
    let mut few = motion.clone();
    few.info.markers = first_100;
    let mut config = config(&motion, dense(1.0));
    config.channels.truncate(100);
    config.pre_roll = Some(PRE_ROLL);
    let (mut intake, pipeline, mut armed) = Pipeline::arm(&config, &header(&motion)).unwrap();
    let feed_n = |intake: &mut Intake, seqs: std::ops::Range<usize>, n: usize| {
        for seq in seqs {
            let all = crate::support::samples(motion.frame(seq));
            while intake.is_full() {
                std::thread::yield_now();
            }
            crate::support::feed_samples(intake, 100.0, seq, &all[..n]);
        }
    };
    feed_n(&mut intake, 0..200, 100);
    feed_n(&mut intake, 200..300, 120);
    let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 300)).unwrap();
    feed_n(&mut intake, 300..400, 120);
    feed_n(&mut intake, 400..500, 150);
    let rolled = armed.takes.save(new_take(&motion, Duration::from_secs(600), 500)).unwrap();
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_n(&mut intake, 500..501, 150);
    for (take, n_rows) in [(ended(&handle).1, 200), (ended(&rolled).1, 500)] {
        assert_eq!(chunks(&take).labels.len(), 150);
        let (found, problems) = rows(&take);
        assert_eq!((found.len(), problems.len()), (n_rows, 0));
        let summary = Summary::read(&take[..]).unwrap();
        assert_eq!(
            (summary.take.problems.as_slice(), summary.contradictions()),
            (&[][..], &[][..])
        );
    }
    drop(intake);
    pipeline.join().unwrap();
}

#[test]
fn memory_bounds_the_pre_roll_and_a_take_without_a_frame_is_not_a_pipeline_error() {
    let motion = jump(16, 100.0, 20.0);
    let small = PreRollConfig { time: Duration::from_secs(600), bytes_max: 15_000 };
    let (mut intake, pipeline, mut armed) = arm(&motion, small);
    feed_all(&mut intake, &motion, 0..1500);
    let handle = armed.takes.begin(new_take(&motion, Duration::from_secs(600), 1500)).unwrap();
    intake.tick(arrival_ns(&motion, 1500));
    armed.takes.end(EndingKind::Stopped).unwrap();
    intake.tick(arrival_ns(&motion, 1501));
    let (written, _) = ended(&handle);
    assert!(written.ledger.recorded < 1400, "{}", written.ledger.recorded);
    let progress = pipeline.progress().clone();
    assert!(progress.pre_roll_bytes.load(std::sync::atomic::Ordering::Relaxed) <= 15_000);
    assert!(progress.pre_roll_is_cut.load(std::sync::atomic::Ordering::Relaxed));
    drop(intake);
    pipeline.join().unwrap();
}

/// A failing disk costs the take that is written to it; the next take is written.
#[test]
fn a_disk_that_fails_ends_the_take_and_not_the_pipeline() {
    #[derive(Debug)]
    struct Failing(usize);
    impl io::Write for Failing {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0 = self.0.checked_sub(bytes.len()).ok_or(io::ErrorKind::StorageFull)?;
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    impl TakeOutput for Failing {
        fn sync(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let motion = jump(17, 100.0, 20.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    let mut seq = 0;
    for (space, fails) in [(0, true), (1500, true), (1 << 20, false)] {
        let output = Box::new(Failing(space));
        let take = NewTake { output, ..new_take(&motion, Duration::ZERO, seq) };
        let handle = armed.takes.begin(take).unwrap();
        feed_all(&mut intake, &motion, seq..seq + 500);
        seq += 500;
        armed.takes.end(EndingKind::Stopped).unwrap();
        feed_all(&mut intake, &motion, seq..seq + 1);
        seq += 1;
        let end = handle.ended.recv_timeout(Duration::from_secs(30)).unwrap();
        assert_eq!(end.is_err(), fails, "{space}");
        assert!(!intake.has_failed());
    }
    drop(intake);
    pipeline.join().unwrap();
}

/// A disk that blocks every write while it is shut.
#[derive(Debug, Clone, Default)]
struct ShutDisk(std::sync::Arc<std::sync::Mutex<bool>>, Vec<u8>);

impl io::Write for ShutDisk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        while *self.0.lock().unwrap() {
            std::thread::sleep(Duration::from_millis(5));
        }
        self.1.extend_from_slice(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for ShutDisk {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Frames that found the rings full after a take's last row are that take's loss, although no row followed.
#[test]
fn frames_that_a_stalled_disk_costs_at_a_takes_end_are_on_its_ledger() {
    let motion = jump(18, 1000.0, 80.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..100);
    let gate = ShutDisk::default();
    let output = Box::new(gate.clone());
    let take = NewTake { output, ..new_take(&motion, Duration::ZERO, 100) };
    let handle = armed.takes.begin(take).unwrap();
    feed_all(&mut intake, &motion, 100..300);
    handle.first.recv_timeout(Duration::from_secs(30)).unwrap();
    *gate.0.lock().unwrap() = true;
    // More than buffers and rings hold.
    let mut seq = 300;
    while intake.counts().ring_full < 500 {
        feed(&mut intake, &motion, seq);
        seq += 1;
        if seq % 500 == 0 {
            // Let the workers run.
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    armed.takes.end(EndingKind::Stopped).unwrap();
    intake.tick(arrival_ns(&motion, seq));
    *gate.0.lock().unwrap() = false;
    let (written, output) = end_of::<ShutDisk>(&handle);
    let ledger = &written.ledger;
    assert!(ledger.closes() && ledger.finished, "{ledger:?}");
    assert_eq!(ledger.recorded + ledger.lost_ring_full, seq as u64 - 100, "{ledger:?}");
    assert!(ledger.lost_ring_full >= 500, "{ledger:?}");
    let (found, problems) = rows(&output.1);
    assert_eq!((found.len(), problems.len()), (seq - 100, 0), "{problems:?}");
    let summary = Summary::read(&output.1[..]).unwrap();
    assert_eq!((summary.take.problems.as_slice(), summary.contradictions()), (&[][..], &[][..]));
    // The pre-roll can be saved across that loss as well.
    let output = Box::new(ShutDisk::default());
    let take = NewTake { output, ..new_take(&motion, Duration::from_secs(600), seq) };
    feed_all(&mut intake, &motion, seq..seq + 100);
    let saved = armed.takes.save(take).unwrap();
    intake.tick(arrival_ns(&motion, seq + 100));
    let (written, output) = end_of::<ShutDisk>(&saved);
    assert!(written.ledger.closes(), "{:?}", written.ledger);
    let summary = Summary::read(&output.1[..]).unwrap();
    assert_eq!((summary.take.problems.as_slice(), summary.contradictions()), (&[][..], &[][..]));
    drop(intake);
    pipeline.join().unwrap();
}
