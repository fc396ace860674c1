//! Parts of generated takes, and takes joined of parts, compared row by row with the whole.

mod foreign;
mod repacking;
mod seam;

use std::{
    io::{self, Cursor},
    ops::Range,
};

use mocapd_codec::{BlockReport, Effort, GROUP_CHANNELS, Rows, Settings, Tolerance};
use mocapd_testkit::random::Random;

use super::{CutOrigin, *};
use crate::{
    TakeEvent, TakeFrames, TakeTraversal, TakeWriter,
    chunk::{self, ChunkParse, types},
    foreign::content::Content,
    interchange::c3d::columns::{ANALOG, ColumnWriter, SampleHeader},
    motion::{
        Foreign, FrameSource, GAP, Marker, Motion, MotionFrames, MotionInfo, Position, is_gap,
    },
    motion_encoder::{EncodePlan, MotionWriter, channels, stretch_rows},
    record::{
        CODEC_VERSION, Channel, Clock, ClockLine, ClockPoint, Device, EndingKind, Event, EventKind,
        FIRST_FRAME_SETTING, Header, ImportSource, KeyDistance, Ledger, PART_SETTING,
        SERIES_SETTING, SPLIT_SETTING, SampleForm, TakeEnding,
    },
    recovery::RecoveryScan,
    sampled::LostSamples,
    statistics::{BlockTally, StretchTally, TakeTally},
    stretch::{Span, StretchHeaderWriter, put_block},
    timeline::{LossCauses, RowTime, Timeline, TimelineEncoder},
    traversal::Decode,
};

const RATE_HZ: f64 = 100.0;
const TICK_HZ: u64 = 1_000_000;
const STRETCH_ROWS: u32 = 25;

fn settings(kind: &str) -> Settings {
    Settings { kind: kind.parse().unwrap(), tolerance: Tolerance::from_mm(0.5).unwrap() }
}

fn channel(i: usize) -> Channel {
    Channel { marker_id: i as u16, label: format!("m{i}"), labelled: true }
}

fn header(kind: &str) -> Header {
    let mut header = Header {
        software: "test".to_owned(),
        take_id: [7; 16],
        codec_version: CODEC_VERSION,
        rate_hz: RATE_HZ,
        stretch_rows: STRETCH_ROWS,
        ..Header::default()
    };
    header.set_codec(&settings(kind));
    header
}

/// A smooth path with noise, and a marker's presence: away now and then.
fn column(marker: usize, n_rows: usize) -> (Vec<Position>, Vec<bool>) {
    let mut random = Random::new(marker as u64);
    let mut away = 0;
    let row = |i: usize| {
        let t = i as f64 / RATE_HZ;
        let axis = |phase: f64| 900.0 * (t * 1.7 + phase + marker as f64).sin();
        let position =
            [0.0, 1.3, 2.6].map(|phase| (axis(phase) + random.between(-0.2, 0.2)) as f32);
        away =
            if random.one_in(80) { 1 + random.below(40) } else { usize::saturating_sub(away, 1) };
        (position, away == 0)
    };
    (0..n_rows).map(row).unzip()
}

/// Which rows a recording lost, and why.
fn losses(n_rows: usize) -> Vec<Option<LossCauses>> {
    let mut random = Random::new(99);
    let (mut lost, mut left) = (None, 0);
    let row = |i: usize| {
        if left == 0 {
            let causes =
                [LossCauses::NOT_RECEIVED, LossCauses::RING_FULL, LossCauses::DISCONNECTED];
            lost = random.one_in(60).then(|| causes[random.below(3)]);
            left = if lost.is_some() { 1 + random.below(70) } else { 1 };
        }
        left -= 1;
        lost.filter(|_| i > 0)
    };
    (0..n_rows).map(row).collect()
}

/// Markers from the start, and one more that appears later, in a group of its own.
const EARLY: usize = GROUP_CHANNELS;
const APPEARS_AT: u64 = 300;

/// A recording of `n_rows` rows with gaps, lost rows, a marker that appears, events and clock observations. A key stretch
/// every fourth.
fn recording(kind: &str, n_rows: usize) -> Vec<u8> {
    recording_with(kind, n_rows, Vec::new())
}

