//! Channels of the markers of a system on the network: labelled ones by their labels, unlabelled ones by the vendor's ids.

use std::collections::{HashMap, HashSet};

use crate::device::MarkerInfo;

/// Largest number of labels. A system tracks some hundred markers; a marker's channel takes memory whether or not it is
/// seen.
pub const LABELS_MAX: usize = 4096;

/// First channel id of an unlabelled marker: labelled ones are below.
pub(crate) const FIRST_UNLABELLED: u16 = LABELS_MAX as u16;

/// Largest number of unlabelled markers at once: reflections in a bright room, several times the markers of a subject.
pub(crate) const UNLABELLED_MAX: usize = 1024;

/// A channel is given to another unlabelled marker only when so many have been used. More are used only while so many are seen at
/// once, so that neither a take's table nor the room for new labels is used up by reflections that come and go.
const FRESH_CHANNELS: usize = 64;

/// The labelled markers. A label keeps its channel for as long as the driver lives, also when the vendor's list changes.
#[derive(Debug, Default)]
pub(crate) struct LabelTable {
    /// Every label so far; a marker's id is its place.
    markers: Vec<MarkerInfo>,
    /// The channel of each marker of a frame, in the vendor's order.
    ids: Vec<u16>,
}

impl LabelTable {
    /// Takes over the vendor's labels. Returns how many of them have no channel because there are too many; their markers are
    /// recorded like unlabelled ones.
    pub(crate) fn update(&mut self, labels: &[String]) -> usize {
        self.ids.clear();
        let known: HashMap<String, u16> =
            self.markers.iter().map(|marker| (marker.label.clone(), marker.id)).collect();
        let mut n_excess = 0;
        let mut taken = HashSet::new();
        let mut uses: HashMap<&str, usize> = HashMap::new();
        for (index, label) in labels.iter().enumerate() {
            let n = uses.entry(label).and_modify(|n| *n += 1).or_insert(1);
            let mut unique = match (label.as_str(), *n) {
                ("", _) => format!("trajectory {}", index + 1),
                (label, 1) => label.to_owned(),
                (label, n) => format!("{label} ({n})"),
            };
            // A label may look like a numbered one.
            while !taken.insert(unique.clone()) {
                *n += 1;
                unique = format!("{label} ({n})");
            }
            let id = match known.get(&unique) {
                Some(id) => *id,
                None if self.markers.len() < LABELS_MAX => {
                    let id = self.markers.len() as u16;
                    self.markers.push(MarkerInfo { id, label: unique, labelled: true });
                    id
                }
                None => {
                    n_excess += 1;
                    // No such channel: see `id`.
                    FIRST_UNLABELLED
                }
            };
            self.ids.push(id);
        }
        n_excess
    }

    /// The channel of a frame's marker; `None` if it has none.
    pub(crate) fn id(&self, index: usize) -> Option<u16> {
        self.ids.get(index).copied().filter(|id| *id < FIRST_UNLABELLED)
    }

    /// Number of labelled markers of a frame.
    pub(crate) fn n_labels(&self) -> usize {
        self.ids.len()
    }

    /// The labels in use now, in the vendor's order.
    pub(crate) fn markers(&self) -> Vec<MarkerInfo> {
        let known = self.ids.iter().filter_map(|id| self.markers.get(usize::from(*id)));
        known.cloned().collect()
    }
}

/// A channel of unlabelled markers.
#[derive(Debug, Clone, Copy)]
struct TemporaryChannel {
    vendor_id: u64,
    /// The frame in which it was last seen.
    last_frame: u64,
}

/// Temporary channels of unlabelled markers.
#[derive(Debug, Default)]
pub(crate) struct UnlabelledIds {
    channels: Vec<TemporaryChannel>,
    by_id: HashMap<u64, usize>,
    frame: u64,
}

impl UnlabelledIds {
    /// Begins a frame.
    pub(crate) fn begin_frame(&mut self) {
        self.frame += 1;
    }

    /// The channel of a marker in this frame; `None` when all are taken, or this marker was in this frame already.
    pub(crate) fn channel(&mut self, vendor_id: u64) -> Option<u16> {
        let known = self.by_id.get(&vendor_id).copied();
        let index = match known {
            Some(index) => index,
            None => {
                let index = self.free_channel()?;
                self.by_id.insert(vendor_id, index);
                index
            }
        };
        let channel = self.channels.get_mut(index)?;
        if known.is_some() && channel.last_frame == self.frame {
            return None;
        }
        *channel = TemporaryChannel { vendor_id, last_frame: self.frame };
        Some(FIRST_UNLABELLED + index as u16)
    }

