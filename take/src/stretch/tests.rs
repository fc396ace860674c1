//! Round trips of stretches, and the effect of a missing one on the next.

use mocapd_codec::{BlockReport, ResamplerKind, Rows, Settings, Tolerance};

use super::{
    LIVE_ROWS_MAX, NUMBERS, Placement, Span, Stretch, StretchChain, StretchDecoder,
    StretchHeaderWriter, StretchSizes, put_block, put_renumbered, take_blocks,
};
use crate::{
    timeline::{LossCauses, RowRun, RowTime, Timeline, TimelineEncoder},
    varint,
};

const TICK_HZ: u64 = 1_000_000;
const STRETCH_ROWS: u32 = 30;

/// Payloads of `n` stretches with some loss, and the spans and time lines that they encode.
fn written(n: u64) -> Vec<(Span, Timeline, Vec<u8>)> {
    let times = TimelineEncoder::new(TICK_HZ, 60.0);
    let mut front = StretchHeaderWriter::with_times(STRETCH_ROWS, times);
    let mut row = 0;
    let stretch = |i: u64| {
        let mut timeline = Timeline::default();
        timeline.restart(row);
        let rows = if i == 0 || i % 7 == 3 { 6 } else { STRETCH_ROWS.into() };
        let lost_before = if i % 5 == 4 { 100 } else { 0 };
        timeline.push_lost(lost_before, LossCauses::NOT_RECEIVED);
        while timeline.n_rows() < lost_before + rows {
            let at = row + timeline.n_rows();
            if i % 6 == 5 && at % 30 == 10 {
                timeline.push_lost(1, LossCauses::RING_FULL);
            }
            timeline.push(RowTime {
                device_ticks: at * 1_000_000 / 60,
                arrival_10us: at * 100_000 / 60,
                timecode: None,
            });
        }
        let n_rows = (timeline.n_rows() - lost_before) as u32;
        let span = Span {
            first_row: row + lost_before,
            n_rows,
            key: i.is_multiple_of(20),
            number: (i % u64::from(NUMBERS)) as u8,
        };
        row += timeline.n_rows();
        let mut payload = Vec::new();
        let alone = i.is_multiple_of(2);
        front.put(span, &timeline, &[], alone, &mut payload);
        put_block(b"a block", alone, &mut payload);
        (span, timeline, payload)
    };
    (0..n).map(stretch).collect()
}

fn placed<'a>(chain: &mut StretchChain, payload: &'a [u8]) -> Option<Stretch<'a>> {
    match chain.place(payload).unwrap() {
        Placement::Stretch(stretch) => Some(stretch),
        Placement::Unplaced { .. } => None,
    }
}

fn assert_same(found: &Stretch<'_>, span: Span, timeline: &Timeline) {
    assert_eq!(found.span, span);
    assert_eq!(found.blocks, [b"a block"]);
    let times = found.timeline.as_ref().unwrap();
    assert_eq!((times.first_row, &times.runs), (timeline.first_row, &timeline.runs));
    for (found, wanted) in times.times.iter().zip(&timeline.times) {
        assert_eq!(found.device_ticks, wanted.device_ticks);
        assert!(found.arrival_10us.abs_diff(wanted.arrival_10us) <= 32);
    }
}

#[test]
fn stretches_round_trip_and_their_bytes_are_counted() {
    let mut chain = StretchChain::new(LIVE_ROWS_MAX, STRETCH_ROWS, TICK_HZ);
    for (i, (span, timeline, payload)) in written(100).into_iter().enumerate() {
        let stretch = placed(&mut chain, &payload).unwrap();
        assert!(!stretch.missing_before);
        assert_same(&stretch, span, &timeline);
        let sizes = stretch.sizes;
        let sum = sizes.framing + sizes.time_line + sizes.lengths + sizes.blocks;
        assert_eq!(sum, payload.len() as u64);
        if i == 2 {
            assert!(sizes.framing == 1 && sizes.time_line <= 3, "{sizes:?}");
        }
    }
}

