//! Sampled channels as NatNet sends them: with each frame, as many samples as belong to it.

use std::collections::VecDeque;

use mocapd_acquire::pipeline::TappedBatch;
use mocapd_drivers::{
    device::SampledGroupInfo,
    natnet::{SampledDescription, SampledToSend},
};

use super::super::PublishedDevice;

/// Time of the samples that wait for their frames: several times that of the longest batch.
const HELD_S: f64 = 1.0;

/// A force plate or device of the definitions.
#[derive(Debug)]
struct SampledDevice {
    group: u8,
    /// The indices of its channels in the group.
    channels: Vec<usize>,
    is_plate: bool,
    id: u32,
    /// The samples of the current frame: one channel after another.
    samples: Vec<f32>,
}

/// The samples of a group that wait for their frames.
#[derive(Debug)]
struct GroupQueue {
    info: SampledGroupInfo,
    /// Samples of a channel in a frame.
    per_frame: f64,
    /// The values, and the number of the first sample.
    values: VecDeque<f32>,
    first: u64,
    /// Whether a batch has come, so that the number behind the last one is known.
    is_begun: bool,
    /// Samples of the longest batch.
    batch_max: i64,
    lag: Lag,
    /// Samples that were left out, because they were too far behind.
    n_left_out: u64,
    /// The row of a frame, and the number of its first sample, which may be one before the first of all.
    anchor: Option<(u64, i64)>,
    /// Those of the current frame: the place of the first one, and their number.
    current: (usize, usize),
}

/// How far samples are behind their frames.
#[derive(Debug, Default)]
struct Lag {
    /// Frames that were watched, and the fewest samples that waited behind those of one of them.
    n_frames: u64,
    least: i64,
    /// Whether more waited than are held.
    has_overflowed: bool,
}

/// All sampled channels of a device.
#[derive(Debug, Default)]
pub(super) struct ServedSamples {
    devices: Vec<SampledDevice>,
    groups: Vec<GroupQueue>,
    /// Rates of the groups that are not sent: no whole number of their samples belongs to a frame.
    uneven_hz: Vec<f64>,
}

/// How far from a whole number of samples a frame may be: what rates in millihertz are rounded by.
const UNEVEN_MAX: f64 = 1e-4;

/// Whether every frame has equally many samples, at least one: clients of NatNet expect it.
fn is_even(per_frame: f64) -> bool {
    per_frame.round() >= 1.0 && (per_frame - per_frame.round()).abs() <= UNEVEN_MAX * per_frame
}

impl ServedSamples {
    /// The force plates of a device, and each of its groups without those: with what the definitions state about them.
    pub(super) fn new(device: &PublishedDevice) -> (Self, Vec<SampledDescription>) {
        let mut served = Self::default();
        let mut described = Vec::new();
        for info in &device.sampled {
            let rate_hz = f64::from(info.rate_millihertz) / 1000.0;
            let per_frame = rate_hz / device.header.rate_hz;
            if !is_even(per_frame) {
                served.uneven_hz.push(rate_hz);
                continue;
            }
            let plates = device.plates.iter().filter(|plate| plate.group == info.id);
            let mut rest: Vec<usize> = (0..info.channels.len()).collect();
            for plate in plates {
                let channels: Vec<usize> =
                    plate.channels.iter().map(|at| usize::from(*at)).collect();
                rest.retain(|channel| !channels.contains(channel));
                described.push(served.add(info, channels, true, plate.number.into()));
            }
            if !rest.is_empty() {
                described.push(served.add(info, rest, false, u32::from(info.id) + 1));
            }
            served.groups.push(GroupQueue {
                per_frame,
                info: info.clone(),
                // A second of samples: see `held_max`.
                values: VecDeque::default(),
                first: 0,
                is_begun: false,
                batch_max: 0,
                lag: Lag::default(),
                n_left_out: 0,
                anchor: None,
                current: (0, 0),
            });
        }
        (served, described)
    }

    fn add(
        &mut self,
        info: &SampledGroupInfo,
        channels: Vec<usize>,
        is_plate: bool,
        id: u32,
    ) -> SampledDescription {
        let stated = channels.iter().filter_map(|channel| info.channels.get(*channel));
        let (names, units): (Vec<String>, Vec<&str>) =
            stated.map(|channel| (channel.name.clone(), channel.unit.as_str())).unzip();
        let name = format!("{} {id}", if is_plate { "plate" } else { "device" });
        // Volts, or what the device calibrated.
        let data_type = u32::from(!units.is_empty() && units.iter().all(|unit| *unit == "V"));
        let group = info.id;
        self.devices.push(SampledDevice { group, channels, is_plate, id, samples: Vec::new() });
        SampledDescription { is_plate, id, name, data_type, channels: names }
    }

