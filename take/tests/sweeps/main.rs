//! A take of a hundred stretches, cut at every byte and changed in every way: no panic, no sample, time or name that
//! differs from the original, every loss is reported, and memory stays in proportion to the file.
//!
//! Each `cargo test` runs a part of the sweep. The complete sweep:
//!
//! ```text
//! cargo test --release -p mocapd-take --test sweeps -- --ignored --nocapture --test-threads 1
//! ```

// The counting allocator implements an unsafe trait.
#![expect(unsafe_code, reason = "GlobalAlloc is an unsafe trait")]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking, and a long one says what it did"
)]

#[path = "../../../codec/tests/allocation/counting.rs"]
mod counting;
mod mutated;
mod repacking;
mod take;
mod text;
mod window;

use std::{io::Cursor, ops::Range, time::Instant};

use mocapd_take::{
    TakeError, TakeEvent, TakeFrames, TakeReader,
    damage::Problem,
    motion::{FrameSource, GAP, Position, is_gap},
    reader::read_events,
    recovery::RecoveryScan,
    timeline::{RowTime, Timeline},
};

use mocapd_testkit::random::Random;

use self::{counting::peak_bytes, take::ONE_KEY};

/// Memory of the DEFLATE decoder, independent of the length: the takes here have a document of a few bytes.
const INFLATER_BYTES: usize = 48 << 10;

/// Rows, times and names read from a take.
struct Whole {
    take: Vec<u8>,
    rows: Vec<Vec<Position>>,
    times: Vec<(u64, RowTime)>,
    labels: Vec<String>,
    /// Memory for reading and decoding it, in bytes.
    memory: usize,
}

/// Reads frame by frame, like an export. `on_row` receives each row with its number.
fn read(
    take: &[u8],
    mut on_row: impl FnMut(usize, &[Position]),
) -> Result<(Vec<String>, Vec<Problem>), TakeError> {
    let mut frames = TakeFrames::open(Cursor::new(take))?;
    let labels: Vec<String> = frames.info().markers.iter().map(|m| m.label.clone()).collect();
    let mut row = vec![GAP; labels.len()];
    let mut at = 0;
    while frames.next_frame(&mut row)? {
        on_row(at, &row);
        at += 1;
    }
    Ok((labels, frames.problems().to_vec()))
}

fn times(take: &[u8]) -> Result<Vec<(u64, RowTime)>, TakeError> {
    let mut times = Vec::new();
    read_events(take, |event| {
        if let TakeEvent::Stretch(stretch) = event {
            times.extend(stretch.timeline.iter().flat_map(Timeline::recorded));
        }
        Ok(())
    })?;
    Ok(times)
}

/// Maximum number of bytes that a reader holds of the take, without its decoders; the take arrives in pieces, as from a
/// disk.
fn reader_memory(take: &[u8]) -> usize {
    peak_bytes(|| {
        let mut reader = TakeReader::new();
        let mut pieces = take.chunks(1 << 12);
        loop {
            match reader.next_event() {
                Ok(Some(TakeEvent::End { .. })) | Err(_) => return,
                Ok(Some(_)) => {}
                Ok(None) => match pieces.next() {
                    Some(piece) => reader.push(piece),
                    None => reader.finish(),
                },
            }
        }
    })
}

impl Whole {
    fn new(kind: &str) -> Self {
        let take = take::take(kind);
        let mut rows = Vec::new();
        let mut read_whole = None;
        let memory = peak_bytes(|| read_whole = Some(read(&take, |_, _| {})));
        let (labels, problems) = read_whole.unwrap().unwrap();
        read(&take, |_, row| rows.push(row.to_vec())).unwrap();
        assert!(problems.is_empty(), "{problems:?}");
        assert_eq!(labels.len(), 6);
        let times = times(&take).unwrap();
        assert_eq!(times.len(), 1200);
        Self { take, rows, times, labels, memory }
    }

