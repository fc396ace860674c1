//! Fills a frame's row by channel, puts the row into the rings, and closes stretches.
//!
//! Poses are in step with the frames: they go into the rings behind their frame, before a boundary of takes that follows it,
//! whichever of both came first.

use std::{
    collections::{HashMap, VecDeque},
    sync::atomic::Ordering,
};

use mocapd_drivers::device::{
    BODIES_MAX, BodyInfo, EndOfPoses, Frame, MarkerInfo, Pose, PoseFrame,
};
use mocapd_take::{
    record::EndingKind,
    stretch::{NUMBERS, Span},
    timeline::RowTime,
};

use super::{Intake, NO_SLOT, losses::PendingLoss};
use crate::pipeline::{
    messages::{Control, NewChannel, StretchEnd, TakeCommand},
    plan::{POSES_WAIT_NS, RUNS_MAX},
    publish_tap::PublishTapSender,
    ring::{RingProducer, Sample, TimelineItem},
    sampled::{NewPoses, PosesOutcome},
};

impl Intake {
    /// Closes the open stretch when the rows lost before this frame do not fit into it.
    pub(super) fn make_room(&mut self) {
        let left = u64::from(self.open_limit - self.open_rows);
        if self.open_rows > 0 && self.pending.rows() >= left {
            self.close_stretch();
        }
    }

    /// Whether this frame fits, with the lost rows before it that belong to the open stretch.
    pub(super) fn has_room(&mut self) -> bool {
        self.has_room_for(1 + if self.open_rows > 0 { self.pending.rows() as usize } else { 0 })
    }

    /// Whether this many rows fit.
    pub(super) fn has_room_for(&mut self, rows: usize) -> bool {
        if self.rows_free < rows {
            let active = &self.rings[..self.n_channels];
            self.rows_free = active.iter().map(RingProducer::vacant).min().unwrap_or(usize::MAX);
        }
        // The pending runs, one of which may be divided between two takes, this row, and the runs that may be pending
        // at the end.
        self.rows_free >= rows && self.timeline.vacant() > 2 * RUNS_MAX + 1
    }

    pub(super) fn push_row(&mut self, time: RowTime) {
        if self.open_rows > 0 {
            for _ in 0..self.pending.rows() {
                self.push_samples(|_| Sample::default());
                self.open_rows += 1;
            }
        }
        self.push_pending();
        if self.open_rows == 0 {
            self.open_first_row = self.next_row;
        }
        let (stretch, segment) = (self.feed.next_stretch(), self.clocks.segment());
        self.samples.residuals(&self.row[..self.n_channels], time.device_ticks, stretch, segment);
        let mut present = 0;
        self.push_samples(|sample| {
            present += u64::from(sample.present);
            std::mem::take(sample)
        });
        self.timeline.push(TimelineItem::Recorded(time));
        self.open_rows += 1;
        self.next_row += 1;
        self.counts.recorded += 1;
        self.counts.samples_announced += self.n_channels as u64;
        self.counts.samples_present += present;
        self.progress.frames.store(self.counts.recorded, Ordering::Relaxed);
    }

    fn push_samples(&mut self, mut take: impl FnMut(&mut Sample) -> Sample) {
        for (ring, sample) in self.rings[..self.n_channels].iter_mut().zip(&mut self.row) {
            ring.push(take(sample));
        }
        self.rows_free = self.rows_free.saturating_sub(1);
    }

    pub(super) fn push_pending(&mut self) {
        let mut pending = std::mem::take(&mut self.pending);
        self.push_lost(&mut pending);
    }

    /// Puts the first `rows` of the pending rows into the ring.
    fn push_pending_up_to(&mut self, rows: u64) {
        let mut first = self.pending.split_off_first(rows);
        self.push_lost(&mut first);
    }

    fn push_lost(&mut self, lost: &mut PendingLoss) {
        self.next_row += lost.rows();
        for (rows, causes) in lost.drain() {
            self.samples.lose_residuals(rows, causes);
            self.timeline.push(TimelineItem::Lost { rows, causes });
        }
        self.progress.lost.store(self.counts.lost(), Ordering::Relaxed);
    }

    pub(super) fn close_stretch(&mut self) {
        if self.open_rows > 0 {
            self.end_stretch(self.open_rows, false);
            self.open_rows = 0;
            self.open_limit = self.stretch_rows;
        }
    }

