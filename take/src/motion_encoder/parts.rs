//! The parts of a motion: its stretches, group by group, as they are read.

use std::{collections::VecDeque, fmt};

use mocapd_codec::{CodecError, Effort, GROUP_CHANNELS, Position, ResamplerKind, Rows, Settings};

use crate::{
    TakeError,
    motion::{FrameSource, GAP, MotionInfo, is_gap},
    record::{Header, long_stretch_rows},
};

/// One group of channels over one stretch, with its samples: the unit that is encoded independently.
#[derive(Debug, Clone)]
pub struct EncodePart {
    /// Number of its stretch in the take, from 0.
    pub(super) stretch: usize,
    /// It is encoded without state from earlier stretches.
    pub(super) key: bool,
    /// First row.
    pub first_row: usize,
    /// Number of rows.
    pub n_rows: usize,
    /// Column of the first marker.
    pub first_marker: usize,
    /// Number of markers.
    pub n_markers: usize,
    columns: ColumnBuffer,
}

impl EncodePart {
    /// The rows of each channel.
    pub(super) fn rows(&self) -> Result<Vec<Rows<'_>>, CodecError> {
        self.columns.rows()
    }
}

/// The parts of a motion, read from its frames.
pub struct EncodeParts<'f> {
    frames: &'f mut dyn FrameSource,
    n_rows: usize,
    stretch_rows: usize,
    /// Which stretches are joined, where any are.
    still: Option<StillSpans>,
    /// Stretches from one key to the next.
    key_every: usize,
    /// First row that was not read yet.
    next_row: usize,
    /// Number of the next stretch.
    next_stretch: usize,
    /// The stretch that was read to see whether it continues a still span, and does not.
    ahead: Option<StretchRows>,
    /// The parts of the last stretch that were not yet handed out.
    ready: VecDeque<EncodePart>,
}

impl<'f> EncodeParts<'f> {
    pub(super) fn new(
        frames: &'f mut dyn FrameSource,
        n_rows: usize,
        stretch_rows: usize,
        still: Option<StillSpans>,
        key_every: usize,
    ) -> Self {
        let n_groups = frames.info().markers.len().div_ceil(GROUP_CHANNELS).max(1);
        let ready = VecDeque::with_capacity(n_groups);
        let (next_row, next_stretch, ahead) = (0, 0, None);
        Self {
            frames,
            n_rows,
            stretch_rows,
            still,
            key_every,
            next_row,
            next_stretch,
            ahead,
            ready,
        }
    }

    /// The description of the motion.
    #[must_use]
    pub fn info(&self) -> &MotionInfo {
        self.frames.info()
    }

    /// Reads the first stretch. Returns the rows of all of its channels.
    pub(super) fn first_stretch(&mut self) -> Result<Vec<Rows<'_>>, TakeError> {
        self.read_stretch()?;
        let columns: Result<Vec<_>, _> = self.ready.iter().map(EncodePart::rows).collect();
        Ok(columns?.concat())
    }

    /// Reads the next stretch, if there is one, and those that it is joined with.
    fn read_stretch(&mut self) -> Result<(), TakeError> {
        let mut stretch = match self.ahead.take() {
            Some(stretch) => stretch,
            None => self.read_rows()?,
        };
        if stretch.n_rows == 0 {
            return Ok(());
        }
        if let Some(still) = self.still {
            let mut span = stretch.boxes();
            while still.holds(&span) && self.next_row < self.n_rows {
                let next = self.read_rows()?;
                span.iter_mut().zip(next.boxes()).for_each(|(span, next)| span.join(next));
                if stretch.n_rows + next.n_rows > still.rows_max || !still.holds(&span) {
                    self.ahead = Some(next);
                    break;
                }
                stretch.append(next);
            }
        }
        let StretchRows { first_row, n_rows, groups } = stretch;
        let number = self.next_stretch;
        let key = number.is_multiple_of(self.key_every);
        self.next_stretch += 1;
        self.ready.extend(groups.into_iter().enumerate().map(|(group, columns)| EncodePart {
            stretch: number,
            key,
            first_row,
            n_rows,
            first_marker: group * GROUP_CHANNELS,
            n_markers: columns.positions.len(),
            columns,
        }));
        Ok(())
    }

    /// Reads the rows of the next stretch; none at the end.
    fn read_rows(&mut self) -> Result<StretchRows, TakeError> {
        let first_row = self.next_row;
        let n_rows = self.stretch_rows.min(self.n_rows - first_row);
        let n_all = self.frames.info().markers.len();
        // A take without markers still has its stretches.
        let groups = (0..n_all.max(1)).step_by(GROUP_CHANNELS);
        let groups =
            groups.map(|first| ColumnBuffer::new(GROUP_CHANNELS.min(n_all - first), n_rows));
        let mut groups: Vec<_> = groups.collect();
        let mut row = vec![GAP; n_all];
        for index in 0..n_rows {
            if !self.frames.next_frame(&mut row)? {
                return Err(TakeError::InvalidArgument(format!(
                    "expected {} frames, got {}: the source has fewer than it announces",
                    self.n_rows,
                    first_row + index
                )));
            }
            for (columns, positions) in groups.iter_mut().zip(row.chunks(GROUP_CHANNELS)) {
                columns.push(positions);
            }
        }
        self.next_row += n_rows;
        Ok(StretchRows { first_row, n_rows, groups })
    }
}