    /// Reads a damaged copy; `None` if it is not a take any more.
    fn check(&self, damaged: &[u8], what: &str) -> Option<Read> {
        let mut samples = 0;
        let mut result = None;
        let memory = peak_bytes(|| {
            result = Some(read(damaged, |at, row| {
                let original = self.rows.get(at);
                assert!(original.is_some(), "{what}: row {at} is beyond the end");
                for (column, (&got, &wanted)) in row.iter().zip(&self.rows[at]).enumerate() {
                    let same = got.map(f32::to_bits) == wanted.map(f32::to_bits);
                    assert!(is_gap(got) || same, "{what}: row {at}, channel {column} is wrong");
                    samples += usize::from(!is_gap(got));
                }
            }));
        });
        // The copy of the header in SUMMARY may be inflated while other parts of the take are held.
        assert!(
            memory <= self.memory + 4 * self.take.len() + INFLATER_BYTES,
            "{what}: {memory} bytes, the whole take needs {}",
            self.memory
        );
        let reader_bytes = reader_memory(damaged);
        let reader_bytes_max = 4 * self.take.len() + INFLATER_BYTES;
        assert!(reader_bytes <= reader_bytes_max, "{what}: {reader_bytes} bytes in the reader");
        let (labels, problems) = match result.unwrap() {
            Ok(read) => read,
            Err(TakeError::NotATake(_) | TakeError::Unsupported { .. }) => return None,
            Err(error) => panic!("{what}: {error}"),
        };
        for (i, label) in labels.iter().enumerate() {
            let own = *label == self.labels[i] || *label == format!("u{:03}", i + 1);
            assert!(own, "{what}: channel {i} is called {label}");
        }
        let mut known = self.times.iter();
        for time in times(damaged).unwrap() {
            assert!(known.any(|known| *known == time), "{what}: {time:?} is wrong");
        }
        assert!(damaged == self.take || !problems.is_empty(), "{what}: nothing was reported");
        Some(Read { samples, memory: reader_bytes })
    }

    /// Recovers a damaged copy: the new take has `samples` samples and no problem.
    fn check_recovered(&self, damaged: &[u8], samples: usize, what: &str) {
        let scan = RecoveryScan::read(damaged).unwrap();
        let mut new = Vec::new();
        scan.write(Cursor::new(damaged), &mut new, "sweeps").unwrap();
        let mut recovered = 0;
        let (_, problems) = read(&new, |at, row| {
            for (&got, &wanted) in row.iter().zip(&self.rows[at]) {
                let same = got.map(f32::to_bits) == wanted.map(f32::to_bits);
                assert!(is_gap(got) || same, "{what}: recovered, row {at} is wrong");
                recovered += usize::from(!is_gap(got));
            }
        })
        .unwrap();
        assert!(problems.is_empty(), "{what}: {problems:?}");
        assert_eq!(recovered, samples, "{what}: other samples are recovered than can be read");
        assert!(scan.ledger.closes(), "{what}: {:?}", scan.ledger);
    }
}

struct Read {
    samples: usize,
    memory: usize,
}

/// The results of a sweep.
#[derive(Debug, Default)]
struct Tally {
    tried: usize,
    no_take: usize,
    most_lost: usize,
    most_memory: usize,
}

impl Tally {
    fn add(&mut self, whole: &Whole, damaged: &[u8], recover: bool, what: &str) -> usize {
        self.tried += 1;
        let Some(read) = whole.check(damaged, what) else {
            self.no_take += 1;
            return 0;
        };
        if recover {
            whole.check_recovered(damaged, read.samples, what);
        }
        self.most_memory = self.most_memory.max(read.memory);
        let all = whole.rows.iter().flatten().filter(|position| !is_gap(**position)).count();
        self.most_lost = self.most_lost.max(all - read.samples);
        read.samples
    }

