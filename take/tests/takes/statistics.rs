//! The statistics in SUMMARY equal what decoding the take gives, for takes of every writer, and take few bytes.

use std::io::Cursor;

use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_take::{
    TakeEnds, TakeEvent,
    chunk::{self, ChunkParse, MAGIC, types},
    motion::{GAP, Marker, Motion, MotionInfo, UpAxis},
    motion_encoder::{channels, stretch_rows},
    reader::read_events,
    record::{
        CODEC_VERSION, Channel, Device, EndingKind, Header, ImportSource, SummaryRecord, TakeEnding,
    },
    recovery::RecoveryScan,
    statistics::{ChannelStatistics, TakeStatistics},
    stretch::StretchDecoder,
};
use mocapd_testkit::random::Random;

/// A sample of a decoded take: whether it was kept, and the error that its block states.
type Found = Option<(bool, f64)>;

/// The statistics that a take states, and the same figures counted sample by sample, as its definitions read.
fn stated_and_counted(take: &[u8]) -> (TakeStatistics, TakeStatistics) {
    let (mut stated, mut settings, mut decoder) = (None, None, None);
    let (mut n_channels, mut n_rows) = (0, 0);
    let mut rows: Vec<Vec<Found>> = Vec::new();
    read_events(take, |event| {
        match event {
            TakeEvent::Header(header) => {
                settings = Some(header.codec()?);
                decoder = settings.map(StretchDecoder::new);
                n_channels = header.channels.len();
            }
            TakeEvent::Channels(more) => n_channels += more.len(),
            TakeEvent::Stretch(stretch) => {
                let decoder = decoder.as_mut().unwrap();
                if stretch.span.n_rows > 0 {
                    decoder.decode(&stretch)?;
                    rows.resize(stretch.span.first_row as usize, Vec::new());
                    rows.resize(stretch.span.end_row() as usize, Vec::new());
                    for decoded in decoder.rows() {
                        for (i, row) in
                            rows[stretch.span.first_row as usize..].iter_mut().enumerate()
                        {
                            row.push(
                                decoded
                                    .filter(|rows| rows.present[i])
                                    .map(|rows| (rows.kept[i], rows.max_error_mm)),
                            );
                        }
                    }
                }
            }
            TakeEvent::Summary(summary) => stated = summary.statistics,
            TakeEvent::Footer(footer) => n_rows = footer.n_rows as usize,
            _ => {}
        }
        Ok(())
    })
    .unwrap();
    rows.resize(n_rows, Vec::new());
    let tolerance = settings.unwrap().tolerance;
    let of_channel = |channel: usize| {
        let track: Vec<Found> =
            rows.iter().map(|row| row.get(channel).copied().flatten()).collect();
        let starts = |row: usize| track[row].is_none() && (row == 0 || track[row - 1].is_some());
        let most_mm = track.iter().flatten().map(|found| found.1).fold(0.0, f64::max);
        ChannelStatistics {
            samples: track.iter().flatten().count() as u64,
            gaps: (0..track.len()).filter(|&row| starts(row)).count() as u64,
            knots: track.iter().flatten().filter(|found| found.0).count() as u64,
            error_step: (0..=63).find(|&step| tolerance.stated_mm(step) == most_mm).unwrap(),
        }
    };
    let samples = |row: &&Vec<Found>| row.iter().flatten().count() as u64;
    let is_key = |row: &&Vec<Found>| row.iter().flatten().any(|found| found.0);
    let counted = TakeStatistics {
        channels: (0..n_channels).map(of_channel).collect(),
        rows_with_samples: rows.iter().filter(|row| samples(row) > 0).count() as u64,
        key_rows: rows.iter().filter(is_key).count() as u64,
        samples_in_key_rows: rows.iter().filter(is_key).map(|row| samples(&row)).sum(),
    };
    (stated.unwrap(), counted)
}

/// Compares, and returns the statistics for further checks.
fn check(take: &[u8], what: &str) -> TakeStatistics {
    let (stated, counted) = stated_and_counted(take);
    assert_eq!(stated, counted, "{what}");
    let ends = TakeEnds::read(&mut Cursor::new(take)).unwrap();
    let end = ends.end.unwrap();
    assert_eq!(end.statistics, Some(counted), "{what}");
    assert_eq!(end.channels.unwrap().len(), stated.channels.len(), "{what}");
    stated
}

fn header(settings: &Settings, rate_hz: f64) -> Header {
    let mut header = Header {
        software: "test".to_owned(),
        codec_version: CODEC_VERSION,
        rate_hz,
        up_axis: UpAxis::Z,
        ..Header::default()
    };
    header.set_codec(settings);
    header
}

