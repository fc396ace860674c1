//! Takes whose markers are coded in another order than that of their source: whatever reads one shows the source's
//! order, and damage never gives a marker the samples of another.

use std::io::{self, Cursor};

use mocapd_codec::{GROUP_CHANNELS, ResamplerKind, Settings, Tolerance};
use mocapd_take::{
    ChannelOrder, TakeEnds, TakeError, TakeFrames, TakeMap, TakeTraversal,
    chunk::{self, ChunkParse, types},
    damage::Problem,
    edit::{self, EditContext, SourceTake},
    interchange::Format,
    motion::{Foreign, FrameSource, GAP, Marker, Motion, MotionFrames, MotionInfo, Source, is_gap},
    motion_encoder::{EncodePart, EncodePlan, MotionWriter, channels},
    reader::read_events,
    record::{Header, ImportSource, KeyDistance},
    recovery::RecoveryScan,
    sampled::SpanEncoder,
    traversal::Decode,
};

const ROWS: usize = 40;
const RATE_HZ: f64 = 10.0;

/// `n` markers that swing, each with a gap of its own, and the parts of a C3D file that belong to them.
fn motion(n: usize) -> Motion {
    let position = |row: usize, marker: usize| {
        if row % (marker + 7) == 3 {
            return GAP;
        }
        let t = row as f32 / 9.0 + marker as f32;
        [300.0 * t.sin(), 900.0 + 20.0 * marker as f32, 5.0 * t]
    };
    let rows = (0..ROWS).flat_map(|row| (0..n).map(move |marker| position(row, marker)));
    let label = |marker: usize| format!("m{:02}", marker * 37 % 100);
    let marker = |at: usize| Marker { label: label(at), labelled: at != 2 };
    let info = MotionInfo {
        rate_hz: RATE_HZ,
        n_frames: ROWS as u64,
        markers: (0..n).map(marker).collect(),
        source: Source {
            format: "c3d".to_owned(),
            unit: "mm".to_owned(),
            factor: 1.0,
            first_frame: 1,
            ..Source::default()
        },
        foreign: vec![residuals(n), gap_coordinates(n)],
        ..MotionInfo::default()
    };
    Motion { info, positions_mm: rows.collect() }
}

/// Residuals of which those of a marker differ from those of every other.
fn residuals(n: usize) -> Foreign {
    let mut data = vec![1, 2];
    data.extend([n as u32, 1].iter().flat_map(|number| number.to_le_bytes()));
    data.extend([1_u64, ROWS as u64].iter().flat_map(|number| number.to_le_bytes()));
    for marker in 0..n {
        // High bytes of differences, then their low bytes: twice the first sample, and no change.
        data.extend([0; ROWS]);
        data.push(2 * (marker % 100) as u8);
        data.extend([0; ROWS - 1]);
    }
    Foreign::exact("c3d/residuals", data)
}

/// Coordinates of some missing samples of every third marker, in runs of different lengths.
fn gap_coordinates(n: usize) -> Foreign {
    let markers = (0..n as u32).step_by(3);
    let mut data = vec![1];
    data.extend(1_u64.to_le_bytes());
    data.extend((markers.clone().count() as u32).to_le_bytes());
    for marker in markers {
        let n_samples = 1 + marker as usize % 3;
        data.extend(marker.to_le_bytes());
        data.extend([1, 3, n_samples as u64].iter().flat_map(|number| number.to_le_bytes()));
        data.extend((0..16 * n_samples).map(|byte| (byte + marker as usize) as u8));
    }
    Foreign::exact("c3d/gap-coordinates", data)
}

fn header(motion: &Motion, kind: ResamplerKind) -> Header {
    let mut header = Header {
        software: "order".to_owned(),
        take_id: [7; 16],
        rate_hz: RATE_HZ,
        source: Some(ImportSource {
            format: "c3d".to_owned(),
            unit: "mm".to_owned(),
            factor: 1.0,
            first_frame: 1,
            ..ImportSource::default()
        }),
        channels: channels(&motion.info.markers),
        stretch_rows: 10,
        ..Header::default()
    };
    header.set_codec(&Settings { kind, tolerance: Tolerance::from_mm(0.5).unwrap() });
    header.set_key_distance(KeyDistance::Every(std::time::Duration::from_secs(1)), u64::MAX);
    header
}

