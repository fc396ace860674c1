//! What the device sends, through its bounded output queue of whole messages: answers to commands, as specified in
//! `docs/link-protocol.md` section 3, batches of samples, and the poses of rigid bodies behind each frame.

use std::collections::VecDeque;
use std::sync::Arc;

use mocapd_drivers::device::{
    BodyInfo, Command, EndOfPoses, LinkBudget, Pong, PoseFrame, SampleBatch,
};
use mocapd_drivers::link::{
    DeviceLink, batch_bytes_max, frame_bytes_in_volume, frame_bytes_max, link_budget,
    pose_frame_bytes_max,
};

use super::{
    Device, LineDevice, RATE_MILLIHERTZ, Run, SECOND_NS, SentBatch, SentCounters, SentLog,
    frame_after_ns,
};
use crate::sampled::SampledSource;

/// Smallest capacity, bytes: as much as a kernel pty holds.
const CAPACITY_MIN: usize = 64 << 10;

/// Largest capacity, bytes: 1.3 s of 200 markers at 1000 Hz (3.1 MB/s).
const CAPACITY_MAX: usize = 4 << 20;

/// Frames that always fit, regardless of their size.
const FRAMES_MIN: usize = 4;

impl Queued {
    /// A frame, or another message.
    pub(crate) fn frame_if(is_frame: bool) -> Self {
        if is_frame { Self::Frame } else { Self::Other }
    }
}

/// A queue of bytes that counts a frame as sent once the line has taken all of it.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    bytes: Vec<u8>,
    head: usize,
    capacity: usize,
    /// Bytes ever queued.
    queued: u64,
    /// Where each waiting frame ends, in bytes ever queued.
    frame_ends: VecDeque<u64>,
    frames_sent: u64,
    frames_discarded: u64,
    /// The same of batches of samples.
    batch_ends: VecDeque<u64>,
    batches_discarded: u64,
}

/// What is queued.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Queued {
    Frame,
    Batch,
    Other,
}

impl Outbox {
    /// Sets the capacity to `size` bytes, or to one second of frames and of `samples_bytes_per_s`, between 64 KiB and
    /// 4 MiB.
    pub(crate) fn resize(
        &mut self,
        frame_bytes: usize,
        rate_millihertz: u32,
        samples_bytes_per_s: u64,
        size: Option<usize>,
    ) {
        let frames = frame_bytes as u64 * u64::from(rate_millihertz) / 1000;
        let second = frames.saturating_add(samples_bytes_per_s);
        let second = usize::try_from(second).unwrap_or(CAPACITY_MAX);
        let capacity = size.unwrap_or(second.clamp(CAPACITY_MIN, CAPACITY_MAX));
        self.capacity = capacity.max(FRAMES_MIN * frame_bytes);
    }

    pub(crate) fn has_room(&self, bytes: usize) -> bool {
        self.pending().len() + bytes <= self.capacity
    }

    /// Queues the bytes that `write` appends.
    pub(crate) fn put(&mut self, what: Queued, write: impl FnOnce(&mut Vec<u8>)) {
        let start = self.bytes.len();
        write(&mut self.bytes);
        self.queued += (self.bytes.len() - start) as u64;
        if self.bytes.len() > start {
            match what {
                Queued::Frame => self.frame_ends.push_back(self.queued),
                Queued::Batch => self.batch_ends.push_back(self.queued),
                Queued::Other => {}
            }
        }
    }

    pub(crate) fn pending(&self) -> &[u8] {
        self.bytes.get(self.head..).unwrap_or_default()
    }

    /// The line took the first `n` bytes.
    pub(crate) fn sent(&mut self, n: usize) {
        self.head = (self.head + n).min(self.bytes.len());
        let sent = self.bytes_sent();
        while self.frame_ends.pop_front_if(|end| *end <= sent).is_some() {
            self.frames_sent += 1;
        }
        while self.batch_ends.pop_front_if(|end| *end <= sent).is_some() {}
        if self.head == self.bytes.len() {
            self.bytes.clear();
            self.head = 0;
        } else if self.head > self.bytes.len() / 2 {
            // Amortised: moves at most as many bytes as were sent since the last move.
            self.bytes.drain(..self.head);
            self.head = 0;
        }
    }

    /// Discards the bytes that the line has not taken. A message that it took in part stays incomplete on the line.
    pub(crate) fn discard(&mut self) {
        self.queued = self.bytes_sent();
        self.frames_discarded += self.frames_waiting();
        self.batches_discarded += self.batch_ends.len() as u64;
        self.frame_ends.clear();
        self.batch_ends.clear();
        self.bytes.clear();
        self.head = 0;
    }

