//! Parts with samples in takes: whole, damaged, cut off and recovered.

mod times;

use std::{
    io::{self, Cursor},
    sync::Arc,
};

use mocapd_testkit::random::Random;

use super::{BLOCK_ROWS_MAX, SampleContent, SampleSpan};
use crate::{
    TakeError, TakeFrames, TakeMap, TakeWriter,
    chunk::{self, ChunkParse, types},
    damage::Problem,
    foreign::{
        Foreign,
        content::{Content, MemoryScratch, PartStore, ScratchFile},
    },
    interchange::c3d::columns::{
        ANALOG, ColumnReader, ColumnWriter, MODEL_OUTPUTS, RESIDUALS, SampleHeader, value,
    },
    interchange::c3d::sample_parts,
    motion::FrameSource,
    record::{
        CODEC_VERSION, Header, Ledger, Record, SampleBounds, SampleForm, SampledChannel,
        SampledGroup,
    },
    recovery::RecoveryScan,
    timeline::LossCauses,
};

const RATE_HZ: f64 = 10.0;

/// A part with these columns of words, from frame 11 on.
fn part(kind: &str, width: usize, ratio: usize, columns: &[Vec<u32>]) -> Foreign {
    let per_signal = if kind == MODEL_OUTPUTS { 4 } else { 1 };
    let n_signals = columns.len() / per_signal;
    let (length, first_frame) = (columns[0].len(), 11);
    let header = SampleHeader { width, n_signals, ratio, first_frame, n_frames: length / ratio };
    let mut data = header.encode();
    if per_signal > 1 {
        data.extend((0..n_signals as u32).flat_map(|signal| (3 * signal + 2).to_le_bytes()));
    }
    let from = data.len();
    data.resize(from + columns.len() * width * length, 0);
    let mut data = Content::from(data);
    for (i, column) in columns.iter().enumerate() {
        let at = (from + i * width * length) as u64;
        let words = column.iter().copied();
        ColumnWriter::new(width).write(&mut data, at, length, words).unwrap();
    }
    Foreign::exact(kind, data)
}

/// Columns of a walk, as integers of 16 bits or as floats of the same shape.
fn walks(seed: u64, n_columns: usize, length: usize, width: usize) -> Vec<Vec<u32>> {
    let mut random = Random::new(seed);
    let mut column = || {
        let mut at = 0_i32;
        let mut step = |_: usize| {
            at = (at + random.below(41) as i32 - 20).clamp(-32_768, 32_767);
            match width {
                2 => u32::from(at as u16),
                _ => crate::interchange::c3d::columns::ordered((at as f32 * 0.37).to_bits()),
            }
        };
        (0..length).map(&mut step).collect()
    };
    (0..n_columns).map(|_| column()).collect()
}

fn header() -> Header {
    Header {
        software: "test".to_owned(),
        resampler: "dense".to_owned(),
        codec_version: CODEC_VERSION,
        tolerance_mm: 1.0,
        rate_hz: RATE_HZ,
        stretch_rows: 50,
        ..Header::default()
    }
}

fn take_of(parts: &[Foreign]) -> Vec<u8> {
    let mut take = TakeWriter::new(Vec::new(), &header()).unwrap();
    parts.iter().for_each(|part| take.foreign(part).unwrap());
    take.finish(&Ledger { finished: true, ..Ledger::default() }).unwrap().0
}

fn memory_scratch() -> io::Result<Arc<dyn ScratchFile>> {
    Ok(Arc::new(MemoryScratch::default()))
}

/// The foreign parts of a take, and its problems.
fn read(take: &[u8]) -> (Vec<Foreign>, Vec<Problem>) {
    let frames = TakeFrames::open_with(Cursor::new(take), |_| true, memory_scratch).unwrap();
    (frames.info().foreign.clone(), frames.problems().to_vec())
}

/// The chunks of an undamaged take: types, and where they begin and end.
fn chunks(take: &[u8]) -> Vec<(u8, usize, usize)> {
    let (mut found, mut at) = (Vec::new(), chunk::MAGIC.len());
    while at < take.len() {
        let ChunkParse::Whole { kind, len, .. } = chunk::parse(&take[at..]) else { panic!("{at}") };
        found.push((kind, at, at + len));
        at += len;
    }
    found
}

