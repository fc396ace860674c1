//! `recover`: everything readable of a damaged take is in the new one, unchanged, and the ledger has the rest.

use std::io::Cursor;

use mocapd_acquire::inspect::Summary;
use mocapd_drivers::device::MarkerSample;
use mocapd_take::{
    TakeError, TakeEvent,
    chunk::types,
    damage::Problem,
    motion::Position,
    reader::read_events,
    record::EndingKind,
    recovery::{ChunkKind, RecoveryScan, repair_start},
};
use mocapd_testkit::random::Random;

use crate::support::{
    config, dense, fast, feed_samples, jump, lossless, mentions, places, rows, samples, start,
};

/// A recording with loss, and with two markers that appear later; stretches of a quarter of a second and
/// keys every second, so that a short take has many.
fn recording(codec: mocapd_codec::Settings) -> Vec<u8> {
    let motion = jump(3, 60.0, 8.0);
    let mut config = config(&motion, codec);
    config.stretch = std::time::Duration::from_millis(250);
    config.key_every = std::time::Duration::from_secs(1);
    config.channels.truncate(13);
    let (mut intake, pipeline) = start(&config, Vec::new());
    for seq in (0..motion.n_frames()).filter(|seq| seq % 97 != 50 && !(200..230).contains(seq)) {
        while intake.is_full() {
            std::thread::yield_now();
        }
        let n_visible = if seq < 120 { 13 } else { 15 };
        let all: Vec<MarkerSample> = samples(motion.frame(seq));
        feed_samples(&mut intake, 60.0, seq, &all[..n_visible]);
    }
    intake.finish();
    pipeline.finish().unwrap().1
}

/// An import of three stretches, each a key.
fn import(seconds: f64) -> Vec<u8> {
    let motion = jump(4, 60.0, seconds);
    let codec = dense(0.5);
    let mut header = mocapd_acquire::header::of_import(&codec, 60.0);
    header.channels = mocapd_acquire::header::channels(&motion.info.markers);
    header.stretch_rows = 600;
    let counter = std::sync::Arc::default();
    let written =
        mocapd_acquire::pipeline::offline::write_take(&motion, &header, 1, &counter, Vec::new())
            .unwrap();
    written.1
}

fn recover(take: &[u8]) -> (RecoveryScan, Vec<u8>) {
    let scan = RecoveryScan::read(take).unwrap();
    let mut new = Vec::new();
    let n = scan.write(Cursor::new(take), &mut new, "tests").unwrap();
    assert_eq!(n, new.len() as u64);
    (scan, new)
}

fn stretches(take: &[u8]) -> Vec<&[u8]> {
    let places = places(take).into_iter().filter(|place| place.0 == types::STRETCH);
    places.map(|place| &take[place.1]).collect()
}

/// Recovers a damaged take, and compares the new one with what can be read of the damaged one.
fn check(damaged: &[u8], original: &[u8], what: &str) -> (RecoveryScan, Vec<u8>, Summary) {
    let (scan, new) = recover(damaged);
    let summary = Summary::read(&new[..]).unwrap();
    assert_eq!(summary.take.problems, [], "{what}: {:?}", scan.problems);
    assert!(summary.take.finished, "{what}");
    let ledger = summary.take.ledger.as_ref().unwrap();
    assert!(ledger.closes() && ledger.finished, "{what}: {ledger:?}");
    assert_eq!(ledger.samples_present, summary.samples(), "{what}");
    assert_eq!(summary.take.n_rows, scan.rows, "{what}");
    assert_eq!(scan.per_channel.len(), summary.take.channels.len(), "{what}");
    assert_eq!(scan.channels, summary.take.channels, "{what}");
    for (ours, theirs) in scan.per_channel.iter().zip(&summary.per_channel) {
        assert_eq!(
            (ours.samples, ours.rows_damaged),
            (theirs.samples, theirs.rows_damaged),
            "{what}"
        );
    }
    // Every sample of the damaged take at its row, and no other. After the last one, both may have
    // rows without samples.
    let (old_rows, _) = rows(damaged);
    let (new_rows, _) = rows(&new);
    let bits = |rows: &[Vec<Position>]| {
        let rows = rows.iter().map(|row| row.iter().map(|p| p.map(f32::to_bits)).collect());
        let mut rows: Vec<Vec<[u32; 3]>> = rows.collect();
        let gap = rows.first().and_then(|row| row.first()).map(|_| [f32::NAN.to_bits(); 3]);
        while gap.is_some_and(|gap| rows.last().is_some_and(|row| row.iter().all(|p| *p == gap))) {
            rows.pop();
        }
        rows
    };
    assert_eq!(bits(&old_rows), bits(&new_rows), "{what}");
    // Copied, not encoded again.
    let old = stretches(original);
    let is_old = |stretch: &&&[u8]| old.contains(*stretch);
    let lost = scan.damage.len();
    assert!(
        stretches(&new).iter().filter(|stretch| !is_old(stretch)).count() <= lost,
        "{what}: a stretch is new"
    );
    (scan, new, summary)
}

