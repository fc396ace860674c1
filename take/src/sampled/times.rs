//! `SAMPLE_TIMES`: when the samples of a recording were taken, by the device's clock.

use super::{SampleContent, SamplesChunk};
use crate::{TakeError, record::SAMPLES_MAX, varint};

const NAME: &str = "times of samples";

/// Time between two anchors from which on their line goes on beyond them, in seconds. Devices stamp batches up to some
/// milliseconds late, so that a line over less time is steeper or flatter than the rate that the group states.
const APART_S: f64 = 10.0;

/// The version of the payload.
const VERSION: u16 = 1;

/// Most anchors of a chunk: a recorder writes one for each block.
const ANCHORS_MAX: usize = 1 << 16;

/// The time of one sample of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SampleAnchor {
    /// Number of the sample.
    pub number: u64,
    /// Number of the first sample of its run: between the samples of a run the device's clock did not jump, and none was
    /// taken that has no number.
    pub run_start: u64,
    /// Time of the sample by the device's clock, in ticks: the clock of the rows.
    pub device_ticks: u64,
    /// The segment of the device's clock, as in CLOCK.
    pub segment: u32,
}

impl SampleAnchor {
    /// The anchor in a take in which numbers of samples and of segments are higher by these.
    pub(crate) fn moved(&self, by: u64, by_segment: u32) -> Self {
        Self {
            number: self.number.saturating_add(by),
            run_start: self.run_start.saturating_add(by),
            segment: self.segment.saturating_add(by_segment),
            ..*self
        }
    }
}

/// A `SAMPLE_TIMES` chunk: anchors of one group in one run, in order.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SampleTimes {
    /// Number of the group.
    pub group: u32,
    /// The anchors; at least one.
    pub anchors: Vec<SampleAnchor>,
}

impl SampleTimes {
    /// Appends the payload of a chunk with an anchor and, in the same run, the number and time of a later sample.
    pub(crate) fn put(
        group: u32,
        anchor: &SampleAnchor,
        later: Option<(u64, u64)>,
        out: &mut Vec<u8>,
    ) {
        out.extend_from_slice(&VERSION.to_le_bytes());
        let after_start = anchor.number.saturating_sub(anchor.run_start);
        for number in [
            group.into(),
            anchor.segment.into(),
            anchor.run_start,
            after_start,
            anchor.device_ticks,
        ] {
            varint::put(out, number);
        }
        if let Some((number, device_ticks)) = later.filter(|later| later.0 > anchor.number) {
            varint::put(out, number - anchor.number);
            varint::put(out, zigzag(device_ticks.wrapping_sub(anchor.device_ticks)));
        }
    }

    /// Parses the payload of the chunk at file offset `offset`, whose CRC matched.
    pub(crate) fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |why| TakeError::corrupt(NAME, offset, why);
        let Some((version, rest)) = payload.split_first_chunk::<2>() else {
            return Err(corrupt("shorter than its version"));
        };
        let (found, supported) = (u16::from_le_bytes(*version), VERSION);
        if found != supported {
            return Err(TakeError::Unsupported { what: NAME, found, supported });
        }
        Self::parse(&mut varint::Cursor::new(rest)).map_err(corrupt)
    }

    fn parse(cursor: &mut varint::Cursor<'_>) -> Result<Self, &'static str> {
        const INCOMPLETE: &str = "its numbers are incomplete";
        let small = |cursor: &mut varint::Cursor<'_>| {
            let number = cursor.varint().ok_or(INCOMPLETE)?;
            u32::try_from(number).map_err(|_| "the number of its group or segment is too large")
        };
        let (group, segment) = (small(cursor)?, small(cursor)?);
        let run_start = cursor.varint().ok_or(INCOMPLETE)?;
        let mut times = Self { group, anchors: Vec::new() };
        let (mut number, mut device_ticks) = (run_start, 0_u64);
        while !cursor.is_empty() || times.anchors.is_empty() {
            let step = cursor.varint().ok_or(INCOMPLETE)?;
            let ticks = cursor.varint().ok_or(INCOMPLETE)?;
            let is_first = times.anchors.is_empty();
            number = number.saturating_add(step);
            device_ticks =
                if is_first { ticks } else { device_ticks.wrapping_add(unzigzag(ticks)) };
            if (step == 0 && !is_first) || number > SAMPLES_MAX {
                return Err("its samples are not in order, or their numbers too large");
            }
            if times.anchors.len() == ANCHORS_MAX {
                return Err("it has more times than a chunk can hold");
            }
            times.anchors.push(SampleAnchor { number, run_start, device_ticks, segment });
        }
        Ok(times)
    }
}