/// The same with these settings in its header.
fn recording_with(kind: &str, n_rows: usize, of_header: Vec<(String, String)>) -> Vec<u8> {
    let settings = settings(kind);
    let device = Device { driver: "test".to_owned(), tick_hz: TICK_HZ, ..Device::default() };
    let header = Header {
        device: Some(device),
        created_unix_ms: 1_700_000_000_000,
        channels: (0..EARLY).map(channel).collect(),
        settings: of_header,
        ..header(kind)
    };
    let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
    let times = TimelineEncoder::new(TICK_HZ, RATE_HZ);
    let mut front = StretchHeaderWriter::with_times(STRETCH_ROWS, times);
    let mut encoders = [settings.encoder(), settings.encoder()];
    let mut columns: Vec<_> = (0..=EARLY).map(|marker| column(marker, n_rows)).collect();
    let lost = losses(n_rows);
    let mut random = Random::new(5);
    let mut ledger = Ledger { finished: true, ..Ledger::default() };
    let (mut at, mut number, mut has_late) = (0, 0, false);
    while at < n_rows {
        // Rows lost before the stretch, then up to its number of rows.
        let mut timeline = Timeline::default();
        timeline.restart(at as u64);
        let mut first = at;
        while let Some(Some(causes)) = lost.get(first) {
            timeline.push_lost(1, *causes);
            first += 1;
        }
        let end = (first + STRETCH_ROWS as usize).min(n_rows);
        for (row, lost) in lost.iter().enumerate().take(end).skip(first) {
            match lost {
                Some(causes) => timeline.push_lost(1, *causes),
                None => timeline.push(RowTime {
                    device_ticks: 5_000_000_000 + row as u64 * 10_000 + random.below(3) as u64,
                    arrival_10us: 77_000 + row as u64 * 1000 + random.below(400) as u64,
                    timecode: (row % 3 > 0).then_some([1, 2, (row / 30) as u8, (row % 30) as u8]),
                }),
            }
        }
        if !has_late && first as u64 >= APPEARS_AT {
            take.channels(&[channel(EARLY)]).unwrap();
            has_late = true;
        }
        let n_channels = EARLY + usize::from(has_late);
        for (marker, (_, present)) in columns.iter_mut().enumerate() {
            (first..end).for_each(|row| present[row] &= lost[row].is_none() && marker < n_channels);
        }
        let span = Span {
            first_row: first as u64,
            n_rows: (end - first) as u32,
            key: number % 4 == 0,
            number: (number % 32) as u8,
        };
        let mut payload = Vec::new();
        front.put(span, &timeline, &[], !has_late, &mut payload);
        let rows: Vec<_> = columns[..n_channels]
            .iter()
            .map(|(positions, present)| Rows::new(&positions[first..end], &present[first..end]))
            .map(Result::unwrap)
            .collect();
        let mut tally = BlockTally::default();
        tally.restart(end - first);
        if first < end {
            for (group, encoder) in rows.chunks(GROUP_CHANNELS).zip(&mut encoders) {
                let (mut block, mut reports) =
                    (Vec::new(), vec![BlockReport::default(); group.len()]);
                encoder.encode(group, &[], span.key, &mut block, &mut reports).unwrap();
                put_block(&block, !has_late, &mut payload);
                let kept_rows = encoder.kept_rows();
                tally.append(&BlockTally::of_encoded(&block, group, &reports, kept_rows));
                ledger.samples_present += reports.iter().map(|r| u64::from(r.samples)).sum::<u64>();
            }
        }
        take.stretch(span, &payload, &StretchTally::of(&tally)).unwrap();
        ledger.frames_sent += timeline.n_rows();
        ledger.recorded += timeline.n_recorded();
        ledger.samples_announced += timeline.n_recorded() * n_channels as u64;
        for (causes, counter) in [
            (LossCauses::NOT_RECEIVED, &mut ledger.lost_on_link),
            (LossCauses::RING_FULL, &mut ledger.lost_ring_full),
            (LossCauses::DISCONNECTED, &mut ledger.unknown_after_disconnect),
        ] {
            let runs = timeline.runs.iter().filter(|run| run.lost == Some(causes));
            *counter += runs.map(|run| run.rows).sum::<u64>();
        }
        if number % 3 == 0 {
            take.event(&event(end as u64)).unwrap();
        }
        if number % 7 == 0 {
            take.clock(&clock(at as u64)).unwrap();
        }
        (at, number) = (end, number + 1);
    }
    ledger.samples_occluded = ledger.samples_announced - ledger.samples_present;
    let ending = Some(TakeEnding::from(EndingKind::DeviceEnded));
    take.close(&ledger, ending).unwrap();
    take.abandon()
}

fn event(row: u64) -> Event {
    let text = format!("at row {row}");
    Event { row, device_ticks: row * 3, input: 2, ..Event::new(EventKind::Mark, row * 7, text) }
}

