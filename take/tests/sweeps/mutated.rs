//! Takes whose chunks were cut, changed, repeated, moved, or forged with matching CRCs: all ways of reading one give
//! the same frames and report the same problems.

use std::{collections::BTreeSet, io::Cursor, ops::Range, time::Instant};

use mocapd_take::{
    TakeError, TakeFrames, TakeMap, TakeTraversal,
    chunk::{self, ChunkParse},
    damage::{Problem, Refusal},
    motion::FrameSource,
    recovery::RecoveryScan,
    traversal::Decode,
};

use mocapd_testkit::random::Random;

use crate::{counting::peak_bytes, take};

/// Enough for three keys, a channel that appears late, and an event.
const STRETCHES: usize = 28;

/// Maximum number of rows of a take that is read row by row, and the memory of the compared frames: six copies, of six
/// channels, in vectors that double.
const ROWS_MAX: u64 = 3_000;
const FRAMES_BYTES: usize = 2 * 6 * ROWS_MAX as usize * (24 + 6 * 12);

/// Consecutive frames, as bits; NaN for a gap.
type Frames = Vec<Vec<[u32; 3]>>;

const GAP: [u32; 3] = [f32::NAN.to_bits(); 3];

/// The ranges of its chunks.
fn chunks(take: &[u8]) -> Vec<Range<usize>> {
    let mut at = chunk::MAGIC.len();
    let mut chunks = Vec::new();
    while let ChunkParse::Whole { len, .. } = chunk::parse(&take[at..]) {
        chunks.push(at..at + len);
        at += len;
    }
    chunks
}

/// Mutates a take once.
fn mutate(take: &mut Vec<u8>, random: &mut Random) {
    let chunks = chunks(take);
    if chunks.len() < 3 {
        return;
    }
    // Another test covers the header.
    let some = |random: &mut Random| chunks[1 + random.below(chunks.len() - 1)].clone();
    let chosen = some(random);
    match random.below(7) {
        0 => take.truncate(chosen.start + random.below(chosen.len())),
        1 => take[chosen.start + random.below(chosen.len())] ^= 1 + random.below(255) as u8,
        2 => drop(take.drain(chosen)),
        // Repeat a range of stretches, in place or elsewhere.
        3 | 4 => {
            let end = some(random).end.max(chosen.end);
            let again = take[chosen.start..end].to_vec();
            let at = if random.below(2) == 0 { end } else { some(random).start };
            drop(take.splice(at..at, again));
        }
        5 => {
            let moved: Vec<u8> = take.drain(chosen.clone()).collect();
            let to = some(random).start;
            let to = if to > chosen.start { to - moved.len() } else { to };
            drop(take.splice(to..to, moved));
        }
        // Change the payload and make the CRC match.
        _ => {
            let ChunkParse::Whole { kind, payload, .. } = chunk::parse(&take[chosen.clone()])
            else {
                return;
            };
            let mut payload = payload.to_vec();
            if payload.is_empty() {
                return;
            }
            for _ in 0..=random.below(3) {
                let near = payload.len().min(1 + random.below(400));
                let at = random.below(near);
                payload[at] = random.below(256) as u8;
            }
            let mut forged = Vec::new();
            chunk::put(&mut forged, kind, &payload).unwrap();
            drop(take.splice(chosen, forged));
        }
    }
}

/// The result of one way of reading.
#[derive(Debug, Default, PartialEq)]
struct Read {
    frames: Frames,
    problems: BTreeSet<String>,
    n_samples: usize,
}

impl Read {
    fn add_problems(&mut self, problems: &[Problem]) {
        self.problems.extend(problems.iter().map(ToString::to_string));
    }
}

fn bits(position: [f32; 3]) -> [u32; 3] {
    if position.iter().any(|value| value.is_nan()) { GAP } else { position.map(f32::to_bits) }
}

/// From frame `from` on to the end of the file, one after another.
fn frames(take: &[u8], from: u64) -> Result<(Read, TakeMap), TakeError> {
    let mut source = TakeFrames::open(Cursor::new(take))?;
    source.seek(from)?;
    let mut read = Read::default();
    let mut row = vec![[0.0; 3]; source.info().markers.len()];
    while source.next_frame(&mut row)? {
        read.n_samples += row.iter().filter(|at| !at[0].is_nan()).count();
        read.frames.push(row.iter().copied().map(bits).collect());
    }
    read.add_problems(source.problems());
    Ok((read, source.map().clone()))
}