/// The samples of each column as numbers.
fn columns_of(part: &Foreign, n_columns: usize) -> Vec<Vec<f32>> {
    let (header, rest) = part.data.as_slice().split_array().unwrap().unwrap();
    let header = SampleHeader::parse(&header).unwrap();
    let n = header.samples().unwrap();
    let mut reader = ColumnReader::new(rest, header.width, n_columns, n, 1 << 16).unwrap();
    let mut columns = vec![Vec::new(); n_columns];
    while let Some(row) = reader.next().unwrap() {
        for (column, &word) in columns.iter_mut().zip(row) {
            column.push(value(header.width, word, false));
        }
    }
    columns
}

#[test]
fn parts_round_trip_bit_for_bit() {
    let mut all: Vec<Foreign> = [
        (ANALOG, 2, 10, 3, 12_000),
        (ANALOG, 4, 10, 70, 300),
        (RESIDUALS, 2, 1, 130, 40),
        (RESIDUALS, 4, 1, 1, 1),
        (MODEL_OUTPUTS, 4, 1, 72, 35),
    ]
    .into_iter()
    .map(|(kind, width, ratio, n, length)| part(kind, width, ratio, &walks(7, n, length, width)))
    .collect();
    // Any bits of a float: infinities, NaN of every kind, subnormal numbers.
    let mut random = Random::new(3);
    let bits =
        (0..5).map(|_| (0..200).map(|_| random.next_u64() as u32).collect()).collect::<Vec<_>>();
    all.push(part(ANALOG, 4, 1, &bits));
    for part in all {
        let take = take_of(std::slice::from_ref(&part));
        let (found, problems) = read(&take);
        assert!(found == [part.clone()], "{}", part.kind);
        assert_eq!(problems, [], "{}", part.kind);
        let map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
        let [kept] = &map.foreign[..] else { panic!("{:?}", map.foreign) };
        assert_eq!((kept.data_bytes(), kept.sampled().is_some()), (part.data.len(), true));
        assert!(chunks(&take).iter().all(|(kind, ..)| *kind != types::FOREIGN));
    }
}

#[test]
fn parts_without_samples_or_of_an_unknown_layout_stay_foreign() {
    let whole = part(ANALOG, 2, 1, &walks(1, 2, 40, 2));
    let bytes = whole.data.to_vec(u64::MAX).unwrap().unwrap();
    let mut later = bytes.clone();
    later[0] = 2;
    for data in [later, bytes[..bytes.len() - 1].to_vec(), bytes[..26].to_vec(), Vec::new()] {
        let part = Foreign::exact(ANALOG, data);
        let take = take_of(std::slice::from_ref(&part));
        assert_eq!(read(&take), (vec![part], Vec::new()));
        assert!(chunks(&take).iter().any(|(kind, ..)| *kind == types::FOREIGN));
    }
}

/// 45 seconds, which are five key blocks, of one group and of a second one.
fn long_take() -> (Vec<u8>, Foreign) {
    let part = part(ANALOG, 2, 2, &walks(5, 66, 900, 2));
    (take_of(std::slice::from_ref(&part)), part)
}

#[test]
fn a_damaged_block_loses_only_its_samples_and_a_recovery_states_them() {
    let (take, whole) = long_take();
    let original = columns_of(&whole, 66);
    let samples: Vec<_> =
        chunks(&take).into_iter().filter(|(kind, ..)| *kind == types::SAMPLES).collect();
    assert_eq!(samples.len(), 10);
    for (i, &(_, from, to)) in samples.iter().enumerate() {
        let mut damaged = take.clone();
        damaged[(from + to) / 2] ^= 0x10;
        let lost = i % 5 * 200..(i % 5 * 200 + 200).min(900);
        let is_lost = |column: usize, row: usize| column / 64 == i / 5 && lost.contains(&row);
        let check = |take: &[u8]| {
            let (found, problems) = read(take);
            let found = columns_of(&found[0], 66);
            for (column, (found, original)) in found.iter().zip(&original).enumerate() {
                for (row, (found, original)) in found.iter().zip(original).enumerate() {
                    let expected = if is_lost(column, row) { f32::NAN } else { *original };
                    assert_eq!(found.to_bits(), expected.to_bits(), "{i} {column} {row}");
                }
            }
            problems
        };
        let problems = check(&damaged);
        let expected = Problem::SamplesLost {
            kind: ANALOG.to_owned(),
            channels: if i < 5 { [1, 64] } else { [65, 66] },
            first: lost.start as u64,
            n: lost.len() as u64,
        };
        assert!(problems.contains(&expected), "{problems:?}");
        let scan = RecoveryScan::read(&damaged).unwrap();
        assert!(scan.lost_anything());
        let mut new = Vec::new();
        scan.write(Cursor::new(&damaged), &mut new, "test").unwrap();
        let again = RecoveryScan::read(&new).unwrap();
        assert!(again.problems.is_empty() && !again.lost_anything(), "{:?}", again.problems);
        assert!(again.damage.is_empty());
        // Readers of the samples still learn that some are lost.
        assert_eq!(check(&new), [expected]);
    }
}

