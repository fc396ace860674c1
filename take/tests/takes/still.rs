//! Takes in which nothing moves take few bytes, in stretches that an import makes longer for them.

use std::{io, io::Cursor, ops::Range, time::Duration};

use mocapd_codec::{Effort, ResamplerKind, Settings, Tolerance};
use mocapd_take::{
    TakeError, TakeEvent,
    edit::{
        CutReport, EditContext, RepackReport, RepackSettings, SourceTake, check_repacked, concat,
        cut, repack,
    },
    frames::read_motion,
    motion::{GAP, Marker, Motion, MotionInfo, is_gap},
    motion_encoder::{channels, stretch_rows},
    reader::read_events,
    record::{CODEC_VERSION, Header, ImportSource, KeyDistance, LONG_KEYS_VERSION},
    recovery::RecoveryScan,
    stretch::Span,
};
use mocapd_testkit::random::Random;

const RATE_HZ: f64 = 100.0;
const N_MARKERS: usize = 7;

/// Markers at random places, each with an offset in millimetres from its place, or none.
fn motion(
    n_markers: usize,
    n_frames: usize,
    offset: impl FnMut(usize, usize) -> Option<[f32; 3]>,
) -> Motion {
    let mut random = Random::new(25);
    let mut offset = offset;
    let places: Vec<[f32; 3]> = (0..n_markers)
        .map(|_| std::array::from_fn(|_| random.between(-900.0, 900.0) as f32))
        .collect();
    let markers =
        (0..n_markers).map(|marker| Marker { label: format!("M{marker}"), labelled: true });
    let info = MotionInfo {
        rate_hz: RATE_HZ,
        n_frames: n_frames as u64,
        markers: markers.collect(),
        ..MotionInfo::default()
    };
    let mut positions_mm = Vec::with_capacity(n_frames * n_markers);
    for frame in 0..n_frames {
        positions_mm.extend(places.iter().enumerate().map(|(marker, place)| {
            let moved = |by: [f32; 3]| std::array::from_fn(|axis| place[axis] + by[axis]);
            offset(frame, marker).map_or(GAP, moved)
        }));
    }
    Motion { info, positions_mm }
}

/// Slow sway of 4 mm with the noise of a good rig; each marker but the first is hidden for a second now and then.
fn near_still() -> Motion {
    let mut random = Random::new(4);
    let mut hidden = [0_usize; N_MARKERS];
    motion(N_MARKERS, 24_000, |frame, marker| {
        if marker > 0 && hidden[marker] == 0 && random.one_in(1500) {
            hidden[marker] = 1 + random.below(200);
        }
        hidden[marker] = hidden[marker].saturating_sub(1);
        let phase = frame as f32 / 250.0 + marker as f32;
        let mut noise = || random.between(-0.05, 0.05) as f32;
        let at = [2.0 * phase.sin() + noise(), 2.0 * (0.7 * phase).cos() + noise(), noise()];
        (hidden[marker] == 0).then_some(at)
    })
}

/// The take of an import with `dense`.
fn imported(motion: &Motion, tolerance_mm: f64, effort: u8, keys: Option<Duration>) -> Vec<u8> {
    imported_with(motion, tolerance_mm, effort, keys.map(KeyDistance::Every))
}

fn imported_with(
    motion: &Motion,
    tolerance_mm: f64,
    effort: u8,
    keys: Option<KeyDistance>,
) -> Vec<u8> {
    let kind = if tolerance_mm > 0.0 { ResamplerKind::Dense } else { ResamplerKind::Lossless };
    let tolerance_mm = if tolerance_mm > 0.0 { tolerance_mm } else { 1.0 };
    let tolerance = Tolerance::from_mm(tolerance_mm).unwrap();
    let codec = Settings { kind, tolerance };
    let mut header = Header {
        software: "mocapd".to_owned(),
        codec_version: CODEC_VERSION,
        rate_hz: RATE_HZ,
        source: Some(ImportSource::default()),
        channels: channels(&motion.info.markers),
        ..Header::default()
    };
    header.set_codec(&codec);
    header.set_effort(Effort::new(effort).unwrap());
    header.stretch_rows =
        stretch_rows(&codec, RATE_HZ, motion.n_frames(), header.channels.len()) as u32;
    keys.into_iter().for_each(|distance| {
        header.set_key_distance(distance, motion.n_frames() as u64);
    });
    crate::encoded(motion, &header)
}

