//! Takes that are cut off, damaged, or written by a newer version: everything readable is read,
//! everything missing is reported, and no wrong sample is returned.

use mocapd_take::{
    NotATake, TakeError, TakeEvent, TakeFrames, TakeReader, chunk,
    damage::{Problem, Refusal},
    motion::{Motion, Position, is_gap},
    record::{Header, Record},
};
use mocapd_testkit::random::Random;

use crate::support::{assert_mentions, config, dense, distance_mm, jump, places, record, rows};

const TOLERANCE_MM: f64 = 0.5;

fn take() -> (Motion, Vec<u8>) {
    let motion = jump(1, 60.0, 12.0);
    // Some loss, so that the time line has runs of lost rows.
    let frames = (0..motion.n_frames()).filter(|seq| seq % 97 != 50);
    let (_, take, _) = record(&motion, &config(&motion, dense(TOLERANCE_MM)), frames);
    (motion, take)
}

/// Asserts that every sample present is correct.
fn assert_right(rows: &[Vec<Position>], motion: &Motion, what: &str) -> usize {
    let mut n_present = 0;
    assert!(rows.len() <= motion.n_frames(), "{what}: {} rows", rows.len());
    for (index, row) in rows.iter().enumerate() {
        for (&got, &wanted) in row.iter().zip(motion.frame(index)) {
            assert!(is_gap(got) || distance_mm(got, wanted) <= TOLERANCE_MM, "{what}: row {index}");
            n_present += usize::from(!is_gap(got));
        }
    }
    n_present
}

fn try_rows(take: &[u8]) -> Result<(Vec<Vec<Position>>, Vec<Problem>), TakeError> {
    TakeFrames::open(std::io::Cursor::new(take)).map(|_| rows(take))
}

#[test]
fn a_cut_take_gives_what_was_written_and_says_that_the_end_is_missing() {
    let (motion, take) = take();
    let (whole, problems) = rows(&take);
    assert!(problems.is_empty(), "{problems:?}");
    let n_whole = assert_right(&whole, &motion, "whole");
    let mut n_before = 0;
    // Around every end of a chunk, and every 29th byte; take/tests/sweeps cuts at every byte.
    let ends: Vec<_> = places(&take).into_iter().map(|(_, place)| place.end).collect();
    let is_near_end = |cut: usize| ends.iter().any(|end| cut.abs_diff(*end) <= 12);
    for cut in (0..take.len()).filter(|&cut| cut % 29 == 0 || is_near_end(cut)) {
        match try_rows(&take[..cut]) {
            Err(error) => assert!(
                matches!(error, TakeError::NotATake(_)) && n_before == 0,
                "cut at {cut}: {error}"
            ),
            Ok((rows, problems)) => {
                assert!(problems.contains(&Problem::CutOff), "cut at {cut}: {problems:?}");
                let n = assert_right(&rows, &motion, "cut");
                assert!(
                    n >= n_before && n <= n_whole,
                    "cut at {cut}: {n} samples after {n_before}"
                );
                n_before = n;
            }
        }
    }
    assert_eq!(n_before, n_whole, "the samples end before the ledger");
}

#[test]
fn a_flipped_byte_costs_what_depends_on_it_and_never_gives_a_wrong_sample() {
    let (motion, take) = take();
    let n_whole = assert_right(&rows(&take).0, &motion, "whole");
    // Every byte of the header and of the first stretches, then every 47th; take/tests/sweeps has the others.
    for at in (8..take.len()).filter(|at| *at < 1_200 || at % 47 == 0) {
        let mut damaged = take.clone();
        damaged[at] ^= 1 << (at % 8);
        match try_rows(&damaged) {
            Err(error) => assert!(matches!(error, TakeError::NotATake(_)), "byte {at}: {error}"),
            Ok((rows, problems)) => {
                assert!(!problems.is_empty(), "byte {at}: nobody was told");
                let n = assert_right(&rows, &motion, "flipped");
                // At most one key distance of ten seconds is lost.
                assert!(n * 8 >= n_whole, "byte {at}: {n} of {n_whole} samples");
            }
        }
    }
}

#[test]
fn a_zeroed_range_costs_no_more_than_up_to_the_next_key_stretch() {
    let (motion, take) = take();
    let mut damaged = take.clone();
    let middle = take.len() / 3;
    damaged[middle..middle + 200].fill(0);
    let (rows, problems) = rows(&damaged);
    assert!(!problems.is_empty());
    assert!(assert_right(&rows, &motion, "zeroed") > 0);
    let last = rows.last().unwrap();
    assert!(last.iter().any(|&p| !is_gap(p)), "the stretches after the next key are unaffected");
}