#[test]
fn a_take_that_is_cut_off_has_every_whole_chunk() {
    let (take, whole) = long_take();
    let original = columns_of(&whole, 66);
    let all = chunks(&take);
    let first_sample = all.iter().position(|(kind, ..)| *kind == types::SAMPLES).unwrap();
    for &(_, from, to) in &all[first_sample..first_sample + 10] {
        for end in [from + 1, to - 1, to] {
            let map = TakeMap::scan(&mut Cursor::new(&take[..end])).unwrap();
            let n_whole = all.iter().filter(|(kind, _, to)| *kind == types::SAMPLES && *to <= end);
            let n_whole = n_whole.count();
            let lost = map.foreign[0].sampled().unwrap().lost();
            let n_lost: u64 = lost.iter().map(|lost| lost.n).sum();
            let rows_of = |n: usize| if n >= 5 { 900 } else { 200 * n as u64 };
            let kept = rows_of(n_whole.min(5)) + rows_of(n_whole.saturating_sub(5));
            assert_eq!(n_lost, 1_800 - kept, "{end}");
            let found = columns_of(&read(&take[..end]).0[0], 66);
            let n = rows_of(n_whole.min(5)) as usize;
            assert_eq!(found[63][..n], original[63][..n]);
            assert!(found[63][n..].iter().all(|sample| sample.is_nan()));
        }
    }
}

#[test]
fn a_lost_description_costs_its_part_and_a_recovery_leaves_it_out() {
    let (take, _) = long_take();
    let groups: Vec<_> =
        chunks(&take).into_iter().filter(|(kind, ..)| *kind == types::SAMPLED_GROUP).collect();
    for (i, &(_, from, to)) in groups.iter().enumerate() {
        let mut damaged = take.clone();
        damaged[(from + to) / 2] ^= 0x10;
        let (found, problems) = read(&damaged);
        assert_eq!(found, []);
        let channels = if i == 0 { [1, 64] } else { [65, 66] };
        let kind = ANALOG.to_owned();
        assert!(problems.contains(&Problem::DescriptionLost { kind, channels }), "{problems:?}");
        assert!(problems.contains(&Problem::SamplesOrphaned { chunks: 5 }), "{problems:?}");
        let scan = RecoveryScan::read(&damaged).unwrap();
        let mut new = Vec::new();
        scan.write(Cursor::new(&damaged), &mut new, "test").unwrap();
        let again = RecoveryScan::read(&new).unwrap();
        assert!(again.problems.is_empty() && !again.lost_anything(), "{:?}", again.problems);
        assert_eq!(read(&new).0, []);
    }
}

