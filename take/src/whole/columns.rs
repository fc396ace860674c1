//! Rows of markers turned into channels, one after another.

use mocapd_codec::{CodecError, Position, Rows, Settings};

use super::Part;
use crate::motion::{Motion, is_gap};

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

    /// The channels, one after another.
    pub(super) fn rows(&self) -> Result<Vec<Rows<'_>>, CodecError> {
        let columns = self.positions.iter().zip(&self.present);
        columns.map(|(positions, present)| Rows::new(positions, present)).collect()
    }
}

/// What all channels of a whole take share.
pub(super) fn plan(motion: &Motion, codec: &Settings) -> Result<Vec<u8>, CodecError> {
    if codec.kind.is_live() {
        return Ok(Vec::new());
    }
    let mut columns = Columns::default();
    let (n_rows, n_markers) = (motion.n_frames(), motion.info.markers.len());
    if n_markers > 0 {
        columns.fill(motion, Part { first_row: 0, n_rows, first_marker: 0, n_markers });
    }
    codec.plan(&columns.rows()?)
}
