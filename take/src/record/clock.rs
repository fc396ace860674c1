//! CLOCK: observations of the device's and the host's clock, and the line fitted to them.
//!
//! All inputs of the fit are stored in whole microseconds, so a reader can repeat it. docs/clock.md describes the fit.

use bincode::{Decode, Encode, de::Decoder, enc::Encoder, error::DecodeError, error::EncodeError};

use super::Record;
use crate::{
    chunk::types,
    varint::{self, Cursor},
};

/// Maximum number of probes, and of points, in one record. A recorder writes a record well before it has so many, and a
/// reader
/// needs memory for no more.
pub const CLOCK_ENTRIES_MAX: usize = 4096;

/// A frame that arrived early for its part of the recording. No frame arrives before its exposure, so the device's
/// clock had reached `device_ticks` no later than `host_us`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ClockPoint {
    /// Device time of the frame, in ticks.
    pub device_ticks: u64,
    /// Arrival by the host's monotonic clock, in microseconds, rounded up.
    pub host_us: u64,
}

/// One round trip: the device's clock read `device_ticks` at a moment between the two host times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ClockProbe {
    /// Host monotonic time at which the ping was sent, in microseconds, rounded down.
    pub sent_us: u64,
    /// Device time at which the ping arrived, in ticks.
    pub device_ticks: u64,
    /// Time from sending the ping to receiving the pong, in microseconds, rounded up.
    pub round_trip_us: u64,
}

/// The fitted line. The host time of device time `ticks` is
/// `host_ns + (ticks - device_ticks) * 1e9 / tick_hz * (1 + drift_ppb * 1e-9)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ClockLine {
    /// Reference point of the line, in device ticks.
    pub device_ticks: u64,
    /// Host monotonic time at the reference point, in nanoseconds.
    pub host_ns: u64,
    /// How much faster the host's clock runs, in parts per billion.
    pub drift_ppb: i64,
    /// The largest error of the line. `None` without a round trip: the line is then late by the least delay of any
    /// frame.
    pub bound: Option<ClockBound>,
}

/// The largest error of a line, if both clocks keep their rates and these are within 500 ppm of each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Encode, Decode)]
pub struct ClockBound {
    /// Error at the reference point, in microseconds.
    pub offset_us: u64,
    /// Error of the drift, in parts per billion.
    pub drift_ppb: u64,
}

/// Distribution of arrivals around the line, over the recording so far, in microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Encode, Decode)]
pub struct ClockJitter {
    /// Number of frames.
    pub frames: u64,
    /// Root mean square distance of arrivals from the line.
    pub residual_us: u64,
    /// Median delay of arrivals after the line.
    pub p50_us: u64,
    /// 99th percentile of the delay.
    pub p99_us: u64,
    /// Largest delay.
    pub max_us: u64,
}

/// Observations of the clocks since the previous record of this type.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Clock {
    /// Number of the device clock's continuous run, from 0; a jump of the clock starts the next.
    pub segment: u32,
    /// Device clock ticks per second.
    pub tick_hz: u64,
    /// The line as currently fitted.
    pub line: Option<ClockLine>,
    /// The distribution of arrivals around it.
    pub jitter: ClockJitter,
    /// Round trips, in the order of their answers.
    pub probes: Vec<ClockProbe>,
    /// Early frames, in order.
    pub points: Vec<ClockPoint>,
}

impl Record for Clock {
    const NAME: &'static str = "clock";
    const KIND: u8 = types::CLOCK;
    const VERSION: u16 = 1;
}

/// Device ticks and host microseconds; each entry is stored as its difference from the previous one.
type Times = (u64, u64);

fn ticks_in(us: i64, tick_hz: u64) -> u64 {
    // Modulo 2^64, like ticks.
    (i128::from(us) * i128::from(tick_hz)).div_euclid(1_000_000) as u64
}

fn zigzag(value: u64) -> u64 {
    let value = value.cast_signed();
    (value << 1 ^ value >> 63).cast_unsigned()
}

fn unzigzag(value: u64) -> u64 {
    value >> 1 ^ (value & 1).wrapping_neg()
}

fn put_times(out: &mut Vec<u8>, (ticks, us): Times, previous: &mut Times, tick_hz: u64) {
    let passed_us = us.wrapping_sub(previous.1);
    let expected = ticks_in(passed_us.cast_signed(), tick_hz);
    // Time increases, except after a pong that overtook another.
    varint::put(out, passed_us);
    varint::put(out, zigzag(ticks.wrapping_sub(previous.0).wrapping_sub(expected)));
    *previous = (ticks, us);
}

fn read_times(bytes: &mut Cursor<'_>, previous: &mut Times, tick_hz: u64) -> Option<Times> {
    let passed_us = bytes.varint()?;
    let expected = ticks_in(passed_us.cast_signed(), tick_hz);
    let error = unzigzag(bytes.varint()?);
    let ticks = previous.0.wrapping_add(expected).wrapping_add(error);
    *previous = (ticks, previous.1.wrapping_add(passed_us));
    Some(*previous)
}

