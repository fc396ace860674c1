//! Takes whose CRCs match may claim anything: claims beyond the limits are damage, and values within them are read
//! back.

use std::io::Cursor;

use mocapd_codec::{CodecError, Settings, Tolerance};
use mocapd_take::{
    TakeError, TakeEvent, TakeFrames, TakeMap, TakeTraversal, TakeWriter,
    chunk::{self, types},
    damage::{Problem, Refusal},
    index::Footer,
    motion::{FrameSource, UpAxis},
    reader::read_events,
    record::{Channel, Device, Header, Ledger, SampledChannel, SampledGroup},
    recovery::RecoveryScan,
    sampled::SampledPart,
    statistics::StretchTally,
    stretch::{LIVE_ROWS_MAX, ROWS_MAX, Span, Stretch, StretchDecoder, StretchSizes, rows_max},
    traversal::Decode,
};

const LIVE: [&str; 4] = ["dense", "fast", "lossless", "lossless:predictive"];

/// Maximum number of rows between two stretches, from docs/take-format.md.
const ROWS_PASSED_MAX: u64 = 1 << 32;

/// Shapes of a stretch: with a listed number of rows; with a time line; with listed runs.
const ROWS_LISTED: u8 = 4;
const RUNS_LISTED: u8 = 7;

fn settings(kind: &str) -> Settings {
    Settings { kind: kind.parse().unwrap(), tolerance: Tolerance::from_mm(0.5).unwrap() }
}