fn clock(row: u64) -> Clock {
    let point = ClockPoint { device_ticks: row * 10_000, host_us: row * 10_000 + 3 };
    let line = ClockLine { device_ticks: row, ..ClockLine::default() };
    Clock { tick_hz: TICK_HZ, line: Some(line), points: vec![point], ..Clock::default() }
}

/// An import, in stretches of ten seconds; the resamplers of whole takes have one.
fn import(kind: &str, n_rows: usize) -> Vec<u8> {
    import_with(kind, n_rows, Vec::new())
}

fn import_with(kind: &str, n_rows: usize, foreign: Vec<Foreign>) -> Vec<u8> {
    let n_markers = 5;
    let columns: Vec<_> = (0..n_markers).map(|marker| column(marker, n_rows)).collect();
    let mut positions_mm = Vec::new();
    for row in 0..n_rows {
        let at = |(positions, present): &(Vec<Position>, Vec<bool>)| {
            if present[row] { positions[row] } else { GAP }
        };
        positions_mm.extend(columns.iter().map(at));
    }
    let marker = |i| Marker { label: format!("m{i}"), labelled: true };
    let markers: Vec<_> = (0..n_markers).map(marker).collect();
    let info = MotionInfo {
        rate_hz: RATE_HZ,
        n_frames: n_rows as u64,
        markers,
        foreign,
        ..MotionInfo::default()
    };
    imported(kind, &Motion { info, positions_mm }, None)
}

/// The take of an import, with this distance of keys.
fn imported(kind: &str, motion: &Motion, keys: Option<KeyDistance>) -> Vec<u8> {
    let (n_rows, n_markers) = (motion.n_frames(), motion.info.markers.len());
    let mut header = header(kind);
    header.channels = channels(&motion.info.markers);
    header.stretch_rows = stretch_rows(&settings(kind), RATE_HZ, n_rows, n_markers) as u32;
    keys.into_iter().for_each(|keys| header.set_key_distance(keys, n_rows as u64));
    let source = ImportSource {
        format: "csv".to_owned(),
        file: "a.csv".to_owned(),
        factor: 1.0,
        first_frame: 11,
        ..ImportSource::default()
    };
    header.source = Some(source);
    let mut frames = MotionFrames::new(motion);
    let (plan, parts) = EncodePlan::new(&mut frames, &header).unwrap();
    let mut writer = MotionWriter::new(&plan, &motion.info, &header, Vec::new()).unwrap();
    let mut encoder = plan.encoder();
    for part in parts {
        let part = part.unwrap();
        writer.push(&part, &encoder.encode(&part).unwrap()).unwrap();
    }
    writer.finish().unwrap().1
}

fn context() -> EditContext<'static> {
    EditContext {
        software: "test",
        new_scratch: &|| Err(io::ErrorKind::Unsupported.into()),
        on_rows: &|_| {},
    }
}

fn source(take: &[u8]) -> SourceTake {
    SourceTake::read(&mut Cursor::new(take)).unwrap()
}

fn part_of(take: &[u8], rows: Range<u64>) -> (Vec<u8>, CutReport) {
    let mut part = Vec::new();
    let report = cut(&source(take), Cursor::new(take), rows, &mut part, &context()).unwrap();
    assert_eq!(report.bytes, part.len() as u64);
    assert!(report.rows_copied + report.rows_exact <= report.rows);
    (part, report)
}

fn joined(takes: &[Vec<u8>]) -> (Vec<u8>, ConcatReport) {
    let sources: Vec<_> = takes.iter().map(|take| source(take)).collect();
    let mut all = Vec::new();
    let open = |i: usize| Ok(Cursor::new(&takes[i][..]));
    let report = concat(&sources, open, &mut all, &context()).unwrap();
    assert_eq!(report.bytes, all.len() as u64);
    (all, report)
}

/// Everything that a row has.
#[derive(Debug, Clone, PartialEq)]
struct RowContent {
    /// By channel, the bits of its position, and the error that its block states.
    samples: Vec<Option<([u32; 3], f64)>>,
    time: Option<RowTime>,
    lost: Option<LossCauses>,
}

/// Asserts that a take states the statistics that its samples have.
fn check_statistics(take: &[u8]) {
    let mut tally = TakeTally::default();
    let traversal = TakeTraversal::new(Cursor::new(take), Decode::All);
    let found = traversal.run(|found, progress| {
        tally.follow_table(found.lost_entries, progress.channels().len());
        if let TakeEvent::Stretch(stretch) = &found.event {
            tally.add(stretch.span, &StretchTally::of_decoded(stretch, progress.rows()));
        }
        Ok(())
    });
    let map = found.unwrap().take;
    assert_eq!(map.statistics.unwrap(), tally.finish(map.n_rows));
}

