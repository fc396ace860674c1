//! The device's commands and answers, as specified in `docs/link-protocol.md` section 3.

use std::sync::Arc;

use mocapd_drivers::device::{Command, LinkBudget, Pong};
use mocapd_drivers::link::{DeviceLink, frame_bytes_in_volume, frame_bytes_max, link_budget};

use super::{Device, LineDevice, Queued, RATE_MILLIHERTZ, Run, SECOND_NS, SentCounters};
use crate::sampled::SampledSource;

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
        let frame_bytes = frame_bytes + self.pose_bytes();
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