/// The rows of the stretches after it are unknown, so none is assigned up to the next key stretch.
#[test]
fn no_row_is_assigned_after_a_missing_stretch() {
    let written = written(64);
    for n_missing in [1, 2, 19, 20, 31] {
        for first in 0..30 {
            let mut chain = StretchChain::new(LIVE_ROWS_MAX, STRETCH_ROWS, TICK_HZ);
            for (i, (span, timeline, payload)) in written.iter().enumerate() {
                if (first..first + n_missing).contains(&i) {
                    continue;
                }
                let found = placed(&mut chain, payload);
                let after_key = i < first || i / 20 * 20 >= first + n_missing;
                assert_eq!(found.is_some(), after_key, "{i} without {first} and {n_missing}");
                if let Some(found) = found {
                    assert_same(&found, *span, timeline);
                }
            }
        }
    }
}

#[test]
fn damage_that_may_hide_a_stretch_breaks_the_chain() {
    let written = written(25);
    let mut chain = StretchChain::new(LIVE_ROWS_MAX, STRETCH_ROWS, TICK_HZ);
    let mut found = written.iter().enumerate().map(|(i, (.., payload))| {
        if i == 7 {
            chain.break_off();
        }
        placed(&mut chain, payload).is_some()
    });
    assert!(found.by_ref().take(7).all(|found| found));
    assert!(found.by_ref().take(13).all(|found| !found));
    assert!(found.all(|found| found));
}

#[test]
fn a_take_may_end_with_lost_rows() {
    let times = TimelineEncoder::new(TICK_HZ, 60.0);
    let mut front = StretchHeaderWriter::with_times(STRETCH_ROWS, times);
    let mut timeline = Timeline::default();
    timeline.restart(0);
    timeline.push_lost(77, LossCauses::DISCONNECTED);
    let span = Span { first_row: 77, n_rows: 0, key: true, number: 0 };
    let mut payload = Vec::new();
    front.put(span, &timeline, &[], false, &mut payload);
    let mut chain = StretchChain::new(LIVE_ROWS_MAX, STRETCH_ROWS, TICK_HZ);
    let stretch = placed(&mut chain, &payload).unwrap();
    assert_eq!((stretch.span, stretch.blocks.len()), (span, 0));
    let runs = stretch.timeline.unwrap().runs;
    assert_eq!(runs, [RowRun { rows: 77, lost: Some(LossCauses::DISCONNECTED) }]);
}

#[test]
fn an_import_has_no_time_line_and_states_every_row() {
    let mut front = StretchHeaderWriter::new(600);
    let mut chain = StretchChain::new(LIVE_ROWS_MAX, 600, 1);
    for (number, n_rows) in [(0, 600), (1, 600), (2, 55)] {
        let span = Span { first_row: u64::from(number) * 600, n_rows, key: true, number };
        let mut payload = Vec::new();
        front.put(span, &Timeline::default(), b"shared", false, &mut payload);
        for block in [&b"one"[..], b"", b"three"] {
            put_block(block, false, &mut payload);
        }
        let stretch = placed(&mut chain, &payload).unwrap();
        assert_eq!((stretch.span, stretch.shared), (span, &b"shared"[..]));
        assert_eq!(stretch.blocks, [&b"one"[..], b"", b"three"]);
        assert!(stretch.timeline.is_none());
    }
}

#[test]
fn every_cut_and_every_mutation_gives_an_error_or_a_stretch() {
    let written = written(6);
    let before = |chain: &mut StretchChain| {
        written[..5].iter().for_each(|(.., payload)| drop(chain.place(payload)));
    };
    let payload = &written[5].2;
    for at in 0..payload.len() {
        let mut chain = StretchChain::new(LIVE_ROWS_MAX, STRETCH_ROWS, TICK_HZ);
        before(&mut chain);
        drop(chain.place(&payload[..at]));
        for value in 0..=255 {
            let mut chain = StretchChain::new(LIVE_ROWS_MAX, STRETCH_ROWS, TICK_HZ);
            before(&mut chain);
            let mut damaged = payload.clone();
            damaged[at] = value;
            drop(chain.place(&damaged));
        }
    }
}