/// Groups as a recording writes them: the number of samples is unknown, and some were never received.
#[test]
fn open_ended_groups_are_read_up_to_the_last_sample() {
    let mut take = TakeWriter::new(Vec::new(), &header()).unwrap();
    let group = SampledGroup {
        number: 4,
        kind: ANALOG.to_owned(),
        form: SampleForm::Float32,
        part_channels: 2,
        samples_per_frame: 10,
        rate_hz: 1000.0,
        channels: vec![SampledChannel::default(); 2],
        ..SampledGroup::default()
    };
    take.sampled_group(&group).unwrap();
    let mut encoder = mocapd_codec::sampled::SampledEncoder::new();
    let samples: Vec<f32> = (0..25).map(|i| i as f32 * 0.5).collect();
    let mut put = |first, n: usize, content| {
        let mut payload = Vec::new();
        SampleSpan { group: 4, first, n: n as u64, content }.put(&mut payload);
        if !matches!(content, SampleContent::Lost(_)) {
            let channels = [&samples[..n], &samples[..n]];
            encoder.encode(&channels, content == SampleContent::Key, &mut payload).unwrap();
        }
        take.chunk(types::SAMPLES, &payload).unwrap();
    };
    put(0, 25, SampleContent::Key);
    put(25, 10, SampleContent::Continued);
    put(35, 8, SampleContent::Lost(LossCauses::NOT_RECEIVED));
    put(43, 1, SampleContent::Key);
    put(44, 2, SampleContent::Continued);
    let take = take.finish(&Ledger { finished: true, ..Ledger::default() }).unwrap().0;
    let map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
    assert_eq!((map.damaged, map.problems), (false, Vec::new()));
    let (found, problems) = read(&take);
    assert_eq!(problems.len(), 1, "{problems:?}");
    // The last frame is completed.
    let column = &columns_of(&found[0], 2)[1];
    assert_eq!(column.len(), 50);
    assert_eq!([column[24], column[25], column[34]], [12.0, 0.0, 4.5]);
    assert!(column[35..43].iter().chain(&column[46..]).all(|sample| sample.is_nan()));
    assert_eq!(column[43..46], [0.0, 0.0, 0.5]);
}

#[test]
fn an_incomplete_frame_is_completed_with_nan_and_not_with_zeros() {
    let mut take = TakeWriter::new(Vec::new(), &header()).unwrap();
    let group = SampledGroup {
        kind: ANALOG.to_owned(),
        form: SampleForm::Int16,
        part_channels: 1,
        samples_per_frame: 10,
        rate_hz: 1000.0,
        channels: vec![SampledChannel::default()],
        ..SampledGroup::default()
    };
    take.sampled_group(&group).unwrap();
    let mut payload = Vec::new();
    SampleSpan { group: 0, first: 0, n: 15, content: SampleContent::Key }.put(&mut payload);
    let mut encoder = mocapd_codec::sampled::SampledEncoder::new();
    encoder.encode(&[&[7.0; 15]], true, &mut payload).unwrap();
    take.chunk(types::SAMPLES, &payload).unwrap();
    let take = take.finish(&Ledger { finished: true, ..Ledger::default() }).unwrap().0;
    let column = &columns_of(&read(&take).0[0], 1)[0];
    assert_eq!(column[..15], [7.0; 15]);
    assert_eq!(column.len(), 20);
    assert!(column[15..].iter().all(|sample| sample.is_nan()), "{column:?}");
}

/// A take with one channel: blocks of ten samples; the first and the fourth are keys.
fn continued_take(change: impl Fn(usize, &mut Vec<u8>)) -> Vec<u8> {
    let mut take = TakeWriter::new(Vec::new(), &header()).unwrap();
    let group = SampledGroup {
        kind: ANALOG.to_owned(),
        form: SampleForm::Int16,
        part_channels: 1,
        samples_per_frame: 1,
        rate_hz: RATE_HZ,
        n_samples: Some(50),
        channels: vec![SampledChannel::default()],
        ..SampledGroup::default()
    };
    take.sampled_group(&group).unwrap();
    let mut encoder = mocapd_codec::sampled::SampledEncoder::new();
    for block in 0..5 {
        let key = block % 3 == 0;
        let samples: Vec<f32> = (0..10).map(|i| (7 * block * i) as f32).collect();
        let mut payload = Vec::new();
        let content = if key { SampleContent::Key } else { SampleContent::Continued };
        SampleSpan { group: 0, first: 10 * block as u64, n: 10, content }.put(&mut payload);
        encoder.encode(&[&samples], key, &mut payload).unwrap();
        change(block, &mut payload);
        take.chunk(types::SAMPLES, &payload).unwrap();
    }
    take.finish(&Ledger { finished: true, ..Ledger::default() }).unwrap().0
}

