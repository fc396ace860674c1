//! Takes that begin and end while the device runs: with a pre-roll, without, one after another.

use std::{io, time::Duration};

use mocapd_acquire::{
    inspect::Summary,
    pipeline::{Armed, Intake, NewTake, Pipeline, PreRollConfig, TakeHandle, TakeOutput, Written},
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

pub(super) fn arm(motion: &Motion, pre_roll: PreRollConfig) -> (Intake, Pipeline, Armed) {
    let mut config = config(motion, dense(1.0));
    config.pre_roll = Some(pre_roll);
    Pipeline::arm(&config, &header(motion)).unwrap()
}

/// When frame `seq` arrives, as `feed` has it.
pub(super) fn arrival_ns(motion: &Motion, seq: usize) -> u64 {
    5_000_000 + (seq as f64 * 1e9 / motion.info.rate_hz).round() as u64
}

pub(super) fn new_take(motion: &Motion, pre_roll: Duration, seq: usize) -> NewTake {
    let asked_ns = arrival_ns(motion, seq);
    NewTake { pre_roll, asked_ns, ..NewTake::new(Vec::new(), header(motion)) }
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

pub(super) fn ended(begun: &TakeHandle) -> (Written, Vec<u8>) {
    end_of(begun)
}

fn end_of<W: TakeOutput>(begun: &TakeHandle) -> (Written, W) {
    let (written, output) = begun.ended.recv_timeout(Duration::from_secs(60)).unwrap().unwrap();
    (written, output_of(output))
}

/// The take has exactly these frames of `motion`, and says nothing that is not so.
fn assert_has(take: &[u8], motion: &Motion, seqs: impl ExactSizeIterator<Item = usize>) {
    let (found, problems) = rows(take);
    assert!(problems.is_empty(), "{problems:?}");
    assert_eq!(found.len(), seqs.len());
    let same = |&(&got, &wanted): &(&Position, &Position)| {
        is_gap(got) == is_gap(wanted) && (is_gap(got) || distance_mm(got, wanted) <= 1.0)
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
fn takes_begin_and_end_at_the_frame_that_comes_next() {
    let motion = crowd(11, 200.0, 20.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..333);
    for (from, to) in [(333, 500), (900, 1000), (1001, 2777)] {
        let next = intake.next_row() as usize;
        feed_all(&mut intake, &motion, next..from);
        let begun = armed.takes.begin(new_take(&motion, Duration::ZERO, from)).unwrap();
        feed_all(&mut intake, &motion, from..to);
        let first = begun.first.recv_timeout(Duration::from_secs(30)).unwrap();
        assert_eq!(first.arrival_ns, arrival_ns(&motion, from));
        assert_eq!((first.row, first.device_ticks), (from as u64, from as u64 * 5000));
        armed.takes.end(EndingKind::Stopped).unwrap();
        feed_all(&mut intake, &motion, to..=to);
        let (written, take) = ended(&begun);
        assert_has(&take, &motion, from..to);
        assert_eq!(written.file_bytes, take.len() as u64);
    }
    drop(intake);
    pipeline.join().unwrap();
}

#[test]
fn a_take_begins_before_it_was_asked_for_as_far_as_it_is_held() {
    let motion = jump(12, 100.0, 30.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..1203);
    // A key every second, counted from the first frame: the last that is old enough.
    let begun = armed.takes.begin(new_take(&motion, Duration::from_secs(2), 1203)).unwrap();
    feed_all(&mut intake, &motion, 1203..1500);
    let first = begun.first.recv_timeout(Duration::from_secs(30)).unwrap();
    assert!((903..=1003).contains(&first.row), "{first:?}");
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_all(&mut intake, &motion, 1500..1600);
    assert_has(&ended(&begun).1, &motion, first.row as usize..1500);
    // More than is held is what is held.
    let begun = armed.takes.begin(new_take(&motion, Duration::from_secs(600), 1600)).unwrap();
    feed_all(&mut intake, &motion, 1600..1650);
    let first = begun.first.recv_timeout(Duration::from_secs(30)).unwrap();
    assert!((900..1100).contains(&first.row), "{first:?}");
    drop(intake);
    assert_has(&ended(&begun).1, &motion, first.row as usize..1650);
    pipeline.join().unwrap();
}

#[test]
fn what_is_held_is_saved_after_the_fact_while_a_take_goes_on() {
    let motion = jump(13, 100.0, 30.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..800);
    let begun = armed.takes.begin(new_take(&motion, Duration::ZERO, 800)).unwrap();
    feed_all(&mut intake, &motion, 800..1000);
    let saved = armed.takes.save(new_take(&motion, Duration::from_secs(3), 1000)).unwrap();
    feed_all(&mut intake, &motion, 1000..1200);
    let (written, take) = ended(&saved);
    let first = 1000 - written.ledger.recorded as usize;
    assert!((600..=700).contains(&first), "{first}");
    assert_has(&take, &motion, first..1000);
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_all(&mut intake, &motion, 1200..1201);
    assert_has(&ended(&begun).1, &motion, 800..1200);
    drop(intake);
    pipeline.join().unwrap();
}

/// Loss that is not told before the next frame comes belongs to the take that has that frame.
#[test]
fn each_take_has_the_loss_of_its_own_rows() {
    let motion = jump(14, 100.0, 12.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, (0..300).filter(|seq| seq % 50 != 49));
    // Frame 299 is lost, and nobody knows yet.
    let begun = armed.takes.begin(new_take(&motion, Duration::ZERO, 300)).unwrap();
    feed_all(&mut intake, &motion, (300..600).filter(|seq| seq % 100 != 0 && seq % 100 != 99));
    feed_all(&mut intake, &motion, [598, 597]);
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_all(&mut intake, &motion, 601..700);
    let (written, take) = ended(&begun);
    let ledger = &written.ledger;
    // The row 299 was not there when it began; 300 is its first, and lost with it. The last, 599, is the next one's.
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
    let begun = armed.takes.begin(new_take(&motion, Duration::ZERO, 300)).unwrap();
    feed_n(&mut intake, 300..400, 120);
    feed_n(&mut intake, 400..500, 150);
    let rolled = armed.takes.save(new_take(&motion, Duration::from_secs(600), 500)).unwrap();
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_n(&mut intake, 500..501, 150);
    for (take, n_rows) in [(ended(&begun).1, 200), (ended(&rolled).1, 500)] {
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
fn memory_bounds_the_pre_roll_and_a_take_without_a_frame_is_no_error_of_the_pipeline() {
    let motion = jump(16, 100.0, 20.0);
    let small = PreRollConfig { time: Duration::from_secs(600), bytes_max: 15_000 };
    let (mut intake, pipeline, mut armed) = arm(&motion, small);
    feed_all(&mut intake, &motion, 0..1500);
    let begun = armed.takes.begin(new_take(&motion, Duration::from_secs(600), 1500)).unwrap();
    intake.tick(arrival_ns(&motion, 1500));
    armed.takes.end(EndingKind::Stopped).unwrap();
    intake.tick(arrival_ns(&motion, 1501));
    let (written, _) = ended(&begun);
    assert!(written.ledger.recorded < 1400, "{}", written.ledger.recorded);
    let progress = pipeline.progress().clone();
    assert!(progress.held_bytes.load(std::sync::atomic::Ordering::Relaxed) <= 15_000);
    assert!(progress.held_cut.load(std::sync::atomic::Ordering::Relaxed));
    drop(intake);
    pipeline.join().unwrap();
}

/// A disk that fails costs the take that is on it, and the next one is written.
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
    for (room, fails) in [(0, true), (1500, true), (1 << 20, false)] {
        let output = Box::new(Failing(room));
        let take = NewTake { output, ..new_take(&motion, Duration::ZERO, seq) };
        let begun = armed.takes.begin(take).unwrap();
        feed_all(&mut intake, &motion, seq..seq + 500);
        seq += 500;
        armed.takes.end(EndingKind::Stopped).unwrap();
        feed_all(&mut intake, &motion, seq..seq + 1);
        seq += 1;
        let end = begun.ended.recv_timeout(Duration::from_secs(30)).unwrap();
        assert_eq!(end.is_err(), fails, "{room}");
        assert!(!intake.has_failed());
    }
    drop(intake);
    pipeline.join().unwrap();
}

/// A disk that lets nothing through until somebody opens it.
#[derive(Debug, Clone, Default)]
struct Shut(std::sync::Arc<std::sync::Mutex<bool>>, Vec<u8>);

impl io::Write for Shut {
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

impl TakeOutput for Shut {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// What found the rings full after a take's last row is that take's loss, though no row of it followed.
#[test]
fn frames_that_a_stalled_disk_costs_at_a_takes_end_are_on_its_ledger() {
    let motion = jump(18, 1000.0, 80.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..100);
    let gate = Shut::default();
    let output = Box::new(gate.clone());
    let take = NewTake { output, ..new_take(&motion, Duration::ZERO, 100) };
    let begun = armed.takes.begin(take).unwrap();
    feed_all(&mut intake, &motion, 100..300);
    begun.first.recv_timeout(Duration::from_secs(30)).unwrap();
    *gate.0.lock().unwrap() = true;
    // More than buffers and rings hold.
    let mut seq = 300;
    while intake.counts().ring_full < 500 {
        feed(&mut intake, &motion, seq);
        seq += 1;
        if seq % 500 == 0 {
            // The workers get their turn.
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    armed.takes.end(EndingKind::Stopped).unwrap();
    intake.tick(arrival_ns(&motion, seq));
    *gate.0.lock().unwrap() = false;
    let (written, output) = end_of::<Shut>(&begun);
    let ledger = &written.ledger;
    assert!(ledger.closes() && ledger.finished, "{ledger:?}");
    assert_eq!(ledger.recorded + ledger.lost_ring_full, seq as u64 - 100, "{ledger:?}");
    assert!(ledger.lost_ring_full >= 500, "{ledger:?}");
    let (found, problems) = rows(&output.1);
    assert_eq!((found.len(), problems.len()), (seq - 100, 0), "{problems:?}");
    let summary = Summary::read(&output.1[..]).unwrap();
    assert_eq!((summary.take.problems.as_slice(), summary.contradictions()), (&[][..], &[][..]));
    // What is held goes over that, too.
    let output = Box::new(Shut::default());
    let take = NewTake { output, ..new_take(&motion, Duration::from_secs(600), seq) };
    feed_all(&mut intake, &motion, seq..seq + 100);
    let saved = armed.takes.save(take).unwrap();
    intake.tick(arrival_ns(&motion, seq + 100));
    let (written, output) = end_of::<Shut>(&saved);
    assert!(written.ledger.closes(), "{:?}", written.ledger);
    let summary = Summary::read(&output.1[..]).unwrap();
    assert_eq!((summary.take.problems.as_slice(), summary.contradictions()), (&[][..], &[][..]));
    drop(intake);
    pipeline.join().unwrap();
}