/// The stretches of a take whose every sample is within the tolerance.
fn spans(take: &[u8], motion: &Motion, tolerance_mm: f64) -> Vec<Span> {
    let (decoded, problems) = read_motion(Cursor::new(take)).unwrap();
    assert_eq!(problems, []);
    assert_eq!(decoded.positions_mm.len(), motion.positions_mm.len());
    for (decoded, original) in decoded.positions_mm.iter().zip(&motion.positions_mm) {
        assert_eq!(is_gap(*decoded), is_gap(*original));
        let off = decoded.iter().zip(original).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        assert!(is_gap(*decoded) || off.sqrt() <= tolerance_mm * 1.000_001, "{off}");
    }
    let mut spans = Vec::new();
    read_events(take, |event| {
        if let TakeEvent::Stretch(stretch) = event {
            spans.push(stretch.span);
        }
        Ok(())
    })
    .unwrap();
    spans
}

/// Numbers of rows of the stretches.
fn lengths(spans: &[Span]) -> Vec<u32> {
    assert!(spans.iter().all(|span| span.key));
    spans.iter().map(|span| span.n_rows).collect()
}

#[test]
fn an_hour_in_which_nothing_moves_takes_less_than_2_kb() {
    let still = motion(N_MARKERS, 360_000, |_, _| Some([0.0; 3]));
    let take = imported(&still, 0.1, 3, None);
    assert_eq!(lengths(&spans(&take, &still, 0.1)), [30_000; 12]);
    assert!(take.len() < 1300, "{} bytes", take.len());
}

#[test]
fn five_still_minutes_cost_little_more_than_ten_seconds() {
    let still = |n_rows| motion(N_MARKERS, n_rows, |_, _| Some([0.0; 3]));
    let (short, long) = (still(1000), still(30_000));
    for tolerance_mm in [0.1, 5.0] {
        let bytes = |motion| imported(motion, tolerance_mm, 3, None).len();
        let more = bytes(&long) - bytes(&short);
        assert!(more <= 16, "{more} bytes at {tolerance_mm} mm");
        // What a recorder writes is not changed by what follows: the least effort keeps stretches of ten seconds.
        let least = imported(&long, tolerance_mm, 1, None);
        assert_eq!(lengths(&spans(&least, &long, tolerance_mm)), [1000; 30]);
    }
}

#[test]
fn near_still_takes_are_joined_where_the_tolerance_holds_their_motion() {
    let near = near_still();
    let ten_s = Some(Duration::from_secs(10));
    for tolerance_mm in [0.1, 2.0, 5.0, 20.0] {
        let keyed = imported(&near, tolerance_mm, 3, ten_s);
        let take = imported(&near, tolerance_mm, 3, None);
        let spans = spans(&take, &near, tolerance_mm);
        if tolerance_mm < 5.0 {
            assert_eq!(lengths(&spans), [1000; 24]);
            // The setting that states the distance.
            assert!((1..20).contains(&(keyed.len() - take.len())));
        } else {
            assert_eq!(lengths(&spans), [24_000]);
            assert!(take.len() * 2 < keyed.len(), "{} of {} bytes", take.len(), keyed.len());
        }
    }
}

#[test]
fn stretches_end_where_motion_begins_in_every_group_of_markers() {
    // Only the last marker, of the second group, moves; nothing is seen in the last seconds.
    let moving = motion(70, 7_300, |frame, marker| {
        let is_moving = marker == 69 && (3_500..3_600).contains(&frame);
        let at = if is_moving { (frame - 3_500) as f32 } else { 0.0 };
        (frame < 7_000).then_some([at, 0.0, 0.0])
    });
    let take = imported(&moving, 0.5, 2, None);
    assert_eq!(lengths(&spans(&take, &moving, 0.5)), [3_000, 1_000, 3_300]);
}

#[test]
fn a_stated_distance_of_keys_is_kept() {
    let still = motion(3, 1_030, |_, _| Some([0.0; 3]));
    let take = imported(&still, 0.5, 3, Some(Duration::from_millis(2_500)));
    assert_eq!(lengths(&spans(&take, &still, 0.5)), [250, 250, 250, 250, 30]);
    let take = imported(&still, 0.5, 3, Some(Duration::from_secs(10)));
    assert_eq!(lengths(&spans(&take, &still, 0.5)), [1_000, 30]);
    let take = imported(&still, 0.5, 3, None);
    assert_eq!(lengths(&spans(&take, &still, 0.5)), [1_030]);
}

/// The keys of a take, and its version.
fn keys_of(take: &[u8]) -> (Vec<u64>, u16) {
    let source = SourceTake::read(&mut Cursor::new(take)).unwrap();
    let map = source.map();
    (map.keys.iter().map(|key| key.first_row).collect(), map.header.codec_version)
}