#[test]
fn everything_of_an_intact_take_is_kept() {
    for take in [recording(dense(0.5)), recording(lossless()), import(25.0)] {
        let (scan, new, summary) = check(&take, &take, "intact");
        assert!(!scan.lost_anything() && scan.finished);
        assert_eq!(stretches(&new), stretches(&take));
        let before = Summary::read(&take[..]).unwrap();
        assert_eq!(summary.take.ledger, before.take.ledger);
        assert_eq!(summary.take.events, before.take.events);
        assert_eq!(scan.discarded_bytes, 0);
        let header = summary.take.header;
        assert_eq!(header.take_id, before.take.header.take_id);
        assert_eq!(
            header.settings.last().unwrap(),
            &("recovered".to_owned(), format!("by tests: {}", scan.loss_summary()))
        );
    }
}

#[test]
fn a_rebuilt_ledger_equals_that_of_the_recorder() {
    // Without its last ledger, the take's account is rebuilt from its stretches, and is the same.
    for codec in [dense(0.5), fast(0.5)] {
        let take = recording(codec);
        let ledger = Summary::read(&take[..]).unwrap().take.ledger.unwrap();
        let last = places(&take).into_iter().rfind(|place| place.0 == types::LEDGER).unwrap();
        let (scan, _, summary) = check(&take[..last.1.start], &take, "without its ledger");
        assert!(scan.lost_anything(), "nobody knows whether more came");
        let again = summary.take.ledger.unwrap();
        let frames = |ledger: &mocapd_take::record::Ledger| {
            (
                [ledger.frames_sent, ledger.recorded, ledger.lost_on_link, ledger.lost_other],
                [ledger.samples_announced, ledger.samples_present, ledger.samples_occluded],
            )
        };
        assert_eq!(frames(&again), frames(&ledger));
        assert!(ledger.lost_on_link >= 30 && ledger.recorded < 480);
    }
}

#[test]
fn a_take_cut_at_any_byte_is_recovered() {
    let take = recording(dense(0.5));
    let first = places(&take)[0].1.end;
    let summary_chunk = places(&take).into_iter().find(|p| p.0 == types::SUMMARY).unwrap().1;
    let mut most = 0;
    // Every byte of the first and the last part, then every 127th.
    for cut in (first..take.len())
        .filter(|cut| *cut < first + 200 || *cut + 200 > take.len() || cut % 127 == 0)
    {
        let (scan, _, summary) = check(&take[..cut], &take, &format!("cut at {cut}"));
        let finished = scan.finished;
        // The lost summary stated how the take ended.
        let is_torn = (summary_chunk.start + 1..summary_chunk.end).contains(&cut);
        assert_eq!(scan.lost_anything(), !finished || is_torn, "cut at {cut}");
        let known = cut >= summary_chunk.end;
        let ending = summary.take.ending.as_ref().map(|ending| ending.kind);
        assert_eq!(ending == Some(EndingKind::Stopped), known, "cut at {cut}: {ending:?}");
        assert_eq!(ending == Some(EndingKind::CutOff), !finished, "cut at {cut}: {ending:?}");
        assert!(summary.samples() >= most, "cut at {cut}");
        most = summary.samples();
    }
    assert_eq!(most, Summary::read(&take[..]).unwrap().samples());
}