/// In pieces, alternating between two traversals, like threads.
fn in_pieces(take: &[u8], map: &TakeMap, n: usize) -> Result<Read, TakeError> {
    let mut read = Read::default();
    read.add_problems(&map.problems);
    let n_markers = map.channels.len();
    read.frames = vec![vec![GAP; n_markers]; map.n_rows as usize];
    let new = || TakeTraversal::from_map(Cursor::new(take), map, Decode::All);
    let mut readers = [new()?, new()?];
    for (i, rows) in map.pieces(&(0..map.n_rows), n).into_iter().enumerate() {
        readers[i / 2 % 2].read_rows(&rows, |take, held, offset| {
            for (column, rows) in take.rows().take(n_markers).enumerate() {
                let Some(rows) = rows else { continue };
                for row in held.clone() {
                    let i = offset + (row - held.start) as usize;
                    if rows.present[i] {
                        read.n_samples += 1;
                        read.frames[row as usize][column] = bits(rows.positions[i]);
                    }
                }
            }
            Ok(())
        })?;
    }
    readers.iter().for_each(|reader| read.add_problems(reader.problems()));
    Ok(read)
}

/// In a single pass, like a recovery.
fn whole(take: &[u8]) -> Result<Read, TakeError> {
    let mut read = Read::default();
    let traversal = TakeTraversal::new(take, Decode::All);
    let progress = traversal.run(|found, progress| {
        if let (mocapd_take::TakeEvent::Stretch(stretch), false) = (&found.event, found.is_refused)
            && stretch.span.n_rows > 0
        {
            let span = stretch.span;
            let n_markers = progress.channels().len();
            read.frames.iter_mut().for_each(|row| row.resize(n_markers, GAP));
            read.frames.resize(span.end_row() as usize, vec![GAP; n_markers]);
            for (column, rows) in progress.rows().take(n_markers).enumerate() {
                let Some(rows) = rows else { continue };
                for (i, row) in (span.first_row..span.end_row()).enumerate() {
                    if rows.present[i] {
                        read.n_samples += 1;
                        read.frames[row as usize][column] = bits(rows.positions[i]);
                    }
                }
            }
        }
        Ok(())
    })?;
    let n_markers = progress.take.channels.len();
    read.frames.iter_mut().for_each(|row| row.resize(n_markers, GAP));
    read.frames.resize(progress.take.n_rows as usize, vec![GAP; n_markers]);
    read.add_problems(&progress.take.problems);
    Ok(read)
}