    /// Sends the rows lost since the last recorded one as a stretch of their own: they count for the take that ends
    /// here.
    pub(super) fn close_pending(&mut self) {
        let is_empty = self.pending.rows() == 0 || self.counts.recorded == 0;
        if is_empty || self.timeline.vacant() <= 3 * RUNS_MAX {
            return;
        }
        self.push_pending();
        self.end_boundary();
    }

    pub(super) fn end_stretch(&mut self, n_rows: u32, last: bool) {
        let first_row = if n_rows > 0 { self.open_first_row } else { self.next_row };
        // The next stretch would begin too late to be the key stretch.
        let key = first_row.saturating_add(u64::from(self.stretch_rows)) > self.next_key_row;
        if key {
            self.next_key_row = first_row.saturating_add(self.key_every);
        }
        let number = (self.feed.next_stretch() % u64::from(NUMBERS)) as u8;
        let span = Span { first_row, n_rows, key, number };
        self.send(self.end_of(span, last));
    }

    /// Sends a boundary between two stretches, through the same queue as stretches.
    pub(super) fn end_boundary(&mut self) {
        self.send(self.boundary());
    }

    fn boundary(&self) -> StretchEnd {
        let span = Span { first_row: self.next_row, n_rows: 0, key: false, number: 0 };
        self.end_of(span, false)
    }

    /// Sends the rows lost before `end_row` as a stretch of their own.
    pub(super) fn close_pending_up_to(&mut self, end_row: u64) {
        if end_row > self.next_row {
            self.push_pending_up_to(end_row - self.next_row);
            self.end_boundary();
        }
    }

    /// Whether the next frame is behind the end of a take of a requested length.
    pub(super) fn length_is_reached(&self) -> bool {
        self.take_end_row.is_some_and(|end| self.next_row + self.pending.rows() >= end)
    }

    /// Ends the open take before the next frame if it has its requested length. Of the rows lost before that frame,
    /// those up to the end belong to the take.
    pub(super) fn end_before_frame(&mut self) {
        if !self.length_is_reached() {
            return;
        }
        let Some(end_row) = self.take_end_row.take() else { return };
        self.close_stretch();
        self.close_pending_up_to(end_row);
        self.key_every = self.armed_key_rows;
        let end = (self.feed.next_stretch(), TakeCommand::End(EndingKind::Length));
        // The queue has a place for it; if the writer is gone, so is the take.
        self.to_writer.commands.try_send(end).ok();
        self.end_boundary();
        self.next_key_row = self.next_row;
        self.open_limit = self.first_stretch_rows;
    }

    /// Divides the recording before this frame, for which there is room, if a take ends here. Rows lost before it
    /// belong to the take whose range contains them.
    pub(super) fn split_before_frame(&mut self) {
        let row = self.next_row + self.pending.rows();
        let is_asked = self.open_rows == 0 && self.progress.split_is_due.load(Ordering::Relaxed);
        let Some(first_row) = self.splits.take_due(row, is_asked) else { return };
        self.progress.split_is_due.store(false, Ordering::Relaxed);
        self.close_stretch();
        self.push_pending_up_to(first_row.saturating_sub(self.next_row));
        self.send(StretchEnd { splits: true, ..self.boundary() });
        self.next_key_row = self.next_row;
        self.open_limit = self.first_stretch_rows;
    }

    fn end_of(&self, span: Span, last: bool) -> StretchEnd {
        StretchEnd {
            span,
            first: self.open_first,
            last_arrival_ns: self.last_arrival_ns,
            n_channels: self.n_channels,
            lacks_residuals: self.samples.lacks_residuals(self.n_channels),
            last,
            splits: false,
        }
    }

    fn send(&mut self, end: StretchEnd) {
        let fill = |ring: &RingProducer<Sample>| ring.fill_permille();
        let fullest = self.rings[..self.n_channels].iter().map(fill).max().unwrap_or(0);
        self.progress.ring_fill_permille.store(fullest, Ordering::Relaxed);
        // Boundaries have no rows.
        let (stretch, is_boundary) = (self.feed.next_stretch(), end.span.n_rows == 0);
        let segment = self.clocks.segment();
        self.samples.end_stretch(stretch, end.span.key, is_boundary, segment);
        self.blocks_since_ns = self.now_ns;
        if !self.feed.end_stretch(end, self.counts()) {
            self.progress.failed.store(true, Ordering::Relaxed);
        }
    }
}

/// Announcements that wait for a frame: one for every possible id.
const ANNOUNCED_MAX: usize = 1 << 16;

