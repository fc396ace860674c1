//! The channel table, and the detection of entries that are lost.

use crate::record::Channel;

/// Entries in column order. When a stretch has more channels than there are entries, the lost ones get generated names
/// at the position where they were lost, so that no channel gets the name of another.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct ChannelTable {
    channels: Vec<Channel>,
    /// The header's entries have been read.
    begun: bool,
    hole: Option<Hole>,
}

/// A position at which entries may be missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Hole {
    /// The column before which they are missing.
    column: usize,
    /// Entries may be missing at other positions behind it, too, so that names and columns cannot be matched.
    several: bool,
}

/// Entries that a stretch revealed as lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Renamed {
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
    pub(crate) fn damaged(&mut self) {
        if !self.begun {
            return;
        }
        let column = self.channels.len();
        match &mut self.hole {
            Some(hole) => hole.several |= hole.column != column,
            None => self.hole = Some(Hole { column, several: false }),
        }
    }

    /// Reports that a stretch has at least `n_channels` channels. Returns the entries that this reveals as lost.
    pub(crate) fn stated(&mut self, n_channels: usize) -> Option<Renamed> {
        let len = self.channels.len();
        if n_channels < len {
            return None;
        }
        let hole = self.hole.take();
        let inserted = n_channels - len;
        if inserted == 0 {
            return None;
        }
        let Hole { column: first, several } = hole.unwrap_or(Hole { column: len, several: false });
        let nameless = if several { n_channels - first } else { inserted };
        let replaced = if several { first..len } else { first..first };
        let new: Vec<_> = (first..first + nameless).map(nameless_channel).collect();
        self.channels.splice(replaced, new);
        Some(Renamed { first, inserted, nameless })
    }
}

/// A generated entry for a channel whose own is lost.
fn nameless_channel(column: usize) -> Channel {
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
        table.damaged();
        table.append(&channels(&["d"]));
        assert_eq!(table.stated(2), None);
        assert_eq!(table.stated(4), Some(Renamed { first: 2, inserted: 1, nameless: 1 }));
        assert_eq!(labels(&table), ["a", "b", "u003", "d"]);
        table.append(&channels(&["e"]));
        assert_eq!(table.stated(5), None);
        assert_eq!(table.stated(6), Some(Renamed { first: 5, inserted: 1, nameless: 1 }));
    }

    #[test]
    fn damage_that_hid_no_entry_is_forgotten() {
        let mut table = ChannelTable::default();
        table.append(&channels(&["a"]));
        table.damaged();
        assert_eq!(table.stated(1), None);
        table.append(&channels(&["b"]));
        table.damaged();
        table.append(&channels(&["d"]));
        table.stated(4);
        assert_eq!(labels(&table), ["a", "b", "u003", "d"]);
    }

    #[test]
    fn damage_before_the_header_hides_no_entry() {
        let mut table = ChannelTable::default();
        table.damaged();
        table.append(&channels(&["a", "b"]));
        table.damaged();
        table.stated(3);
        assert_eq!(labels(&table), ["a", "b", "u003"]);
    }

    #[test]
    fn where_nobody_knows_no_name_is_given() {
        let mut table = ChannelTable::default();
        table.append(&channels(&["a"]));
        table.damaged();
        table.append(&channels(&["b or c"]));
        table.damaged();
        assert_eq!(table.stated(3), Some(Renamed { first: 1, inserted: 1, nameless: 2 }));
        assert_eq!(labels(&table), ["a", "u002", "u003"]);
    }
}