    /// Fills in the queue's counters of a log: frames sent, waiting and discarded, and bytes sent.
    pub(crate) fn complete_log(&self, log: &SentLog) -> SentLog {
        SentLog {
            frames_sent: self.frames_sent,
            frames_waiting: self.frames_waiting(),
            frames_discarded: self.frames_discarded,
            batches_discarded: self.batches_discarded,
            bytes_sent: self.bytes_sent(),
            ..log.clone()
        }
    }

    fn bytes_sent(&self) -> u64 {
        self.queued - self.pending().len() as u64
    }

    fn frames_waiting(&self) -> u64 {
        self.frame_ends.len() as u64
    }
}

impl Device {
    /// Queues a pending end of stream once there is room.
    pub(super) fn send_end_of_stream(&mut self) {
        if let Some(status) = self.pending_end
            && self.outbox.has_room(0)
        {
            self.pending_end = None;
            self.end_sent = true;
            self.log.ends += 1;
            let link = &mut self.link;
            self.outbox.put(Queued::Other, |out| link.end_of_stream(status, out));
        }
    }

    /// Queues an answer; drops it when the queue is full because the host does not read.
    pub(super) fn answer(&mut self, write: impl FnOnce(&mut DeviceLink, &mut Vec<u8>)) {
        if self.outbox.has_room(0) {
            let link = &mut self.link;
            self.outbox.put(Queued::Other, |out| write(link, out));
        } else {
            self.log.answers_dropped += 1;
        }
    }

    pub(super) fn execute(&mut self, command: Command, now_ns: u64) {
        match command {
            Command::Identify => self.identify(),
            Command::Ping { host_ns } => {
                let pong = Pong { host_ns, device_ticks: self.ticks(now_ns) };
                self.answer(|link, out| link.pong(pong, out));
            }
            Command::SetRate(rate_millihertz) => self.set_rate(rate_millihertz),
            Command::Start { line_bytes_per_s } => self.start(line_bytes_per_s, now_ns),
            Command::Stop => {
                // Frames that were due before the command are part of the run.
                self.poll(now_ns);
                self.end(now_ns);
                self.finished = false;
                self.send_end_of_stream();
            }
        }
    }

    /// Stops the device, discards frames queued for an earlier host, and queues Hello and the marker table.
    pub(super) fn identify(&mut self) {
        self.run = None;
        self.pending_end = None;
        self.end_sent = false;
        self.outbox.discard();
        if self.finished {
            let status = self.status();
            self.answer(|link, out| link.status(status, out));
        }
        let hello = self.hello.clone();
        let table = std::mem::take(&mut self.table);
        let groups = std::mem::take(&mut self.settings.sampled);
        let bodies = self.body_infos();
        self.answer(|link, out| {
            // All were encoded once when the device was made.
            let outcome = link.hello(&hello, out).and_then(|()| link.markers(&table, out));
            let mut groups_of = groups.iter().map(|source| link.sampled_group(source.info(), out));
            let outcome = outcome.and(groups_of.try_for_each(|announced| announced));
            let mut plates = groups.iter().flat_map(SampledSource::force_plates);
            let outcome = outcome.and(plates.try_for_each(|plate| link.force_plate(plate, out)));
            let outcome = match bodies.is_empty() {
                true => outcome,
                false => outcome.and_then(|()| link.bodies(&bodies, out)),
            };
            debug_assert!(outcome.is_ok());
        });
        self.table = table;
        self.settings.sampled = groups;
    }

    /// Ends the run at `at_ns`, with the samples taken up to then.
    pub(super) fn end(&mut self, at_ns: u64) {
        self.end_samples(at_ns);
        self.run = None;
        self.pending_end = Some(self.status());
    }

    fn budget(&self, rate_millihertz: u32, host_line_bytes_per_s: u64) -> LinkBudget {
        let lines = [self.settings.line_bytes_per_s, host_line_bytes_per_s];
        let line = lines.into_iter().filter(|line| *line > 0).min().unwrap_or(0);
        let frame_bytes = frame_bytes_in_volume(self.settings.form, self.table.len());
        let residuals = if self.settings.residuals.is_some() { self.table.len() } else { 0 };
        let frame_bytes = frame_bytes + residuals + self.pose_bytes();
        let rate_max_millihertz = self.hello.rate_max_millihertz;
        let samples = self.samples_bytes_per_s();
        link_budget(frame_bytes, rate_millihertz, rate_max_millihertz, samples, line)
    }

    fn start(&mut self, line_bytes_per_s: u64, now_ns: u64) {
        let budget = self.budget(self.hello.rate_millihertz, line_bytes_per_s);
        if !budget.fits() {
            self.log.refused += 1;
            self.answer(|link, out| link.refused(budget, out));
            return;
        }
        if !self.outbox.has_room(0) {
            // Frames must not come without Started before them: the host will repeat its Start.
            self.log.answers_dropped += 1;
            return;
        }
        // A Start repeated during a run changes nothing: the answer was lost, not the command.
        if self.run.is_none() {
            self.pending_end = None;
            self.end_sent = false;
            self.finished = false;
            self.log.starts += 1;
            self.first_start_ns.get_or_insert(now_ns);
            self.log.run = SentCounters::default();
            self.start_samples();
            self.run = Some(Run { start_ns: now_ns, status_ns: now_ns + SECOND_NS });
        }
        self.answer(|link, out| link.started(budget, out));
    }