/// Markers that swing, with gaps: the first has none, the second no sample, the last no sample but one.
fn motion(n_markers: usize, n_frames: usize, rate_hz: f64) -> Motion {
    let label = |i: usize| Marker { label: format!("m{i}"), labelled: true };
    let markers: Vec<_> = (0..n_markers).map(label).collect();
    let mut random = Random::new(7);
    let mut positions_mm = Vec::new();
    let mut hidden = vec![0; n_markers];
    for frame in 0..n_frames {
        for (marker, hidden) in hidden.iter_mut().enumerate() {
            if marker > 1 && *hidden == 0 && random.one_in(90) {
                *hidden = random.below(70);
            }
            *hidden = usize::saturating_sub(*hidden, 1);
            let phase = frame as f32 / 30.0 + marker as f32;
            let at = [300.0 * phase.sin(), 50.0 * marker as f32, 900.0 + 40.0 * phase.cos()];
            let is_seen = match marker {
                0 => true,
                1 => false,
                last if last + 1 == n_markers => frame == n_frames / 2,
                _ => *hidden == 0 && !(200..260).contains(&frame),
            };
            positions_mm.push(if is_seen { at } else { GAP });
        }
    }
    let info = MotionInfo { rate_hz, n_frames: n_frames as u64, markers, ..MotionInfo::default() };
    Motion { info, positions_mm }
}

fn imported(motion: &Motion, settings: &Settings) -> Vec<u8> {
    let (rate_hz, n_frames) = (motion.info.rate_hz, motion.n_frames());
    let mut header = header(settings, rate_hz);
    header.channels = channels(&motion.info.markers);
    header.stretch_rows = stretch_rows(settings, rate_hz, n_frames, header.channels.len()) as u32;
    crate::encoded(motion, &header)
}

#[test]
fn an_import_states_what_decoding_gives() {
    // Of several stretches of ten seconds, and of several groups; short takes for the offline kinds.
    for kind in [
        "dense",
        "fast",
        "lossless",
        "lossless:predictive",
        "spline",
        "spline:worst-sample",
        "sync",
    ] {
        let kind: ResamplerKind = kind.parse().unwrap();
        let settings = Settings { kind, tolerance: Tolerance::from_mm(1.0).unwrap() };
        let n_frames = if kind.is_live() { 700 } else { 300 };
        for n_markers in [3, 64, 65, 131] {
            let take = imported(&motion(n_markers, n_frames, 30.0), &settings);
            let found = check(&take, &format!("{kind}, {n_markers} markers"));
            let last = found.channels.len() - 1;
            assert_eq!((found.channels[0].gaps, found.channels[1].gaps), (0, 1));
            assert_eq!((found.channels[1].samples, found.channels[last].gaps), (0, 2));
            assert_eq!(found.rows_with_samples, n_frames as u64);
            assert_eq!(found.error_step() == 0, kind.is_lossless());
        }
    }
    let settings =
        Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(1.0).unwrap() };
    for (n_markers, n_frames) in [(0, 5), (3, 0)] {
        let mut empty = motion(3, n_frames, 30.0);
        if n_markers == 0 {
            empty = Motion::default();
            (empty.info.rate_hz, empty.info.n_frames) = (30.0, n_frames as u64);
        }
        let found = check(&imported(&empty, &settings), "nothing");
        assert_eq!(found.channels, vec![ChannelStatistics::default(); n_markers]);
    }
}

/// Recordings with lost rows, and a marker that appears late.
#[test]
fn a_recording_states_what_decoding_gives() {
    for kind in ["dense", "fast", "lossless", "lossless:predictive"] {
        let found = check(&crate::take::take(kind), kind);
        let late = found.channels.last().unwrap();
        assert!(late.samples < found.channels[0].samples && late.gaps > 1, "{late:?}");
    }
}

#[test]
fn a_recovered_take_states_what_it_has_kept() {
    let whole = crate::take::take("dense");
    let mut places = Vec::new();
    let mut at = MAGIC.len();
    while let ChunkParse::Whole { kind, len, .. } = chunk::parse(&whole[at..]) {
        places.push((kind, at..at + len));
        at += len;
    }
    let before = check(&whole, "whole");
    let mut random = Random::new(3);
    for round in 0..120 {
        let mut hurt = whole.clone();
        for _ in 0..1 + round % 4 {
            let (_, place) = &places[1 + random.below(places.len() - 1)];
            hurt[place.start + random.below(place.len())] ^= 0x5a;
        }
        if round % 5 == 1 {
            // A chunk that is gone without a trace.
            let (_, place) = &places[1 + random.below(places.len() - 4)];
            hurt.drain(place.clone());
        }
        if round % 3 == 0 {
            let (_, place) = &places[places.len() / 3 + random.below(places.len() / 2)];
            hurt.truncate(place.start + random.below(place.len()));
        }
        let scan = RecoveryScan::read(&hurt[..]).unwrap();
        let mut new = Vec::new();
        scan.write(Cursor::new(&hurt), &mut new, "test").unwrap();
        let found = check(&new, &format!("round {round}"));
        assert_eq!(found, scan.statistics);
        assert!(found.samples() <= before.samples(), "round {round}");
    }
}