fn zigzag(value: u64) -> u64 {
    let value = value.cast_signed();
    (value << 1 ^ value >> 63).cast_unsigned()
}

fn unzigzag(value: u64) -> u64 {
    value >> 1 ^ (value & 1).wrapping_neg()
}

/// When a sample was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleTime {
    /// Time by the device's clock in whole ticks, rounded down.
    pub device_ticks: u64,
    /// The rest, 0 to 1 ticks.
    pub fraction: f64,
    /// The segment of the device's clock.
    pub segment: u32,
    /// Number of the first sample of its run.
    pub run_start: u64,
}

impl SampleTime {
    /// Ticks since another time of the same segment.
    #[must_use]
    pub fn ticks_since(&self, device_ticks: u64) -> f64 {
        self.device_ticks.wrapping_sub(device_ticks).cast_signed() as f64 + self.fraction
    }
}

/// The times of all samples of a group: those of a run lie on the lines between its anchors. Before the first and behind
/// the last anchor of a run the line through these two goes on if they are far enough apart for it; else samples come at
/// the group's rate. A block whose anchors are lost has times only where other anchors show its run.
#[derive(Debug, Clone, Copy)]
pub struct SampleClock<'a> {
    anchors: &'a [SampleAnchor],
    /// The chunks of the samples, in order.
    chunks: &'a [SamplesChunk],
    /// Ticks between two anchors from which on their line goes on beyond them.
    apart_ticks: f64,
    /// Ticks from a sample to the next at the group's rate.
    nominal_ticks: f64,
}

impl<'a> SampleClock<'a> {
    /// The clock of a group with `rate_hz`, whose anchors and chunks are in ascending order of samples.
    pub(crate) fn new(
        anchors: &'a [SampleAnchor],
        chunks: &'a [SamplesChunk],
        rate_hz: f64,
        tick_hz: u64,
    ) -> Self {
        let (apart_ticks, nominal_ticks) = (APART_S * tick_hz as f64, tick_hz as f64 / rate_hz);
        Self { anchors, chunks, apart_ticks, nominal_ticks }
    }

    /// The time of a sample; `None` before the first run, and where the run is unknown because anchors are lost.
    #[must_use]
    pub fn at(&self, number: u64) -> Option<SampleTime> {
        let next = self.anchors.partition_point(|anchor| anchor.number <= number);
        let before = next.checked_sub(1).and_then(|at| self.anchors.get(at));
        let after = self.anchors.get(next).filter(|after| after.run_start <= number);
        let (from, ticks_each) = match (before, after) {
            (Some(before), Some(after)) if before.run_start == after.run_start => {
                (before, slope(before, after))
            }
            // The anchor of the first sample of the run is missing.
            (_, Some(after)) => (after, self.ticks_each(next)),
            (Some(before), None) if self.is_anchored(number, before) => {
                (before, self.ticks_each(next - 1))
            }
            (_, None) => return None,
        };
        let by = (i128::from(number) - i128::from(from.number)) as f64 * ticks_each;
        let whole = by.floor();
        Some(SampleTime {
            device_ticks: from.device_ticks.wrapping_add_signed(whole as i64),
            fraction: by - whole,
            segment: from.segment,
            run_start: from.run_start,
        })
    }