    fn set_rate(&mut self, rate_millihertz: u32) {
        let mut budget = self.budget(rate_millihertz, 0);
        if self.run.is_some() {
            budget.rate_fits_millihertz = self.hello.rate_millihertz;
        }
        if self.run.is_some() || !RATE_MILLIHERTZ.contains(&rate_millihertz) || !budget.fits() {
            self.log.refused += 1;
            self.answer(|link, out| link.refused(budget, out));
            return;
        }
        self.adopt_rate(rate_millihertz);
        self.answer(|link, out| link.rate_set(rate_millihertz, out));
    }

    pub(super) fn adopt_rate(&mut self, rate_millihertz: u32) {
        let motion = Arc::clone(self.replay.motion());
        self.replay = self.rates.replay(motion, rate_millihertz);
        self.hello.rate_millihertz = rate_millihertz;
        self.hello.n_frames = if self.settings.looping { 0 } else { self.replay.n_frames() };
        let frame_bytes = frame_bytes_max(usize::from(self.hello.markers_max)) + self.pose_bytes();
        let samples = self.samples_bytes_per_s();
        self.outbox.resize(frame_bytes, rate_millihertz, samples, self.settings.queue_bytes);
    }
}

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

/// The group that poses have in logs of batches: the one after those of sampled channels. Takes have them from this number
/// on.
pub const POSES_GROUP: u8 = mocapd_drivers::link::GROUPS_MAX as u8;

impl Device {
    /// The rigid bodies that it announces.
    pub(super) fn body_infos(&self) -> Vec<BodyInfo> {
        self.settings.bodies.as_ref().map(|bodies| bodies.infos()).unwrap_or_default()
    }

    /// Bytes on the wire of the poses of a frame, at most.
    pub(super) fn pose_bytes(&self) -> usize {
        match self.body_infos().len() {
            0 => 0,
            n_bodies => pose_frame_bytes_max(n_bodies),
        }
    }

    /// Queues the poses of frame `counter`, the one with this number in the run, or drops them when the queue is full.
    pub(super) fn produce_poses(&mut self, counter: u32, number: u64, at_ns: u64) {
        let Some(bodies) = &self.settings.bodies else { return };
        let mut poses = std::mem::take(&mut self.poses);
        let rate_hz = f64::from(self.hello.rate_millihertz) / 1000.0;
        let is_sent = bodies.poses(number, rate_hz, &mut poses);
        let since_ns = self.since_ns(at_ns).unwrap_or(0);
        if let Some(faults) = &mut self.faults {
            faults.poses(since_ns, &mut poses);
        }
        self.poses = poses;
        self.put_poses((counter, is_sent), (number, 1), at_ns);
    }

    /// States the number of the frame that would come next.
    pub(super) fn end_poses(&mut self, at_ns: u64) {
        if self.settings.bodies.is_some() {
            self.poses.clear();
            self.put_poses((self.counter, true), (self.log.run.frames_produced, 0), at_ns);
        }
    }

    /// `is_sent`: otherwise the device dropped them.
    fn put_poses(
        &mut self,
        (seq, is_sent): (u32, bool),
        (first_in_run, n): (u64, u64),
        at_ns: u64,
    ) {
        let (number, device_ticks) = (self.poses_sent, self.ticks(at_ns));
        let poses = std::mem::take(&mut self.poses);
        let frame = PoseFrame { seq, number, device_ticks, poses: &poses };
        let mut dropped = !is_sent || !self.outbox.has_room(pose_frame_bytes_max(poses.len()));
        if !dropped {
            let link = &mut self.link;
            // They fit by construction. If the link refused them, they would count as dropped.
            let end = EndOfPoses { seq, number, device_ticks };
            self.outbox.put(Queued::Batch, |out| match n {
                0 => link.end_of_poses(end, out),
                _ => dropped = link.poses(&frame, out).is_err(),
            });
        }
        self.poses = poses;
        if dropped {
            self.log.batches_dropped += 1;
        } else {
            self.poses_sent = number.wrapping_add(1);
            self.log.batches_produced += 1;
        }
        if self.settings.log_frames {
            self.log.batches.push(SentBatch {
                run: self.log.starts,
                group: POSES_GROUP,
                number,
                first: seq.into(),
                first_in_run,
                n,
                device_ticks,
                dropped,
                host_ns: at_ns,
            });
        }
    }
}
