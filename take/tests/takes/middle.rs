//! A take read from the middle equals the take read from its start, and only the requested rows are read and decoded.

use std::{
    cell::Cell,
    io::{Cursor, Read, Seek, SeekFrom},
    rc::Rc,
};

use mocapd_take::{
    TakeFrames, TakeMap, TakeTraversal,
    damage::{Problem, Refusal},
    motion::{FrameSource, GAP, Position},
    traversal::Decode,
};

/// All frames from `row` on.
fn frames(take: &[u8], row: u64) -> Vec<Vec<[u32; 3]>> {
    let mut frames = TakeFrames::open(Cursor::new(take)).unwrap();
    frames.seek(row).unwrap();
    let mut positions: Vec<Position> = vec![GAP; frames.info().markers.len()];
    let mut all = Vec::new();
    while frames.next_frame(&mut positions).unwrap() {
        all.push(positions.iter().map(|position| position.map(f32::to_bits)).collect());
    }
    all
}

fn scanned(take: &[u8]) -> TakeMap {
    TakeMap::scan(&mut Cursor::new(take)).unwrap()
}

/// The offsets of all chunks, and of the end.
fn chunks(take: &[u8]) -> Vec<usize> {
    let mut at = vec![8];
    while let mocapd_take::chunk::ChunkParse::Whole { len, .. } =
        mocapd_take::chunk::parse(&take[at[at.len() - 1]..])
    {
        at.push(at[at.len() - 1] + len);
    }
    assert_eq!(at.last(), Some(&take.len()));
    at
}

#[test]
fn frames_from_any_row_on_are_those_from_the_start() {
    for kind in ["dense", "fast", "lossless", "lossless:predictive"] {
        let take = crate::take::take(kind);
        let all = frames(&take, 0);
        assert!(all.len() > 1200, "{} frames", all.len());
        for row in (0..all.len() + 3).step_by(37).chain([1, all.len() - 1, all.len()]) {
            assert_eq!(frames(&take, row as u64), all[row.min(all.len())..], "{kind}, row {row}");
        }
    }
}

#[test]
fn damage_before_the_row_costs_nothing_after_the_next_key() {
    let whole = crate::take::take("dense");
    let all = frames(&whole, 0);
    let mut hurt = whole.clone();
    let key = scanned(&whole).keys[3];
    hurt[key.offset as usize + 40] ^= 1;
    let next = scanned(&whole).keys[4].first_row;
    assert_eq!(frames(&hurt, next), all[next as usize..]);
    // Within the damage, the rows are gaps and a problem is reported.
    let mut source = TakeFrames::open(Cursor::new(&hurt[..])).unwrap();
    source.seek(key.first_row + 20).unwrap();
    let mut row = vec![[0.0; 3]; source.info().markers.len()];
    assert!(source.next_frame(&mut row).unwrap());
    assert!(row.iter().flatten().all(|value| value.is_nan()) && source.is_lost());
    let depends = |problem: &Problem| {
        matches!(
            problem,
            Problem::Unplaced { .. } | Problem::Refused { refusal: Refusal::DependsOnLost, .. }
        )
    };
    assert!(source.problems().iter().any(depends), "{:?}", source.problems());
}

#[test]
fn the_map_from_heads_equals_the_map_from_chunks() {
    let take = crate::take::take("dense");
    let quick = TakeMap::open(&mut Cursor::new(&take)).unwrap();
    let slow = scanned(&take);
    assert_eq!((quick.n_sampled_rows, slow.n_sampled_rows.is_some()), (None, true));
    assert!(quick.finished && quick.keys.len() == 10 && quick.events.len() == 5);
    assert_eq!(quick.channels.len(), 6);
    // The length of stretches is unknown, because they were not read.
    assert_eq!(quick, TakeMap { n_sampled_rows: None, longest_stretch: None, ..slow });
}

