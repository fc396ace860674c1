//! A golden take like a recording: with a time line, lost rows, and markers that appear late.

use mocapd_codec::GROUP_CHANNELS;
use mocapd_take::{
    TakeWriter,
    record::{ClockFit, Device, Event, EventKind, Header, Ledger, StatedPlate},
    statistics::{BlockTally, StretchTally},
    stretch::{Span, StretchHeaderWriter, put_block},
    timeline::{Timeline, TimelineEncoder},
};

use super::{
    motion::{Column, markers},
    poses::{self, SampledParts},
    takes::{Golden, Written, channel, encode},
    times::{PLANS, STRETCH_ROWS, TICK_HZ, n_rows, timelines},
};

/// Markers that appear late and belong to a second group.
const LATE: usize = 2;

/// The stretch in which the late markers appear.
const APPEAR: usize = 2;

impl Golden {
    pub(crate) fn record(&self) -> Written {
        let early = self.n_markers - LATE;
        let header = Header {
            created_unix_ms: 1_700_000_000_123,
            device: Some(Device {
                driver: "golden".to_owned(),
                model: "seeded".to_owned(),
                tick_hz: TICK_HZ,
                low_latency: true,
                ..Device::default()
            }),
            channels: (0..GROUP_CHANNELS).map(channel).collect(),
            ..self.header()
        };
        let mut timelines = timelines();
        let mut columns = markers(n_rows());
        columns.truncate(self.n_markers);
        blank(&mut columns, early, &timelines);

        let settings = self.settings();
        let mut groups = [settings.encoder(), settings.encoder()];
        let mut header = header;
        let tolerance = (!settings.kind.is_lossless()).then_some(settings.tolerance);
        let mut sampled = self.has_poses().then(|| SampledParts::new(tolerance));
        if sampled.is_some() {
            header.settings = poses::plates().iter().map(StatedPlate::setting).collect();
        }
        let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
        sampled.iter().for_each(|sampled| sampled.begin(&mut take));
        let times = TimelineEncoder::new(TICK_HZ, header.rate_hz);
        let mut front = StretchHeaderWriter::with_times(STRETCH_ROWS, times);
        let mut ledger = Ledger::default();
        for (i, (plan, timeline)) in PLANS.iter().zip(&timelines).enumerate() {
            if i == APPEAR {
                take.channels(&[channel(GROUP_CHANNELS), channel(GROUP_CHANNELS + 1)]).unwrap();
                events().iter().for_each(|event| take.event(event).unwrap());
            }
            let end = (timeline.first_row + timeline.n_rows()) as usize;
            let first = end - plan.n_rows as usize;
            let span = Span {
                first_row: first as u64,
                n_rows: plan.n_rows,
                key: plan.key,
                number: i as u8,
            };
            // One block, before any marker of the second group is announced.
            let alone = i < APPEAR;
            let mut payload = Vec::new();
            front.put(span, timeline, &[], alone, &mut payload);
            let all: Vec<_> = columns.iter().map(|column| column.part(first..end)).collect();
            let parts = [&all[..early], &all[early..]];
            let mut all = BlockTally::default();
            all.restart(plan.n_rows as usize);
            for (encoder, rows) in groups.iter_mut().zip(parts).take(if alone { 1 } else { 2 }) {
                let (block, tally, n) = encode(encoder.as_mut(), rows, &[], plan.key);
                all.append(&tally);
                put_block(&block, alone, &mut payload);
                ledger.samples_present += n;
            }
            take.stretch(span, &payload, &StretchTally::of(&all)).unwrap();
            if let Some(sampled) = &mut sampled {
                sampled.stretch(i, timeline, &mut take);
            }
            add_counts(&mut ledger, timeline, if alone { early } else { self.n_markers });
            if i == 0 {
                let contradictions = vec!["a counter that jumped".to_owned()];
                take.ledger(&Ledger { contradictions, ..ledger.clone() }).unwrap();
            }
        }
        ledger.finished = true;
        (ledger.duplicates, ledger.link_bytes, ledger.link_messages) = (3, 123_456_789, 341);
        ledger.clock = Some(ClockFit {
            offset_ns: -3_765_432_110_987,
            drift_ppm: 40.25,
            residual_us: 0.1,
            n_fitted: ledger.recorded,
        });
        sampled.iter().for_each(|sampled| sampled.finish(&mut take));
        timelines.retain(|timeline| timeline.n_rows() > 0);
        let places = (0..early).chain(GROUP_CHANNELS..GROUP_CHANNELS + LATE);
        let (bytes, _) = take.finish(&ledger).unwrap();
        Written { bytes, columns: places.zip(columns).collect(), timelines }
    }
}

/// Removes the samples of lost frames and of rows without visible markers, and those of markers from `late` on before
/// they appear.
pub(crate) fn blank(columns: &mut [Column], late: usize, timelines: &[Timeline]) {
    for (i, (plan, timeline)) in PLANS.iter().zip(timelines).enumerate() {
        let rows = timeline.first_row..timeline.first_row + timeline.n_rows();
        for row in rows {
            let recorded = timeline.recorded().any(|(recorded, _)| recorded == row);
            for (marker, column) in columns.iter_mut().enumerate() {
                let seen = recorded && !plan.empty && (marker < late || i >= APPEAR);
                column.present[row as usize] &= seen;
            }
        }
    }
}

fn add_counts(ledger: &mut Ledger, timeline: &Timeline, n_markers: usize) {
    let lost = |bit: u8| -> u64 {
        let runs = timeline.runs.iter();
        let lost = runs.filter(|run| run.lost.is_some_and(|causes| causes.0 == bit));
        lost.map(|run| run.rows).sum()
    };
    ledger.frames_sent += timeline.n_rows();
    ledger.recorded += timeline.n_recorded();
    ledger.lost_on_link += lost(1);
    ledger.lost_ring_full += lost(2);
    ledger.unknown_after_disconnect += lost(1 | 4);
    ledger.samples_announced += timeline.n_recorded() * n_markers as u64;
    ledger.samples_occluded = ledger.samples_announced - ledger.samples_present;
}

/// One event of every kind.
fn events() -> [Event; 5] {
    let kinds = [
        EventKind::Mark,
        EventKind::Trigger,
        EventKind::SyncPulse,
        EventKind::Device,
        EventKind::Host,
    ];
    let mut row = 61;
    kinds.map(|kind| {
        row += 1;
        Event {
            kind,
            row,
            device_ticks: 5_000_000_000 + 8_333 * row,
            host_ns: 1_234_567_890_000 + 8_333_333 * row,
            input: row as u8 % 3,
            text: format!("event at row {row}"),
        }
    })
}