fn check(take: &[u8], random: &mut Random, what: &str) -> Result<(), TakeError> {
    // No way of reading goes through days of lost rows row by row.
    let map = TakeMap::scan(&mut Cursor::new(take))?;
    let scan = RecoveryScan::read(take)?;
    if map.n_rows.max(scan.rows) > ROWS_MAX {
        return Ok(());
    }
    let all = whole(take)?;
    let (read, _) = frames(take, 0)?;
    let labels = |channels: &[mocapd_take::record::Channel]| {
        channels.iter().map(|channel| channel.label.clone()).collect::<Vec<_>>()
    };
    let undecodable = |problem: &Problem| {
        matches!(problem, Problem::Refused { refusal: Refusal::Undecodable(_), .. })
    };
    // Stretches that cannot be decoded may have rows and name channels, which the map counts.
    let is_decodable = !scan.problems.iter().any(undecodable);
    let is_same = map.n_rows == scan.rows && labels(&map.channels) == labels(&scan.channels);
    if !is_same {
        assert!(!is_decodable, "{what}: rows or names");
        return Ok(());
    }
    let same = |problems: &BTreeSet<String>, what: &str| {
        // The least frame of such a stretch differs if the index gave a damaged key stretch.
        let is_bound =
            |text: &&String| text.contains(" or later") || text.contains(" on are missing");
        let more = problems.difference(&all.problems).filter(|problem| !is_bound(problem));
        let more: Vec<_> = more.collect();
        assert!(more.is_empty() || !is_decodable, "{what}: {more:?} beside {:?}", all.problems);
    };
    // Reading may begin at a key that cannot be decoded; its content is still right.
    let agree = |frames: &Frames, from: usize, what: &str| {
        let expected = &all.frames[from.min(all.frames.len())..];
        assert_eq!(frames.len(), expected.len(), "{what}");
        let cells = frames.iter().flatten().zip(expected.iter().flatten());
        let is_same = |found, expected| found == expected || !is_decodable && found == GAP;
        assert!(cells.into_iter().all(|(&a, &b)| is_same(a, b)), "{what}: other frames");
    };
    assert!(read.frames == all.frames, "{what}: frame by frame, other frames");
    if is_decodable {
        assert_eq!(map.damage, scan.damage, "{what}: damage");
        assert_eq!(read.problems, all.problems, "{what}: frame by frame");
    }
    let samples: u64 = scan.per_channel.iter().map(|channel| channel.samples).sum();
    assert_eq!(samples, all.n_samples as u64, "{what}: samples in the scan");

    let n = [3, 100][random.below(2)];
    // Chunk heads alone do not reveal a duplicate, unless both are read.
    let is_twice =
        |problem: &Problem| matches!(problem, Problem::Refused { refusal: Refusal::Twice, .. });
    let by_heads = TakeMap::open(&mut Cursor::new(take))?;
    let is_known = by_heads.n_rows == map.n_rows
        && by_heads.channels == map.channels
        && !scan.problems.iter().any(is_twice);
    if is_known && by_heads.keys != map.keys {
        // The index is wrong, with a matching CRC.
        let pieces = in_pieces(take, &by_heads, n)?;
        let is_reported = !pieces.problems.is_empty();
        assert!(is_reported || pieces.frames == all.frames, "{what}: {n} pieces, no report");
    }
    let by_heads = (is_known && by_heads.keys == map.keys).then_some(&by_heads);
    for map in [Some(&map), by_heads].into_iter().flatten() {
        let pieces = in_pieces(take, map, n)?;
        agree(&pieces.frames, 0, &format!("{what}: in {n} pieces"));
        same(&pieces.problems, &format!("{what}: in {n} pieces"));
    }
    let from = random.below(all.frames.len() + 2);
    let (behind, _) = frames(take, from as u64)?;
    agree(&behind.frames, from, &format!("{what}: from frame {from}"));
    same(&behind.problems, &format!("{what}: from frame {from}"));

    let mut recovered = Vec::new();
    scan.write(Cursor::new(take), &mut recovered, "sweeps")?;
    let (again, _) = frames(&recovered, 0)?;
    assert!(again.problems.is_empty(), "{what}: recovered, {:?}", again.problems);
    assert!(again.frames == all.frames, "{what}: recovered, it is another");
    Ok(())
}

fn mutated(kind: &str, seeds: Range<u64>) {
    let begun = Instant::now();
    let original = take::begun(kind, STRETCHES);
    let whole = peak_bytes(|| check(&original, &mut Random::new(0), kind).unwrap());
    let (n, mut n_read) = (seeds.end - seeds.start, 0);
    for seed in seeds {
        let mut random = Random::new(seed);
        let mut take = original.clone();
        for _ in 0..=random.below(3) {
            mutate(&mut take, &mut random);
        }
        let what = format!("{kind}, seed {seed}");
        let memory = peak_bytes(|| match check(&take, &mut random, &what) {
            Ok(()) => n_read += 1,
            Err(TakeError::NotATake(_) | TakeError::Unsupported { .. }) => {}
            Err(error) => panic!("{what}: {error}"),
        });
        assert!(memory <= 4 * whole + 8 * take.len() + FRAMES_BYTES, "{what}: {memory} bytes");
    }
    println!("{kind}, {n} mutated, {n_read} read, {:.1} s", begun.elapsed().as_secs_f64());
    assert!(n_read > n / 2, "{kind}: {n_read} of {n} were read");
}

#[test]
fn some_mutated() {
    mutated("dense", 0..10);
    mutated("fast", 200..260);
    mutated("lossless", 300..380);
}

#[test]
#[ignore = "minutes: see the command above"]
fn many_mutated() {
    mutated("fast", 1_000..21_000);
    mutated("lossless", 21_000..41_000);
    mutated("dense", 41_000..51_000);
}