/// Two groups: the second begins late, and neither has samples in every stretch.
#[test]
fn groups_are_decoded_side_by_side() {
    let settings =
        Settings { kind: ResamplerKind::Fast, tolerance: Tolerance::from_mm(0.5).unwrap() };
    let positions: Vec<[f32; 3]> = (0..30).map(|i| [i as f32, 0.0, 1.0]).collect();
    let (all, none) = ([true; 30], [false; 30]);
    let rows = |present| Rows::new(&positions, present).unwrap();
    let mut encoders = [settings.encoder(), settings.encoder()];
    let mut decoder = StretchDecoder::new(settings);
    // By stretch, channels with samples among the 64 of the first group and the two of the second.
    for (i, seen) in [[64, 0], [0, 0], [3, 0], [64, 2], [0, 1], [5, 0], [0, 2]].iter().enumerate() {
        let key = i % 5 == 0;
        let mut payload = Vec::new();
        for (encoder, (&seen, n)) in encoders.iter_mut().zip(seen.iter().zip([64, 2])) {
            let channels: Vec<_> =
                (0..n).map(|i| rows(if i < seen { &all } else { &none })).collect();
            let (mut block, mut reports) = (Vec::new(), vec![BlockReport::default(); n]);
            encoder.encode(&channels, &[], key, &mut block, &mut reports).unwrap();
            put_block(&block, false, &mut payload);
        }
        let mut cursor = varint::Cursor::new(&payload);
        let blocks = take_blocks(&mut cursor, false, 30, &mut StretchSizes::default()).unwrap();
        let span = Span { first_row: 0, n_rows: 30, key, number: 0 };
        let stretch = Stretch {
            span,
            missing_before: false,
            timeline: None,
            shared: &[],
            blocks,
            sizes: StretchSizes::default(),
            payload: &payload,
        };
        decoder.decode(&stretch).unwrap();
        let seen_in = |channel: usize| {
            let rows = decoder.rows().nth(channel).flatten();
            rows.is_some_and(mocapd_codec::DecodedRows::has_samples)
        };
        for channel in 0..66 {
            let expected = if channel < 64 { channel < seen[0] } else { channel - 64 < seen[1] };
            assert_eq!(seen_in(channel), expected, "channel {channel} in stretch {i}");
        }
        let stated = [64, 0, 0, 66, 0, 5, 66][i];
        assert_eq!(stretch.stated_channels(), stated, "stretch {i}");
    }
}

/// A take that begins at any key stretch of a recording, with rows and numbers of its own.
#[test]
fn moved_stretches_are_read_at_their_new_rows() {
    let all = written(100);
    for begin in [0, 20, 60] {
        let rows_before = all[begin].1.first_row;
        let mut chain = StretchChain::new(LIVE_ROWS_MAX, STRETCH_ROWS, TICK_HZ);
        for (number, (span, timeline, payload)) in all[begin..].iter().enumerate() {
            let number = (number % usize::from(NUMBERS)) as u8;
            let mut moved = Vec::new();
            put_renumbered(payload, rows_before, number, &mut moved).unwrap();
            let stretch = placed(&mut chain, &moved).unwrap();
            assert!(!stretch.missing_before);
            let span = Span { first_row: span.first_row - rows_before, number, ..*span };
            let mut timeline = timeline.clone();
            timeline.first_row -= rows_before;
            assert_same(&stretch, span, &timeline);
        }
    }
    let mut out = Vec::new();
    assert!(put_renumbered(&[], 0, 0, &mut out).is_err());
    let key = &all[20];
    assert!(
        put_renumbered(&key.2, key.1.first_row + 1, 0, &mut out).is_err(),
        "begins before the take"
    );
}

#[test]
fn stretches_after_a_missing_empty_one_can_be_read() {
    let times = TimelineEncoder::new(TICK_HZ, 60.0);
    let mut headers = StretchHeaderWriter::with_times(STRETCH_ROWS, times);
    let mut chain = StretchChain::new(LIVE_ROWS_MAX, STRETCH_ROWS, TICK_HZ);
    for (number, rows) in [(0, 7), (1, 0), (2, 0), (3, 1)] {
        let mut timeline = Timeline::default();
        timeline.restart(if number == 0 { 0 } else { 7 });
        timeline.push_damaged(rows);
        let first_row = timeline.first_row + rows;
        let span = Span { first_row, n_rows: 0, key: true, number };
        let mut payload = Vec::new();
        headers.put(span, &timeline, &[], true, &mut payload);
        assert_eq!(placed(&mut chain, &payload).unwrap().span, span);
    }
}