#[test]
fn blocks_that_continue_a_lost_one_are_lost_up_to_the_next_key() {
    let whole = continued_take(|_, _| ());
    assert_eq!(read(&whole).1, []);
    let original = columns_of(&read(&whole).0[0], 1).concat();
    let is_samples = |(kind, ..): &(u8, usize, usize)| *kind == types::SAMPLES;
    let places: Vec<_> = chunks(&whole).into_iter().filter(is_samples).collect();
    for (block, lost) in [(0, 0..30), (1, 10..30), (2, 20..30), (3, 30..50), (4, 40..50)] {
        let (_, from, to) = places[block];
        let mut damaged = whole.clone();
        damaged[to - 5] ^= 0x40;
        // A chunk that is missing, without damaged bytes in its place.
        let missing = [&whole[..from], &whole[to..]].concat();
        // A valid chunk with an invalid block: of two channels, or with other bytes.
        let of_two = continued_take(|i, payload| {
            let head_bytes = 4;
            if i == block {
                payload[head_bytes] = 2;
            }
        });
        for (what, take) in [("damaged", damaged), ("missing", missing), ("of two", of_two)] {
            let (found, problems) = read(&take);
            let found = columns_of(&found[0], 1).concat();
            for (row, (found, original)) in found.iter().zip(&original).enumerate() {
                let expected = if lost.contains(&row) { f32::NAN } else { *original };
                assert_eq!(found.to_bits(), expected.to_bits(), "{what} {block} {row}");
            }
            assert!(!problems.is_empty(), "{what} {block}");
            let mut map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
            map.check_samples(&mut Cursor::new(&take)).unwrap();
            assert!(map.damaged && !map.problems.is_empty(), "{what} {block}");
            let scan = RecoveryScan::read(&take).unwrap();
            assert!(scan.lost_anything(), "{what} {block}");
            let mut new = Vec::new();
            scan.write(Cursor::new(&take), &mut new, "test").unwrap();
            let again = RecoveryScan::read(&new).unwrap();
            assert!(again.problems.is_empty() && !again.lost_anything(), "{:?}", again.problems);
            let map = TakeMap::scan(&mut Cursor::new(&new)).unwrap();
            let stated = map.foreign[0].sampled().unwrap().lost();
            let [stated] = stated[..] else { panic!("{stated:?}") };
            assert_eq!((stated.first, stated.n), (lost.start as u64, lost.len() as u64), "{what}");
            assert_eq!(stated.causes, Some(LossCauses::DAMAGED));
        }
    }
}

/// Every changed byte of descriptions, heads and blocks, with valid checksums, and random bytes in place of each chunk.
#[test]
fn hostile_chunks_give_errors_or_bounded_parts_and_can_be_recovered() {
    const CHANGES: [u8; 5] = [0x01, 0x08, 0x40, 0x80, 0xff];
    let whole = continued_take(|_, _| ());
    let places = chunks(&whole);
    let mut random = Random::new(11);
    let with = |at: usize, kind: u8, payload: &[u8]| {
        let (_, from, to) = places[at];
        let mut take = whole[..from].to_vec();
        chunk::put(&mut take, kind, payload).unwrap();
        take.extend(&whole[to..]);
        take
    };
    let mut takes = Vec::new();
    for (at, &(kind, from, to)) in places.iter().enumerate() {
        if ![types::SAMPLED_GROUP, types::SAMPLES].contains(&kind) {
            continue;
        }
        let ChunkParse::Whole { payload, .. } = chunk::parse(&whole[from..to]) else { panic!() };
        // For a description, the inflated bytes are changed: changed deflated bytes hardly ever inflate.
        let is_group = kind == types::SAMPLED_GROUP;
        let group = is_group.then(|| SampledGroup::from_chunk_payload(payload, 0).unwrap());
        let open = group.map_or_else(|| payload.to_vec(), |group| group.to_payload().unwrap());
        let seal = |bytes: &[u8]| if is_group { deflated(bytes) } else { bytes.to_vec() };
        for i in 0..open.len() {
            for change in CHANGES {
                let mut changed = open.clone();
                changed[i] ^= change;
                takes.push(with(at, kind, &seal(&changed)));
            }
            takes.push(with(at, kind, &seal(&open[..i])));
        }
        for n in [0, 3, 20, 200] {
            takes.push(with(at, kind, &random.bytes(n)));
        }
    }
    assert!(takes.len() > 700, "{}", takes.len());
    for take in takes {
        let opened = TakeFrames::open_with(Cursor::new(&take), |_| true, memory_scratch);
        let parts = opened.map(|frames| frames.info().foreign.clone()).unwrap_or_default();
        assert!(parts.iter().all(|part| part.data.len() < 1 << 28));
        let scan = RecoveryScan::read(&take).unwrap();
        let mut new = Vec::new();
        scan.write(Cursor::new(&take), &mut new, "test").unwrap();
        let again = RecoveryScan::read(&new).unwrap();
        assert!(again.problems.is_empty() && !again.lost_anything(), "{:?}", again.problems);
    }
}

