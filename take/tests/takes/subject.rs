//! SUBJECT in a take: its position, the readers and copies that keep it, and takes that lack it.

use std::{io::Cursor, ops::Range};

use mocapd_take::{
    TakeFrames, TakeMap,
    chunk::{self, ChunkParse, MAGIC, MAY_SKIP, types},
    damage::Problem,
    motion::{FrameSource, GAP},
    reader::read_events,
    record::{Record, Subject},
    recovery::{ChunkKind, RecoveryScan},
};

/// The range of the take's SUBJECT, right after the header.
fn place(take: &[u8]) -> Range<usize> {
    let front = |at: usize| match chunk::parse(&take[at..]) {
        ChunkParse::Whole { kind, len, .. } => (kind, at + len),
        other => panic!("{other:?}"),
    };
    let (header, behind) = front(MAGIC.len());
    assert_eq!(header, types::HEADER);
    let (kind, end) = front(behind);
    assert_eq!(kind, Subject::KIND);
    behind..end
}

/// The take with another chunk in place of SUBJECT.
fn with(take: &[u8], chunk: &[u8]) -> Vec<u8> {
    let place = place(take);
    [&take[..place.start], chunk, &take[place.end..]].concat()
}

/// All samples, and the problems.
fn samples(take: &[u8]) -> (Vec<u32>, Vec<Problem>, Option<Subject>) {
    let mut frames = TakeFrames::open(Cursor::new(take)).unwrap();
    let mut row = vec![GAP; frames.info().markers.len()];
    let mut all = Vec::new();
    while frames.next_frame(&mut row).unwrap() {
        all.extend(row.iter().flatten().map(|value| value.to_bits()));
    }
    (all, frames.problems().to_vec(), frames.info().subject.clone())
}

#[test]
fn every_reader_finds_the_subject() {
    let whole = crate::take::take("dense");
    let (_, problems, found) = samples(&whole);
    assert_eq!((found, problems), (Some(crate::take::subject()), vec![]));
    let quick = TakeMap::open(&mut Cursor::new(&whole)).unwrap();
    let scanned = TakeMap::scan(&mut Cursor::new(&whole)).unwrap();
    assert_eq!(quick.n_sampled_rows, None, "known by the heads of its chunks");
    assert_eq!(quick.subject, Some(crate::take::subject()));
    assert_eq!(scanned.subject, quick.subject);
    let mut bytes = 0;
    read_events(&whole[..], |event| {
        if let mocapd_take::TakeEvent::End { bytes: found, .. } = event {
            assert_eq!(found.sum(), whole.len() as u64);
            bytes = found.subject;
        }
        Ok(())
    })
    .unwrap();
    assert_eq!(bytes, place(&whole).len() as u64);
}

#[test]
fn readers_that_do_not_know_it_skip_it() {
    const { assert!(Subject::KIND == 0x87 && Subject::KIND & MAY_SKIP != 0) };
    let whole = crate::take::take("dense");
    let (wanted, ..) = samples(&whole);
    // Of a later version, or of a future type.
    let mut payload = crate::take::subject().to_payload().unwrap();
    payload[0] = 9;
    for kind in [Subject::KIND, 0xf7] {
        let mut unknown = Vec::new();
        chunk::put(&mut unknown, kind, &payload).unwrap();
        let later = with(&whole, &unknown);
        let quick = TakeMap::open(&mut Cursor::new(&later));
        assert_eq!(quick.unwrap().subject, None);
        let (found, problems, subject) = samples(&later);
        assert!(found == wanted && subject.is_none());
        assert_eq!(problems, [], "{kind:02x}");
    }
}

#[test]
fn a_damaged_subject_costs_nothing_else() {
    let whole = crate::take::take("dense");
    let (wanted, ..) = samples(&whole);
    for at in place(&whole) {
        let mut hurt = whole.clone();
        hurt[at] ^= 0x21;
        let (found, problems, subject) = samples(&hurt);
        assert!(found == wanted && problems.len() == 1, "byte {at}: {problems:?}");
        // A head that alone is damaged is repaired.
        let is_mended = matches!(problems[0], Problem::Repaired { .. });
        assert_eq!(subject.is_some(), is_mended, "byte {at}: {problems:?}");
    }
    // The CRC matches, but the content is invalid.
    let mut wrong = Vec::new();
    chunk::put(&mut wrong, Subject::KIND, &[1, 0, 9]).unwrap();
    let (found, problems, subject) = samples(&with(&whole, &wrong));
    assert!(found == wanted && subject.is_none());
    let begin = place(&whole).start as u64;
    assert!(
        matches!(problems[..], [Problem::Damaged { offset, len: 9, .. }] if offset == begin),
        "{problems:?}"
    );
}

#[test]
fn a_recovery_keeps_the_subject() {
    let whole = crate::take::take("dense");
    let hurt = {
        let mut hurt = whole.clone();
        let middle = hurt.len() / 2;
        hurt[middle] ^= 1;
        hurt
    };
    for take in [&whole, &hurt, &whole[..whole.len() / 2].to_vec()] {
        let scan = RecoveryScan::read(&take[..]).unwrap();
        let mut new = Vec::new();
        scan.write(Cursor::new(&take[..]), &mut new, "tests").unwrap();
        assert_eq!(new[place(&new)], whole[place(&whole)], "the same bytes, behind the header");
        let kept = scan.kinds.iter().find(|count| count.kind == ChunkKind::Subject).unwrap();
        assert_eq!((kept.recovered, kept.discarded), (1, 0));
    }
}
