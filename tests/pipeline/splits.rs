//! Recordings that are divided into takes: every frame is in exactly one of them, and each is complete by itself.

use std::{
    io::{self, Write},
    sync::{Arc, Mutex},
    time::Duration,
};

use anyhow::bail;
use crossbeam_channel::{Receiver, Sender, bounded, unbounded};
use mocapd_acquire::{
    inspect::Summary,
    pipeline::{
        Intake, NewTake, NextTake, NothingRecorded, Pipeline, PipelineConfig, Split, SplitAt,
        TakeAccount, TakeFailed, TakeOutput, TakeResult, TakeSeries,
    },
};
use mocapd_take::{
    motion::{Motion, is_gap},
    record::{EndingKind, Event, EventKind, Header},
    timeline::Timeline,
};

use super::takes::{arrival_ns, feed_all, header};
use crate::support::{
    chunks, config, crowd, dense, distance_mm, feed, feed_samples, jump, lossless, output_of, rows,
    samples,
};

/// A take in memory, whose disk can be shut, and can fail from a number of writes on.
#[derive(Debug, Clone, Default)]
struct Disk {
    bytes: Vec<u8>,
    is_shut: Arc<Mutex<bool>>,
    writes_left: Option<usize>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        while *self.is_shut.lock().unwrap() {
            std::thread::sleep(Duration::from_millis(5));
        }
        if let Some(left) = &mut self.writes_left {
            *left = left.checked_sub(1).ok_or(io::ErrorKind::StorageFull)?;
        }
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for Disk {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

type Started = (u64, Receiver<TakeResult>);

/// Creates takes in memory: one for each disk, and then `None`, which is an error.
struct Takes {
    header: Header,
    n_created: usize,
    disk: Box<dyn FnMut(usize) -> Option<Disk> + Send>,
    started: Sender<Started>,
}

impl TakeSeries for Takes {
    fn next_take(&mut self, first_row: u64) -> anyhow::Result<NextTake> {
        let number = self.n_created;
        let Some(disk) = (self.disk)(number) else { bail!("no place for take {number}") };
        self.n_created += 1;
        let (ended, result) = bounded(1);
        self.started.send((first_row, result)).unwrap();
        let name = format!("number {number}");
        Ok(NextTake { take: NewTake::new(disk, self.header.clone()), name, ended, notice: None })
    }
}

/// A recording that is being divided.
struct Divided {
    pipeline: Pipeline,
    started: Receiver<Started>,
}

fn divide(
    motion: &Motion,
    config: &PipelineConfig,
    at: SplitAt,
    disk: impl FnMut(usize) -> Option<Disk> + Send + 'static,
) -> (Intake, Divided) {
    let (started_in, started) = unbounded();
    let mut header = header(motion);
    header.set_codec(&config.codec);
    header.channels.clone_from(&config.channels);
    let takes = Takes { header, n_created: 0, disk: Box::new(disk), started: started_in };
    let split = Split { at, takes: Box::new(takes) };
    let (intake, pipeline) = Pipeline::start_series(config, split).unwrap();
    (intake, Divided { pipeline, started })
}

fn in_memory(_: usize) -> Option<Disk> {
    Some(Disk::default())
}

/// First row, account and bytes of a take.
type Take = (u64, TakeAccount, Vec<u8>);

/// First row and result of a take.
type Ended = (u64, Result<(TakeAccount, Vec<u8>), TakeFailed>);

impl Divided {
    fn results(self) -> Vec<Ended> {
        self.pipeline.join().unwrap();
        let bytes = |(written, output)| (written, output_of::<Disk>(output).bytes);
        let result = |(first_row, result): Started| {
            (first_row, result.try_recv().expect("every take has a result").map(bytes))
        };
        self.started.iter().map(result).collect()
    }

    fn finish(self) -> Vec<Take> {
        let take = |(first_row, result): Ended| {
            let (written, bytes) = result.unwrap();
            (first_row, written, bytes)
        };
        self.results().into_iter().map(take).collect()
    }
}

/// The takes of a recording that is divided every `rows` rows.
pub(super) fn record_parts(
    (motion, config): (&Motion, &PipelineConfig),
    rows: u64,
    feed: impl FnOnce(&mut Intake),
) -> Vec<Vec<u8>> {
    let (mut intake, divided) = divide(motion, config, rows_at(rows), in_memory);
    feed(&mut intake);
    intake.finish();
    divided.finish().into_iter().map(|(_, _, bytes)| bytes).collect()
}

fn rows_at(rows: u64) -> SplitAt {
    SplitAt::Rows { rows, end_row: None }
}

/// Asserts that the takes follow each other, that each is complete and states nothing false, and that together they have
/// exactly the frames `seqs` of `motion`, each at its row.
fn assert_divided(takes: &[Take], motion: &Motion, seqs: impl IntoIterator<Item = usize>) {
    let mut seqs = seqs.into_iter().peekable();
    let mut next_row = 0;
    for (index, (first_row, written, bytes)) in takes.iter().enumerate() {
        assert_eq!(*first_row, next_row, "take {index} begins where the one before ended");
        let summary = Summary::read(&bytes[..]).unwrap();
        let problems = summary.take.problems.as_slice();
        assert_eq!((problems, summary.contradictions()), (&[][..], &[][..]), "take {index}");
        let ledger = summary.take.ledger.unwrap();
        assert!(ledger.finished && ledger.closes(), "take {index}: {ledger:?}");
        assert_eq!(ledger, written.ledger);
        assert!(ledger.recorded > 0, "take {index} has no frame");
        let found = chunks(bytes);
        assert!(found.finished);
        assert!(found.keys[0].1, "take {index} does not begin with a key");
        let last = index + 1 == takes.len();
        let kind = if last { EndingKind::Stopped } else { EndingKind::Length };
        assert_eq!(written.ending.kind, kind);
        let names_next = written.ending.detail.contains(&format!("number {}", index + 1));
        assert_eq!(names_next, !last, "{}", written.ending.detail);

        let (rows, problems) = rows(bytes);
        assert!(problems.is_empty(), "{problems:?}");
        assert_eq!(rows.len() as u64, ledger.frames_sent, "take {index}");
        let times = found.timelines.iter().flat_map(Timeline::recorded);
        for (row, time) in times {
            let seq = seqs.next().expect("no more frames than were sent");
            assert_eq!(first_row + row, seq as u64, "take {index}");
            let ticks = (seq as f64 * 1e6 / motion.info.rate_hz).round() as u64;
            assert_eq!(time.device_ticks, ticks, "frame {seq}");
            for (&got, &expected) in rows[row as usize].iter().zip(motion.frame(seq)) {
                assert_eq!(is_gap(got), is_gap(expected), "frame {seq}");
                assert!(is_gap(got) || distance_mm(got, expected) <= 1.0, "frame {seq}");
            }
        }
        next_row += ledger.frames_sent;
    }
    assert_eq!(seqs.next(), None, "a frame is missing");
}

fn first_rows(takes: &[Take]) -> Vec<u64> {
    takes.iter().map(|take| take.0).collect()
}

#[test]
fn takes_have_exactly_their_rows_and_every_frame_is_in_one() {
    let motion = crowd(41, 1000.0, 7.3);
    for workers in [1, 3] {
        let config = PipelineConfig { workers, ..config(&motion, dense(1.0)) };
        let (mut intake, divided) = divide(&motion, &config, rows_at(2000), in_memory);
        feed_all(&mut intake, &motion, 0..7300);
        drop(intake);
        let takes = divided.finish();
        assert_eq!(first_rows(&takes), [0, 2000, 4000, 6000]);
        assert_divided(&takes, &motion, 0..7300);
        // The first stretch is short, as that of any take.
        assert!(takes.iter().all(|take| chunks(&take.2).keys[1].0 == 100));
    }
}

#[test]
fn a_recording_that_ends_at_a_seam_has_no_empty_take() {
    let motion = jump(42, 200.0, 6.0);
    let (mut intake, divided) =
        divide(&motion, &config(&motion, dense(1.0)), rows_at(400), in_memory);
    feed_all(&mut intake, &motion, 0..1200);
    // Ctrl-C comes before the next frame.
    intake.tick(arrival_ns(&motion, 1200));
    drop(intake);
    let takes = divided.finish();
    assert_eq!(first_rows(&takes), [0, 400, 800]);
    assert_divided(&takes, &motion, 0..1200);
}

#[test]
fn frames_after_the_end_of_the_recording_belong_to_the_last_take() {
    let motion = jump(43, 200.0, 6.0);
    let at = SplitAt::Rows { rows: 400, end_row: Some(800) };
    let (mut intake, divided) = divide(&motion, &config(&motion, dense(1.0)), at, in_memory);
    feed_all(&mut intake, &motion, 0..830);
    drop(intake);
    let takes = divided.finish();
    assert_eq!(first_rows(&takes), [0, 400]);
    assert_divided(&takes, &motion, 0..830);
}

#[test]
fn lost_rows_belong_to_the_take_that_has_their_place() {
    let motion = jump(44, 100.0, 82.0);
    let (mut intake, divided) =
        divide(&motion, &config(&motion, dense(1.0)), rows_at(1000), in_memory);
    let event =
        |intake: &mut Intake, text: &str| intake.event(Event::new(EventKind::Mark, 1, text));
    // Lost on the link across the first seam, and up to the second.
    let sent = |seq: &usize| !(995..1007).contains(seq) && !(1998..2000).contains(seq);
    feed_all(&mut intake, &motion, (0..2000).filter(sent));
    event(&mut intake, "before row 1998 is known to be lost");
    feed_all(&mut intake, &motion, 2000..3000);
    event(&mut intake, "at the third seam");
    feed_all(&mut intake, &motion, 3000..3456);
    // Away across a seam, and then across three.
    for (from, to) in [(3456, 4010), (4100, 7300)] {
        let next = intake.next_row() as usize;
        feed_all(&mut intake, &motion, next..from);
        intake.set_away(true);
        intake.set_away(false);
        intake.rejoin();
        feed_all(&mut intake, &motion, to..to + 50);
    }
    feed_all(&mut intake, &motion, 7350..8100);
    let counts = intake.finish();
    let takes = divided.finish();
    // Every take has a frame: the one that begins during the long absence continues after it.
    assert_eq!(first_rows(&takes), [0, 1000, 2000, 3000, 4000, 5000, 8000]);
    let gaps = [3456..4010, 4100..7300];
    let recorded = (0..8100).filter(sent).filter(|seq| !gaps.iter().any(|gap| gap.contains(seq)));
    assert_divided(&takes, &motion, recorded);
    let lost = |index: usize| {
        let ledger = &takes[index].1.ledger;
        (ledger.lost_on_link, ledger.unknown_after_disconnect)
    };
    let found: Vec<_> = (0..takes.len()).map(lost).collect();
    let expected = [(5, 0), (7 + 2, 0), (0, 0), (0, 544), (0, 10 + 900), (0, 2300), (0, 0)];
    assert_eq!(found, expected);
    let sum = |of: fn(&TakeAccount) -> u64| takes.iter().map(|take| of(&take.1)).sum::<u64>();
    assert_eq!(sum(|written| written.ledger.frames_sent), counts.seen());
    assert_eq!(sum(|written| written.ledger.recorded), counts.recorded);

    let events = |index: usize| Summary::read(&takes[index].2[..]).unwrap().take.events;
    let rows = |index| events(index).iter().map(|event| event.row).collect::<Vec<_>>();
    assert_eq!(rows(1), [998], "the row of the next frame as it was known");
    assert_eq!(rows(3), [0], "the mark at the seam");
    assert!(rows(2).is_empty() && rows(0).is_empty());
    // Each return is in the take with the first frame after it.
    assert_eq!((rows(4), rows(5)), (vec![10], vec![2300]));
}

#[test]
fn a_take_ends_at_the_first_end_of_a_stretch_that_makes_it_large_enough() {
    const LIMIT: u64 = 200_000;
    let motion = crowd(45, 200.0, 10.0);
    let config = config(&motion, lossless());
    let at = SplitAt::Bytes(LIMIT);
    let (mut intake, divided) = divide(&motion, &config, at, in_memory);
    for seq in 0..2000 {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(&mut intake, &motion, seq);
        // Pauses, so that the writer can update the length of the take.
        if seq.is_multiple_of(20) {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    drop(intake);
    let takes = divided.finish();
    assert!(takes.len() >= 4, "{:?}", first_rows(&takes));
    assert_divided(&takes, &motion, 0..2000);
    let (_, whole) = takes.split_last().unwrap();
    for (first_row, written, bytes) in whole {
        assert_eq!(written.file_bytes, bytes.len() as u64);
        assert!(written.file_bytes >= LIMIT, "from row {first_row}: {}", written.file_bytes);
        // Plus the stretches in progress by then: 100 rows of 150 markers take 180 kB.
        assert!(written.file_bytes < LIMIT + 1_500_000, "{}", written.file_bytes);
    }
}

#[test]
fn a_disk_that_stalls_at_a_seam_costs_no_frame() {
    let motion = jump(46, 1000.0, 20.0);
    let is_shut = Arc::new(Mutex::new(false));
    let shut = Arc::clone(&is_shut);
    let disk = move |_| Some(Disk { is_shut: Arc::clone(&shut), ..Disk::default() });
    let (mut intake, divided) = divide(&motion, &config(&motion, dense(1.0)), rows_at(1000), disk);
    feed_all(&mut intake, &motion, 0..950);
    *is_shut.lock().unwrap() = true;
    // Twelve seams while nothing is written. With takes so short, a second has four stretches and boundaries, and 64
    // of them fit into memory.
    feed_all(&mut intake, &motion, 950..13_000);
    assert_eq!(intake.counts().ring_full, 0);
    *is_shut.lock().unwrap() = false;
    feed_all(&mut intake, &motion, 13_000..20_000);
    drop(intake);
    let takes = divided.finish();
    assert_eq!(takes.len(), 20);
    assert_divided(&takes, &motion, 0..20_000);
}

/// More than buffers and rings hold: the ledgers have every frame once, and still close.
#[test]
fn frames_that_a_long_stall_costs_are_on_one_ledger_each() {
    let motion = jump(47, 1000.0, 80.0);
    let is_shut = Arc::new(Mutex::new(false));
    let shut = Arc::clone(&is_shut);
    let disk = move |_| Some(Disk { is_shut: Arc::clone(&shut), ..Disk::default() });
    let (mut intake, divided) = divide(&motion, &config(&motion, dense(1.0)), rows_at(3000), disk);
    feed_all(&mut intake, &motion, 0..300);
    *is_shut.lock().unwrap() = true;
    let mut seq = 300;
    while intake.counts().ring_full < 5000 {
        feed(&mut intake, &motion, seq);
        seq += 1;
        if seq % 500 == 0 {
            // Let the workers run.
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    *is_shut.lock().unwrap() = false;
    std::thread::sleep(Duration::from_millis(500));
    feed_all(&mut intake, &motion, seq..seq + 2000);
    let counts = intake.finish();
    let takes = divided.finish();
    let recorded: Vec<usize> = takes
        .iter()
        .flat_map(|(first_row, _, bytes)| {
            let times = chunks(bytes).timelines;
            let rows: Vec<_> = times.iter().flat_map(Timeline::recorded).map(|row| row.0).collect();
            rows.into_iter().map(move |row| (first_row + row) as usize)
        })
        .collect();
    assert!(first_rows(&takes).iter().all(|row| row.is_multiple_of(3000)));
    assert_divided(&takes, &motion, recorded.iter().copied());
    let lost: u64 = takes.iter().map(|take| take.1.ledger.lost_ring_full).sum();
    assert!(lost >= 5000 && lost == counts.ring_full, "{lost} of {}", counts.ring_full);
    assert_eq!(recorded.len() as u64 + lost, seq as u64 + 2000);
}

#[test]
fn a_take_continues_when_the_next_cannot_begin() {
    let motion = jump(48, 100.0, 10.0);
    // The second cannot be created at first; the header of the third cannot be written.
    let mut refusals = 2;
    let disk = move |number| match number {
        1 if refusals > 0 => {
            refusals -= 1;
            None
        }
        2 => Some(Disk { writes_left: Some(0), ..Disk::default() }),
        _ => in_memory(number),
    };
    let (mut intake, divided) = divide(&motion, &config(&motion, dense(1.0)), rows_at(150), disk);
    feed_all(&mut intake, &motion, 0..1000);
    let progress = Arc::clone(divided.pipeline.progress());
    drop(intake);
    let mut results = divided.results();
    assert_eq!(results.len(), 5);
    let (first_row, failed) = results.remove(2);
    assert_eq!(first_row, 600);
    assert!(failed.unwrap_err().error.is::<NothingRecorded>());
    let takes: Vec<Take> = results
        .into_iter()
        .map(|(first_row, result)| {
            let (written, bytes) = result.unwrap();
            (first_row, written, bytes)
        })
        .collect();
    assert_eq!(first_rows(&takes), [0, 450, 750, 900]);
    let lengths: Vec<_> = takes.iter().map(|take| rows(&take.2).0.len()).collect();
    assert_eq!(lengths, [450, 300, 150, 100]);
    let notices = progress.take_notices();
    assert_eq!(notices.len(), 3, "{notices:?}");
    assert!(notices[0].contains("no place for take 1"), "{notices:?}");
    assert!(notices[2].contains("number 2"), "{notices:?}");
    assert!(progress.take_notices().is_empty());
}

#[test]
fn a_disk_that_fails_ends_the_recording_and_leaves_the_takes_before() {
    let motion = jump(49, 100.0, 10.0);
    let config = PipelineConfig { sync_every: Duration::ZERO, ..config(&motion, dense(1.0)) };
    // Between two stretches, or at the end of a take: no take begins after the failure.
    let mut n_failed_at_the_end = 0;
    for writes in 1..20 {
        let disk = move |number| {
            let writes_left = (number == 1).then_some(writes);
            Some(Disk { writes_left, ..Disk::default() })
        };
        let (mut intake, divided) = divide(&motion, &config, rows_at(300), disk);
        feed_all(&mut intake, &motion, 0..1000);
        let has_failed = intake.has_failed();
        drop(intake);
        let mut results = divided.results().into_iter();
        let (first_row, first) = results.next().unwrap();
        assert_eq!((first_row, first.unwrap().0.ledger.recorded), (0, 300));
        let (first_row, second) = results.next().unwrap();
        assert_eq!(first_row, 300);
        let Err(failed) = second else {
            assert!(!has_failed, "{writes} writes");
            continue;
        };
        if let Some((_, third)) = results.next() {
            // The second could not be closed.
            assert!(third.unwrap_err().error.is::<NothingRecorded>(), "{writes} writes");
            assert!(!failed.error.is::<NothingRecorded>());
            n_failed_at_the_end += 1;
        }
        assert!(results.next().is_none(), "{writes} writes");
    }
    assert!(n_failed_at_the_end > 0);
}

#[test]
fn a_marker_that_appears_at_a_seam_is_in_the_table_of_the_next_take() {
    let motion = crowd(50, 100.0, 6.0);
    let mut config = config(&motion, dense(1.0));
    config.channels.truncate(100);
    for fails in [false, true] {
        let disk = move |number| if fails && number == 1 { None } else { in_memory(number) };
        let (mut intake, divided) = divide(&motion, &config, rows_at(200), disk);
        for seq in 0..390 {
            while intake.is_full() {
                std::thread::yield_now();
            }
            let n = if seq < 200 { 100 } else { 130 };
            feed_samples(&mut intake, 100.0, seq, &samples(motion.frame(seq))[..n]);
        }
        drop(intake);
        let takes = divided.finish();
        let labels: Vec<_> = takes.iter().map(|take| chunks(&take.2).labels.len()).collect();
        if fails {
            assert_eq!(labels, [130]);
            assert_eq!(takes[0].1.ledger.recorded, 390);
        } else {
            assert_eq!(labels, [100, 130]);
        }
        for (_, written, bytes) in &takes {
            assert!(written.ledger.closes(), "{:?}", written.ledger);
            let summary = Summary::read(&bytes[..]).unwrap();
            let problems = summary.take.problems.as_slice();
            assert_eq!((problems, summary.contradictions()), (&[][..], &[][..]));
        }
    }
}