impl Intake {
    /// Announces markers of the device's table. New ones become channels with the next frame, as long as free channels
    /// remain.
    /// A table may come in several messages: all messages before that frame form one.
    pub fn announce(&mut self, markers: &[MarkerInfo]) {
        self.announced.extend_from_slice(markers);
        if self.announced.len() > ANNOUNCED_MAX {
            self.bind_announced();
        }
    }

    /// Gives every announced marker the channel of its name, or a new one.
    pub(super) fn bind_announced(&mut self) {
        let announced = std::mem::take(&mut self.announced);
        // If an id was announced twice, the last announcement counts.
        let last: HashMap<u16, usize> =
            announced.iter().enumerate().map(|(at, marker)| (marker.id, at)).collect();
        let is_new = |(at, marker): &(usize, &MarkerInfo)| {
            let slot = self.slot_of_id[usize::from(marker.id)];
            let known = self.labels.get(slot as usize);
            last.get(&marker.id) == Some(at)
                && !known.is_some_and(|label| marker.label.is_empty() || *label == marker.label)
        };
        let new: Vec<&MarkerInfo> =
            announced.iter().enumerate().filter(is_new).map(|(_, marker)| marker).collect();
        if new.is_empty() {
            return;
        }
        // These ids now stand for other markers. All lose their channels before any gets one, so that markers that
        // exchanged names find each other's channels free. Samples of a marker without a channel count as dropped: they
        // must not be stored under the old name.
        for marker in &new {
            self.slot_of_id[usize::from(marker.id)] = NO_SLOT;
        }
        let mut is_bound = vec![false; self.labels.len()];
        for &slot in &self.slot_of_id {
            if let Some(is_bound) = is_bound.get_mut(slot as usize) {
                *is_bound = true;
            }
        }
        let mut free: HashMap<String, VecDeque<u32>> = HashMap::new();
        for (slot, label) in self.labels.iter().enumerate() {
            if !is_bound[slot] && !label.is_empty() {
                free.entry(label.clone()).or_default().push_back(slot as u32);
            }
        }
        for marker in new {
            match free.get_mut(&marker.label).and_then(VecDeque::pop_front) {
                Some(slot) => self.slot_of_id[usize::from(marker.id)] = slot,
                None => self.open_channel(marker.id, Some((&marker.label, marker.labelled))),
            }
        }
    }

    /// Sorts the frame's markers into slots.
    pub(super) fn fill_row(&mut self, frame: &Frame<'_>) {
        for marker in frame.markers {
            let mut slot = self.slot_of_id[usize::from(marker.id)];
            if slot == NO_SLOT {
                self.open_channel(marker.id, None);
                slot = self.slot_of_id[usize::from(marker.id)];
            }
            let Some(sample) = self.row.get_mut(slot as usize) else {
                self.counts.markers_dropped += 1;
                continue;
            };
            let finite = marker.position_mm.iter().all(|v| v.is_finite());
            self.counts.samples_not_finite += u64::from(!finite && !marker.occluded);
            *sample = Sample {
                position_mm: marker.position_mm,
                present: finite && !marker.occluded,
                residual_10um: marker.residual_10um,
            };
        }
    }

    /// Opens a channel for a new marker, which begins with a new stretch.
    fn open_channel(&mut self, id: u16, named: Option<(&str, bool)>) {
        if self.n_channels >= self.row.len() {
            return;
        }
        self.close_stretch();
        let channel = NewChannel {
            slot: self.n_channels,
            marker_id: id,
            named: named.map(|(label, labelled)| (label.to_owned(), labelled)),
        };
        let control = (self.feed.next_stretch(), Control::Channel(channel));
        if self.to_writer.control.try_send(control).is_err() {
            return;
        }
        self.labels.push(named.map(|(label, _)| label.to_owned()).unwrap_or_default());
        self.slot_of_id[usize::from(id)] = self.n_channels as u32;
        self.n_channels += 1;
        self.counts.markers_appeared += 1;
        self.rows_free = 0;
    }
}

/// Poses whose frame has not come, and the frame whose poses have not.
#[derive(Debug, Default)]
pub(super) struct PoseStep {
    /// Number of the frame, number of the message, and ticks of the poses that wait.
    waiting: Option<(u32, u32, u64)>,
    poses: Vec<Pose>,
    /// The last frame.
    last_frame: Option<u32>,
    /// The frame of the last poses in the rings.
    last_poses: Option<u32>,
    /// Whether the device has sent poses: those of a frame are expected.
    is_active: bool,
}