    /// A new channel, or the one whose marker has been away for longest.
    fn free_channel(&mut self) -> Option<usize> {
        if self.channels.len() >= FRESH_CHANNELS {
            let away = self.channels.iter().enumerate().filter(|(_, c)| c.last_frame < self.frame);
            if let Some((index, channel)) = away.min_by_key(|(_, channel)| channel.last_frame) {
                self.by_id.remove(&channel.vendor_id);
                return Some(index);
            }
        }
        if self.channels.len() == UNLABELLED_MAX {
            return None;
        }
        self.channels.push(TemporaryChannel { vendor_id: 0, last_frame: 0 });
        Some(self.channels.len() - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn update(table: &mut LabelTable, labels: &[&str]) -> Vec<(u16, String)> {
        let labels: Vec<String> = labels.iter().map(|label| (*label).to_owned()).collect();
        assert_eq!(table.update(&labels), 0);
        table.markers().into_iter().map(|marker| (marker.id, marker.label)).collect()
    }

    #[test]
    fn a_label_keeps_its_channel_when_the_list_changes() {
        let mut table = LabelTable::default();
        let pair = |id, label: &str| (id, label.to_owned());
        assert_eq!(update(&mut table, &["a", "b"]), [pair(0, "a"), pair(1, "b")]);
        assert_eq!(
            update(&mut table, &["c", "b", "a"]),
            [pair(2, "c"), pair(1, "b"), pair(0, "a")]
        );
        assert_eq!((table.id(0), table.id(2), table.id(3)), (Some(2), Some(0), None));
    }

    #[test]
    fn labels_are_unique() {
        let found = update(&mut LabelTable::default(), &["a", "a", "", "", "a (2)", "a"]);
        let names: Vec<_> = found.iter().map(|(_, label)| label.as_str()).collect();
        assert_eq!(found.iter().map(|(id, _)| *id).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
        assert_eq!(names, ["a", "a (2)", "trajectory 3", "trajectory 4", "a (2) (2)", "a (3)"]);
    }

    #[test]
    fn labels_beyond_the_channels_have_none() {
        let mut table = LabelTable::default();
        let names =
            |from: usize| (from..from + LABELS_MAX).map(|i| format!("m{i}")).collect::<Vec<_>>();
        assert_eq!(table.update(&names(0)), 0);
        assert_eq!(table.update(&names(10)), 10);
        assert_eq!(table.id(0), Some(10));
        assert_eq!(table.id(LABELS_MAX - 1), None);
    }

    #[test]
    fn an_unlabelled_marker_keeps_its_channel_while_it_is_away() {
        let mut ids = UnlabelledIds::default();
        let mut frame = |vendor: &[u64]| {
            ids.begin_frame();
            vendor.iter().map(|id| ids.channel(*id)).collect::<Vec<_>>()
        };
        let some = |n: u16| Some(FIRST_UNLABELLED + n);
        assert_eq!(frame(&[70, 90]), [some(0), some(1)]);
        assert_eq!(frame(&[90]), [some(1)]);
        assert_eq!(frame(&[70, 80, 70]), [some(0), some(2), None], "one marker, one sample");
    }

    #[test]
    fn channels_are_given_to_others_only_when_there_are_many() {
        let mut ids = UnlabelledIds::default();
        for marker in 0..FRESH_CHANNELS as u64 {
            ids.begin_frame();
            assert_eq!(ids.channel(marker), Some(FIRST_UNLABELLED + marker as u16));
        }
        ids.begin_frame();
        assert_eq!(ids.channel(1000), Some(FIRST_UNLABELLED), "the one away for longest");
        assert_eq!(ids.channel(0), Some(FIRST_UNLABELLED + 1), "which is a new marker now");
        ids.begin_frame();
        let found = (0..2000).filter_map(|marker| ids.channel(5000 + marker)).count();
        assert_eq!((found, ids.by_id.len()), (UNLABELLED_MAX, UNLABELLED_MAX));
    }
}
