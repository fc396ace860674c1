//! The poses of a part of a take: those of its rows.

use std::{
    io::{Read, Seek},
    ops::Range,
};

use crate::{
    TakeError, TakeMap, TakeTraversal, poses::PosesByRow, sampled::SampleAnchor,
    timeline::Timeline, traversal::Decode,
};

/// Which poses of a group are in a part, and times of theirs.
pub(super) struct PoseEnds {
    /// Number of the group.
    pub group: u32,
    /// The samples.
    pub numbers: Range<u64>,
    /// Of the samples of each run that are in rows one after another the first and the last one whose row was recorded, with
    /// the time of this row.
    pub anchors: Vec<SampleAnchor>,
    /// The rows of the last anchors, and the number of the sample in the first of them.
    rows: Range<u64>,
    first: u64,
    /// Whether the last anchor is the first of those rows.
    is_first: bool,
}

impl PoseEnds {
    /// Those of all groups of poses. At the ends of the take, poses before its first row and behind its last one belong to
    /// the part.
    pub(super) fn read(
        map: &TakeMap,
        input: &mut (impl Read + Seek),
        rows: &Range<u64>,
        tick_hz: u64,
    ) -> Result<Vec<Self>, TakeError> {
        let Some(by_row) = PosesByRow::read(&mut *input, map)? else { return Ok(Vec::new()) };
        let mut all: Vec<Self> = Vec::new();
        for (index, group) in by_row.groups().enumerate() {
            let n = group.n_samples();
            let at = |row: u64| by_row.number_at(index, row).unwrap_or(n);
            let first = if rows.start == 0 { 0 } else { at(rows.start) };
            let last = if rows.end < map.n_rows { at(rows.end) } else { n };
            all.push(Self {
                group: group.group.number,
                numbers: first..last.max(first),
                anchors: Vec::new(),
                rows: 0..0,
                first: 0,
                is_first: false,
            });
        }
        let mut stretches = TakeTraversal::from_map(input, map, Decode::Groups(Vec::new()))?;
        stretches.seek(rows.start)?;
        while stretches.next_stretch()?.is_some_and(|span| span.first_row < rows.end) {
            let times = stretches.timeline().into_iter().flat_map(Timeline::recorded);
            for (row, time) in times.filter(|(row, _)| rows.contains(row)) {
                for (index, ends) in all.iter_mut().enumerate() {
                    ends.add(&by_row, index, (row, time.device_ticks), tick_hz);
                }
            }
        }
        Ok(all)
    }

    /// Adds a recorded row and its time.
    fn add(&mut self, by_row: &PosesByRow, index: usize, (row, ticks): (u64, u64), tick_hz: u64) {
        if self.rows.contains(&row) {
            let number = self.first + (row - self.rows.start);
            if let Some(&last) = self.anchors.last().filter(|_| self.numbers.contains(&number)) {
                if !std::mem::take(&mut self.is_first) {
                    self.anchors.pop();
                }
                self.anchors.push(SampleAnchor { number, device_ticks: ticks, ..last });
            }
            return;
        }
        let Some((numbers, rows)) = by_row.piece_at(index, row) else { return };
        let number = numbers.start + (row - rows.start);
        let Some(group) = by_row.groups().nth(index) else { return };
        let time = group.clock(tick_hz).at(number).filter(|_| self.numbers.contains(&number));
        let Some(time) = time else { return };
        let (run_start, segment) = (time.run_start, time.segment);
        self.anchors.push(SampleAnchor { number, run_start, device_ticks: ticks, segment });
        (self.rows, self.first, self.is_first) = (rows, numbers.start, true);
    }
}