impl PoseStep {
    /// For a device with this many bodies.
    pub(super) fn new(n_bodies: usize) -> Self {
        // Drivers report at most as many poses, also of bodies that were not announced.
        let capacity = if n_bodies > 0 { BODIES_MAX } else { 0 };
        Self { poses: Vec::with_capacity(capacity), ..Self::default() }
    }
}

impl Intake {
    /// Accepts the poses of a frame: all of them go into the rings of their groups, or are counted as lost.
    pub fn poses(&mut self, frame: &PoseFrame<'_>) {
        self.flush_poses();
        self.pose_step.is_active = true;
        let last = self.pose_step.last_frame;
        if last.is_none_or(|last| frame.seq.wrapping_sub(last).cast_signed() > 0) {
            self.pose_step.waiting = Some((frame.seq, frame.number, frame.device_ticks));
            self.pose_step.poses.clear();
            self.pose_step.poses.extend_from_slice(frame.poses);
            return;
        }
        self.put_poses(frame);
        // The frame was the last one of the take, whose end waited for its poses.
        self.end_before_frame();
    }

    /// Counts the poses that are missing up to the end of a run.
    pub fn end_of_poses(&mut self, end: &EndOfPoses) {
        self.flush_poses();
        let (stretch, segment) = (self.feed.next_stretch(), self.clocks.segment());
        self.samples.end_of_poses(end, stretch, segment);
    }

    /// Reports rigid bodies that differ from those announced before the start.
    pub fn announce_bodies(&mut self, bodies: &[BodyInfo]) {
        if !self.samples.announce_bodies(bodies) {
            let n = bodies.len();
            self.report_announcement(format_args!("other rigid bodies than before, {n} in all,"));
        }
    }

    fn put_poses(&mut self, frame: &PoseFrame<'_>) {
        self.pose_step.last_poses = Some(frame.seq);
        let segment = self.clocks.segment();
        let outcome = self.samples.poses(frame, self.feed.next_stretch(), segment);
        if let Some(NewPoses { rows, n_frames, n_tracked }) = self.samples.new_poses() {
            self.tap.offer_poses(frame.seq, n_frames, (rows, n_tracked));
            self.publish.iter_mut().for_each(|tap| tap.poses(frame.seq, rows));
        }
        if let PosesOutcome::Refused { body } = outcome {
            self.count_refused(format_args!("poses of body {body}"));
        }
    }

    /// Puts the poses that wait into the rings.
    pub(super) fn flush_poses(&mut self) {
        let Some((seq, number, device_ticks)) = self.pose_step.waiting.take() else { return };
        let poses = std::mem::take(&mut self.pose_step.poses);
        self.put_poses(&PoseFrame { seq, number, device_ticks, poses: &poses });
        self.pose_step.poses = poses;
    }

    /// A frame comes: poses of one before it, which did not come, are not behind a boundary before this one.
    pub(super) fn flush_poses_before(&mut self, seq: u32) {
        let is_before = |(of, ..): (u32, u32, u64)| seq.wrapping_sub(of).cast_signed() > 0;
        if self.pose_step.waiting.is_some_and(is_before) {
            self.flush_poses();
        }
    }

    /// The frame is in the rings: its poses follow, if they wait. Returns whether its poses are still to come.
    pub(super) fn flush_poses_of(&mut self, seq: u32) -> bool {
        self.pose_step.last_frame = Some(seq);
        if self.pose_step.waiting.is_some_and(|(of, ..)| of == seq) {
            self.flush_poses();
        }
        self.lacks_poses()
    }

    fn lacks_poses(&self) -> bool {
        let step = &self.pose_step;
        step.is_active && step.last_frame.is_some() && step.last_poses != step.last_frame
    }

    /// Whether the poses of the last frame are still expected.
    pub(super) fn awaits_poses(&self, now_ns: u64) -> bool {
        self.lacks_poses() && now_ns.saturating_sub(self.last_arrival_ns) < POSES_WAIT_NS
    }

    /// The poses of the last frame of a take did not come: its end does not wait any longer.
    pub(super) fn end_without_poses(&mut self) {
        if self.pose_step.is_active {
            self.end_before_frame();
        }
    }

    /// The device was away or starts again: its numbers do, too.
    pub(super) fn reset_poses(&mut self) {
        self.flush_poses();
        self.pose_step.last_frame = None;
        self.tap.forget_frame();
        self.publish.iter_mut().for_each(PublishTapSender::forget_frame);
    }
}