    fn print(&self, whole: &Whole, what: &str, begun: Instant) {
        println!(
            "{what}: {} tried, {} no take any more, at most {} samples of {} lost, reader at most {:.2} times the \
             file's {} bytes, {:.0} s",
            self.tried,
            self.no_take,
            self.most_lost,
            whole.rows.iter().flatten().filter(|position| !is_gap(**position)).count(),
            self.most_memory as f64 / whole.take.len() as f64,
            whole.take.len(),
            begun.elapsed().as_secs_f64()
        );
    }
}

fn truncations(kind: &str, step: usize) {
    let begun = Instant::now();
    let whole = Whole::new(kind);
    let mut tally = Tally::default();
    let mut before = 0;
    for cut in (0..whole.take.len()).step_by(step) {
        let recover = cut % (step * 16) == 0 && cut > 400;
        let what = format!("{kind}, cut at {cut}");
        let samples = tally.add(&whole, &whole.take[..cut], recover, &what);
        assert!(samples >= before, "{what}: {samples} samples after {before}");
        before = samples;
    }
    tally.print(&whole, &format!("{kind}, cut at every {step} bytes"), begun);
}

fn mutations(kind: &str, seeds: Range<u64>) {
    let begun = Instant::now();
    let whole = Whole::new(kind);
    let mut tally = Tally::default();
    let n = seeds.end - seeds.start;
    for seed in seeds {
        let mut random = Random::new(seed);
        let at = random.below(whole.take.len());
        let by = 1 + random.below(255) as u8;
        let mut damaged = whole.take.clone();
        damaged[at] ^= by;
        let what = format!("{kind}, seed {seed}: byte {at} changed by {by}");
        tally.add(&whole, &damaged, seed % 16 == 0 && at > 400, &what);
    }
    // From one key stretch to the next, of six channels: the most that a damaged stretch can cost.
    assert!(kind.ends_with(ONE_KEY) || tally.most_lost <= 10 * 12 * 6, "{tally:?}");
    tally.print(&whole, &format!("{kind}, {n} bytes changed"), begun);
}

fn ranges(kind: &str, seeds: Range<u64>) {
    let begun = Instant::now();
    let whole = Whole::new(kind);
    let mut tally = Tally::default();
    let n = seeds.end - seeds.start;
    for seed in seeds {
        let mut random = Random::new(seed);
        let from = 400 + random.below(whole.take.len() - 400);
        let to = (from + 1 + random.below(3000)).min(whole.take.len());
        let mut damaged = whole.take.clone();
        match seed % 3 {
            0 => damaged[from..to].fill(0),
            1 => damaged[from..to].fill_with(|| random.byte()),
            _ => drop(damaged.drain(from..to)),
        }
        let what = format!("{kind}, seed {seed}: {from}..{to} zeroed, noise, or gone");
        tally.add(&whole, &damaged, seed % 4 == 0, &what);
    }
    tally.print(&whole, &format!("{kind}, {n} ranges"), begun);
}

#[test]
fn some_truncations() {
    truncations("dense", 53);
    truncations("lossless", 499);
    truncations("dense, one key", 211);
}

#[test]
fn some_bytes_changed() {
    mutations("dense", 0..250);
    mutations("fast", 0..60);
    mutations("dense, one key", 0..60);
}

#[test]
fn some_ranges_damaged() {
    ranges("dense", 0..120);
    ranges("lossless", 0..30);
    ranges("dense, one key", 0..30);
}

#[test]
#[ignore = "minutes: see the command above"]
fn all_truncations() {
    truncations("dense", 1);
    truncations("fast", 1);
}

#[test]
#[ignore = "minutes: see the command above"]
fn a_hundred_thousand_bytes_changed() {
    mutations("dense", 0..80_000);
    mutations("fast", 80_000..90_000);
    mutations("lossless", 90_000..100_000);
    mutations("dense, one key", 0..10_000);
}

#[test]
#[ignore = "minutes: see the command above"]
fn twenty_thousand_ranges_damaged() {
    ranges("dense", 0..16_000);
    ranges("lossless", 16_000..20_000);
}