/// An order of `n` markers in which none is at its place.
fn order(n: usize) -> ChannelOrder {
    let group = |first: usize| {
        let len = GROUP_CHANNELS.min(n - first);
        (0..len).map(move |row| (first + (row + 1) % len) as u16).rev()
    };
    let columns = (0..n).step_by(GROUP_CHANNELS).flat_map(group);
    ChannelOrder::from_columns(columns.collect()).unwrap()
}

fn encoded(motion: &Motion, kind: ResamplerKind, order: &ChannelOrder) -> Vec<u8> {
    let header = header(motion, kind);
    let mut frames = MotionFrames::new(motion);
    let (plan, mut parts) = EncodePlan::new(&mut frames, &header).unwrap();
    let held: Vec<EncodePart> = parts.by_ref().collect::<Result<_, _>>().unwrap();
    let described = (parts.info(), &header);
    let mut take = MotionWriter::begin_in(&plan, described, order.clone(), Vec::new()).unwrap();
    for part in &motion.info.foreign {
        let ordered = take.ordered(part).unwrap();
        let Some(plan) = take.push_foreign(ordered.as_ref().unwrap_or(part)).unwrap() else {
            continue;
        };
        for span in plan.spans() {
            take.push_span(&SpanEncoder::default().encode(&span.unwrap()).unwrap()).unwrap();
        }
    }
    let mut encoder = plan.encoder();
    for part in &held {
        let rows = part.first_marker..part.first_marker + part.n_markers;
        let in_group = rows.map(|row| (order.column_of(row) - part.first_marker) as u8).collect();
        let coded = encoder.encode_in(part, Some(&in_group)).unwrap();
        take.push(part, &coded).unwrap();
    }
    take.finish().unwrap().1
}

/// The take in the order of its source, and in another.
fn pair(n: usize, kind: ResamplerKind) -> [Vec<u8>; 2] {
    let motion = motion(n);
    [ChannelOrder::default(), order(n)].map(|order| encoded(&motion, kind, &order))
}

fn read(take: &[u8]) -> Result<(Motion, Vec<Problem>), TakeError> {
    let no_scratch = || Err(io::ErrorKind::Unsupported.into());
    let mut frames = TakeFrames::open_with(Cursor::new(take), |_| true, no_scratch)?;
    let mut row = vec![GAP; frames.info().markers.len()];
    let mut positions_mm = Vec::new();
    while frames.next_frame(&mut row)? {
        positions_mm.extend_from_slice(&row);
    }
    Ok((Motion { info: frames.info().clone(), positions_mm }, frames.problems().to_vec()))
}

fn bits(motion: &Motion) -> Vec<[u32; 3]> {
    motion.positions_mm.iter().map(|at| at.map(f32::to_bits)).collect()
}

/// Offset, type and payload of each chunk.
fn chunks(take: &[u8]) -> Vec<(usize, u8, Vec<u8>)> {
    let (mut at, mut found) = (chunk::MAGIC.len(), Vec::new());
    while let ChunkParse::Whole { kind, payload, len } = chunk::parse(&take[at..]) {
        found.push((at, kind, payload.to_vec()));
        at += len;
    }
    found
}

/// A take of these chunks. The places in index and footer are those of the old one.
fn of_chunks(chunks: &[(usize, u8, Vec<u8>)]) -> Vec<u8> {
    let mut take = chunk::MAGIC.to_vec();
    chunks.iter().for_each(|(_, kind, payload)| chunk::put(&mut take, *kind, payload).unwrap());
    take
}