#[test]
fn a_damaged_chunk_costs_what_depends_on_it_and_its_rows_stay() {
    for take in [recording(dense(0.5)), recording(lossless()), import(25.0)] {
        let whole = Summary::read(&take[..]).unwrap();
        for (kind, place) in places(&take).into_iter().skip(1) {
            let mut damaged = take.clone();
            damaged[place.start + (place.len() / 2).max(2)] ^= 0x10;
            let what = format!("type {kind:02x} at {}", place.start);
            let (scan, _, summary) = check(&damaged, &take, &what);
            let is_rebuilt = ChunkKind::of(Some(kind)).is_rebuilt();
            assert_eq!(scan.lost_anything(), !is_rebuilt, "{what}");
            assert_eq!(summary.take.n_rows, whole.take.n_rows, "{what}");
            let counts = scan.kinds.iter().find(|count| count.kind == ChunkKind::of(Some(kind)));
            assert!(counts.unwrap().discarded >= 1, "{what}");
            let (before, after) =
                (whole.take.ledger.as_ref().unwrap(), summary.take.ledger.as_ref().unwrap());
            if kind == types::STRETCH {
                let lost = scan.rows_damaged();
                assert!(lost > 0 && scan.damage.len() == 1, "{what}");
                assert_eq!(after.frames_sent, before.frames_sent, "{what}");
                assert_eq!(after.recorded + after.lost_other, before.recorded, "{what}");
                assert!(after.lost_other > 0 && after.lost_other <= lost, "{what}");
                let first_row = scan.damage[0].first_row.to_string();
                assert!(summary.take.events.iter().any(|event| mentions(&event.text, &first_row)));
            } else {
                assert_eq!(summary.samples(), whole.samples(), "{what}");
                assert_eq!(after.recorded, before.recorded, "{what}");
            }
        }
    }
}

#[test]
fn a_damaged_head_costs_nothing() {
    let take = recording(dense(0.5));
    let whole = rows(&take).0;
    for (kind, place) in places(&take) {
        let len_bytes = if place.len() < 6 + 128 { 1 } else { 2 };
        for at in place.start..=place.start + len_bytes {
            let mut damaged = take.clone();
            damaged[at] ^= 0x05;
            let (scan, new) = recover(&damaged);
            assert!(!scan.lost_anything(), "type {kind:02x}, byte {at}");
            assert_eq!(scan.problems, [Problem::Repaired { offset: place.start as u64 }]);
            assert_eq!(format!("{:?}", rows(&new).0), format!("{whole:?}"));
            assert_eq!(format!("{:?}", rows(&damaged).0), format!("{whole:?}"));
        }
    }
}

#[test]
fn takes_with_zeros_and_noise_anywhere_are_recovered() {
    let mut random = Random::new(7);
    let takes = [recording(dense(0.5)), recording(lossless()), import(25.0)];
    for round in 0..120 {
        let take = &takes[round % 3];
        let mut damaged = take.clone();
        let first = places(take)[0].1.end;
        for _ in 0..=random.below(2) {
            let from = first + random.below(take.len() - first);
            let len = 1 + random.below([4, 60, 3_000][round / 3 % 3]);
            let to = (from + len).min(take.len());
            match random.below(3) {
                0 => damaged[from..to].fill(0),
                1 => damaged[from..to].fill_with(|| random.byte()),
                _ => damaged.truncate(to.max(first + 100)),
            }
            damaged.resize(take.len().min(damaged.len()), 0);
            if damaged.len() < take.len() {
                break;
            }
        }
        let (scan, new, _) = check(&damaged, take, &format!("round {round}"));
        // A second recovery loses nothing more.
        let (again, newer, _) = check(&new, &new, &format!("round {round}, again"));
        assert!(!again.lost_anything(), "round {round}: {:?}", again.problems);
        assert_eq!(again.ledger, scan.ledger, "round {round}");
        assert_eq!(stretches(&newer), stretches(&new));
        assert_eq!(again.damage.len(), scan.damage.len());
    }
}