fn header(kind: &str) -> Header {
    let mut header = Header {
        software: "bounds".to_owned(),
        take_id: [7; 16],
        created_unix_ms: 0,
        resampler: String::new(),
        codec_version: 0,
        tolerance_mm: 0.0,
        rate_hz: 60.0,
        up_axis: UpAxis::Unknown,
        device: None,
        source: None,
        channels: vec![Channel { marker_id: 0, label: "m".to_owned(), labelled: true }],
        stretch_rows: 600,
        settings: Vec::new(),
    };
    header.set_codec(&settings(kind));
    header
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

/// A stretch of a single group: its first byte, shape and numbers, and a block.
fn stretch(number: u8, key: bool, shape: u8, numbers: &[u64], block: &[u8]) -> Vec<u8> {
    let mut payload = vec![u8::from(key) | 4 | number << 3, shape];
    payload.extend(numbers.iter().flat_map(|&number| varint(number)));
    payload.extend(block);
    payload
}

/// `n_rows` rows of samples from `first_row` on, without a time line.
fn held(number: u8, first_row: u64, n_rows: u64, block: &[u8]) -> Vec<u8> {
    stretch(number, true, ROWS_LISTED, &[first_row, n_rows], block)
}

/// A stretch of lost rows only, after `from_row` or after the previous stretch.
fn lost(number: u8, from_row: Option<u64>, runs: &[u64]) -> Vec<u8> {
    let mut numbers: Vec<u64> = from_row.into_iter().chain([0, runs.len() as u64]).collect();
    // Each with its cause, one byte: not received.
    numbers.extend(runs.iter().flat_map(|rows| [rows << 1 | 1, 1]));
    stretch(number, from_row.is_some(), RUNS_LISTED, &numbers, &[])
}

/// A take of these stretches with matching CRCs, and a footer if one is given.
fn take(kind: &str, payloads: &[Vec<u8>], footer: Option<u64>) -> Vec<u8> {
    let mut take = Vec::new();
    TakeWriter::new(&mut take, &header(kind)).unwrap();
    for payload in payloads {
        chunk::put(&mut take, types::STRETCH, payload).unwrap();
    }
    if let Some(n_rows) = footer {
        let mut writer = TakeWriter::new(Vec::new(), &header(kind)).unwrap();
        let header_bytes = writer.bytes() as usize;
        writer.ledger(&Ledger { finished: true, ..Ledger::default() }).unwrap();
        take.extend_from_slice(&writer.abandon()[header_bytes..]);
        let footer = Footer { index_offset: 0, ledger_offset: 0, n_rows };
        chunk::put(&mut take, types::FOOTER, &footer.to_payload()).unwrap();
    }
    take
}

/// The first row of each stretch that is read, and the damage.
fn read(take: &[u8]) -> (Vec<u64>, Vec<String>) {
    let (mut rows, mut damage) = (Vec::new(), Vec::new());
    read_events(take, |event| {
        match event {
            TakeEvent::Stretch(stretch) => rows.push(stretch.span.first_row),
            TakeEvent::Damaged { message, .. } => damage.push(message),
            _ => {}
        }
        Ok(())
    })
    .unwrap();
    (rows, damage)
}

fn frames(take: &[u8]) -> TakeFrames<Cursor<&[u8]>> {
    TakeFrames::open(Cursor::new(take)).unwrap()
}

/// A block of eight channels at rest: two bytes for any number of rows.
const AT_REST: [u8; 2] = [0x7f, 8];

#[test]
fn a_live_stretch_of_too_many_rows_is_damage() {
    for kind in LIVE {
        for n_rows in [LIVE_ROWS_MAX + 1, ROWS_MAX] {
            let take = take(kind, &[held(0, 0, n_rows, &AT_REST)], None);
            let (rows, damage) = read(&take);
            assert_eq!((rows.len(), damage.len()), (0, 1), "{kind}: {damage:?}");
            assert!(damage[0].contains("rows"), "{kind}: {damage:?}");
            assert_eq!(frames(&take).info().n_frames, 0, "{kind}");
        }
        assert_eq!(read(&take(kind, &[held(0, 0, LIVE_ROWS_MAX, &AT_REST)], None)).0, [0]);
    }
    for kind in ["spline", "sync"] {
        let n_rows = rows_max(settings(kind).kind);
        assert_eq!(n_rows, ROWS_MAX);
        assert_eq!(read(&take(kind, &[held(0, 0, n_rows, &AT_REST)], None)).0, [0], "{kind}");
        let (rows, damage) = read(&take(kind, &[held(0, 0, n_rows + 1, &AT_REST)], None));
        assert_eq!((rows.len(), damage.len()), (0, 1), "{kind}");
    }
}

#[test]
fn a_decoder_refuses_too_many_rows() {
    for kind in LIVE {
        let mut decoder = StretchDecoder::new(settings(kind));
        let mut decode = |n_rows: u64| {
            let span = Span { first_row: 0, n_rows: n_rows as u32, key: true, number: 0 };
            decoder.decode(&Stretch {
                span,
                missing_before: false,
                timeline: None,
                shared: &[],
                blocks: vec![&AT_REST],
                sizes: StretchSizes::default(),
                payload: &[],
            })
        };
        let refused = decode(ROWS_MAX);
        assert!(
            matches!(refused, Err(TakeError::Codec(CodecError::Corrupt(m))) if m.contains("rows")),
            "{kind}: {refused:?}"
        );
    }
}

/// The number of blocks does not limit the number of their channels.
#[test]
fn blocks_of_more_samples_than_a_stretch_holds_are_not_decoded() {
    let span = Span { first_row: 0, n_rows: LIVE_ROWS_MAX as u32, key: true, number: 0 };
    let full = [0x40, 64];
    for kind in LIVE {
        let refused = StretchDecoder::new(settings(kind)).decode(&Stretch {
            span,
            missing_before: false,
            timeline: None,
            shared: &[],
            blocks: vec![&full; 5],
            sizes: StretchSizes::default(),
            payload: &[],
        });
        assert!(
            matches!(refused, Err(TakeError::Codec(CodecError::Corrupt(m))) if m.contains("samples")),
            "{kind}: {refused:?}"
        );
    }
}

#[test]
fn a_writer_refuses_what_no_reader_accepts() {
    let refused = |result: Result<(), TakeError>| match result {
        Err(TakeError::InvalidArgument(message)) => message,
        other => panic!("{other:?}"),
    };
    for kind in LIVE {
        let mut writer = TakeWriter::new(Vec::new(), &header(kind)).unwrap();
        let mut write = |first_row, n_rows: u64| {
            let span = Span { first_row, n_rows: n_rows as u32, key: true, number: 0 };
            writer.stretch(span, &held(0, first_row, n_rows, &[]), &StretchTally::default())
        };
        write(0, LIVE_ROWS_MAX).unwrap();
        assert!(refused(write(LIVE_ROWS_MAX, LIVE_ROWS_MAX + 1)).contains("131073"));
        let ahead = refused(write(LIVE_ROWS_MAX + ROWS_PASSED_MAX, 1));
        assert!(ahead.contains(&ROWS_PASSED_MAX.to_string()), "{ahead}");
        write(LIVE_ROWS_MAX + ROWS_PASSED_MAX - 1, 1).unwrap();
    }
    // Refused before the recording starts: a time line cannot hold the times of this many rows.
    let device = Some(Device::default());
    let new = |rows| {
        let header = Header { device: device.clone(), stretch_rows: rows, ..header("dense") };
        TakeWriter::new(Vec::new(), &header).map(drop)
    };
    new(1 << 16).unwrap();
    assert!(refused(new((1 << 16) + 1)).contains("65537"));
}

#[test]
fn a_row_further_ahead_than_rows_can_be_lost_is_damage() {
    let block = &AT_REST;
    let sound = held(0, 0, 30, block);
    // Before the first stretch, and after one.
    for (before, known) in [(None, 0), (Some(sound), 30)] {
        let later = held(2, known + 1_000, 3, block);
        for (row, believed) in [
            (known + ROWS_PASSED_MAX, true),
            (known + ROWS_PASSED_MAX + 1, false),
            (1 << 62, false),
            (u64::MAX, false),
        ] {
            let payloads: Vec<_> =
                before.clone().into_iter().chain([held(1, row, 3, block)]).collect();
            let (rows, damage) = read(&take("dense", &payloads, None));
            assert_eq!(rows.contains(&row), believed, "{row}");
            assert_eq!(damage.is_empty(), believed, "{row}: {damage:?}");
            // Valid stretches after it are read.
            let payloads = [payloads, vec![later.clone()]].concat();
            let take = take("dense", &payloads, None);
            assert!(read(&take).0.contains(&(known + 1_000)));
            let end = if believed { row + 3 } else { known + 1_003 };
            assert_eq!(frames(&take).info().n_frames, end, "{row}");
        }
    }
}

#[test]
fn too_many_lost_rows_are_damage() {
    let sound = held(0, 0, 30, &AT_REST);
    let most = ROWS_PASSED_MAX;
    for (runs, n_frames) in [
        (vec![most], 30 + most),
        (vec![most - 7, 7], 30 + most),
        (vec![most + 1], 30),
        (vec![most, 1], 30),
    ] {
        // With known rows, as a key stretch, and with unknown ones, after a missing stretch.
        for from_row in [Some(30), None] {
            let number = if from_row.is_some() { 1 } else { 2 };
            let take = take("dense", &[sound.clone(), lost(number, from_row, &runs)], None);
            assert_eq!(frames(&take).info().n_frames, n_frames, "{runs:?} from {from_row:?}");
            assert_eq!(read(&take).1.is_empty(), n_frames > 30);
        }
    }
}

#[test]
fn a_footer_is_accepted_up_to_the_maximum_of_lost_rows() {
    let stretches = [held(0, 0, 30, &AT_REST), b"no stretch".to_vec()];
    for (n_rows, believed) in [
        (30, true),
        (90, true),
        (30 + ROWS_PASSED_MAX, true),
        (31 + ROWS_PASSED_MAX, false),
        (u64::MAX, false),
    ] {
        let take = take("dense", &stretches, Some(n_rows));
        let frames = frames(&take);
        assert_eq!(frames.info().n_frames, if believed { n_rows } else { 30 });
        assert_eq!(frames.map().n_sampled_rows, Some(30));
        assert_eq!(read(&take).1.len(), if believed { 1 } else { 2 });
        // The rows are missing because of the damage, and the footer adds no problem.
        let footer = frames.problems().iter().filter(|p| matches!(p, Problem::FooterRows { .. }));
        assert_eq!(footer.count(), 0, "{n_rows}");
        let cut_off = frames.problems().contains(&Problem::CutOff);
        assert_eq!(cut_off, !believed, "{:?}", frames.problems());
    }
}

#[test]
fn a_footer_with_more_frames_is_a_problem() {
    let stretches = [held(0, 0, 30, &[0x7f, 1]), held(1, 30, 30, &[0x7f, 1])];
    let whole = take("dense", &stretches, Some(60));
    assert_eq!(frames(&whole).problems(), []);
    let cut = take("dense", &stretches[..1], Some(60));
    let cut = frames(&cut);
    assert_eq!(cut.problems(), [Problem::FooterRows { stated: 60, found: 30 }]);
}

/// Their numbers fit, because exactly as many are missing as there are numbers.
#[test]
fn a_row_reveals_missing_stretches_when_no_number_does() {
    let mut missing = Vec::new();
    let stretches = [held(0, 0, 30, &AT_REST), held(1, 33 * 30, 30, &AT_REST)];
    read_events(&take("dense", &stretches, None)[..], |event| {
        if let TakeEvent::Stretch(stretch) = event {
            missing.push(stretch.missing_before);
        }
        Ok(())
    })
    .unwrap();
    assert_eq!(missing, [false, true]);
}

#[test]
fn a_take_within_the_limits_is_read_back() {
    let take = {
        let mut writer = TakeWriter::new(Vec::new(), &header("dense")).unwrap();
        let span = Span { first_row: 0, n_rows: LIVE_ROWS_MAX as u32, key: true, number: 0 };
        let payload = held(0, 0, LIVE_ROWS_MAX, &[0x7f, 1]);
        writer.stretch(span, &payload, &StretchTally::default()).unwrap();
        writer.finish(&Ledger::default()).unwrap().0
    };
    let mut frames = frames(&take);
    let mut row = [[f32::NAN; 3]];
    let mut n_frames = 0;
    while frames.next_frame(&mut row).unwrap() {
        assert!(row[0].iter().all(|coordinate| coordinate.is_finite()));
        n_frames += 1;
    }
    assert_eq!(n_frames, LIVE_ROWS_MAX);
    assert_eq!(frames.problems(), []);
}

#[test]
fn duplicates_are_refused_after_a_seek() {
    let bad = &[0xff; 4];
    let stretches = [
        held(0, 0, 30, &AT_REST),
        held(1, 30, 30, &AT_REST),
        held(2, 60, 30, bad),
        held(1, 30, 30, &AT_REST),
        held(4, 90, 30, &AT_REST),
    ];
    let take = take("dense", &stretches, Some(120));
    let twice = Problem::Refused { first_row: 30, n_rows: 30, refusal: Refusal::Twice };
    let map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
    assert!(map.problems.contains(&twice), "{:?}", map.problems);
    for row in [0, 60] {
        // A map that was built without reading stretches leaves all problems to the traversal.
        let map = TakeMap { n_sampled_rows: None, ..map.clone() };
        let mut part = TakeTraversal::from_map(Cursor::new(&take), &map, Decode::All).unwrap();
        part.seek(row).unwrap();
        let mut rows = Vec::new();
        while let Some(span) = part.next_stretch().unwrap() {
            rows.push(span.first_row);
        }
        assert_eq!(rows, if row == 0 { vec![0, 30, 90] } else { vec![90] });
        assert!(part.problems().contains(&twice), "{:?}", part.problems());
    }
}

#[test]
fn a_stretch_that_is_refused_names_no_channels() {
    let (one, three) = (&[0x7f, 1], &[0x7f, 3]);
    let again = held(1, 0, 30, three);
    let take = take("dense", &[held(0, 0, 30, one), again], None);
    let map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
    assert_eq!((map.channels.len(), map.longest_stretch), (1, Some(30)));
    let scan = RecoveryScan::read(&take).unwrap();
    assert_eq!((scan.channels.len(), scan.per_channel.len()), (1, 1));
    let named = |problem: &Problem| matches!(problem, Problem::NamesLost { .. });
    assert!(!map.problems.iter().chain(&scan.problems).any(named), "{:?}", scan.problems);
    // A stretch that is not refused names all of them.
    let take = self::take("dense", &[held(0, 0, 30, one), held(1, 30, 30, three)], None);
    assert_eq!(RecoveryScan::read(&take).unwrap().channels.len(), 3);
}

#[test]
fn an_index_with_another_row_is_a_problem() {
    let take = take("dense", &[held(0, 0, 30, &AT_REST), held(1, 30, 30, &AT_REST)], Some(60));
    let mut map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
    map.n_sampled_rows = None;
    map.keys[1].first_row = 20;
    let mut part = TakeTraversal::from_map(Cursor::new(&take), &map, Decode::All).unwrap();
    part.seek(25).unwrap();
    assert_eq!(part.next_stretch().unwrap().map(|span| span.first_row), Some(30));
    assert_eq!(part.problems(), [Problem::IndexRow { stated: 20, found: 30 }]);
    assert!(!part.is_intact());
}

/// Names that deflate to nothing do not fill the memory: what exceeds the limit is left out, and reported.
#[test]
fn names_of_sampled_channels_are_bounded() {
    let channel = SampledChannel { name: "n".repeat(60_000), ..SampledChannel::default() };
    let group = |number: u32| SampledGroup {
        number,
        kind: "c3d/analog".to_owned(),
        part_channels: 64,
        samples_per_frame: 1,
        rate_hz: 60.0,
        channels: vec![channel.clone(); 64],
        ..SampledGroup::default()
    };
    let mut take = take("dense", &[held(0, 0, 30, &AT_REST)], None);
    let at = take.len();
    for number in 0..20 {
        let payload = group(number).to_chunk_payload().unwrap();
        chunk::put(&mut take, types::SAMPLED_GROUP, &payload).unwrap();
    }
    assert!(take.len() - at < 20 * 8192, "{} bytes", take.len() - at);
    let map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
    let groups = map.foreign.iter().filter_map(|part| part.sampled()).flat_map(SampledPart::groups);
    // 3.84 MB each.
    assert_eq!(groups.count(), 8);
    assert_eq!(map.samples_orphaned, 12);
    assert!(map.problems.contains(&Problem::SamplesOrphaned { chunks: 12 }), "{:?}", map.problems);
}
