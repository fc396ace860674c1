//! The batches of samples that the device sends.

use mocapd_drivers::device::SampleBatch;
use mocapd_drivers::link::batch_bytes_max;

use super::{Device, Queued, Run, SentBatch, frame_after_ns};
use crate::sampled::SampledSource;

/// What a group of sampled channels has sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct GroupState {
    /// Samples taken since power-up.
    taken: u64,
    /// Batches that left the device since power-up.
    sent: u32,
    /// Samples taken in this run.
    in_run: u64,
}

impl Device {
    /// Bytes per second that all batches need on the wire.
    pub(super) fn samples_bytes_per_s(&self) -> u64 {
        let needed = self.settings.sampled.iter().map(|source| {
            let info = source.info();
            let n = source.batch_samples();
            let bytes = batch_bytes_max(info.form, info.channels.len(), n as usize) as u64;
            (bytes * u64::from(info.rate_millihertz)).div_ceil(n * 1000)
        });
        needed.sum()
    }

    /// A run begins: its first samples are those at its start.
    pub(super) fn start_samples(&mut self) {
        self.groups.iter_mut().for_each(|group| group.in_run = 0);
    }

    /// When the sample with this number in the run is taken.
    fn sample_time_ns(&self, group: usize, number: u64, run: &Run) -> u64 {
        let rate_millihertz =
            self.settings.sampled.get(group).map_or(1, |source| source.info().rate_millihertz);
        let after_ns = frame_after_ns(number, rate_millihertz);
        run.start_ns.saturating_add(self.clock.caller_ns(after_ns))
    }

    /// The group whose batch is due next, and when that is: with its last sample.
    pub(super) fn next_batch(&self, run: &Run) -> Option<(usize, u64)> {
        let due = |(index, group): (usize, &GroupState)| {
            let source = self.settings.sampled.get(index)?;
            let n = source.n_left(group.in_run, source.batch_samples());
            let last = group.in_run + n.checked_sub(1)?;
            Some((index, self.sample_time_ns(index, last, run)))
        };
        let groups = self.groups.iter().enumerate();
        groups.filter_map(due).min_by_key(|(_, due_ns)| *due_ns)
    }

    /// Queues a whole batch of a group, or drops it when the queue is full.
    pub(super) fn produce_batch(&mut self, group: usize, run: &Run) {
        let n = self.settings.sampled.get(group).map_or(0, SampledSource::batch_samples);
        self.put_batches(group, self.n_left(group, n), run);
    }

    fn n_left(&self, group: usize, n: u64) -> u64 {
        let first = self.groups.get(group).map_or(0, |group| group.in_run);
        self.settings.sampled.get(group).map_or(0, |source| source.n_left(first, n))
    }

    /// Queues samples of a group, except those that it does not have.
    fn put_batches(&mut self, index: usize, n: u64, run: &Run) {
        let Some(source) = self.settings.sampled.get(index) else { return };
        let first = self.groups.get(index).map_or(0, |group| group.in_run);
        for (n, is_sent) in source.parts(first, n) {
            self.put_batch(index, (n, is_sent), run);
        }
    }

    /// Queues what was sampled up to the end of the run, and how many samples there were.
    pub(super) fn end_samples(&mut self, at_ns: u64) {
        let Some(run) = self.run else { return };
        for group in 0..self.groups.len() {
            let mut n = 0;
            while self.sample_time_ns(group, self.groups[group].in_run + n, &run) <= at_ns {
                n += 1;
            }
            let n = self.n_left(group, n);
            if n > 0 {
                self.put_batches(group, n, &run);
            }
            self.put_batch(group, (0, true), &run);
        }
        self.end_poses(at_ns);
    }

    /// Queues a batch, or drops it when the queue is full; `is_sent`: otherwise the device dropped it in any case.
    fn put_batch(&mut self, index: usize, (n, is_sent): (u64, bool), run: &Run) {
        let Some(source) = self.settings.sampled.get(index) else { return };
        let GroupState { taken, sent, in_run } = self.groups[index];
        let host_ns = self.sample_time_ns(index, in_run, run);
        let info = source.info();
        let mut samples = std::mem::take(&mut self.batch);
        samples.clear();
        source.samples(in_run, n, &mut samples);
        let batch = SampleBatch {
            group: info.id,
            number: sent,
            first: taken,
            device_ticks: self.ticks(host_ns),
            form: info.form,
            n_channels: info.channels.len() as u8,
            samples: &samples,
        };
        let bytes = batch_bytes_max(info.form, info.channels.len(), n as usize);
        let mut dropped = !is_sent || !self.outbox.has_room(bytes);
        if !dropped {
            let link = &mut self.link;
            // It fits by construction. If the link refused a batch, it would count as dropped.
            self.outbox.put(Queued::Batch, |out| dropped = link.samples(&batch, out).is_err());
        }
        let sent_batch = SentBatch {
            run: self.log.starts,
            group: batch.group,
            number: batch.number,
            first: batch.first,
            first_in_run: in_run,
            n,
            device_ticks: batch.device_ticks,
            dropped,
            host_ns,
        };
        self.batch = samples;
        let group = &mut self.groups[index];
        (group.taken, group.in_run) = (taken + n, in_run + n);
        self.log.samples_taken += n;
        if dropped {
            self.log.batches_dropped += 1;
        } else {
            group.sent = sent.wrapping_add(1);
            self.log.batches_produced += 1;
        }
        if self.settings.log_frames {
            self.log.batches.push(sent_batch);
        }
    }

    /// Takes the logged batches.
    pub fn take_batches(&mut self) -> Vec<SentBatch> {
        std::mem::take(&mut self.log.batches)
    }
}
