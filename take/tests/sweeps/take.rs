//! The take to damage: a hundred stretches of a recording, with loss, events, and markers that appear late.

use mocapd_codec::{BlockReport, Rows, Settings, Tolerance};
use mocapd_take::{
    TakeWriter,
    record::{
        Channel, Clock, ClockPoint, Device, Event, EventKind, Header, LONG_KEYS_VERSION, Ledger,
        Subject,
    },
    statistics::{BlockTally, StretchTally},
    stretch::{NUMBERS, Span, StretchHeaderWriter, put_block},
    timeline::{LossCauses, RowTime, Timeline, TimelineEncoder},
};

const STRETCHES: usize = 100;
/// A fifth of a second at 60 Hz.
const ROWS: usize = 12;
/// Number of stretches from key to key.
const KEY_EVERY: usize = 10;
const CHANNELS: usize = 5;
/// From this stretch on there is one more channel.
const APPEARS_AT: usize = 25;

fn channel(i: usize) -> Channel {
    Channel { marker_id: i as u16, label: format!("marker_{i}"), labelled: true }
}

/// The position of a channel in a row: a swing with a little noise.
fn position(channel: usize, row: usize) -> [f32; 3] {
    let t = row as f32 / 60.0 + channel as f32;
    let noise = (row * 7919 + channel * 104_729) % 1013;
    let noise = noise as f32 / 1013.0 - 0.5;
    [300.0 * (2.0 * t).sin() + noise, 900.0 + 150.0 * (3.0 * t).cos() - noise, 10.0 * t]
}

fn header(settings: &Settings) -> Header {
    let mut header = Header {
        software: "sweeps".to_owned(),
        take_id: [7; 16],
        created_unix_ms: 1,
        resampler: String::new(),
        codec_version: 0,
        tolerance_mm: 0.0,
        rate_hz: 60.0,
        up_axis: mocapd_take::motion::UpAxis::Z,
        device: Some(Device { tick_hz: 1_000_000, ..Device::default() }),
        source: None,
        channels: (0..CHANNELS).map(channel).collect(),
        stretch_rows: ROWS as u32,
        settings: Vec::new(),
    };
    header.set_codec(settings);
    header
}

/// The captured person.
pub(crate) fn subject() -> Subject {
    let mut subject = Subject { name: "Anna".to_owned(), documents: Vec::new() };
    subject.set(Subject::SKELETON, br#"{"format":"mocapd-skeleton","bones":[]}"#.to_vec());
    subject
}

/// Behind the name of a resampler: only the first stretch is a key.
pub(crate) const ONE_KEY: &str = ", one key";

/// The bytes of the take, encoded with `kind`.
pub(crate) fn take(kind: &str) -> Vec<u8> {
    begun(kind, STRETCHES)
}

/// The bytes of the take, cut off after `n_stretches`.
pub(crate) fn begun(kind: &str, n_stretches: usize) -> Vec<u8> {
    let tolerance = Tolerance::from_mm(0.5).unwrap();
    let has_one_key = kind.ends_with(ONE_KEY);
    let kind = kind.trim_end_matches(ONE_KEY).parse().unwrap();
    let settings = Settings { kind, tolerance };
    let mut header = header(&settings);
    if has_one_key {
        header.codec_version = LONG_KEYS_VERSION;
    }
    let mut writer = TakeWriter::new(Vec::new(), &header).unwrap();
    writer.subject(&subject()).unwrap();
    let times = TimelineEncoder::new(1_000_000, 60.0);
    let mut front = StretchHeaderWriter::with_times(ROWS as u32, times);
    let mut encoder = settings.encoder();
    let mut ledger = Ledger::default();
    let mut first_row = 0;
    for stretch in 0..n_stretches {
        if stretch == APPEARS_AT {
            writer.channels(&[channel(CHANNELS)]).unwrap();
        }
        let n_channels = CHANNELS + usize::from(stretch >= APPEARS_AT);
        let key = if has_one_key { stretch == 0 } else { stretch.is_multiple_of(KEY_EVERY) };
        let mut timeline = Timeline::default();
        timeline.restart(first_row);
        if stretch % 7 == 3 {
            timeline.push_lost(5, LossCauses::NOT_RECEIVED);
            ledger.lost_on_link += 5;
        }
        let from = first_row + timeline.n_rows();
        let rows = from as usize..from as usize + ROWS;
        for row in rows.clone() {
            let device_ticks = row as u64 * 16_667;
            let arrival_10us = row as u64 * 1667 + row as u64 % 5;
            timeline.push(RowTime { device_ticks, arrival_10us, timecode: None });
        }
        let seen: Vec<Vec<bool>> = (0..n_channels)
            .map(|channel| rows.clone().map(|row| (row / 9 + channel) % 6 != 0).collect())
            .collect();
        let paths: Vec<Vec<[f32; 3]>> = (0..n_channels)
            .map(|channel| rows.clone().map(|row| position(channel, row)).collect())
            .collect();
        let coded: Vec<_> =
            paths.iter().zip(&seen).map(|(path, seen)| Rows::new(path, seen).unwrap()).collect();
        let (mut block, mut reports) = (Vec::new(), [BlockReport::default(); CHANNELS + 1]);
        encoder.encode(&coded, &[], key, &mut block, &mut reports[..n_channels]).unwrap();
        let span = Span {
            first_row: from,
            n_rows: ROWS as u32,
            key,
            number: (stretch % usize::from(NUMBERS)) as u8,
        };
        let mut payload = Vec::new();
        front.put(span, &timeline, &[], true, &mut payload);
        put_block(&block, true, &mut payload);
        let reports = &reports[..n_channels];
        let tally = BlockTally::of_encoded(&block, &coded, reports, encoder.kept_rows());
        writer.stretch(span, &payload, &StretchTally::of(&tally)).unwrap();
        first_row = span.end_row();
        ledger.recorded += ROWS as u64;
        ledger.frames_sent = first_row;
        ledger.samples_announced += (ROWS * n_channels) as u64;
        ledger.samples_present += reports.iter().map(|r| u64::from(r.samples)).sum::<u64>();
        ledger.samples_occluded = ledger.samples_announced - ledger.samples_present;
        if stretch % 20 == 10 {
            writer.ledger(&ledger).unwrap();
            let row = first_row;
            let (device_ticks, host_us) = (row * 16_667, row * 16_670);
            let points = vec![ClockPoint { device_ticks, host_us }];
            writer.clock(&Clock { tick_hz: 1_000_000, points, ..Clock::default() }).unwrap();
            let kind = EventKind::Mark;
            let text = format!("mark {stretch}");
            let event = Event { kind, row, device_ticks, host_ns: host_us * 1000, input: 0, text };
            writer.event(&event).unwrap();
        }
    }
    ledger.finished = true;
    writer.finish(&ledger).unwrap().0
}