impl Iterator for EncodeParts<'_> {
    type Item = Result<EncodePart, TakeError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ready.is_empty()
            && let Err(error) = self.read_stretch()
        {
            // Nothing follows an error.
            self.ready.clear();
            self.next_row = self.n_rows;
            return Some(Err(error));
        }
        self.ready.pop_front().map(Ok)
    }
}

impl fmt::Debug for EncodeParts<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut debug = f.debug_struct("EncodeParts");
        debug.field("n_rows", &self.n_rows).field("next_row", &self.next_row);
        debug.finish_non_exhaustive()
    }
}

/// Which stretches become one: consecutive ones in which no marker moves by more than the tolerance allows. `dense` then
/// codes next to nothing but where each marker is, and that once in place of every ten seconds.
///
/// A damaged byte costs a longer stretch then, but there are fewer bytes that it can hit, and what is lost lay still.
#[derive(Debug, Clone, Copy)]
pub(super) struct StillSpans {
    rows_max: usize,
    /// Diagonal of the box that holds the samples of a still marker, in millimetres.
    diagonal_mm: f64,
}

/// Diagonal of the box that holds a still marker, in tolerances: in a box of two, every sample lies within the
/// tolerance of its middle.
const STILL_TOLERANCES: f64 = 2.0;

impl StillSpans {
    /// What is joined in an import with this header: nothing where the distance between keys is stated, and nothing at
    /// the least effort, whose stretches are those of the live encoder.
    pub(super) fn of(header: &Header, codec: &Settings, n_markers: usize) -> Option<Self> {
        let is_joined = codec.kind == ResamplerKind::Dense
            && header.effort() > Effort::MIN
            && header.key_rows().is_none();
        let rows_max = long_stretch_rows(header.rate_hz, n_markers);
        let diagonal_mm = STILL_TOLERANCES * codec.tolerance.mm();
        is_joined.then_some(Self { rows_max, diagonal_mm })
    }

    /// Most rows of a joined stretch.
    pub(super) fn rows_max(&self) -> usize {
        self.rows_max
    }

    /// Whether no marker leaves a box of the size of the tolerance.
    fn holds(&self, boxes: &[BoundingBox]) -> bool {
        boxes.iter().all(|bounds| bounds.diagonal_squared() <= self.diagonal_mm * self.diagonal_mm)
    }
}

/// The box around the samples of a channel.
#[derive(Debug, Clone, Copy)]
struct BoundingBox {
    least: Position,
    most: Position,
}

impl BoundingBox {
    const EMPTY: Self = Self { least: [f32::INFINITY; 3], most: [f32::NEG_INFINITY; 3] };

    fn of(positions: &[Position], present: &[bool]) -> Self {
        let present = positions.iter().zip(present).filter(|&(_, &present)| present);
        let mut bounds = Self::EMPTY;
        present.for_each(|(&at, _)| bounds.join(Self { least: at, most: at }));
        bounds
    }

    fn join(&mut self, other: Self) {
        for axis in 0..3 {
            self.least[axis] = self.least[axis].min(other.least[axis]);
            self.most[axis] = self.most[axis].max(other.most[axis]);
        }
    }

    /// In square millimetres; 0 without samples, NaN or infinity where samples are not finite.
    fn diagonal_squared(&self) -> f64 {
        let sides = self.least.iter().zip(&self.most);
        sides
            .map(
                |(&least, &most)| {
                    if least > most { 0.0 } else { f64::from(most) - f64::from(least) }
                },
            )
            .map(|side| side * side)
            .sum()
    }
}

/// The rows of a stretch.
struct StretchRows {
    first_row: usize,
    n_rows: usize,
    /// By group.
    groups: Vec<ColumnBuffer>,
}

impl StretchRows {
    /// The box of each channel.
    fn boxes(&self) -> Vec<BoundingBox> {
        let columns =
            self.groups.iter().flat_map(|group| group.positions.iter().zip(&group.present));
        columns.map(|(positions, present)| BoundingBox::of(positions, present)).collect()
    }

    /// Adds the rows of the next stretch.
    fn append(&mut self, next: Self) {
        self.n_rows += next.n_rows;
        for (columns, next) in self.groups.iter_mut().zip(next.groups) {
            let ColumnBuffer { positions, present } = next;
            columns.positions.iter_mut().zip(&positions).for_each(|(all, more)| all.extend(more));
            columns.present.iter_mut().zip(&present).for_each(|(all, more)| all.extend(more));
        }
    }
}

/// The samples of one part, column by column.
#[derive(Debug, Clone, Default)]
struct ColumnBuffer {
    positions: Vec<Vec<Position>>,
    present: Vec<Vec<bool>>,
}

impl ColumnBuffer {
    fn new(n_markers: usize, n_rows: usize) -> Self {
        Self {
            positions: (0..n_markers).map(|_| Vec::with_capacity(n_rows)).collect(),
            present: (0..n_markers).map(|_| Vec::with_capacity(n_rows)).collect(),
        }
    }

    /// Adds a row.
    fn push(&mut self, row: &[Position]) {
        let columns = self.positions.iter_mut().zip(&mut self.present);
        for ((positions, present), &position) in columns.zip(row) {
            positions.push(position);
            present.push(!is_gap(position));
        }
    }

    /// The rows of each channel.
    fn rows(&self) -> Result<Vec<Rows<'_>>, CodecError> {
        let columns = self.positions.iter().zip(&self.present);
        columns.map(|(positions, present)| Rows::new(positions, present)).collect()
    }
}