/// All rows of a take, which must be whole and agree with its index and its statistics.
fn rows_of(take: &[u8]) -> Vec<RowContent> {
    check_statistics(take);
    let mut frames = TakeFrames::open(Cursor::new(take)).unwrap();
    let quick = TakeMap::open(&mut Cursor::new(take)).unwrap();
    assert_eq!(quick.n_sampled_rows, None, "its end and the heads of its chunks agree");
    assert_eq!(quick.keys, frames.map().keys);
    let mut row = vec![GAP; frames.info().markers.len()];
    let mut rows = Vec::new();
    while frames.next_frame(&mut row).unwrap() {
        let sample = |(i, position): (usize, &Position)| {
            let stated_mm = frames.stated_error_mm(i).unwrap_or(-1.0);
            (!is_gap(*position)).then(|| (position.map(f32::to_bits), stated_mm))
        };
        let samples = row.iter().enumerate().map(sample).collect();
        rows.push(RowContent { samples, time: None, lost: None });
    }
    assert_eq!(frames.problems(), []);
    let mut traversal = TakeTraversal::new(Cursor::new(take), Decode::Groups(Vec::new()));
    while traversal.next_stretch().unwrap().is_some() {
        let Some(timeline) = traversal.timeline() else { continue };
        timeline.recorded().for_each(|(row, time)| rows[row as usize].time = Some(time));
        let mut at = timeline.first_row;
        for run in &timeline.runs {
            (at..at + run.rows).for_each(|row| rows[row as usize].lost = run.lost);
            at += run.rows;
        }
    }
    rows
}

/// Rows with the channels of a part, which lacks those that appear behind it.
fn with_channels(rows: &[RowContent], n: usize) -> Vec<RowContent> {
    let row = |row: &RowContent| {
        assert!(row.samples[n..].iter().all(Option::is_none), "a sample of a channel left out");
        RowContent { samples: row.samples[..n].to_vec(), ..row.clone() }
    };
    rows.iter().map(row).collect()
}

fn check_part(take: &[u8], whole: &[RowContent], rows: Range<u64>) -> (Vec<u8>, CutReport) {
    let (part, report) = part_of(take, rows.clone());
    let map = source(&part).map().clone();
    let expected = &whole[rows.start as usize..rows.end as usize];
    assert!(rows_of(&part) == with_channels(expected, map.channels.len()), "rows {rows:?}");
    let ledger = map.ledger.unwrap();
    assert!(ledger.closes(), "rows {rows:?}: {ledger:?}");
    assert_eq!(ledger, report.ledger);
    let samples = expected.iter().flat_map(|row| &row.samples).flatten().count() as u64;
    assert_eq!((ledger.frames_sent, ledger.samples_present), (rows.end - rows.start, samples));
    let n_lost = expected.iter().filter(|row| row.lost.is_some()).count() as u64;
    assert_eq!(ledger.frames_lost(), n_lost);
    (part, report)
}

#[test]
fn every_range_of_a_recording_has_its_rows_times_and_events() {
    for kind in ["dense", "fast", "lossless", "lossless:predictive"] {
        let take = recording(kind, 900);
        let whole = rows_of(&take);
        assert!(whole.iter().filter(|row| row.lost.is_some()).count() > 50);
        let mut random = Random::new(3);
        let keys = source(&take).map().keys.clone();
        let at_keys = keys.windows(2).map(|pair| pair[0].first_row..pair[1].first_row);
        let around = keys.iter().map(|key| key.first_row.saturating_sub(1)..key.first_row + 2);
        let anywhere = (0..20).map(|_| {
            let start = random.below(899) as u64;
            start..start + 1 + random.below(900 - start as usize) as u64
        });
        for rows in at_keys.chain(around).chain(anywhere).chain([0..900, 0..1, 899..900]) {
            let (part, _) = check_part(&take, &whole, rows.clone());
            let events: Vec<_> =
                source(&part).map().events.iter().map(|e| e.text.clone()).collect();
            let is_inside = |row: &u64| rows.contains(row) || (rows.end == 900 && *row >= 900);
            let inside = source(&take)
                .map()
                .events
                .iter()
                .filter(|e| is_inside(&e.row))
                .map(|e| e.text.clone())
                .collect::<Vec<_>>();
            assert_eq!(events, inside, "{kind} {rows:?}");
            for event in &source(&part).map().events {
                assert_eq!(event.text, format!("at row {}", event.row + rows.start));
            }
            assert_eq!(source(&part).clocks, source(&take).clocks);
        }
    }
}