#[test]
fn keys_further_apart_than_ten_seconds_are_of_the_later_version_and_save_bytes() {
    let near = near_still();
    let every = |s| Some(KeyDistance::Every(Duration::from_secs(s)));
    for tolerance_mm in [0.0, 0.5, 20.0] {
        let with = |keys| imported_with(&near, tolerance_mm, 1, keys);
        let ten = with(every(10));
        assert_eq!(keys_of(&ten), ((0..24_000).step_by(1_000).collect(), CODEC_VERSION));
        let minute = with(every(60));
        assert_eq!(keys_of(&minute), (vec![0, 6_000, 12_000, 18_000], LONG_KEYS_VERSION));
        let none = with(Some(KeyDistance::FirstOnly));
        assert_eq!(keys_of(&none), (vec![0], LONG_KEYS_VERSION));
        let sizes = [&ten, &minute, &none].map(Vec::len);
        assert!(sizes[0] > sizes[1] && sizes[1] > sizes[2], "{tolerance_mm} mm: {sizes:?}");
        for take in [&ten, &minute, &none] {
            spans(take, &near, tolerance_mm.max(1e-9));
        }
    }
    // A take that ends before the second key would come is as it was.
    let short = motion(3, 900, |_, _| Some([0.0; 3]));
    let take = imported_with(&short, 0.5, 1, Some(KeyDistance::FirstOnly));
    assert_eq!(keys_of(&take), (vec![0], CODEC_VERSION));
}

#[test]
fn stretches_that_continue_others_are_lost_with_them_and_recovered_before() {
    // 40 markers: stretches of at most 26 214 rows.
    let moving = motion(40, 60_000, |frame, _| Some([frame as f32 / 7.0, 0.0, 0.0]));
    let take = imported_with(&moving, 5.0, 1, Some(KeyDistance::FirstOnly));
    assert_eq!(
        lengths_of(&spans(&take, &moving, 5.0)),
        [(20_000, true), (20_000, false), (20_000, false)]
    );
    let mut damaged = take.clone();
    let mut offsets = Vec::new();
    let mut at = mocapd_take::chunk::MAGIC.len();
    while let mocapd_take::chunk::ChunkParse::Whole { kind, len, .. } =
        mocapd_take::chunk::parse(&take[at..])
    {
        if kind == 3 {
            offsets.push(at + len / 2);
        }
        at += len;
    }
    damaged[offsets[1]] ^= 0x55;
    let mut input = Cursor::new(&damaged);
    let scan = RecoveryScan::read(&mut input).unwrap();
    let mut recovered = Vec::new();
    scan.write(&mut input, &mut recovered, "test").unwrap();
    let (found, _) = read_motion(Cursor::new(&recovered)).unwrap();
    let seen = found.positions_mm.chunks(40).take_while(|row| !is_gap(row[0])).count();
    assert_eq!(seen, 20_000, "all rows before the damage");
    assert_eq!(found.positions_mm.iter().filter(|at| !is_gap(**at)).count(), 20_000 * 40);
}

/// Numbers of rows of the stretches, and whether they are keys.
fn lengths_of(spans: &[Span]) -> Vec<(u32, bool)> {
    spans.iter().map(|span| (span.n_rows, span.key)).collect()
}

fn context() -> EditContext<'static> {
    EditContext {
        software: "test",
        new_scratch: &|| Err(io::ErrorKind::Unsupported.into()),
        on_rows: &|_| {},
    }
}

fn part(take: &[u8], rows: Range<u64>) -> (Vec<u8>, CutReport) {
    let source = SourceTake::read(&mut Cursor::new(take)).unwrap();
    let mut out = Vec::new();
    let report = cut(&source, Cursor::new(take), rows.clone(), &mut out, &context()).unwrap();
    let (whole, _) = read_motion(Cursor::new(take)).unwrap();
    let (found, problems) = read_motion(Cursor::new(&out)).unwrap();
    assert_eq!(problems, []);
    let n = whole.info.markers.len();
    let bits = |at: &[[f32; 3]]| -> Vec<_> { at.iter().map(|at| at.map(f32::to_bits)).collect() };
    let of_whole = &whole.positions_mm[rows.start as usize * n..rows.end as usize * n];
    assert!(bits(&found.positions_mm) == bits(of_whole), "{rows:?}");
    (out, report)
}