#[test]
fn readers_show_the_order_of_the_source() {
    for n in [3, 15, 70, 150] {
        let [own, ordered] = pair(n, ResamplerKind::LosslessPredictive);
        let ((expected, none), (found, problems)) = (read(&own).unwrap(), read(&ordered).unwrap());
        assert_eq!((none, problems), (Vec::new(), Vec::new()));
        assert_eq!(bits(&found), bits(&expected));
        assert_eq!(found.info, expected.info);
        assert_eq!(found.info.foreign, motion(n).info.foreign);
        // Without reading stretches, and with it.
        let map = TakeMap::open(&mut Cursor::new(&ordered)).unwrap();
        let scanned = TakeMap::scan(&mut Cursor::new(&ordered)).unwrap();
        assert_eq!(map.n_sampled_rows, None, "the heads of the chunks are enough");
        let own_map = TakeMap::open(&mut Cursor::new(&own)).unwrap();
        for found in [&map, &scanned] {
            assert_eq!(found.channels, own_map.channels);
            assert_eq!(found.order, order(n));
            assert_ne!(found.header.channels, found.channels);
            let samples = |map: &TakeMap| {
                let statistics = map.statistics.as_ref().unwrap();
                statistics.channels.iter().map(|of| (of.samples, of.gaps)).collect::<Vec<_>>()
            };
            assert_eq!(samples(found), samples(&own_map));
        }
        let ends = |take: &[u8]| TakeEnds::read(&mut Cursor::new(take)).unwrap().end.unwrap();
        assert_eq!(ends(&ordered).channels, ends(&own).channels);
        // Groups of channels are the same in both orders.
        let last = n - 1;
        let groups = Decode::Groups(vec![last / GROUP_CHANNELS]);
        let mut one = TakeTraversal::from_map(Cursor::new(&ordered), &map, groups).unwrap();
        one.next_stretch().unwrap().unwrap();
        let rows = one.rows().nth(last).flatten().unwrap();
        assert_eq!(rows.positions[0].map(f32::to_bits), bits(&expected)[last]);
    }
}

#[test]
fn an_export_to_c3d_is_that_of_the_own_order() {
    let [own, ordered] = pair(70, ResamplerKind::LosslessPredictive).map(|take| {
        let mut c3d = Vec::new();
        let motion = read(&take).unwrap().0;
        Format::C3d.write(&mut MotionFrames::new(&motion), &mut c3d).unwrap();
        c3d
    });
    assert!(own == ordered);
}

/// What an earlier version reads: the chunk skipped, and the section of the summary.
#[test]
fn a_reader_that_skips_the_order_has_everything_in_that_of_the_table() {
    let [own, ordered] = pair(15, ResamplerKind::LosslessPredictive);
    let mut without = chunks(&ordered);
    let at = without.iter().position(|(_, kind, _)| *kind == types::ORDER).unwrap();
    assert_eq!(without[at - 1].1, types::HEADER);
    without.remove(at);
    let (found, problems) = read(&of_chunks(&without)).unwrap();
    assert_eq!(problems.first(), Some(&Problem::OrderLost));
    let expected = read(&own).unwrap().0;
    let mut columns: Vec<Vec<[u32; 3]>> =
        (0..15).map(|i| bits(&expected).into_iter().skip(i).step_by(15).collect()).collect();
    let mut labels = expected.info.labels();
    order(15).apply(&mut columns);
    order(15).apply(&mut labels);
    assert_eq!(found.info.labels(), labels);
    for (i, column) in columns.iter().enumerate() {
        assert!(bits(&found).iter().skip(i).step_by(15).eq(column), "{i}");
    }
    // So are the residuals, which follow their marker.
    let residuals =
        |motion: &Motion| motion.info.foreign[0].data.to_vec(u64::MAX).unwrap().unwrap();
    let residual = |data: &[u8], i: usize| data[26 + 2 * ROWS * i + ROWS];
    let (ours, theirs) = (residuals(&found), residuals(&expected));
    for (row, label) in found.info.labels().iter().enumerate() {
        let column = expected.info.labels().iter().position(|other| other == label).unwrap();
        assert_eq!(residual(&ours, row), residual(&theirs, column), "{label}");
    }
}

/// Samples belong to their labels, and what reads without a problem is the original.
fn check(expected: &Motion, damaged: &[u8], what: &str) -> bool {
    let (found, problems) = match read(damaged) {
        Ok(read) => read,
        Err(TakeError::NotATake(_) | TakeError::Unsupported { .. }) => return false,
        Err(error) => panic!("{what}: {error}"),
    };
    let (n, labels) = (expected.info.markers.len(), expected.info.labels());
    assert_eq!(found.info.markers.len(), n, "{what}");
    for (column, label) in found.info.labels().iter().enumerate() {
        let own = labels.iter().position(|other| other == label);
        let own = own.unwrap_or_else(|| panic!("{what}: {label}"));
        let rows = found.positions_mm.iter().skip(column).step_by(n);
        for (row, at) in rows.enumerate().filter(|(_, at)| !is_gap(**at)) {
            let wanted = expected.positions_mm[row * n + own];
            assert_eq!(at.map(f32::to_bits), wanted.map(f32::to_bits), "{what}: {label} {row}");
        }
    }
    if problems.is_empty() {
        assert_eq!(bits(&found), bits(expected), "{what}");
        assert_eq!(found.info.labels(), labels, "{what}");
        assert!(found.info.foreign == expected.info.foreign, "{what}");
    }
    problems.is_empty()
}