/// Removed bytes leave pieces of two chunks, which do not describe the stretches between them.
#[test]
fn bytes_that_are_missing_give_no_wrong_sample_and_no_wrong_time() {
    let motion = jump(3, 60.0, 40.0);
    let (_, take, _) = record(&motion, &config(&motion, dense(TOLERANCE_MM)), 0..motion.n_frames());
    let whole: Vec<_> = times(&take);
    assert_eq!(whole.len(), motion.n_frames());
    let mut random = Random::new(1);
    for _ in 0..200 {
        let from = 1_000 + random.below(take.len() - 1_000);
        let to = (from + 1 + random.below(take.len() / 2)).min(take.len());
        let mut damaged = take.clone();
        damaged.drain(from..to);
        let (rows, problems) = rows(&damaged);
        assert!(!problems.is_empty(), "without {from}..{to}");
        assert_right(&rows, &motion, "without some bytes");
        for (row, time) in times(&damaged) {
            assert_eq!(whole[row as usize], (row, time), "without {from}..{to}");
        }
    }
}

/// The times of all rows that can be read.
fn times(take: &[u8]) -> Vec<(u64, mocapd_take::timeline::RowTime)> {
    let mut times = Vec::new();
    mocapd_take::reader::read_events(take, |event| {
        if let TakeEvent::Stretch(stretch) = event {
            times.extend(
                stretch.timeline.iter().flat_map(mocapd_take::timeline::Timeline::recorded),
            );
        }
        Ok(())
    })
    .unwrap();
    times
}

#[test]
fn bytes_may_come_in_any_pieces() {
    let (_, take) = take();
    let events = |size: usize| {
        let mut reader = TakeReader::new();
        let mut found = Vec::new();
        for piece in take.chunks(size) {
            reader.push(piece);
            while let Some(event) = reader.next_event().unwrap() {
                found.push(format!("{event:?}"));
            }
        }
        reader.finish();
        while let Some(event) = reader.next_event().unwrap() {
            found.push(format!("{event:?}"));
        }
        found
    };
    let whole = events(take.len());
    for size in [1, 2, 7, 1000] {
        assert_eq!(events(size), whole, "{size}");
    }
}

#[test]
fn newer_parts_are_skipped_or_refused_as_their_type_says() {
    let (_, take) = take();
    let chunk::ChunkParse::Whole { len, .. } = chunk::parse(&take[8..]) else { panic!() };
    let with = |kind: u8| {
        let mut changed = take[..8 + len].to_vec();
        chunk::put(&mut changed, kind, b"from the future").unwrap();
        changed.extend_from_slice(&take[8 + len..]);
        changed
    };
    assert!(rows(&with(0xe0)).1.is_empty());
    let (_, problems) = rows(&with(0x60));
    let Problem::Damaged { offset, message, .. } = &problems[0] else { panic!("{problems:?}") };
    assert_eq!(*offset, 8 + len as u64);
    assert_mentions(message, &["60"]);
}

#[test]
fn a_newer_header_is_refused_with_its_version() {
    let (motion, _) = take();
    let header = mocapd_acquire::header::new(&dense(1.0), motion.info.rate_hz).unwrap();
    let mut payload = header.to_payload().unwrap();
    payload[0] = 9;
    let mut take = chunk::MAGIC.to_vec();
    chunk::put(&mut take, Header::KIND, &payload).unwrap();
    let error = TakeFrames::open(std::io::Cursor::new(&take)).unwrap_err();
    assert!(matches!(error, TakeError::Unsupported { found: 9, supported: ..9, .. }), "{error}");
}

#[test]
fn other_files_are_rejected_as_not_a_take() {
    for (bytes, why) in [
        (&b""[..], NotATake::Short),
        (b"\x89TAK", NotATake::Short),
        (b"PK\x03\x04 a zip file", NotATake::OtherMagic),
        (b"\x89TAK\n\x1a\n and more", NotATake::SentAsText),
        (b"\x89TAK\r\n\x1a\n", NotATake::HeaderCut),
        (b"\x89TAK\r\n\x1a\n\x01\x7f garbage, and then nothing", NotATake::HeaderCut),
        (
            b"\x89TAK\r\n\x1a\n\x01\x04 garbage of some length, without a header",
            NotATake::HeaderDamaged,
        ),
    ] {
        let error = TakeFrames::open(std::io::Cursor::new(bytes)).unwrap_err();
        assert!(matches!(error, TakeError::NotATake(found) if found == why), "{why:?}: {error}");
    }
    assert_mentions(&NotATake::HeaderDamaged.to_string(), &["mocapd recover"]);
}