    /// Whether a sample lies in the run of the last anchor before it: it is in the same block, or lost. Each block has an
    /// anchor at its first sample unless that is lost, and another run may begin there.
    fn is_anchored(&self, number: u64, before: &SampleAnchor) -> bool {
        let at = self.chunks.partition_point(|chunk| chunk.span.first <= number);
        let Some(chunk) = at.checked_sub(1).and_then(|at| self.chunks.get(at)) else { return true };
        let is_lost = matches!(chunk.span.content, SampleContent::Lost(_));
        is_lost || number >= chunk.span.end() || before.number >= chunk.span.first
    }

    /// Ticks from a sample to the next over the whole run of an anchor, if it is long enough to measure them.
    fn ticks_each(&self, at: usize) -> f64 {
        let Some(anchor) = self.anchors.get(at) else { return self.nominal_ticks };
        let is_before = |other: &SampleAnchor| other.run_start < anchor.run_start;
        let is_within = |other: &SampleAnchor| other.run_start <= anchor.run_start;
        let first = self.anchors.get(self.anchors.partition_point(is_before));
        let last = self.anchors.get(self.anchors.partition_point(is_within).saturating_sub(1));
        match first.zip(last) {
            Some((first, last)) if last.number > first.number => {
                let each = slope(first, last);
                let apart = each * last.number.saturating_sub(first.number) as f64;
                if apart >= self.apart_ticks { each } else { self.nominal_ticks }
            }
            _ => self.nominal_ticks,
        }
    }
}

