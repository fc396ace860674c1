//! Which marker goes into which channel.

use std::collections::{HashMap, VecDeque};

use mocapd_drivers::device::{Frame, MarkerInfo};

use super::{Intake, NO_SLOT};
use crate::pipeline::{
    messages::{Control, NewChannel},
    ring::Sample,
};

/// Announcements that wait for a frame: one of every id there can be.
const ANNOUNCED_MAX: usize = 1 << 16;

impl Intake {
    /// Markers of the device's table that are not channels yet become channels with the next frame, while the pool lasts.
    /// A table may come in several messages: what comes before that frame is one.
    pub fn announce(&mut self, markers: &[MarkerInfo]) {
        self.announced.extend_from_slice(markers);
        if self.announced.len() > ANNOUNCED_MAX {
            self.bind_announced();
        }
    }

    /// Gives every marker that was announced the channel of its name, or a new one.
    pub(super) fn bind_announced(&mut self) {
        let announced = std::mem::take(&mut self.announced);
        // Of an id that was announced twice the last word counts.
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
        // These ids stand for other markers now, all of them, before any gets its channel: names that changed places
        // find theirs free. Until one has a channel its samples are counted as dropped: they must not be stored under the
        // old name.
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

    /// The frame's markers by slot.
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
            *sample =
                Sample { position_mm: marker.position_mm, present: finite && !marker.occluded };
        }
    }

    /// A channel that was not there before begins with a stretch of its own.
    fn open_channel(&mut self, id: u16, named: Option<(&str, bool)>) {
        if self.n_channels >= self.row.len() {
            return;
        }
        self.close_stretch();
        let channel = NewChannel {
            stretch: self.feed.next_stretch(),
            slot: self.n_channels,
            marker_id: id,
            named: named.map(|(label, labelled)| (label.to_owned(), labelled)),
        };
        if self.control.try_send(Control::Channel(channel)).is_err() {
            return;
        }
        self.labels.push(named.map(|(label, _)| label.to_owned()).unwrap_or_default());
        self.slot_of_id[usize::from(id)] = self.n_channels as u32;
        self.n_channels += 1;
        self.counts.markers_appeared += 1;
        self.room = 0;
    }
}