/// The chunk payload of a description with these bytes.
fn deflated(payload: &[u8]) -> Vec<u8> {
    let (version, body) = payload.split_at(payload.len().min(2));
    let mut deflate =
        flate2::write::DeflateEncoder::new(version.to_vec(), flate2::Compression::fast());
    io::Write::write_all(&mut deflate, body).unwrap();
    deflate.finish().unwrap()
}

/// Old takes have the block of columns itself, deflated.
#[test]
fn deflated_parts_are_read_as_before() {
    let part = part(ANALOG, 2, 10, &walks(9, 3, 500, 2));
    let payload = crate::foreign::ForeignPayload::of(&part).unwrap();
    let deflated = payload.deflated.to_vec(u64::MAX).unwrap().unwrap();
    let mut take = TakeWriter::new(Vec::new(), &header()).unwrap();
    take.chunk(types::FOREIGN, &[payload.front, deflated].concat()).unwrap();
    let take = take.finish(&Ledger { finished: true, ..Ledger::default() }).unwrap().0;
    assert_eq!(read(&take), (vec![part], Vec::new()));
}

#[test]
fn impossible_chunks_are_refused() {
    let mut payload = Vec::new();
    let content = SampleContent::Key;
    SampleSpan { group: 1, first: 300, n: 5, content }.put(&mut payload);
    payload.push(1);
    let (span, block) = SampleSpan::parse(&payload).unwrap();
    assert_eq!((span.first, span.n, block), (300, 5, &[1][..]));
    let put = |span: SampleSpan, rest: &[u8]| {
        let mut payload = Vec::new();
        span.put(&mut payload);
        payload.extend(rest);
        SampleSpan::parse(&payload).map(|(span, _)| span)
    };
    let lost = SampleContent::Lost(LossCauses::DAMAGED);
    let many = SampleSpan { n: BLOCK_ROWS_MAX + 1, ..span };
    assert!(put(many, &[1]).is_err());
    assert!(put(SampleSpan { n: 0, ..span }, &[1]).is_err());
    assert!(put(SampleSpan { first: u64::MAX, ..span }, &[1]).is_err());
    assert!(put(span, &[]).is_err(), "a block without bytes");
    let lost = SampleSpan { content: lost, ..many };
    assert_eq!(put(lost, &[]), Ok(lost));
    assert!(put(lost, &[1]).is_err(), "a byte after the causes");
    for cut in 0..payload.len() {
        assert!(SampleSpan::parse(&payload[..cut]).is_err(), "{cut}");
    }
    payload[0] = 4;
    assert!(SampleSpan::parse(&payload).is_err());
}

/// Bounds come back with the samples, group by group, through a cut and through a join.
#[test]
fn bounds_of_parts_round_trip() {
    let mut whole = part(ANALOG, 4, 10, &walks(5, 70, 300, 4));
    whole.bounds = vec![0.0; 70];
    whole.bounds[66] = 0.25;
    let take = take_of(std::slice::from_ref(&whole));
    let versions = chunks(&take).into_iter().filter(|(kind, ..)| *kind == types::SAMPLED_GROUP);
    let head = |(_, start, _): (u8, usize, usize)| {
        let ChunkParse::Whole { payload, .. } = chunk::parse(&take[start..]) else { panic!() };
        payload[0]
    };
    assert_eq!(versions.map(head).collect::<Vec<_>>(), [1, 2], "the first group is exact");
    let (parts, problems) = read(&take);
    assert!(problems.is_empty());
    assert_eq!(parts, [whole.clone()]);

    let mut store = PartStore::new(true, &memory_scratch);
    let cut = sample_parts::cut(&whole, &(13..20), &mut store).unwrap().unwrap();
    assert_eq!(cut.0.bounds, whole.bounds);
    let mut other = whole.clone();
    (other.bounds[0], other.bounds[66]) = (0.5, 0.125);
    let joined = sample_parts::join(&[(&whole, 30), (&other, 30)], &mut store).unwrap().unwrap();
    assert_eq!((joined.bounds[0], joined.bounds[66]), (0.5, 0.25));
}