impl Clock {
    fn origin(&self) -> Times {
        let probe = self.probes.first().map(|probe| (probe.device_ticks, probe.sent_us));
        let point = self.points.first().map(|point| (point.device_ticks, point.host_us));
        let line = self.line.map(|line| (line.device_ticks, line.host_ns / 1000));
        probe.or(point).or(line).unwrap_or_default()
    }

    /// The reference point of a line is usually the last point.
    fn last(&self) -> Times {
        self.points.last().map_or(self.origin(), |point| (point.device_ticks, point.host_us))
    }
}

impl Encode for Clock {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        if self.probes.len().max(self.points.len()) > CLOCK_ENTRIES_MAX {
            return Err(EncodeError::Other("more probes or points than a record may hold"));
        }
        let (origin, tick_hz) = (self.origin(), self.tick_hz);
        let (mut probes, mut points) = (Vec::new(), Vec::new());
        let mut previous = origin;
        for probe in &self.probes {
            put_times(&mut probes, (probe.device_ticks, probe.sent_us), &mut previous, tick_hz);
            varint::put(&mut probes, probe.round_trip_us);
        }
        previous = origin;
        for point in &self.points {
            put_times(&mut points, (point.device_ticks, point.host_us), &mut previous, tick_hz);
        }
        let last = self.last();
        self.segment.encode(encoder)?;
        tick_hz.encode(encoder)?;
        origin.encode(encoder)?;
        probes.encode(encoder)?;
        points.encode(encoder)?;
        let line = self.line.map(|line| {
            let ticks = line.device_ticks.wrapping_sub(last.0).cast_signed();
            let ns = line.host_ns.wrapping_sub(last.1.wrapping_mul(1000)).cast_signed();
            (ticks, ns, line.drift_ppb, line.bound)
        });
        line.encode(encoder)?;
        self.jitter.encode(encoder)
    }
}

impl Decode<()> for Clock {
    fn decode<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let segment = u32::decode(decoder)?;
        let tick_hz = u64::decode(decoder)?;
        let origin = Times::decode(decoder)?;
        let mut previous = origin;
        let probes = parse_entries(&Vec::<u8>::decode(decoder)?, |bytes| {
            let (device_ticks, sent_us) = read_times(bytes, &mut previous, tick_hz)?;
            Some(ClockProbe { sent_us, device_ticks, round_trip_us: bytes.varint()? })
        })?;
        let mut previous = origin;
        let points = parse_entries(&Vec::<u8>::decode(decoder)?, |bytes| {
            let (device_ticks, host_us) = read_times(bytes, &mut previous, tick_hz)?;
            Some(ClockPoint { device_ticks, host_us })
        })?;
        let line = Option::<(i64, i64, i64, Option<ClockBound>)>::decode(decoder)?;
        let jitter = ClockJitter::decode(decoder)?;
        let mut clock = Self { segment, tick_hz, line: None, jitter, probes, points };
        let last = if clock.points.is_empty() { origin } else { clock.last() };
        clock.line = line.map(|(ticks, ns, drift_ppb, bound)| ClockLine {
            device_ticks: last.0.wrapping_add_signed(ticks),
            host_ns: last.1.wrapping_mul(1000).wrapping_add_signed(ns),
            drift_ppb,
            bound,
        });
        Ok(clock)
    }
}

