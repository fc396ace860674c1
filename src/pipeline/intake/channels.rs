//! Which marker goes into which channel.

use mocapd_drivers::device::{Frame, MarkerInfo};

use super::{Intake, NO_SLOT};
use crate::pipeline::{
    messages::{Control, NewChannel},
    ring::Sample,
};

impl Intake {
    /// Markers of the device's table that are not channels yet become channels, while the pool lasts.
    pub fn announce(&mut self, markers: &[MarkerInfo]) {
        for marker in markers {
            let slot = self.slot_of_id[usize::from(marker.id)];
            let nameless = marker.label.is_empty();
            if self
                .labels
                .get(slot as usize)
                .is_some_and(|label| nameless || *label == marker.label)
            {
                continue;
            }
            // The id stands for another marker now. Until that one has a channel its samples are counted
            // as dropped: they must not be stored under the old name.
            self.slot_of_id[usize::from(marker.id)] = NO_SLOT;
            match self.labels.iter().position(|label| !nameless && *label == marker.label) {
                Some(slot) if !self.slot_of_id.contains(&(slot as u32)) => {
                    self.slot_of_id[usize::from(marker.id)] = slot as u32;
                }
                _ => self.open_channel(marker.id, Some((&marker.label, marker.labelled))),
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