/// Readers of versions 1 and 2 skip groups of poses, with bounds or without.
fn poses_have_a_version_of_their_own(group: &SampledGroup, bounded: &[u8]) {
    let channels = group.channels.iter().cycle().take(8).cloned().collect();
    let poses = SampledGroup {
        kind: crate::sampled::POSES.to_owned(),
        form: SampleForm::Float32,
        channels,
        part_channels: 72,
        ..group.clone()
    };
    for bounds in [Vec::new(), vec![0.25; 8]] {
        let poses = SampledGroup { bounds: SampleBounds(bounds), ..poses.clone() };
        let stored = poses.to_chunk_payload().unwrap();
        assert_eq!(stored[..2], [3, 0]);
        assert_eq!(SampledGroup::from_chunk_payload(&stored, 0).unwrap(), poses);
        for version in [1, 2] {
            let other = [&[version, 0], &stored[2..]].concat();
            assert!(SampledGroup::from_chunk_payload(&other, 0).is_err(), "{version}");
        }
    }
    let other = [&[3, 0], &bounded[2..]].concat();
    assert!(SampledGroup::from_chunk_payload(&other, 0).is_err(), "no poses");
    let half = SampledGroup { channels: poses.channels[..7].to_vec(), ..poses };
    assert!(half.to_chunk_payload().is_err());
}

#[test]
fn descriptions_round_trip_and_impossible_ones_are_refused() {
    let channel = |i: u32| SampledChannel {
        name: format!("Fz{i}"),
        unit: "N".to_owned(),
        index: i,
        scale: -0.25,
        offset: 3.0,
    };
    let group = SampledGroup {
        number: 7,
        kind: ANALOG.to_owned(),
        form: SampleForm::Uint16,
        first_channel: 64,
        part_channels: 70,
        samples_per_frame: 20,
        rate_hz: 2000.0,
        n_samples: Some(40),
        channels: (0..6).map(channel).collect(),
        ..SampledGroup::default()
    };
    let payload = group.to_chunk_payload().unwrap();
    assert_eq!(SampledGroup::from_chunk_payload(&payload, 0).unwrap(), group);
    for cut in 0..payload.len() {
        assert!(SampledGroup::from_chunk_payload(&payload[..cut], 0).is_err(), "{cut}");
    }
    assert_eq!(payload[..2], [1, 0], "exact groups are of version 1");
    let bounds = SampleBounds(vec![0.0, 1.0, 0.0, 7.0, 0.0, 2.0]);
    let bounded = SampledGroup { bounds, ..group.clone() };
    let stored = bounded.to_chunk_payload().unwrap();
    assert_eq!(stored[..2], [2, 0]);
    assert_eq!(SampledGroup::from_chunk_payload(&stored, 0).unwrap(), bounded);
    for cut in 0..stored.len() {
        assert!(SampledGroup::from_chunk_payload(&stored[..cut], 0).is_err(), "{cut}");
    }
    let later = [&[4, 0], &stored[2..]].concat();
    let error = SampledGroup::from_chunk_payload(&later, 0).unwrap_err();
    assert!(matches!(error, TakeError::Unsupported { found: 4, .. }), "{error}");
    poses_have_a_version_of_their_own(&group, &stored);
    for bounds in [vec![1.0; 5], vec![0.5; 6], vec![-1.0; 6], vec![f64::NAN; 6]] {
        let refused = SampledGroup { bounds: SampleBounds(bounds), ..group.clone() };
        assert!(refused.to_chunk_payload().is_err(), "{refused:?}");
    }
    let extended = [&payload[..], &[0]].concat();
    assert!(SampledGroup::from_chunk_payload(&extended, 0).is_err());
    for refused in [
        SampledGroup { channels: Vec::new(), ..group.clone() },
        SampledGroup { channels: vec![channel(0); 65], part_channels: 200, ..group.clone() },
        SampledGroup { part_channels: 69, ..group.clone() },
        SampledGroup { rate_hz: f64::NAN, ..group.clone() },
        SampledGroup { rate_hz: 0.0, ..group.clone() },
        SampledGroup { n_samples: Some(u64::MAX), ..group.clone() },
    ] {
        assert!(refused.to_chunk_payload().is_err(), "{refused:?}");
    }
}