#[test]
fn a_lost_name_is_not_given_to_another() {
    let take = recording(dense(0.5));
    let labels = |take: &[u8]| {
        let summary = Summary::read(take).unwrap();
        summary.take.channels.iter().map(|c| c.label.clone()).collect::<Vec<_>>()
    };
    let whole = labels(&take);
    assert_eq!(whole.len(), 15);
    let tables: Vec<_> = places(&take).into_iter().filter(|p| p.0 == types::CHANNELS).collect();
    assert_eq!(tables.len(), 2, "each marker that appears has its own");
    for (i, (_, place)) in tables.iter().enumerate() {
        let mut damaged = take.clone();
        damaged[place.end - 1] ^= 1;
        let (scan, new, _) = check(&damaged, &take, "a lost name");
        assert!(scan.lost_anything());
        let mut expected = whole.clone();
        expected[13 + i] = format!("u0{}", 14 + i);
        assert_eq!(labels(&damaged), expected);
        assert_eq!(labels(&new), expected);
        let motion = mocapd_take::read_motion(Cursor::new(&damaged)).unwrap().0;
        let read: Vec<_> = motion.info.markers.iter().map(|marker| marker.label.clone()).collect();
        assert_eq!(read, expected, "the reader of frames sees it, too");
    }
}

#[test]
fn one_wrong_byte_of_the_header_is_repaired() {
    let take = import(0.5);
    let header = places(&take)[0].1.clone();
    for at in 0..header.end {
        for by in [0x01, 0x80, 0xff] {
            let mut damaged = take.clone();
            damaged[at] ^= by;
            let (mut input, repaired) = repair_start(Cursor::new(&damaged)).unwrap();
            let scan = RecoveryScan::read(&mut input).unwrap();
            assert!(!scan.lost_anything(), "byte {at}");
            let in_head = (8..11).contains(&at);
            let expected = match at {
                0..8 => vec![Problem::Magic],
                _ if in_head => vec![],
                // A wrong byte of the CRC is reported as its first byte.
                _ => vec![Problem::HeaderByte(at.min(header.end - 4) as u64)],
            };
            assert_eq!(repaired, expected, "byte {at}");
            assert_eq!(scan.problems.len(), usize::from(in_head), "byte {at}");
            let mut new = Vec::new();
            scan.write(&mut input, &mut new, "tests").unwrap();
            assert_eq!(format!("{:?}", rows(&new)), format!("{:?}", rows(&take)), "byte {at}");
        }
    }
    // Two wrong bytes are not repaired.
    let mut damaged = take.clone();
    damaged[header.start + 20] ^= 1;
    damaged[header.start + 30] ^= 1;
    let (input, repaired) = repair_start(Cursor::new(&damaged)).unwrap();
    assert_eq!(repaired, []);
    assert!(RecoveryScan::read(input).is_err());
}

#[test]
fn the_file_may_not_change_meanwhile() {
    let take = import(25.0);
    let scan = RecoveryScan::read(&take[..]).unwrap();
    for changed in [&take[..take.len() / 2], &[&take[..400], &[9], &take[401..]].concat()] {
        let error = scan.write(Cursor::new(changed), Vec::new(), "tests").unwrap_err();
        assert!(matches!(error, TakeError::Corrupt { .. }), "{error}");
    }
}

#[test]
fn the_reader_reports_the_lost_rows() {
    let take = recording(dense(0.5));
    let places = places(&take);
    let middle = places.iter().filter(|p| p.0 == types::STRETCH).nth(6).unwrap();
    let mut damaged = take.clone();
    damaged[middle.1.end - 1] ^= 1;
    let summary = Summary::read(&damaged[..]).unwrap();
    let [lost] = summary.take.damage[..] else { panic!("{:?}", summary.take.damage) };
    // From that stretch to the next key.
    let mut keys = Vec::new();
    read_events(&take[..], |event| {
        if let TakeEvent::Stretch(stretch) = event {
            keys.push((stretch.from_row(), stretch.span.key));
        }
        Ok(())
    })
    .unwrap();
    assert_eq!(lost.first_row, keys[6].0);
    let next_key = keys[7..].iter().find(|key| key.1).unwrap().0;
    assert_eq!(lost.first_row + lost.rows, next_key);
    assert!(lost.first_row + lost.rows < 120, "two markers appear there: {lost:?}");
    for (column, channel) in summary.per_channel.iter().enumerate() {
        assert_eq!(channel.rows_damaged, if column < 13 { lost.rows } else { 0 });
    }
}