    /// Samples that were left out, because they came faster than their rate says, or frames came late.
    pub(super) fn n_left_out(&self) -> u64 {
        self.groups.iter().map(|group| group.n_left_out).sum()
    }

    /// Rates of the groups that are left out, in Hz.
    pub(super) fn uneven_hz(&self) -> &[f64] {
        &self.uneven_hz
    }

    /// Whether there are none.
    pub(super) fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// Samples of the first group in a frame.
    pub(super) fn per_frame(&self) -> u32 {
        self.groups.first().map_or(0, |group| group.per_frame.round() as u32)
    }

    /// Takes over a batch.
    pub(super) fn push(&mut self, batch: &TappedBatch) {
        if let Some(group) = self.groups.iter_mut().find(|group| group.info.id == batch.group) {
            group.push(batch);
        }
    }

    /// Selects the samples of a frame.
    pub(super) fn select(&mut self, row: u64) {
        let Self { devices, groups, .. } = self;
        for group in groups.iter_mut() {
            group.select(row);
            for device in devices.iter_mut().filter(|device| device.group == group.info.id) {
                device.samples.clear();
                for channel in &device.channels {
                    group.put_channel(*channel, &mut device.samples);
                }
            }
            group.release();
        }
    }

    /// The force plates, or the other devices, with the samples of the frame.
    pub(super) fn to_send(&self, is_plate: bool) -> Vec<SampledToSend<'_>> {
        let devices = self.devices.iter().filter(|device| device.is_plate == is_plate);
        let to_send = devices.map(|device| SampledToSend {
            id: device.id,
            n_channels: device.channels.len(),
            samples: &device.samples,
        });
        to_send.collect()
    }
}

impl GroupQueue {
    fn n_channels(&self) -> usize {
        self.info.channels.len().max(1)
    }

    fn n_held(&self) -> u64 {
        (self.values.len() / self.n_channels()) as u64
    }

    fn held_max(&self) -> u64 {
        (f64::from(self.info.rate_millihertz) / 1000.0 * HELD_S).ceil().max(1.0) as u64
    }

    fn push(&mut self, batch: &TappedBatch) {
        if usize::from(batch.n_channels) != self.n_channels() {
            return;
        }
        let end = self.first + self.n_held();
        let missing = batch.first.checked_sub(end);
        let follows = missing.filter(|missing| self.is_begun && *missing <= self.held_max());
        if follows.is_none() {
            // The first one, numbers that begin anew, or a long gap.
            self.values.clear();
            (self.first, self.is_begun, self.anchor) = (batch.first, true, None);
            self.lag = Lag::default();
        } else if let Some(missing) = follows {
            // Samples that are missing stay so: those behind them keep their frames.
            let n = missing as usize * self.n_channels();
            self.values.extend(std::iter::repeat_n(f32::NAN, n));
        }
        let scaled = |(place, value): (usize, &f32)| {
            let channel = self.info.channels.get(place)?;
            Some(channel.value(*value) as f32)
        };
        let n_samples = batch.samples.len() / self.n_channels();
        self.batch_max = self.batch_max.max(n_samples as i64);
        for sample in batch.samples.chunks_exact(self.n_channels()) {
            self.values.extend(sample.iter().enumerate().filter_map(scaled));
        }
        let excess = self.n_held().saturating_sub(self.held_max());
        self.drop_front(excess);
        self.n_left_out += excess;
        self.lag.has_overflowed |= excess > 0;
    }

    fn drop_front(&mut self, n: u64) {
        self.values.drain(..(n as usize * self.n_channels()).min(self.values.len()));
        self.first += n;
    }

    /// Selects the samples of a row. Where they have not come, this frame goes without, and those of all later ones are so
    /// much older: as many as a batch has, until frames never wait for one.
    ///
    /// What is more than two batches behind for half a second is left out, and those behind it are so much younger:
    /// converters that run faster than stated would leave their frames behind, and a pause of the frames as well. For a
    /// moment more samples wait whenever this machine stood still, because their frames come after them.
    fn select(&mut self, row: u64) {
        self.current = (0, 0);
        let (first, end) = (self.first.cast_signed(), (self.first + self.n_held()).cast_signed());
        let (anchor_row, anchor) = match self.anchor {
            Some((at, anchor)) if row >= at => (at, anchor),
            _ if self.values.is_empty() => return,
            _ => (row, first),
        };
        let samples_in = |rows: u64| (rows as f64 * self.per_frame + 1e-6).floor() as i64;
        let start = anchor.saturating_add(samples_in(row - anchor_row));
        let stop = anchor.saturating_add(samples_in(row - anchor_row + 1));
        self.anchor = if stop > end {
            self.lag = Lag { has_overflowed: self.lag.has_overflowed, ..Lag::default() };
            Some((anchor_row, anchor - (stop - start)))
        } else if start < first {
            // They are gone: frames came too late for them.
            None
        } else {
            let excess = self.excess(end - stop);
            self.n_left_out += excess.cast_unsigned();
            self.current = ((start - first + excess) as usize, (stop - start) as usize);
            Some((anchor_row, anchor.saturating_add(excess)))
        };
    }