#[test]
fn hostile_sizes_cost_no_memory() {
    let (motion, _) = take();
    let mut header = mocapd_acquire::header::new(&dense(1.0), motion.info.rate_hz).unwrap();
    header.channels = mocapd_acquire::header::channels(&motion.info.markers);
    let mut front = chunk::MAGIC.to_vec();
    chunk::put(&mut front, Header::KIND, &header.to_payload().unwrap()).unwrap();
    // A stretch that claims 2^60 rows, one that claims 4 M rows of many channels, a chunk of 1 GiB.
    let huge_rows = [&[1, 4, 0][..], &[0xff; 8], &[0x0f, 1, 0]].concat();
    let many = [&[1, 4, 0, 0x80, 0x80, 0x80, 0x02][..], &[1, 0].repeat(100)].concat();
    // One that claims 2^31 recorded rows of a time line.
    let times = [&[1, 7, 0, 0, 1][..], &[0xfe, 0xff, 0xff, 0xff, 0x0f], &[0; 20]].concat();
    for payload in [huge_rows, many, times] {
        let mut take = front.clone();
        chunk::put(&mut take, chunk::types::STRETCH, &payload).unwrap();
        let mut reader = TakeReader::new();
        reader.push(&take);
        reader.finish();
        assert!(matches!(reader.next_event().unwrap(), Some(TakeEvent::Header(_))));
        assert!(matches!(reader.next_event().unwrap(), Some(TakeEvent::Damaged { .. })));
    }
    // Blocks that claim more samples than a stretch holds: detected when they are decoded.
    let group = [&[1, 4, 0, 0x80, 0x80, 0x08][..], &[3, 0x40, 64, 0].repeat(5)].concat();
    let mut take = front.clone();
    chunk::put(&mut take, chunk::types::STRETCH, &group).unwrap();
    let problems = mocapd_acquire::inspect::Summary::read(&take[..]).unwrap().take.problems;
    let Problem::Refused { refusal: Refusal::Undecodable(why), .. } = &problems[0] else {
        panic!("{problems:?}")
    };
    assert_mentions(why, &["more samples"]);
    let mut long = front;
    long.extend_from_slice(&[chunk::types::STRETCH, 0xff, 0xff, 0xff, 0xff, 0x03, 1, 2, 3]);
    let is_last = |problem: &Problem| matches!(problem, Problem::Damaged { offset, len, .. } if offset + len == long.len() as u64);
    assert!(rows(&long).1.iter().any(is_last));
}

#[test]
fn a_stretch_that_is_missing_is_noticed_and_gives_no_wrong_sample() {
    let motion = jump(2, 60.0, 12.0);
    for codec in
        [dense(TOLERANCE_MM), crate::support::lossless(), crate::support::fast(TOLERANCE_MM)]
    {
        let (_, take, _) = record(&motion, &config(&motion, codec), 0..motion.n_frames());
        let stretches = places(&take).into_iter().filter(|p| p.0 == chunk::types::STRETCH);
        let n = stretches.clone().count();
        // Not the last one: without it the rows themselves are missing.
        for (_, place) in stretches.take(n - 1) {
            let mut cut = take.clone();
            cut.drain(place);
            let (rows, problems) = rows(&cut);
            let is_missing = |problem: &Problem| {
                matches!(problem, Problem::MissingBefore { .. } | Problem::MissingFrom { .. })
            };
            assert!(problems.iter().any(is_missing), "{problems:?}");
            assert_right(&rows, &motion, "without a stretch");
        }
    }
}

#[test]
fn a_damaged_record_costs_nothing_but_itself() {
    let (motion, take) = take();
    let n_whole = assert_right(&rows(&take).0, &motion, "whole");
    for (kind, place) in places(&take) {
        if [chunk::types::LEDGER, chunk::types::INDEX].contains(&kind) {
            let mut damaged = take.clone();
            damaged[place.end - 1] ^= 1;
            let (rows, problems) = rows(&damaged);
            assert!(!problems.is_empty());
            assert_eq!(assert_right(&rows, &motion, "record"), n_whole, "type {kind:02x}");
        }
    }
}