#[test]
fn only_rows_before_the_first_key_and_of_the_last_stretch_are_stored_as_floats() {
    let take = recording("dense", 900);
    let whole = rows_of(&take);
    let keys = source(&take).map().keys.clone();
    let (a, b) = (keys[1].first_row, keys[4].first_row);
    let (_, report) = check_part(&take, &whole, a..b);
    let lost = whole[a as usize..b as usize].iter().filter(|row| row.lost.is_some()).count() as u64;
    assert_eq!(report.rows_exact, 0);
    assert!(report.rows_copied + lost >= b - a, "{report:?}");
    let (_, report) = check_part(&take, &whole, a - 10..b + 10);
    assert!((1..=20).contains(&report.rows_exact), "{report:?}");
    let rows = source(&take).whole_stretches(Cursor::new(&take), &(a + 5..b - 60)).unwrap();
    assert!(rows.start == a && (b - 60..b).contains(&rows.end), "{rows:?}");
    assert_eq!(check_part(&take, &whole, rows).1.rows_exact, 0);
    assert_eq!(source(&take).whole_stretches(Cursor::new(&take), &(0..900)).unwrap(), 0..900);
}

#[test]
fn every_range_of_an_import_has_its_rows() {
    for kind in ["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"] {
        let take = import(kind, 2300);
        let whole = rows_of(&take);
        for rows in [0..2300, 0..1, 17..400, 990..1010, 1000..2000, 999..2300, 2299..2300] {
            let (part, _) = check_part(&take, &whole, rows.clone());
            let map = source(&part).map().clone();
            assert_eq!(map.header.source.unwrap().first_frame, 11 + rows.start, "{kind}");
            assert_eq!(map.header.created_unix_ms, 0);
            // The part of a part is the part of the whole, except for what it states of its origin.
            if rows.end - rows.start > 3 {
                let (again, _) = part_of(&part, 1..rows.end - rows.start);
                let (direct, _) = part_of(&take, rows.start + 1..rows.end);
                assert!(rows_of(&again) == rows_of(&direct), "{kind} {rows:?}");
            }
        }
    }
}

#[test]
fn parts_join_to_the_whole() {
    let mut random = Random::new(12);
    for kind in ["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"] {
        let is_live = settings(kind).kind.is_live();
        let takes = [Some(import(kind, 1500)), is_live.then(|| recording(kind, 900))];
        for take in takes.into_iter().flatten() {
            let whole = rows_of(&take);
            let n_rows = whole.len() as u64;
            for n_parts in [2, 3, 7] {
                let mut cuts: Vec<u64> =
                    (1..n_parts).map(|_| 1 + random.below(n_rows as usize - 1) as u64).collect();
                cuts.extend([0, n_rows]);
                cuts.sort_unstable();
                cuts.dedup();
                let parts: Vec<_> =
                    cuts.windows(2).map(|rows| part_of(&take, rows[0]..rows[1]).0).collect();
                let (all, report) = joined(&parts);
                assert!(
                    report.seams.iter().all(|seam| *seam == Seam::Continuous),
                    "{kind} {cuts:?}"
                );
                assert!(rows_of(&all) == whole, "{kind} {cuts:?}");
                let (a, b) = (source(&all), source(&take));
                assert_eq!(a.map().events, sorted_events(b.map()), "{kind}");
                assert_eq!(a.clocks, b.clocks);
                assert_eq!(a.map().ending, b.map().ending);
                let (mut found, expected) =
                    (a.map().ledger.clone().unwrap(), b.map().ledger.clone().unwrap());
                assert!(found.closes());
                found.clock = expected.clock;
                assert_eq!(found, expected, "{kind} {cuts:?}");
                let header = &a.map().header;
                assert!(header.settings.iter().all(|(key, _)| key != CUT));
                assert!(header.settings.iter().any(|(key, _)| key == CONCAT));
            }
        }
    }
}

/// Three analog channels of 16-bit integers, two samples in a frame.
fn analog(n_frames: usize) -> Foreign {
    let (width, n_signals, ratio) = (2, 3, 2);
    let header = SampleHeader { width, n_signals, ratio, first_frame: 11, n_frames };
    let mut data = header.encode();
    let (from, length) = (data.len(), n_frames * ratio);
    data.resize(from + n_signals * length * width, 0);
    let mut data = Content::from(data);
    for signal in 0..n_signals {
        let mut random = Random::new(signal as u64);
        let samples = (0..length).map(|_| random.below(1000) as u32 + 1);
        let at = (from + signal * length * width) as u64;
        ColumnWriter::new(width).write(&mut data, at, length, samples).unwrap();
    }
    Foreign::exact(ANALOG, data)
}