    /// The samples to leave out at a frame behind whose own `behind` others wait.
    fn excess(&mut self, behind: i64) -> i64 {
        let Lag { n_frames, least, has_overflowed } = self.lag;
        let least = if n_frames == 0 || has_overflowed { behind } else { least.min(behind) };
        let n_frames = n_frames + 1;
        // With half of what is held, converters twice as fast as stated do not overflow the queue.
        let is_due = 2.0 * n_frames as f64 * self.per_frame >= self.held_max() as f64;
        if !is_due && !has_overflowed {
            self.lag = Lag { n_frames, least, has_overflowed };
            return 0;
        }
        self.lag = Lag::default();
        let behind_max = 2 * self.batch_max.max(self.per_frame.ceil() as i64);
        (least - behind_max).max(0)
    }

    fn put_channel(&self, channel: usize, out: &mut Vec<f32>) {
        let (start, n) = self.current;
        let values = self.values.iter().skip(start * self.n_channels() + channel);
        out.extend(values.step_by(self.n_channels()).take(n));
    }

    /// Drops the samples of the frame and those before it.
    fn release(&mut self) {
        let (start, n) = self.current;
        self.drop_front((start + n) as u64);
    }
}

#[cfg(test)]
mod tests {
    use mocapd_drivers::device::SampledChannelInfo;

    use super::*;

    fn queue(per_frame: f64) -> ServedSamples {
        let channels = vec![SampledChannelInfo { scale: 1.0, ..SampledChannelInfo::default() }; 2];
        let info = SampledGroupInfo {
            rate_millihertz: 1_000_000,
            channels,
            ..SampledGroupInfo::default()
        };
        let mut served = ServedSamples::default();
        served.add(&info, vec![1], true, 1);
        let group = GroupQueue {
            info,
            per_frame,
            values: VecDeque::default(),
            first: 0,
            is_begun: false,
            batch_max: 0,
            lag: Lag::default(),
            n_left_out: 0,
            anchor: None,
            current: (0, 0),
        };
        served.groups.push(group);
        served
    }

    fn push(served: &mut ServedSamples, numbers: std::ops::Range<u64>) {
        let samples: Vec<f32> = numbers.clone().flat_map(|n| [-(n as f32), n as f32]).collect();
        let batch =
            TappedBatch { first: numbers.start, n_channels: 2, samples, ..TappedBatch::default() };
        served.push(&batch);
    }

    fn select(served: &mut ServedSamples, row: u64) -> Vec<f32> {
        served.select(row);
        served.to_send(true)[0].samples.to_vec()
    }

    #[test]
    fn groups_with_unequal_numbers_of_samples_in_frames_are_left_out() {
        assert!(is_even(4.0) && is_even(1.0) && is_even(2000.0 / 199.999));
        assert!(!is_even(1000.0 / 120.0) && !is_even(0.5) && !is_even(1.5));
    }

    #[test]
    fn each_sample_comes_with_one_frame_and_always_as_many() {
        let mut served = queue(4.0);
        let mut found = Vec::new();
        // Batches of three frames, which come with every third one.
        for row in 0..30 {
            if row % 3 == 0 {
                push(&mut served, row * 4 + 100..row * 4 + 112);
            }
            found.push(select(&mut served, row));
        }
        let all: Vec<f32> = found.iter().flatten().copied().collect();
        let expected: Vec<f32> = (100..220).map(|n| n as f32).collect();
        assert_eq!(all, expected[..all.len()]);
        assert!(found.iter().all(|samples| samples.len() == 4), "{found:?}");
    }

    #[test]
    fn frames_that_came_too_early_go_without_and_later_ones_never_wait() {
        let mut served = queue(4.0);
        push(&mut served, 0..4);
        let mut counts = Vec::new();
        for row in 0..20 {
            counts.push(select(&mut served, row).len());
            if row % 2 == 1 {
                push(&mut served, row * 4..row * 4 + 8);
            }
        }
        assert!(counts[4..].iter().all(|n| *n == 4), "{counts:?}");
    }

