//! Rows of markers turned into channels, one after another.

use mocapd_codec::{BlockEncoder, BlockReport, Position, Rows, Settings};
use mocapd_take::motion::{Motion, is_gap};

use super::{Part, PartReport};

/// Memory for some markers over some rows.
#[derive(Debug, Default)]
pub(super) struct Columns {
    positions: Vec<Vec<Position>>,
    present: Vec<Vec<bool>>,
}

impl Columns {
    /// Takes a part of `motion`.
    pub(super) fn fill(&mut self, motion: &Motion, part: Part) {
        self.positions.resize_with(part.n_markers, Vec::new);
        self.present.resize_with(part.n_markers, Vec::new);
        for (positions, present) in self.positions.iter_mut().zip(&mut self.present) {
            positions.clear();
            positions.reserve(part.n_rows);
            present.clear();
            present.reserve(part.n_rows);
        }
        for row in part.first_row..part.first_row + part.n_rows {
            let markers = &motion.frame(row)[part.first_marker..][..part.n_markers];
            for ((positions, present), &position) in
                self.positions.iter_mut().zip(&mut self.present).zip(markers)
            {
                positions.push(position);
                present.push(!is_gap(position));
            }
        }
    }

    fn rows(&self) -> anyhow::Result<Vec<Rows<'_>>> {
        let columns = self.positions.iter().zip(&self.present);
        Ok(columns
            .map(|(positions, present)| Rows::new(positions, present))
            .collect::<Result<_, _>>()?)
    }

    /// Appends the key block of these channels, which are one group.
    pub(super) fn encode(
        &self,
        encoder: &mut dyn BlockEncoder,
        shared: &[u8],
        block: &mut Vec<u8>,
    ) -> anyhow::Result<PartReport> {
        let mut report = PartReport::default();
        if !self.positions.is_empty() {
            let mut reports = vec![BlockReport::default(); self.positions.len()];
            encoder.encode(&self.rows()?, shared, true, block, &mut reports)?;
            reports.iter().for_each(|channel| report.add_channel(channel));
        }
        Ok(report)
    }
}

/// What all channels of a whole take share.
pub(super) fn plan(motion: &Motion, codec: &Settings) -> anyhow::Result<Vec<u8>> {
    if codec.kind.is_live() {
        return Ok(Vec::new());
    }
    let mut columns = Columns::default();
    let (n_rows, n_markers) = (motion.n_frames(), motion.info.markers.len());
    if n_markers > 0 {
        columns.fill(motion, Part { first_row: 0, n_rows, first_marker: 0, n_markers });
    }
    Ok(codec.plan(&columns.rows()?)?)
}