/// The places of the chunks of this type.
fn chunks(take: &[u8], wanted: u8) -> Vec<Range<usize>> {
    let mut places = Vec::new();
    let mut at = chunk::MAGIC.len();
    while let ChunkParse::Whole { kind, len, .. } = chunk::parse(&take[at..]) {
        places.extend((kind == wanted).then_some(at..at + len));
        at += len;
    }
    places
}

/// The take that a recovery writes of a damaged one.
fn recovered(damaged: &[u8]) -> Vec<u8> {
    let mut recovered = Vec::new();
    let scan = RecoveryScan::read(damaged).unwrap();
    scan.write(Cursor::new(damaged), &mut recovered, "test").unwrap();
    recovered
}

/// The analog samples of a take, their form, and those that are lost.
fn samples_of(take: &[u8]) -> (Foreign, SampleForm, Vec<LostSamples>) {
    let scratch = || Err(io::ErrorKind::Unsupported.into());
    let frames = TakeFrames::open_with(Cursor::new(take), |_| true, scratch).unwrap();
    let part = frames.map().foreign[0].sampled().unwrap();
    (frames.info().foreign[0].clone(), part.groups()[0].group.form, part.lost())
}

#[test]
fn samples_that_a_recovery_lost_stay_lost_in_parts_and_in_joined_takes() {
    let mut damaged = import_with("dense", 2300, vec![analog(2300)]);
    let samples = chunks(&damaged, types::SAMPLES);
    assert_eq!(samples.len(), 3, "ten seconds each");
    damaged[samples[1].start + samples[1].len() / 2] ^= 1;
    let recovered = recovered(&damaged);
    let lost = |first, n| {
        vec![LostSamples { channels: [1, 3], first, n, causes: Some(LossCauses::DAMAGED) }]
    };
    let whole = samples_of(&recovered);
    assert_eq!((whole.1, &whole.2), (SampleForm::Int16, &lost(2000, 2000)));
    let ranges = [0..500, 500..1500, 1500..2300];
    let parts = ranges.map(|rows| part_of(&recovered, rows).0);
    let of_parts = parts.each_ref().map(|part| samples_of(part));
    assert_eq!(of_parts.each_ref().map(|part| part.1), [SampleForm::Int16; 3]);
    assert_eq!(of_parts.map(|part| part.2), [vec![], lost(1000, 1000), lost(0, 1000)]);
    assert_eq!(samples_of(&joined(&parts).0), whole);
}

fn sorted_events(map: &TakeMap) -> Vec<Event> {
    let mut events = map.events.clone();
    events.sort_by_key(|event| event.row);
    events
}

#[test]
fn frames_between_two_parts_are_lost_rows_and_other_takes_are_marked() {
    let take = recording("dense", 900);
    let whole = rows_of(&take);
    let is_lost = |row: u64| whole[row as usize].lost.is_some();
    // Ends that were recorded, so that the clocks of both are known there.
    let (a, b) = (500..600).zip(650..).find(|&(a, b)| !is_lost(a - 1) && !is_lost(b)).unwrap();
    let parts = [part_of(&take, 200..a).0, part_of(&take, b..900).0];
    let (all, report) = joined(&parts);
    assert_eq!(report.seams, [Seam::Missing(b - a)]);
    let rows = rows_of(&all);
    assert_eq!(rows.len(), 700);
    let between = &rows[(a - 200) as usize..(b - 200) as usize];
    assert!(between.iter().all(|row| row.lost == Some(LossCauses::DISCONNECTED)));
    assert!(rows[(b - 200) as usize..] == whole[b as usize..]);
    assert!(rows[..(a - 200) as usize] == whole[200..a as usize]);
    let (ledger, parts_sent) = (report.ledger, 700 - (b - a));
    assert!(ledger.closes());
    let lost_before: u64 = parts
        .iter()
        .map(|p| source(p).map().ledger.clone().unwrap().unknown_after_disconnect)
        .sum();
    assert_eq!(ledger.unknown_after_disconnect - lost_before, b - a);
    assert_eq!(ledger.frames_sent, parts_sent + (b - a));
    let seam = |all: &[u8], row: u64| {
        let map = source(all).map().clone();
        map.events.into_iter().find(|event| event.row == row && event.kind == EventKind::Host)
    };
    assert!(seam(&all, b - 200).unwrap().text.contains(&(b - a).to_string()));

    // Nothing is known of what lies between a take and an earlier one.
    let n_second = 900 - b;
    let reversed = [parts[1].clone(), parts[0].clone()];
    assert_eq!(joined(&reversed).1.seams, [Seam::Unknown]);
    // The first of these has a marker more than the second.
    let error = try_join(&[parts[1].clone(), part_of(&take, 0..250).0]);
    assert!(error.is_some_and(|error| error.contains("lacks `m64`")));
    let (twice, report) = joined(&[parts[1].clone(), parts[1].clone()]);
    assert_eq!(report.seams, [Seam::Unknown]);
    assert_eq!(rows_of(&twice).len() as u64, 2 * n_second);
    assert!(seam(&twice, n_second).is_some());
    assert!(report.ledger.closes());
}

