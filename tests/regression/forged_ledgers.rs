//! Takes with valid checksums whose ledgers do not match their frames.

use std::io::Cursor;

use mocapd_acquire::{inspect::Summary, ledger::TakeHealth};
use mocapd_take::{
    TakeEvent, TakeMap, TakeWriter,
    chunk::{self, MAGIC, types},
    damage::{LedgerTotals, Problem},
    index::Footer,
    reader::read_events,
    record::Ledger,
    recovery::RecoveryScan,
    statistics::StretchTally,
    stretch::StretchDecoder,
};

use crate::{
    cli::Folder,
    support::{assert_mentions, config, dense, jump, places, record},
};

/// A recording of 180 rows, two of which were lost.
fn lossy() -> Vec<u8> {
    let motion = jump(1, 60.0, 3.0);
    record(&motion, &config(&motion, dense(0.5)), (0..180).filter(|seq| seq % 80 != 50)).1
}

fn payload(take: &[u8], place: std::ops::Range<usize>) -> &[u8] {
    let chunk::ChunkParse::Whole { payload, .. } = chunk::parse(&take[place]) else { panic!() };
    payload
}

/// The take's stretches, with another ledger after the second one and at the end.
fn with_ledgers(take: &[u8], early: Option<&Ledger>, last: impl Fn(Ledger) -> Ledger) -> Vec<u8> {
    let (mut header, mut decoder, mut spans) = (None, None, Vec::new());
    let mut ledger = Ledger::default();
    read_events(take, |event| {
        match event {
            TakeEvent::Header(found) => {
                decoder = Some(StretchDecoder::new(found.codec()?));
                header = Some(found);
            }
            TakeEvent::Stretch(stretch) => {
                let decoder = decoder.as_mut().unwrap();
                decoder.decode(&stretch)?;
                spans.push((stretch.span, StretchTally::of_decoded(&stretch, decoder.rows())));
            }
            TakeEvent::Ledger(found) => ledger = *found,
            _ => {}
        }
        Ok(())
    })
    .unwrap();
    let mut writer = TakeWriter::new(Vec::new(), &header.unwrap()).unwrap();
    let stretches = places(take).into_iter().filter(|(kind, _)| *kind == types::STRETCH);
    for (number, ((_, place), (span, tally))) in stretches.zip(spans).enumerate() {
        writer.stretch(span, payload(take, place), &tally).unwrap();
        if let Some(early) = early.filter(|_| number == 1) {
            writer.ledger(early).unwrap();
        }
    }
    writer.finish(&last(ledger)).unwrap().0
}

/// Replaces each chunk of a type by another one of the same length.
fn with_chunks(take: &[u8], of: u8, forged: impl Fn(&[u8]) -> (u8, Vec<u8>)) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    for (kind, place) in places(take) {
        let (kind, payload) = match payload(take, place) {
            payload if kind == of => forged(payload),
            payload => (kind, payload.to_vec()),
        };
        chunk::put(&mut out, kind, &payload).unwrap();
    }
    assert_eq!(out.len(), take.len());
    out
}

#[test]
fn losses_in_the_time_line_are_compared_with_every_ledger() {
    let take = lossy();
    let honest = Summary::read(&with_ledgers(&take, None, |ledger| ledger)[..]).unwrap();
    assert_eq!((honest.contradictions(), honest.health()), (&[][..], TakeHealth::Lossy));
    let nothing_lost =
        |ledger: Ledger| Ledger { frames_sent: ledger.recorded, lost_on_link: 0, ..ledger };
    let forged = Summary::read(&with_ledgers(&take, None, nothing_lost)[..]).unwrap();
    assert!(forged.take.ledger.as_ref().unwrap().closes());
    assert_eq!((forged.contradictions().len(), forged.health()), (1, TakeHealth::Damaged));
}

#[test]
fn a_take_without_a_ledger_is_the_same_to_every_command() {
    const UNKNOWN: u8 = 0xFE;
    let folder = Folder::new();
    let take = with_chunks(&lossy(), types::LEDGER, |payload| (UNKNOWN, payload.to_vec()));
    folder.write("a.take", take);
    // The footer points at a ledger, which is a contradiction as well.
    for (args, code) in [
        (&["info", "a.take"][..], 3),
        (&["verify", "a.take"], 1),
        (&["export", "a.take", "-o", "a.csv"], 3),
        (&["recover", "a.take", "-o", "b.take"], 3),
    ] {
        let ran = folder.run(args).with_code(code);
        assert_mentions(&ran.stderr, &["a.take", &Problem::NoLedger.to_string()]);
    }
    let verify = folder.run(&["verify", "b.take", "--json"]).with_code(3).json();
    let none = serde_json::json!([]);
    assert_eq!((&verify["contradictions"], &verify["problems"]), (&none, &none), "{verify}");
}

#[test]
fn a_recovery_leaves_no_wrong_ledger() {
    let folder = Folder::new();
    let early = Ledger { frames_sent: 7, recorded: 7, ..Ledger::default() };
    let take = with_ledgers(&lossy(), Some(&early), |ledger| ledger);
    let problems = RecoveryScan::read(&take[..]).unwrap().problems;
    let [wrong @ Problem::LedgerCounts { stated, found }] = &problems[..] else { panic!() };
    assert_eq!(*stated, LedgerTotals { frames: 7, samples: 0 });
    assert!(found.frames > 7 && found.samples > 0, "{found:?}");
    folder.write("a.take", take);
    folder.run(&["verify", "a.take"]).with_code(1);
    let ran = folder.run(&["recover", "a.take", "-o", "b.take"]).with_code(3);
    // All names are mentioned.
    assert_mentions(&ran.stderr, &["a.take", &wrong.to_string(), "ledger was missing or wrong"]);
    assert!(!ran.stderr.contains("marker names"), "{}", ran.stderr);
    let verify = folder.run(&["verify", "b.take", "--json"]).with_code(3).json();
    assert_eq!(verify["contradictions"], serde_json::json!([]), "{verify}");
}

#[test]
fn a_footer_with_too_few_rows_hides_none() {
    let take = lossy();
    let fewer = |payload: &[u8]| {
        let footer = Footer::from_payload(payload, 0).unwrap();
        (types::FOOTER, Footer { n_rows: footer.n_rows - 20, ..footer }.to_payload())
    };
    let whole = TakeMap::open(&mut Cursor::new(&take)).unwrap();
    let forged = with_chunks(&take, types::FOOTER, fewer);
    let map = TakeMap::open(&mut Cursor::new(&forged)).unwrap();
    assert_eq!((whole.problems, map.n_rows), (Vec::new(), whole.n_rows));
    assert!(matches!(map.problems[..], [Problem::FooterRows { .. }]), "{:?}", map.problems);
}