/// Labels of Vicon's plug-in gait set and of the like: 4 to 9 letters after a side.
const LABELS: [&str; 16] = [
    "Head", "HeadBack", "Shoulder", "UpperArm", "Elbow", "ElbowIn", "Wrist", "WristOut", "Hand",
    "Sternum", "Asis", "Psis", "Thigh", "KneeIn", "Ankle", "Heel",
];

/// Channels as a laboratory names them: a side, a part of the body, and a number for clusters.
fn realistic_channels(n: usize) -> Vec<Channel> {
    let label = |i: usize| {
        let (side, number) = (["L", "R"][i % 2], i / (2 * LABELS.len()));
        let part = LABELS[i / 2 % LABELS.len()];
        if number == 0 { format!("{side}{part}") } else { format!("{side}{part}{number}") }
    };
    let channel = |i: usize| Channel { marker_id: i as u16, label: label(i), labelled: true };
    (0..n).map(channel).collect()
}

/// An hour at 240 Hz: a few markers are always seen, most have gaps, and all move differently.
fn realistic_statistics(n: usize) -> TakeStatistics {
    let rows = 864_000;
    let mut random = Random::new(11);
    let mut channel = |i: usize| {
        let is_seen = i.is_multiple_of(4);
        let samples = if is_seen { rows } else { rows - random.below(rows / 5) };
        let gaps = if is_seen { 0 } else { random.below(900) as u64 };
        let knots = samples / 9 + random.below(rows / 9);
        let (samples, knots) = (samples as u64, knots as u64);
        ChannelStatistics { samples, gaps, knots, error_step: if i < 64 { 63 } else { 62 } }
    };
    let channels: Vec<_> = (0..n).map(&mut channel).collect();
    let samples: u64 = channels.iter().map(|channel| channel.samples).sum();
    TakeStatistics {
        channels,
        rows_with_samples: rows as u64,
        key_rows: 850_321,
        samples_in_key_rows: samples - samples / 70,
    }
}

#[test]
fn statistics_take_at_most_300_bytes_and_12_per_marker() {
    let settings =
        Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(0.5).unwrap() };
    let recording = Header {
        software: "mocapd 0.1.0".to_owned(),
        take_id: *b"\x1f\xa3\x07\x99\xc2\x5d\x40\x83\xbb\x61\x0e\xd8\x72\x9a\x34\xf0",
        created_unix_ms: 1_795_000_000_123,
        device: Some(Device {
            driver: "dvmc".to_owned(),
            uri: "usb:1209:8820:DV20260117".to_owned(),
            model: "DVMC-8820".to_owned(),
            serial: "DV20260117".to_owned(),
            firmware: "2.14.3".to_owned(),
            tick_hz: 10_000_000,
            low_latency: false,
        }),
        settings: vec![
            ("stretch".to_owned(), "250ms".to_owned()),
            ("sync".to_owned(), "250ms".to_owned()),
        ],
        stretch_rows: 120,
        ..header(&settings, 240.0)
    };
    let import = Header {
        created_unix_ms: 0,
        device: None,
        source: Some(ImportSource {
            format: "c3d".to_owned(),
            file: "S07_walk_fast_03.c3d".to_owned(),
            unit: "mm".to_owned(),
            factor: 1.0,
            first_frame: 1,
            warnings: Vec::new(),
        }),
        settings: vec![("source_bytes".to_owned(), "128456192".to_owned())],
        ..recording.clone()
    };
    for (name, header, ending) in [
        ("recording", recording, Some(TakeEnding::from(EndingKind::Length))),
        ("import", import, None),
    ] {
        for n in [1, 16, 64, 200] {
            let header = Header { channels: realistic_channels(n), ..header.clone() };
            let statistics = realistic_statistics(n);
            let summary = SummaryRecord {
                ending: ending.clone(),
                header: Some(Box::new(header.clone())),
                statistics: Some(statistics),
                order: None,
                sample_ledger: None,
            };
            let payload = summary.to_payload().unwrap();
            assert_eq!(SummaryRecord::from_payload(&payload, 0).unwrap(), summary);
            let mut whole = Vec::new();
            chunk::put(&mut whole, types::SUMMARY, &payload).unwrap();
            println!("{name}, {n} markers: {} bytes", whole.len());
            assert!(whole.len() <= 300 + 12 * n, "{name}, {n} markers: {} bytes", whole.len());
        }
    }
}