#[test]
fn takes_of_a_divided_recording_are_joined_by_their_places() {
    let setting = |(key, value): (&str, &str)| (key.to_owned(), value.to_owned());
    let settings = [
        (SPLIT_SETTING, "9s"),
        (SERIES_SETTING, "5e"),
        (PART_SETTING, "3"),
        (FIRST_FRAME_SETTING, "100"),
    ];
    let take = recording_with("dense", 900, settings.map(setting).to_vec());
    let whole = rows_of(&take);
    let of = |take: &[u8], wanted: &str| -> Option<String> {
        let header = source(take).map().header.clone();
        header.settings.into_iter().find(|(key, _)| key == wanted).map(|(_, value)| value)
    };
    // Joined takes do not state that they were cut from one.
    let piece = |rows: [u64; 3]| {
        let [a, b, c] = rows;
        joined(&[part_of(&take, a..b).0, part_of(&take, b..c).0]).0
    };
    let pieces = [piece([0, 100, 310]), piece([310, 400, 500]), piece([620, 700, 900])];
    for (piece, first_row) in pieces.iter().zip(["100", "410", "720"]) {
        assert_eq!(of(piece, CUT), None);
        assert_eq!(of(piece, FIRST_FRAME_SETTING).as_deref(), Some(first_row));
        assert_eq!(of(piece, SERIES_SETTING).as_deref(), Some("5e"));
        assert_eq!((of(piece, SPLIT_SETTING), of(piece, PART_SETTING)), (None, None));
    }
    let (all, report) = joined(&pieces);
    assert_eq!(report.seams, [Seam::Continuous, Seam::Missing(120)]);
    assert!(report.ledger.closes());
    let rows = rows_of(&all);
    assert!(rows[..500] == whole[..500] && rows[620..] == whole[620..]);
    assert!(rows[500..620].iter().all(|row| row.lost == Some(LossCauses::DISCONNECTED)));
    // In another order nothing is known, and no place is left.
    let (swapped, report) = joined(&[pieces[1].clone(), pieces[0].clone()]);
    assert_eq!(report.seams, [Seam::Unknown]);
    assert_eq!((of(&swapped, SERIES_SETTING), of(&swapped, FIRST_FRAME_SETTING)), (None, None));
    // Another series, however well its rows would follow.
    let mut other = settings;
    (other[1].1, other[3].1) = ("6f", "1000");
    let other = recording_with("dense", 900, other.map(setting).to_vec());
    assert_eq!(joined(&[take, other]).1.seams, [Seam::Unknown]);
}

fn try_join(takes: &[Vec<u8>]) -> Option<String> {
    let sources: Vec<_> = takes.iter().map(|take| source(take)).collect();
    check_joinable(&sources).err().map(|mismatch| mismatch.why)
}

/// A take of one stretch whose header was changed.
fn changed(kind: &str, change: impl FnOnce(&mut Header)) -> Vec<u8> {
    let mut header = Header { channels: (0..3).map(channel).collect(), ..header(kind) };
    header.source =
        Some(ImportSource { unit: "m".to_owned(), factor: 1000.0, ..ImportSource::default() });
    change(&mut header);
    let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
    let mut front = StretchHeaderWriter::new(header.stretch_rows);
    let span = Span { first_row: 0, n_rows: 9, key: true, number: 0 };
    let mut payload = Vec::new();
    front.put(span, &Timeline::default(), &[], true, &mut payload);
    take.stretch(span, &payload, &StretchTally::default()).unwrap();
    let ledger = Ledger {
        finished: true,
        frames_sent: 9,
        recorded: 9,
        samples_announced: 9 * header.channels.len() as u64,
        samples_occluded: 9 * header.channels.len() as u64,
        ..Ledger::default()
    };
    take.finish(&ledger).unwrap().0
}

