//! Rows that a plan knows before the decoder does.
//!
//! Plans are made channel by channel, but rows are coded level by level: where a run ends between the rows of a whole
//! span, the rows beside its ends have not been decoded in all channels before it.

use super::{
    level::Channels,
    level_prediction::slot,
    walk::{Dense, Run},
};

/// A row of an earlier channel that is hidden while other rows are coded.
#[derive(Debug)]
pub(super) struct HiddenRow {
    channel: usize,
    row: usize,
    slot: usize,
    /// The row is of the stride `1 << bit`.
    bit: usize,
    point: [f64; 3],
    span: [f64; 3],
    packed_steps: u64,
    residual: [f32; 3],
}

impl HiddenRow {
    /// Those of `rows` that lie between the ends of `runs`, in which all rows are known.
    pub(super) fn find(runs: &[Run], rows: &[usize], before: usize) -> Vec<Self> {
        let mut found = Vec::new();
        for (i, &row) in rows.iter().enumerate() {
            if rows[..i].contains(&row) {
                continue;
            }
            for run in runs.iter().filter(|run| row > before.max(run.zero) && row < run.end) {
                found.push(Self {
                    channel: run.channel,
                    row,
                    slot: slot(row - before),
                    bit: (row - before).trailing_zeros() as usize,
                    point: [f64::NAN; 3],
                    span: [f64::NAN; 3],
                    packed_steps: 0,
                    residual: [0.0; 3],
                });
            }
        }
        found
    }

    /// Exchanges what is known of the row for nothing, or the reverse, if the row is decoded after the rows of the
    /// stride `1 << bit`.
    fn exchange(&mut self, channels: &mut Channels, bit: usize) {
        if self.bit >= bit {
            return;
        }
        let Self { channel, row, slot, .. } = *self;
        let track = &mut channels.tracks[channel];
        std::mem::swap(&mut track.points[row], &mut self.point);
        for (axis, units) in track.span.iter_mut().zip(&mut self.span) {
            std::mem::swap(&mut axis[slot], units);
        }
        std::mem::swap(&mut track.packed_steps[slot], &mut self.packed_steps);
        channels.cross_channel.exchange_residual(channel, slot, &mut self.residual);
    }

    /// Runs `code` on a group that does not know those of `rows` that are decoded after the stride `1 << bit`.
    pub(super) fn without<T>(
        rows: &mut [Self],
        bit: usize,
        group: &mut Dense,
        code: impl FnOnce(&mut Dense) -> T,
    ) -> T {
        rows.iter_mut().for_each(|row| row.exchange(&mut group.channels, bit));
        let result = code(group);
        rows.iter_mut().for_each(|row| row.exchange(&mut group.channels, bit));
        result
    }
}