/// A part takes the bytes of its content, not of its floats.
#[test]
fn parts_of_still_stretches_stay_small() {
    let mut random = Random::new(9);
    let still = motion(N_MARKERS, 90_000, |_, _| {
        Some(std::array::from_fn(|_| random.between(-0.02, 0.02) as f32))
    });
    let take = imported(&still, 0.5, 3, None);
    assert!(take.len() < 1_000, "{} bytes", take.len());
    for rows in [10..80_000, 45_000..45_500, 0..70_001, 29_999..60_001, 12_345..90_000] {
        let (bytes, report) = part(&take, rows.clone());
        assert_eq!(report.rows_exact, 0, "{rows:?}");
        assert!(bytes.len() < 1_400, "{rows:?}: {} bytes", bytes.len());
    }
}

#[test]
fn whole_spans_of_a_part_are_encoded_again_and_the_parts_join_to_as_many_bytes() {
    let moving = motion(N_MARKERS, 2_000, |frame, marker| {
        let t = frame as f32 / 40.0 + marker as f32;
        Some([150.0 * t.sin(), 90.0 * (0.7 * t).cos(), 40.0 * (1.3 * t).sin()])
    });
    let take = imported(&moving, 1.0, 3, None);
    let (head, report) = part(&take, 0..720);
    assert_eq!((report.rows_copied, report.rows_exact), (704, 16));
    let (tail, report) = part(&take, 720..2_000);
    assert_eq!((report.rows_copied, report.rows_exact), (1_000, 280));
    let parts = [&head, &tail];
    let sources = parts.map(|take| SourceTake::read(&mut Cursor::new(take)).unwrap());
    let mut joined = Vec::new();
    concat(&sources, |i| Ok(Cursor::new(parts[i])), &mut joined, &context()).unwrap();
    let (again, report) = repacked(&joined, None).unwrap();
    assert_eq!(report.stretches, [4, 2]);
    assert!(again.len() < take.len() + 250, "{} of {} bytes", again.len(), take.len());
    assert!(again.len() + 20_000 < joined.len(), "{} of {} bytes", again.len(), joined.len());
    // A take that was only imported has nothing to join.
    let (again, report) = repacked(&take, None).unwrap();
    assert_eq!((again.len(), report.stretches), (take.len(), [2, 2]));
}

fn repacked(
    take: &[u8],
    settings: Option<&RepackSettings>,
) -> Result<(Vec<u8>, RepackReport), TakeError> {
    let source = SourceTake::read(&mut Cursor::new(take))?;
    let mut out = Vec::new();
    let report = repack(&source, Cursor::new(take), settings, &mut out, &context())?;
    let old = Cursor::new(take);
    let found = check_repacked(&source, old, Cursor::new(&out), settings, &context())?;
    assert_eq!(found, None);
    assert_eq!(report.bytes, out.len() as u64);
    Ok((out, report))
}

#[test]
fn a_lossless_take_is_encoded_like_its_source_and_another_is_refused() {
    let near = near_still();
    let lossless = imported(&near, 0.0, 1, None);
    let settings = |kind, tolerance_mm, keys| RepackSettings {
        codec: Settings { kind, tolerance: Tolerance::from_mm(tolerance_mm).unwrap() },
        effort: Effort::new(if kind == ResamplerKind::Dense { 2 } else { 1 }).unwrap(),
        keys,
    };
    let predictive = settings(ResamplerKind::LosslessPredictive, 1.0, None);
    let (smaller, _) = repacked(&lossless, Some(&predictive)).unwrap();
    assert!(smaller.len() * 100 < lossless.len() * 95, "{} of {}", smaller.len(), lossless.len());
    let none = Some(KeyDistance::FirstOnly);
    let (long, _) = repacked(&smaller, Some(&RepackSettings { keys: none, ..predictive })).unwrap();
    assert_eq!(keys_of(&long), (vec![0], LONG_KEYS_VERSION));
    assert!(long.len() < smaller.len());
    for tolerance_mm in [0.5, 5.0] {
        let dense = settings(ResamplerKind::Dense, tolerance_mm, None);
        let (take, report) = repacked(&smaller, Some(&dense)).unwrap();
        let imported = imported(&near, tolerance_mm, 2, None);
        spans(&take, &near, tolerance_mm);
        // The setting that names the old take is all that an import lacks.
        assert!(take.len() - imported.len() < 150, "{} and {}", take.len(), imported.len());
        assert_eq!(report.header.tolerance_mm, tolerance_mm);
        let refused = repacked(&take, Some(&predictive)).unwrap_err().to_string();
        assert!(refused.contains("need the source or a lossless take"), "{refused}");
    }
}