    #[test]
    fn samples_of_frames_that_are_missing_go_with_them_and_missing_samples_are_not_numbers() {
        let mut served = queue(2.0);
        push(&mut served, 0..8);
        assert_eq!(select(&mut served, 10), [0.0, 1.0]);
        assert_eq!(select(&mut served, 12), [4.0, 5.0], "row 11 was lost");
        push(&mut served, 10..12);
        assert_eq!(select(&mut served, 13), [6.0, 7.0]);
        assert!(select(&mut served, 14).iter().all(|value| value.is_nan()));
        assert_eq!(select(&mut served, 15), [10.0, 11.0]);
        // Numbers begin anew.
        push(&mut served, 0..4);
        assert_eq!(select(&mut served, 16), [0.0, 1.0]);
    }

    #[test]
    fn a_batch_that_is_lost_is_not_numbers_where_one_comes_with_each_frame() {
        let mut served = queue(4.0);
        let mut found = Vec::new();
        for row in 0..20 {
            if row != 10 {
                push(&mut served, row * 4..row * 4 + 4);
            }
            found.push(select(&mut served, row));
        }
        assert_eq!((found[9][0], found[10].len()), (36.0, 0), "it may still come");
        assert!(found[11].iter().all(|value| value.is_nan()));
        let rest: Vec<f32> = found[12..].iter().flatten().copied().collect();
        let expected: Vec<f32> = (44..44 + rest.len()).map(|n| n as f32).collect();
        assert_eq!((rest, found[19].len()), (expected, 4));
    }

    #[test]
    fn samples_stay_with_their_frames_where_converters_run_fast_or_slow() {
        // Batches of ten samples; a frame has 2, and by these converters 1 % more or less.
        for (faster, slower) in [(101, 100), (99, 100)] {
            let mut served = queue(2.0);
            let (mut pushed, mut behind_max) = (0, 0.0_f32);
            for row in 0..50_000_u64 {
                let captured = row * 2 * faster / slower;
                while pushed + 10 <= captured {
                    push(&mut served, pushed..pushed + 10);
                    pushed += 10;
                }
                let last = select(&mut served, row).last().copied();
                behind_max = last.map_or(behind_max, |last| behind_max.max(captured as f32 - last));
            }
            assert!(behind_max <= 50.0, "{behind_max}");
            let left_out = served.n_left_out();
            let expected = if faster > slower { 900..1001 } else { 0..1 };
            assert!(expected.contains(&left_out), "{left_out}");
        }
    }

    #[test]
    fn samples_that_wait_for_a_moment_are_all_sent_and_a_pause_of_the_frames_is_caught_up_with() {
        let mut served = queue(2.0);
        let (mut pushed, mut found) = (0, Vec::new());
        for row in 0..2000_u64 {
            // For a tenth of a second all batches come before their frames; then frames 1000 to 1099 do not come.
            let captured = if (100..150).contains(&row) { 300 } else { row * 2 + 10 };
            while pushed + 10 <= captured {
                push(&mut served, pushed..pushed + 10);
                pushed += 10;
            }
            if !(1000..1100).contains(&row) {
                found.push(select(&mut served, if row < 1000 { row } else { row - 100 }));
            }
        }
        let all: Vec<f32> = found[..1000].iter().flatten().copied().collect();
        assert_eq!(all, (0..2000).map(|n| n as f32).collect::<Vec<_>>());
        let behind = pushed as f32 - found[1899][1];
        assert!(behind <= 40.0 && served.n_left_out() > 150, "{behind}, {}", served.n_left_out());
    }

    #[test]
    fn after_a_pause_longer_than_what_is_held_hardly_a_frame_goes_without() {
        for (per_frame, batch) in [(2, 10), (4, 8), (4, 20)] {
            let mut served = queue(per_frame as f64);
            let (mut pushed, mut n_empty) = (0, 0);
            for row in 0..2000_u64 {
                while pushed + batch <= (row + 4) * per_frame {
                    push(&mut served, pushed..pushed + batch);
                    pushed += batch;
                }
                // Of this one, no frame has come for 1.4 times as long as samples are held.
                let paused = 500..500 + 1400 / per_frame;
                if !paused.contains(&row) {
                    let missed = if row < 500 { 0 } else { 1400 / per_frame };
                    n_empty += u32::from(select(&mut served, row - missed).is_empty() && row > 20);
                }
            }
            assert!(n_empty <= 3, "{per_frame} {batch}: {n_empty}");
        }
    }

    #[test]
    fn rates_that_are_no_multiple_send_more_or_less_and_memory_is_bounded() {
        let mut served = queue(2.5);
        push(&mut served, 0..10);
        let counts: Vec<_> = (0..4).map(|row| select(&mut served, row).len()).collect();
        assert_eq!(counts, [2, 3, 2, 3]);
        for n in 0..100 {
            push(&mut served, 10 + n * 100..110 + n * 100);
        }
        assert_eq!(served.groups[0].n_held(), 1000);
        assert_eq!(select(&mut served, 100), [0.0; 0], "gone: frames came too late for them");
        assert_eq!(select(&mut served, 101).len(), 2);
    }
}