#[test]
fn truncated_and_damaged_takes_are_scanned() {
    let take = crate::take::take("fast");
    let chunks = chunks(&take);
    for &end in &chunks[2..] {
        for cut in [end - 3, end] {
            let quick = TakeMap::open(&mut Cursor::new(&take[..cut])).unwrap();
            if cut < take.len() {
                assert!(!quick.finished && quick.n_sampled_rows.is_some(), "cut at {cut}");
                assert_eq!(quick, scanned(&take[..cut]), "cut at {cut}");
            }
        }
    }
    // A wrong byte in a chunk head, or in a chunk other than a stretch, shows at once; the header is indispensable.
    for pair in chunks[1..].windows(2) {
        for at in [pair[0], pair[0] + 1, pair[1] - 1] {
            let mut hurt = take.clone();
            hurt[at] ^= 0x15;
            let quick = TakeMap::open(&mut Cursor::new(&hurt)).unwrap();
            if at < pair[1] - 1 || take[pair[0]] != mocapd_take::chunk::types::STRETCH {
                assert_eq!(quick, scanned(&hurt), "byte {at}");
            }
        }
    }
    for cut in 0..chunks[1] {
        assert!(TakeMap::open(&mut Cursor::new(&take[..cut])).is_err(), "cut at {cut}");
    }
}

#[test]
fn damage_skipped_by_opening_is_reported_when_it_is_read() {
    let whole = crate::take::take("fast");
    let last = *scanned(&whole).keys.last().unwrap();
    for key in [scanned(&whole).keys[2], last] {
        let mut hurt = whole.clone();
        hurt[key.offset as usize + 40] ^= 1;
        let map = TakeMap::open(&mut Cursor::new(&hurt)).unwrap();
        assert!(map.problems.is_empty() && map.n_sampled_rows.is_none());
        let mut stretches = TakeTraversal::from_map(Cursor::new(&hurt), &map, Decode::All).unwrap();
        stretches.seek(key.first_row).unwrap();
        while stretches.next_stretch().unwrap().is_some() {}
        let problems = stretches.problems();
        let damaged = |problem: &Problem| matches!(problem, Problem::Damaged { offset, .. } if *offset == key.offset);
        assert!(problems.iter().any(damaged), "{problems:?}");
    }
}

#[test]
fn only_requested_groups_have_rows() {
    let bytes =
        std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/v6/dense-1mm.mtake"))
            .unwrap();
    let map = TakeMap::open(&mut Cursor::new(&bytes)).unwrap();
    assert!(map.channels.len() > 64);
    let mut all = TakeTraversal::from_map(Cursor::new(&bytes), &map, Decode::All).unwrap();
    let groups = Decode::Groups(vec![1]);
    let mut second = TakeTraversal::from_map(Cursor::new(&bytes), &map, groups).unwrap();
    let mut with_samples = 0;
    while let Some(span) = all.next_stretch().unwrap() {
        assert_eq!(second.next_stretch().unwrap(), Some(span));
        if span.n_rows == 0 {
            continue;
        }
        let late: Vec<_> = all.rows().skip(64).map(Option::<&_>::cloned).collect();
        let rows: Vec<_> = second.rows().map(Option::<&_>::cloned).collect();
        assert!(rows.iter().take(64).all(Option::is_none));
        assert_eq!(rows.get(64..).unwrap_or_default(), late);
        with_samples += late.iter().flatten().filter(|rows| rows.has_samples()).count();
    }
    assert!(with_samples > 0 && second.problems().is_empty());
}

/// Counts the bytes that are read.
struct Counting<R>(R, Rc<Cell<usize>>);

impl<R: Read> Read for Counting<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let n = self.0.read(buffer)?;
        self.1.set(self.1.get() + n);
        Ok(n)
    }
}

impl<R: Seek> Seek for Counting<R> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.0.seek(to)
    }
}

#[test]
fn nothing_before_the_key_is_read() {
    let take = crate::take::take("lossless");
    let read = Rc::new(Cell::new(0));
    let mut input = Counting(Cursor::new(&take), Rc::clone(&read));
    let map = TakeMap::open(&mut input).unwrap();
    let mut stretches = TakeTraversal::from_map(input, &map, Decode::All).unwrap();
    read.set(0);
    let key = map.keys[9];
    stretches.seek(map.n_rows - 1).unwrap();
    assert_eq!(stretches.next_stretch().unwrap().map(|span| span.first_row), Some(key.first_row));
    while stretches.next_stretch().unwrap().is_some() {}
    assert_eq!(read.get(), take.len() - key.offset as usize);
    assert!(stretches.problems().is_empty());
    // Seeking back is not possible.
    stretches.seek(0).unwrap();
    assert_eq!(stretches.next_stretch().unwrap(), None);
}