#[test]
fn no_damage_gives_a_marker_the_samples_of_another() {
    let [_, ordered] = pair(5, ResamplerKind::Dense);
    let expected = read(&ordered).unwrap().0;
    assert!(check(&expected, &ordered, "whole"));
    for at in 0..ordered.len() {
        for by in [1, 0x80, 0xff] {
            let mut damaged = ordered.clone();
            damaged[at] ^= by;
            let what = format!("byte {at} ^ {by:02x}");
            let is_whole = check(&expected, &damaged, &what);
            assert!(!is_whole, "{what} goes unnoticed");
        }
        assert!(!check(&expected, &ordered[..at], &format!("cut at {at}")));
    }
}

#[test]
fn orders_that_are_missing_damaged_or_repeated_are_reported() {
    let [own, ordered] = pair(5, ResamplerKind::Dense);
    let expected = read(&ordered).unwrap().0;
    let all = chunks(&ordered);
    let at = all.iter().position(|(_, kind, _)| *kind == types::ORDER).unwrap();
    let with = |payload: &[u8]| {
        let mut changed = all.clone();
        changed[at].2 = payload.to_vec();
        of_chunks(&changed)
    };
    let other = ChannelOrder::from_columns(vec![1, 0, 2, 3, 4]).unwrap();
    let longer = order(6).to_payload();
    let mut repeated = all.clone();
    repeated.insert(at, all[at].clone());
    let mut late = all.clone();
    let moved = late.remove(at);
    let behind = late.iter().position(|(_, kind, _)| *kind == types::STRETCH).unwrap();
    late.insert(behind + 1, moved);
    let mut missing = all.clone();
    missing.remove(at);
    let no_permutation = [&all[at].2[..3], &[0xff, 0xff]].concat();
    for (damaged, what, problem) in [
        (with(&other.to_payload()), "another", "another order of the markers"),
        (with(&longer), "longer", "of another number of markers"),
        (with(&no_permutation), "no permutation", "no order of the markers"),
        (with(&[1]), "short", "shorter than its version"),
        (with(&[2, 0, 9]), "of a later version", "order of the markers in the source is lost"),
        (of_chunks(&repeated), "repeated", "before the first stretch of an import, once"),
        (of_chunks(&late), "late", "before the first stretch of an import, once"),
        (of_chunks(&missing), "missing", "order of the markers in the source is lost"),
    ] {
        let (found, problems) = read(&damaged).unwrap();
        let texts: Vec<String> = problems.iter().map(ToString::to_string).collect();
        assert!(texts.iter().any(|text| text.contains(problem)), "{what}: {texts:?}");
        assert!(!check(&expected, &damaged, what));
        // Without a valid one, the table's order holds.
        let labels = found.info.labels();
        let is_source = labels == expected.info.labels();
        assert_eq!(is_source, what == "repeated", "{what}: {labels:?}");
        // Summary and map agree with the traversal.
        let map = TakeMap::open(&mut Cursor::new(&damaged)).unwrap();
        assert!(!map.problems.is_empty(), "{what}");
    }
    // An invalid one, or one of a later version, does not keep the next one from being the first.
    for (before, is_damage) in [(&no_permutation[..], true), (&[2, 0, 9], false)] {
        let mut two = all.clone();
        two.insert(at, (0, types::ORDER, before.to_vec()));
        let two = of_chunks(&two);
        let (found, problems) = read(&two).unwrap();
        assert_eq!(found.info.labels(), expected.info.labels(), "{problems:?}");
        let is_reported =
            problems.iter().any(|p| p.to_string().contains("no order of the markers"));
        assert_eq!(is_reported, is_damage, "{problems:?}");
        let map = TakeMap::open(&mut Cursor::new(&two)).unwrap();
        assert_eq!(map.channels[0].label, expected.info.labels()[0]);
    }
    let mut orders = 0;
    read_events(&ordered, |event| {
        orders += usize::from(matches!(event, mocapd_take::TakeEvent::Order(_)));
        Ok(())
    })
    .unwrap();
    assert_eq!(orders, 1);
    assert!(!chunks(&own).iter().any(|(_, kind, _)| *kind == types::ORDER));
}

