//! Windows of takes in a store: the samples are those of the whole take, in few requests for few bytes.

#![expect(clippy::unwrap_used, reason = "a test stops there")]

#[path = "../../take/tests/sweeps/take.rs"]
mod take;

use std::{fs, ops::Range};

use mocapd_store::{ObjectUrl, Store, StoredTake};
use mocapd_take::{TakeEvent, TakeTraversal, motion::Position, traversal::Decode};
use mocapd_testkit::random::Random;

/// A second.
const ROWS: u64 = 60;

struct Stored {
    _folder: tempfile::TempDir,
    url: ObjectUrl,
    bytes: Vec<u8>,
}

impl Stored {
    fn new(bytes: Vec<u8>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("a.take"), &bytes).unwrap();
        let url = format!("file://{}/a.take", folder.path().display());
        Self { _folder: folder, url: ObjectUrl::parse(&url).unwrap(), bytes }
    }

    fn open(&self) -> StoredTake {
        StoredTake::open(&Store::of(&self.url).unwrap().counted_anew(), &self.url).unwrap()
    }

    /// The rows, file range and key of each stretch.
    fn stretches(&self) -> Vec<(Range<u64>, Range<u64>, bool)> {
        let mut found = Vec::new();
        TakeTraversal::new(&self.bytes, Decode::Nothing)
            .run(|event, _| {
                if let TakeEvent::Stretch(stretch) = &event.event {
                    let span = stretch.span;
                    let place = event.offset..event.offset + event.len;
                    found.push((span.first_row..span.end_row(), place, span.key));
                }
                Ok(())
            })
            .unwrap();
        found
    }
}

/// The positions of `rows`, by marker.
fn read(stored: &mut StoredTake, rows: &Range<u64>) -> Vec<Vec<Option<Position>>> {
    let n_channels = stored.map().channels.len();
    let n_rows = (rows.end - rows.start) as usize;
    let mut found = vec![vec![None; n_rows]; n_channels];
    stored
        .read_rows(rows, Decode::All, |take, part, offset| {
            for (channel, decoded) in take.rows().enumerate() {
                let Some(decoded) = decoded else { continue };
                for row in part.clone() {
                    let at = offset + (row - part.start) as usize;
                    let place = &mut found[channel][(row - rows.start) as usize];
                    *place = decoded.present[at].then(|| decoded.positions[at]);
                }
            }
            Ok(())
        })
        .unwrap();
    found
}

#[test]
fn a_window_is_that_of_the_whole_take_in_three_requests_and_twice_its_bytes() {
    for kind in ["dense", "fast", "lossless"] {
        // Larger than a tail, so that windows need requests of their own.
        let take = Stored::new(take::begun(kind, 4000));
        assert!(take.bytes.len() > 200_000, "{kind}: {}", take.bytes.len());
        let stretches = take.stretches();
        let n_rows = take.open().map().n_rows;
        let whole = read(&mut take.open(), &(0..n_rows));
        let mut random = Random::new(26);
        let mut second_ranges = 0;
        for _ in 0..100 {
            let start = random.below((n_rows - ROWS) as usize) as u64;
            let rows = start..start + ROWS;
            let mut opened = take.open();
            let opening = opened.reader().store().traffic();
            assert!(opened.is_from_end() && opening.requests == 1, "{kind}: {opening:?}");
            let window = read(&mut opened, &rows);
            for (channel, positions) in window.iter().enumerate() {
                let of_whole = &whole[channel][rows.start as usize..rows.end as usize];
                assert_eq!(positions, of_whole, "{kind} {rows:?} {channel}");
            }
            let traffic = opened.reader().store().traffic();
            let first = stretches.iter().rposition(|(held, _, key)| *key && held.start <= start);
            let last = stretches.iter().position(|(held, _, _)| held.end >= rows.end).unwrap();
            let needed = stretches[last].1.end - stretches[first.unwrap()].1.start;
            let read = traffic.received_bytes - opening.received_bytes;
            assert!(traffic.requests <= 3, "{kind} {rows:?}: {traffic:?}");
            assert!(read <= 2 * needed, "{kind} {rows:?}: {read} for {needed} bytes");
            second_ranges += u64::from(traffic.requests == 3);
        }
        assert!(second_ranges <= 20, "{kind}: {second_ranges} of 100 windows needed two ranges");
    }
}

#[test]
fn the_last_window_is_in_the_tail() {
    let take = Stored::new(take::take("dense"));
    let mut opened = take.open();
    let n_rows = opened.map().n_rows;
    let last = read(&mut opened, &(n_rows - ROWS..n_rows));
    assert!(last.iter().flatten().any(Option::is_some));
    assert_eq!(opened.reader().store().traffic().requests, 1);
}

#[test]
fn a_take_that_was_cut_off_is_read_as_a_file() {
    let whole = take::begun("dense", 4000);
    let take = Stored::new(whole[..whole.len() / 2].to_vec());
    let mut opened = take.open();
    assert!(!opened.is_from_end() && !opened.map().finished);
    let rows = 600..660;
    let expected = read(&mut Stored::new(whole).open(), &rows);
    assert_eq!(read(&mut opened, &rows), expected);
}

#[test]
fn every_wrong_byte_of_the_end_is_found_or_changes_nothing() {
    let take = Stored::new(take::take("fast"));
    let opened = take.open();
    let expected = opened.map().clone();
    let end = take.stretches().last().unwrap().1.end as usize;
    for at in end..take.bytes.len() {
        let mut bytes = take.bytes.clone();
        bytes[at] ^= 0x41;
        let damaged = Stored::new(bytes).open();
        if damaged.is_from_end() {
            let found = damaged.map();
            assert_eq!((&found.header, &found.keys), (&expected.header, &expected.keys), "{at}");
            assert_eq!((found.n_rows, &found.ledger), (expected.n_rows, &expected.ledger), "{at}");
        }
    }
}
