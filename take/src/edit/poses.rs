//! The poses of a part of a take: those of its rows.

use std::{
    io::{Read, Seek},
    ops::Range,
};

use super::recorded::tick_hz;
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
    /// In each run the first and the last sample whose row was recorded, with the time of this row.
    pub anchors: Vec<SampleAnchor>,
}

impl PoseEnds {
    /// Those of all groups of poses. At the ends of the take, poses before its first row and behind its last one belong to
    /// the part.
    pub(super) fn read(
        map: &TakeMap,
        input: &mut (impl Read + Seek),
        rows: &Range<u64>,
    ) -> Result<Vec<Self>, TakeError> {
        let Some(by_row) = PosesByRow::read(&mut *input, map)? else { return Ok(Vec::new()) };
        let mut all: Vec<Self> = Vec::new();
        for (index, group) in by_row.groups().enumerate() {
            let n = group.n_samples();
            let at = |row: u64| by_row.number_at(index, row).unwrap_or(n);
            let first = if rows.start == 0 { 0 } else { at(rows.start) };
            let last = if rows.end < map.n_rows { at(rows.end) } else { n };
            let numbers = first..last.max(first);
            all.push(Self { group: group.group.number, numbers, anchors: Vec::new() });
        }
        let mut stretches = TakeTraversal::from_map(input, map, Decode::Groups(Vec::new()))?;
        stretches.seek(rows.start)?;
        while stretches.next_stretch()?.is_some_and(|span| span.first_row < rows.end) {
            let times = stretches.timeline().into_iter().flat_map(Timeline::recorded);
            for (row, time) in times.filter(|(row, _)| rows.contains(row)) {
                for (index, ends) in all.iter_mut().enumerate() {
                    ends.add(&by_row, index, row, time.device_ticks, tick_hz(map));
                }
            }
        }
        Ok(all)
    }

    fn add(&mut self, by_row: &PosesByRow, index: usize, row: u64, ticks: u64, tick_hz: u64) {
        let number = by_row.number_of(index, row).filter(|number| self.numbers.contains(number));
        let Some((number, group)) = number.zip(by_row.groups().nth(index)) else { return };
        let Some(time) = group.clock(tick_hz).at(number) else { return };
        let (run_start, segment) = (time.run_start, time.segment);
        let anchor = SampleAnchor { number, run_start, device_ticks: ticks, segment };
        if let [.., before, last] = &mut self.anchors[..]
            && (before.run_start, last.run_start) == (run_start, run_start)
        {
            *last = anchor;
        } else {
            self.anchors.push(anchor);
        }
    }
}