#[test]
fn a_recovery_restores_the_order() {
    let [_, ordered] = pair(15, ResamplerKind::Dense);
    let expected = read(&ordered).unwrap().0;
    let recovered = |take: &[u8]| {
        let scan = RecoveryScan::read(Cursor::new(take)).unwrap();
        let mut out = Vec::new();
        scan.write(Cursor::new(take), &mut out, "order").unwrap();
        (scan, out)
    };
    let all = chunks(&ordered);
    let (at, ..) = all.iter().find(|(_, kind, _)| *kind == types::ORDER).unwrap();
    let mut damaged = ordered.clone();
    damaged[at + 4] ^= 0x40;
    let without: Vec<_> =
        all.iter().filter(|(_, kind, _)| *kind != types::ORDER).cloned().collect();
    for (take, what) in
        [(ordered.clone(), "whole"), (damaged, "damaged"), (of_chunks(&without), "missing")]
    {
        let (scan, out) = recovered(&take);
        assert!(what == "missing" || !scan.lost_anything(), "{what}: {:?}", scan.problems);
        let (found, problems) = read(&out).unwrap();
        assert_eq!(problems, [], "{what}");
        assert_eq!(bits(&found), bits(&expected), "{what}");
        assert_eq!(found.info.labels(), expected.info.labels(), "{what}");
        assert!(found.info.foreign == expected.info.foreign, "{what}");
        let labels: Vec<_> = scan.channels.iter().map(|channel| &channel.label).collect();
        assert!(labels.into_iter().eq(&expected.info.labels()), "{what}");
        for (i, count) in scan.per_channel.iter().enumerate() {
            let rows = expected.positions_mm.iter().skip(i).step_by(15);
            assert_eq!(count.samples, rows.filter(|at| !is_gap(**at)).count() as u64, "{what} {i}");
        }
    }
    // Cut in the middle: the order stands in front.
    let (_, out) = recovered(&ordered[..ordered.len() * 2 / 3]);
    assert_eq!(read(&out).unwrap().0.info.labels(), expected.info.labels());
}

#[test]
fn edited_takes_keep_the_order() {
    let [own, ordered] = pair(15, ResamplerKind::Dense);
    let expected = read(&ordered).unwrap().0;
    let new_scratch = || Err(io::ErrorKind::Unsupported.into());
    let context = EditContext { software: "order", new_scratch: &new_scratch, on_rows: &|_| {} };
    let source = |take: &[u8]| SourceTake::read(&mut Cursor::new(take)).unwrap();
    let cut = |rows: std::ops::Range<u64>| {
        let mut out = Vec::new();
        edit::cut(&source(&ordered), Cursor::new(&ordered), rows, &mut out, &context).unwrap();
        out
    };
    // Whole stretches, and rows of some that are stored exactly.
    for (first, end) in [(0, 20), (10, 40), (3, 17)] {
        let (found, problems) = read(&cut(first..end)).unwrap();
        assert_eq!(problems, []);
        assert_eq!(found.info.markers, expected.info.markers);
        let rows = first as usize * 15..end as usize * 15;
        assert_eq!(bits(&found), bits(&expected)[rows]);
    }
    let parts = [cut(0..20), cut(20..40)];
    let sources = parts.each_ref().map(|part| source(part));
    let mut joined = Vec::new();
    let open = |i: usize| Ok(Cursor::new(&parts[i]));
    edit::concat(&sources, open, &mut joined, &context).unwrap();
    let (found, problems) = read(&joined).unwrap();
    assert_eq!(problems, []);
    assert_eq!((bits(&found), found.info.labels()), (bits(&expected), expected.info.labels()));
    assert!(found.info.foreign == expected.info.foreign);
    // More markers than the take before, of which only the further ones are in another order.
    let further = ChannelOrder::from_columns((0..13).chain([14, 13]).collect()).unwrap();
    let fewer = encoded(&motion(13), ResamplerKind::Dense, &ChannelOrder::default());
    let more = encoded(&motion(15), ResamplerKind::Dense, &further);
    let refused = edit::check_joinable(&[source(&fewer), source(&more)]).unwrap_err();
    assert!(refused.to_string().contains("coded in another order"), "{refused}");
    // Blocks in different orders cannot continue each other.
    let refused = edit::check_joinable(&[source(&ordered), source(&own)]).unwrap_err();
    assert!(refused.to_string().contains("coded in another order"), "{refused}");
}