/// Ticks from a sample to the next on the line between two anchors.
fn slope(a: &SampleAnchor, b: &SampleAnchor) -> f64 {
    let ticks = b.device_ticks.wrapping_sub(a.device_ticks).cast_signed();
    ticks as f64 / b.number.saturating_sub(a.number).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{sampled::SampleSpan, timeline::LossCauses};

    fn anchor(number: u64, run_start: u64, device_ticks: u64) -> SampleAnchor {
        SampleAnchor { number, run_start, device_ticks, segment: run_start as u32 }
    }

    fn seconds(clock: &SampleClock<'_>, number: u64) -> Option<f64> {
        let time = clock.at(number)?;
        Some((time.device_ticks as f64 + time.fraction) / 1000.0)
    }

    #[test]
    fn a_chunk_round_trips_and_every_cut_is_an_error() {
        for found in [anchor(0, 0, 0), anchor(900, 300, u64::MAX), anchor(SAMPLES_MAX, 7, 5)] {
            let mut payload = Vec::new();
            SampleTimes::put(3, &found, None, &mut payload);
            let times = SampleTimes::from_payload(&payload, 0).unwrap();
            assert_eq!(times, SampleTimes { group: 3, anchors: vec![found] });
            for cut in 0..payload.len() {
                assert!(SampleTimes::from_payload(&payload[..cut], 0).is_err(), "{cut}");
            }
            payload[0] = 2;
            let later = SampleTimes::from_payload(&payload, 0);
            assert!(matches!(later, Err(TakeError::Unsupported { .. })));
        }
    }

    #[test]
    fn a_chunk_with_several_anchors_is_read_as_documented() {
        let mut payload = Vec::new();
        // 5 samples and 49 ticks later, and 1 sample later at 10 ticks before that.
        SampleTimes::put(0, &anchor(10, 10, 1000), Some((15, 1049)), &mut payload);
        payload.extend([1, 19]);
        let times = SampleTimes::from_payload(&payload, 0).unwrap();
        let expected = [anchor(10, 10, 1000), anchor(15, 10, 1049), anchor(16, 10, 1039)];
        assert_eq!(times.anchors, expected);
        let mut documented = Vec::new();
        SampleTimes::put(0, &anchor(40, 0, 20_000), Some((60, 30_010)), &mut documented);
        let text = include_str!("../../../docs/take-format.md");
        let (_, example) = text.split_once("A SAMPLE_TIMES of group 0").unwrap();
        let lines = example.lines().skip(2).map_while(|line| line.strip_prefix("    "));
        let words = lines.flat_map(|line| line.split("  ").next().unwrap().split_whitespace());
        let bytes: Vec<u8> = words.map(|word| u8::from_str_radix(word, 16).unwrap()).collect();
        assert_eq!(documented, bytes);
        payload.extend([0, 2]);
        assert!(SampleTimes::from_payload(&payload, 0).is_err(), "the same sample again");
    }

    /// 100 Hz by a clock of 1000 Hz that runs 1 % fast from the second anchor on; then the clock jumps back, and the third
    /// run is too short to measure the rate.
    #[test]
    fn times_lie_on_the_lines_between_anchors_and_jump_between_runs() {
        let anchors = [
            anchor(0, 0, 5000),
            anchor(1000, 0, 15_000),
            anchor(2000, 0, 25_100),
            anchor(2500, 2500, 100),
            anchor(2550, 2500, 700),
        ];
        let clock = SampleClock::new(&anchors, &[], 100.0, 1000);
        let at = |number| seconds(&clock, number).unwrap();
        assert_eq!([at(0), at(500), at(1000)], [5.0, 10.0, 15.0]);
        assert!((at(1500) - 20.05).abs() < 1e-9);
        // Behind the last anchor of a run, over all of which a sample took 10.05 ticks.
        assert!((at(2400) - (25.1 + 400.0 * 0.010_05)).abs() < 1e-9);
        assert_eq!([at(2500), at(2525), at(2550), at(2560)], [0.1, 0.4, 0.7, 0.8]);
        assert_eq!(clock.at(2499).unwrap().segment, 0);
        assert_eq!(clock.at(2500).unwrap().segment, 2500);
    }

    #[test]
    fn a_lost_anchor_never_joins_two_runs() {
        // The anchor of sample 250, which begins the second run, is lost.
        let anchors = [anchor(0, 0, 5000), anchor(100, 0, 6000), anchor(300, 250, 600)];
        let clock = SampleClock::new(&anchors, &[], 100.0, 1000);
        assert_eq!(seconds(&clock, 249), Some(7.49));
        assert_eq!(seconds(&clock, 250), Some(0.1));
        let clock = SampleClock::new(&anchors[2..], &[], 100.0, 1000);
        assert_eq!((seconds(&clock, 249), seconds(&clock, 250)), (None, Some(0.1)));
    }

    #[test]
    fn a_block_without_its_anchors_has_times_only_where_others_show_its_run() {
        let chunk = |(first, n, content)| SamplesChunk {
            span: SampleSpan { group: 0, first, n, content },
            offset: 0,
            block_at: 0,
            block_bytes: 0,
        };
        let lost = SampleContent::Lost(LossCauses::NOT_RECEIVED);
        let chunks = [
            (0, 100, SampleContent::Key),
            // Its anchors are lost; the ones before and behind it are of one run.
            (100, 100, SampleContent::Key),
            (200, 100, SampleContent::Key),
            (300, 50, lost),
            // Its anchors are lost, and with them where the next run begins.
            (350, 50, SampleContent::Key),
            (400, 100, SampleContent::Key),
            (500, 100, SampleContent::Key),
        ]
        .map(chunk);
        let anchors = [anchor(0, 0, 0), anchor(200, 0, 2000), anchor(400, 380, 90_000)];
        let clock = SampleClock::new(&anchors, &chunks, 100.0, 1000);
        let runs = [150, 299, 320, 350, 379, 380, 499, 500].map(|number| clock.at(number));
        let runs = runs.map(|time| time.map(|time| time.run_start));
        let expected = [Some(0), Some(0), Some(0), None, None, Some(380), Some(380), None];
        assert_eq!(runs, expected);
        assert_eq!((seconds(&clock, 150), seconds(&clock, 380)), (Some(1.5), Some(89.8)));
    }
}
