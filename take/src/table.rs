//! The channel table, and the detection of entries that are lost.

use crate::record::Channel;

/// Entries in column order. When a stretch has more channels than there are entries, the lost ones get generated names
/// at the position where they were lost, so that no channel gets the name of another.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct ChannelTable {
    channels: Vec<Channel>,
    /// The header's entries have been read.
    begun: bool,
    missing: Option<MissingEntries>,
}

/// A position at which entries may be missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct MissingEntries {
    /// The column before which they are missing.
    column: usize,
    /// Entries may be missing at other positions after it, too, so that names and columns cannot be matched.
    several: bool,
}

/// Entries that a stretch revealed as lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LostEntries {
    /// The first column without a name.
    pub first: usize,
    /// Columns that had no entry.
    pub inserted: usize,
    /// Columns without a name from `first` on: the inserted ones, and those whose entry may belong to another column.
    pub nameless: usize,
}

impl ChannelTable {
    /// The entries so far.
    pub(crate) fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Appends entries that were read.
    pub(crate) fn append(&mut self, more: &[Channel]) {
        self.begun = true;
        self.channels.extend_from_slice(more);
    }

    /// Reports a damaged region, which may have contained entries if it follows the header.
    pub(crate) fn add_damage(&mut self) {
        if self.begun {
            let column = self.channels.len();
            let missing = self.missing.get_or_insert(MissingEntries { column, several: false });
            missing.several |= missing.column != column;
        }
    }

    /// Reports that a stretch has at least `n_channels` channels. Returns the entries that this reveals as lost.
    pub(crate) fn reconcile(&mut self, n_channels: usize) -> Option<LostEntries> {
        let len = self.channels.len();
        let inserted = n_channels.checked_sub(len)?;
        let missing = self.missing.take();
        if inserted == 0 {
            return None;
        }
        let (first, several) = missing.map_or((len, false), |at| (at.column, at.several));
        let nameless = if several { n_channels - first } else { inserted };
        let replaced = if several { first..len } else { first..first };
        let new: Vec<_> = (first..first + nameless).map(unnamed_channel).collect();
        self.channels.splice(replaced, new);
        Some(LostEntries { first, inserted, nameless })
    }
}

/// A generated entry for a channel whose own is lost.
fn unnamed_channel(column: usize) -> Channel {
    Channel { marker_id: u16::MAX, label: Channel::unlabelled_name(column), labelled: false }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channels(labels: &[&str]) -> Vec<Channel> {
        let channel =
            |label: &&str| Channel { marker_id: 0, label: (*label).to_owned(), labelled: true };
        labels.iter().map(channel).collect()
    }

    fn labels(table: &ChannelTable) -> Vec<&str> {
        table.channels().iter().map(|channel| channel.label.as_str()).collect()
    }

    #[test]
    fn a_lost_entry_leaves_the_others_their_names() {
        let mut table = ChannelTable::default();
        table.append(&channels(&["a", "b"]));
        table.add_damage();
        table.append(&channels(&["d"]));
        assert_eq!(table.reconcile(2), None);
        assert_eq!(table.reconcile(4), Some(LostEntries { first: 2, inserted: 1, nameless: 1 }));
        assert_eq!(labels(&table), ["a", "b", "u003", "d"]);
        table.append(&channels(&["e"]));
        assert_eq!(table.reconcile(5), None);
        assert_eq!(table.reconcile(6), Some(LostEntries { first: 5, inserted: 1, nameless: 1 }));
    }

    #[test]
    fn damage_that_hid_no_entry_is_forgotten() {
        let mut table = ChannelTable::default();
        table.append(&channels(&["a"]));
        table.add_damage();
        assert_eq!(table.reconcile(1), None);
        table.append(&channels(&["b"]));
        table.add_damage();
        table.append(&channels(&["d"]));
        table.reconcile(4);
        assert_eq!(labels(&table), ["a", "b", "u003", "d"]);
    }

    #[test]
    fn damage_before_the_header_hides_no_entry() {
        let mut table = ChannelTable::default();
        table.add_damage();
        table.append(&channels(&["a", "b"]));
        table.add_damage();
        table.reconcile(3);
        assert_eq!(labels(&table), ["a", "b", "u003"]);
    }

    #[test]
    fn ambiguous_entries_lose_their_names() {
        let mut table = ChannelTable::default();
        table.append(&channels(&["a"]));
        table.add_damage();
        table.append(&channels(&["b or c"]));
        table.add_damage();
        assert_eq!(table.reconcile(3), Some(LostEntries { first: 1, inserted: 1, nameless: 2 }));
        assert_eq!(labels(&table), ["a", "u002", "u003"]);
    }
}