#[test]
fn the_first_difference_is_named() {
    let first = changed("dense", |_| {});
    let refusals: [(Vec<u8>, &[&str]); 8] = [
        (changed("fast", |_| {}), &["resampler", "fast", "dense"]),
        (changed("dense", |h| h.tolerance_mm = 1.0), &["tolerance", "1 mm", "0.5 mm"]),
        (changed("dense", |h| h.rate_hz = 60.0), &["rate", "60 Hz", "100 Hz"]),
        (changed("dense", |h| h.up_axis = crate::motion::UpAxis::Z), &["up axis", "z", "unknown"]),
        (changed("dense", |h| h.source.as_mut().unwrap().factor = 1.0), &["unit", "m (1 mm)"]),
        (
            changed("dense", |h| (h.device, h.source) = (Some(Device::default()), None)),
            &["a recording", "an import"],
        ),
        (
            changed("dense", |h| h.channels[1].label = "knee".to_owned()),
            &["marker 2", "`knee`", "`m1`"],
        ),
        (changed("dense", |h| drop(h.channels.pop())), &["lacks `m2`"]),
    ];
    for (other, facts) in refusals {
        let why = try_join(&[first.clone(), first.clone(), other]).unwrap();
        assert!(facts.iter().all(|fact| why.contains(fact)), "{facts:?} are not in: {why}");
    }
    // Another length of stretches is no obstacle, and a marker may appear.
    let longer = changed("dense", |h| h.stretch_rows = 9);
    let more = changed("dense", |h| h.channels.push(channel(3)));
    let (all, report) = joined(&[first, longer, more]);
    assert_eq!((report.rows, report.n_channels), (27, 4));
    assert!(report.ledger.closes());
    assert_eq!(report.ledger.samples_announced, 18 * 3 + 9 * 4);
    assert_eq!(rows_of(&all).len(), 27);
}

#[test]
fn takes_that_are_not_whole_are_refused_with_advice() {
    let take = recording("dense", 400);
    let read = |bytes: &[u8]| SourceTake::read(&mut Cursor::new(bytes)).map(drop);
    let advice = |result: Result<(), TakeError>| {
        let error = result.unwrap_err();
        assert!(matches!(error, TakeError::InvalidArgument(_)), "{error}");
        assert!(error.to_string().contains("mocapd recover"), "{error}");
    };
    advice(read(&take[..take.len() - 1]));
    advice(read(&take[..take.len() / 2]));
    let mut hurt = take.clone();
    hurt[take.len() / 2] ^= 1;
    advice(read(&hurt));
    // A block that is not one, with a matching checksum, is found when it is decoded.
    let mut bad = take[..8].to_vec();
    let mut rest = &take[8..];
    let mut n_stretches = 0;
    while let ChunkParse::Whole { kind, payload, len } = chunk::parse(rest) {
        let mut payload = payload.to_vec();
        n_stretches += usize::from(kind == types::STRETCH);
        if kind == types::STRETCH && n_stretches == 6 {
            let from = payload.len() - 40;
            payload[from..].fill(0xff);
        }
        chunk::put(&mut bad, kind, &payload).unwrap();
        rest = &rest[len..];
    }
    let source = SourceTake::read(&mut Cursor::new(&bad)).unwrap();
    let result = cut(&source, Cursor::new(&bad), 0..400, io::sink(), &context());
    advice(result.map(drop));
    let open = |_: usize| Ok(Cursor::new(&bad[..]));
    advice(concat(&[source], open, io::sink(), &context()).map(drop));
}

#[test]
fn a_part_states_where_it_was_cut() {
    let take = recording("dense", 400);
    let (part, _) = part_of(&take, 30..70);
    let origin = CutOrigin::of(&source(&part).map().header).unwrap();
    assert_eq!(origin, CutOrigin { take_id: "07".repeat(16), rows: 30..70 });
    assert_eq!(CutOrigin::of(&source(&take).map().header), None);
    for settings in
        ["", "07", "07: frames 1..2", "07: frames 1-2 of 3", "07: frames a..b of 3, by x"]
    {
        let settings = vec![(CUT.to_owned(), settings.to_owned())];
        assert_eq!(CutOrigin::of(&Header { settings, ..header("dense") }), None);
    }
}

#[test]
fn ranges_outside_are_refused() {
    let take = changed("dense", |_| {});
    for rows in [0..0, 5..5, 0..10, 9..10, 20..30] {
        let result = cut(&source(&take), Cursor::new(&take), rows.clone(), io::sink(), &context());
        assert!(matches!(result, Err(TakeError::InvalidArgument(_))), "{rows:?}");
    }
    let none: [SourceTake; 0] = [];
    let open = |_: usize| Ok(Cursor::new(Vec::new()));
    assert!(concat(&none, open, io::sink(), &context()).is_err());
}