/// Parses all entries; an error if the bytes end inside one, or there are too many.
fn parse_entries<T>(
    bytes: &[u8],
    mut next: impl FnMut(&mut Cursor<'_>) -> Option<T>,
) -> Result<Vec<T>, DecodeError> {
    let message = "its probes or points are truncated, or more than a record may hold";
    let mut bytes = Cursor::new(bytes);
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let entry = next(&mut bytes).filter(|_| found.len() < CLOCK_ENTRIES_MAX);
        found.push(entry.ok_or(DecodeError::Other(message))?);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    fn recorded() -> Clock {
        let at = |us: u64| 70_000_000 + us * 10 - us / 500;
        Clock {
            segment: 0,
            tick_hz: 10_000_000,
            line: Some(ClockLine {
                device_ticks: at(9_000_000),
                host_ns: 86_400_009_000_123,
                drift_ppb: 200_012,
                bound: Some(ClockBound { offset_us: 96, drift_ppb: 8_400 }),
            }),
            jitter: ClockJitter {
                frames: 600,
                residual_us: 9_000,
                p50_us: 8_000,
                p99_us: 16_100,
                max_us: 21_000,
            },
            probes: (0..8)
                .map(|i| ClockProbe {
                    sent_us: 86_400_000_000 + 16_000 * i,
                    device_ticks: at(16_000 * i) + 600,
                    round_trip_us: 150 + i,
                })
                .collect(),
            points: (0..5)
                .map(|i| ClockPoint {
                    device_ticks: at(1_000_000 * i),
                    host_us: 86_400_000_210 + 1_000_000 * i + i % 3,
                })
                .collect(),
        }
    }

    #[test]
    fn it_comes_back_and_is_small() {
        let clock = recorded();
        let payload = clock.to_payload().unwrap();
        assert_eq!(Clock::from_payload(&payload, 0).unwrap(), clock);
        assert!(payload.len() <= 150, "{} bytes", payload.len());
    }

    /// The bytes of docs/take-format.md, assembled by hand: version 1 never changes.
    #[test]
    fn its_bytes_are_what_the_format_says() {
        let clock = Clock {
            segment: 3,
            tick_hz: 1_000_000,
            line: Some(ClockLine {
                device_ticks: 7_001_003,
                host_ns: 2_001_009_500,
                drift_ppb: -200_000,
                bound: Some(ClockBound { offset_us: 60, drift_ppb: 200 }),
            }),
            jitter: ClockJitter {
                frames: 120,
                residual_us: 300,
                p50_us: 90,
                p99_us: 1_000,
                max_us: 70_000,
            },
            probes: vec![
                ClockProbe { sent_us: 2_000_000, device_ticks: 7_000_000, round_trip_us: 150 },
                ClockProbe { sent_us: 2_000_100, device_ticks: 7_000_098, round_trip_us: 90 },
            ],
            points: vec![ClockPoint { device_ticks: 7_001_003, host_us: 2_001_000 }],
        };
        let bytes: &[&[u8]] = &[
            &[1, 0],
            &[3],
            &[252, 0x40, 0x42, 0x0f, 0],
            // Origin: ticks 7 000 000, us 2 000 000.
            &[252, 0xc0, 0xcf, 0x6a, 0],
            &[252, 0x80, 0x84, 0x1e, 0],
            // Probes: no difference from the origin, 150 = 0x96; 100 us later with two ticks fewer than 100, 90.
            &[7, 0, 0, 0x96, 0x01, 100, 3, 90],
            // A point: 1000 = 0x3e8 us later, three ticks more.
            &[3, 0xe8, 0x07, 6],
            // The line: at the point; 9500 ns later; -200 ppm; within 60 us and 200 ppb.
            &[1, 0, 251, 0x38, 0x4a, 252, 0x7f, 0x1a, 0x06, 0, 1, 60, 200],
            &[120, 251, 0x2c, 0x01, 90, 251, 0xe8, 0x03, 252, 0x70, 0x11, 0x01, 0],
        ];
        assert_eq!(clock.to_payload().unwrap(), bytes.concat());
        assert_eq!(Clock::from_payload(&bytes.concat(), 0).unwrap(), clock);
    }

    #[test]
    fn any_numbers_come_back() {
        let mut random = Random::new(1);
        // Numbers of every length in bits.
        let mut number = || random.next_u64() >> random.below(64);
        for _ in 0..200 {
            let mut clock = Clock {
                segment: number() as u32,
                tick_hz: number(),
                line: Some(ClockLine {
                    device_ticks: number(),
                    host_ns: number(),
                    drift_ppb: number().cast_signed(),
                    bound: Some(ClockBound { offset_us: number(), drift_ppb: number() }),
                }),
                ..Clock::default()
            };
            for _ in 0..number() % 20 {
                let [sent_us, device_ticks, round_trip_us] = [number(), number(), number()];
                clock.probes.push(ClockProbe { sent_us, device_ticks, round_trip_us });
                clock.points.push(ClockPoint { device_ticks: number(), host_us: number() });
            }
            assert_eq!(Clock::from_payload(&clock.to_payload().unwrap(), 0).unwrap(), clock);
        }
    }

    #[test]
    fn every_cut_and_too_many_entries_are_errors() {
        let payload = recorded().to_payload().unwrap();
        for cut in 0..payload.len() {
            assert!(Clock::from_payload(&payload[..cut], 0).is_err(), "{cut}");
        }
        let points = vec![ClockPoint::default(); CLOCK_ENTRIES_MAX + 1];
        assert!(Clock { points, ..Clock::default() }.to_payload().is_err());
        // Replace the empty list of points with entries of two bytes each, as many as allowed, and one more.
        let empty = Clock::default().to_payload().unwrap();
        let (head, rest) = empty.split_at(2 + 1 + 1 + 2 + 1);
        let n = 2 * (CLOCK_ENTRIES_MAX + 1);
        for (n, is_fine) in [(n - 2, true), (n, false)] {
            let list = [251, n as u8, (n >> 8) as u8];
            let bytes = [head, &list, &vec![0; n], &rest[1..]].concat();
            assert_eq!(Clock::from_payload(&bytes, 0).is_ok(), is_fine);
        }
    }
}
