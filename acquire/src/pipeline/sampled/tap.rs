//! The least and the largest sample of each channel, at most twenty times a second, for viewers. While a viewer does not read,
//! columns become longer; nothing waits for it.

use mocapd_drivers::device::{SampleBatch, SampledGroupInfo};

use crate::pipeline::ring::{RingConsumer, RingProducer, ring};

/// Columns of a strip chart in a second: as many as a chart of some seconds has pixels to show.
const COLUMNS_HZ: f64 = 20.0;

/// Columns of a group that wait for the viewer's thread, which polls every few milliseconds: more than a second.
const QUEUED_MAX: usize = 32;

/// The least and the largest sample of a channel, as the device sent them. NaN in both if there is none.
pub type SampleRange = [f32; 2];

const NO_SAMPLE: SampleRange = [f32::NAN; 2];

/// A column of a group of sampled channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SampleColumn {
    /// Number of the group.
    pub group: u8,
    /// Number of its first sample since the pipeline began.
    pub first: u64,
    /// Samples of a channel from its first to its last.
    pub n: u32,
    n_channels: u8,
}

/// The reader's end.
#[derive(Debug)]
pub(in crate::pipeline) struct SampleTapSender {
    columns: RingProducer<SampleColumn>,
    ranges: RingProducer<SampleRange>,
    groups: Vec<OpenColumn>,
}

/// The column of a group that is being filled.
#[derive(Debug)]
struct OpenColumn {
    group: u8,
    /// Samples of a channel in a column, and how many of them it has.
    length: u32,
    n: u32,
    /// Numbers of its first sample and behind its last one.
    first: u64,
    end: u64,
    ranges: Vec<SampleRange>,
}

/// The viewer's end.
#[derive(Debug)]
pub struct SampleTapReceiver {
    columns: RingConsumer<SampleColumn>,
    ranges: RingConsumer<SampleRange>,
}

/// A tap for groups of sampled channels.
pub(super) fn tap(groups: &[SampledGroupInfo]) -> (SampleTapSender, SampleTapReceiver) {
    let n_channels: usize = groups.iter().map(|group| group.channels.len()).sum();
    let (columns, columns_out) = ring(QUEUED_MAX * groups.len().max(1));
    let (ranges, ranges_out) = ring(QUEUED_MAX * n_channels.max(1));
    let open = groups.iter().map(|group| OpenColumn {
        group: group.id,
        length: ((f64::from(group.rate_millihertz) / 1000.0 / COLUMNS_HZ).ceil() as u32).max(1),
        n: 0,
        first: 0,
        end: 0,
        ranges: vec![NO_SAMPLE; group.channels.len()],
    });
    let sender = SampleTapSender { columns, ranges, groups: open.collect() };
    (sender, SampleTapReceiver { columns: columns_out, ranges: ranges_out })
}

impl SampleTapSender {
    /// Offers a batch of the group with this index, which it fits. `first` is the number of its first sample.
    pub(super) fn offer(&mut self, index: usize, first: u64, batch: &SampleBatch<'_>) {
        let Self { columns, ranges, groups } = self;
        let Some(open) = groups.get_mut(index) else { return };
        let rows = batch.samples.chunks_exact(open.ranges.len().max(1));
        for (number, row) in (first..).zip(rows) {
            if open.n == 0 {
                open.first = number;
            }
            for ([least, largest], &sample) in open.ranges.iter_mut().zip(row) {
                // `min` and `max` leave NaN out, also that of an empty range.
                *least = least.min(sample);
                *largest = largest.max(sample);
            }
            open.n = open.n.saturating_add(1);
            open.end = number + 1;
            // Without room the column goes on, so that no peak is left out.
            if open.n < open.length || columns.vacant() == 0 || ranges.vacant() < open.ranges.len()
            {
                continue;
            }
            ranges.push_slice(&open.ranges);
            let n = u32::try_from(open.end.saturating_sub(open.first)).unwrap_or(u32::MAX);
            let n_channels = open.ranges.len() as u8;
            columns.push(SampleColumn { group: open.group, first: open.first, n, n_channels });
            open.n = 0;
            open.ranges.fill(NO_SAMPLE);
        }
    }
}

impl SampleTapReceiver {
    /// The next column. Fills `ranges` by channel.
    pub fn next(&mut self, ranges: &mut Vec<SampleRange>) -> Option<SampleColumn> {
        let column = self.columns.pop()?;
        ranges.clear();
        ranges.resize(column.n_channels.into(), NO_SAMPLE);
        self.ranges.pop_slice(ranges);
        Some(column)
    }
}

#[cfg(test)]
mod tests {
    use mocapd_drivers::device::{SampleForm, SampledChannelInfo};

    use super::*;

    fn group(id: u8, n_channels: usize, rate_millihertz: u32) -> SampledGroupInfo {
        let channel = SampledChannelInfo {
            name: "Fz".to_owned(),
            unit: "N".to_owned(),
            scale: 1.0,
            offset: 0.0,
        };
        let channels = vec![channel; n_channels];
        SampledGroupInfo { id, form: SampleForm::Int16, rate_millihertz, channels }
    }

    fn batch<'a>(group: u8, n_channels: u8, samples: &'a [f32]) -> SampleBatch<'a> {
        let form = SampleForm::Int16;
        SampleBatch { group, number: 0, first: 0, device_ticks: 0, form, n_channels, samples }
    }

    #[test]
    fn columns_have_the_ends_of_their_samples_however_these_arrive() {
        let groups = [group(7, 2, 60_000), group(3, 1, 1_000_000)];
        let (mut sender, mut receiver) = tap(&groups);
        // Three samples a column: two columns and a part of one.
        sender.offer(0, 40, &batch(7, 2, &[1.0, -1.0, 5.0, -5.0]));
        sender.offer(1, 0, &batch(3, 1, &[f32::NAN; 50]));
        sender.offer(0, 45, &batch(7, 2, &[3.0, -3.0, 9.0, 9.0, 8.0, 7.0, 6.0, 5.0, 1.0, 1.0]));
        let mut ranges = Vec::new();
        let mut next = |ranges: &mut Vec<SampleRange>| {
            receiver.next(ranges).map(|column| (column.group, column.first, column.n))
        };
        assert_eq!(next(&mut ranges), Some((3, 0, 50)));
        assert!(ranges.len() == 1 && ranges[0][0].is_nan());
        assert_eq!(next(&mut ranges), Some((7, 40, 6)), "three samples are missing in it");
        assert_eq!(ranges, [[1.0, 5.0], [-5.0, -1.0]]);
        assert_eq!(next(&mut ranges), Some((7, 46, 3)));
        assert_eq!(ranges, [[6.0, 9.0], [5.0, 9.0]]);
        assert_eq!(next(&mut ranges), None);
    }

    #[test]
    fn a_viewer_that_does_not_read_costs_no_peak() {
        let (mut sender, mut receiver) = tap(&[group(0, 1, 20_000)]);
        for i in 0..100_u8 {
            sender.offer(0, i.into(), &batch(0, 1, &[f32::from(i)]));
        }
        let mut ranges = Vec::new();
        let kept = std::iter::from_fn(|| receiver.next(&mut ranges)).count();
        assert_eq!(kept, QUEUED_MAX);
        sender.offer(0, 100, &batch(0, 1, &[5.0]));
        let column = receiver.next(&mut ranges).unwrap();
        assert_eq!((column.first, column.n, ranges[0]), (32, 69, [5.0, 99.0]));
    }
}
