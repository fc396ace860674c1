//! The frames of a text file, parsed: in memory, and in a scratch file if there are many.
//!
//! They are not parsed again in each pass, because parsing takes most of the time of a text import; as binary numbers
//! they take less than half of the file's size.

use std::io::{self, Read};

use super::{
    Result,
    origin::OriginScan,
    origin_gaps::OriginGaps,
    units::{FileUnit, MotionExtent},
};
use crate::{
    foreign::content::{Content, ContentCursor, ContentWriter, NewScratch},
    motion::{Ambiguity, GAP, Notes, Position, is_gap},
};

/// Bytes of a stored position.
pub(super) const POSITION_BYTES: usize = 12;

/// This NaN, which no position has, is stored as 0, so that zeros are a sample that was never written.
const NEVER_WRITTEN: u32 = 0x7fc0_0001;

/// A position as it is stored.
pub(super) fn stored(position: Position) -> [u8; POSITION_BYTES] {
    let mut bytes = [0; POSITION_BYTES];
    for (bytes, value) in bytes.as_chunks_mut().0.iter_mut().zip(position) {
        *bytes = (value.to_bits() ^ NEVER_WRITTEN).to_le_bytes();
    }
    bytes
}

fn restored(bytes: [u8; POSITION_BYTES]) -> Position {
    let mut position = GAP;
    for (value, &bytes) in position.iter_mut().zip(bytes.as_chunks().0) {
        *value = f32::from_bits(u32::from_le_bytes(bytes) ^ NEVER_WRITTEN);
    }
    if is_gap(position) { GAP } else { position }
}

/// Writes rows of any length: each its number of positions as a `u32`, and these.
pub(super) struct RowWriter<'a> {
    out: ContentWriter<'a>,
    row: Vec<u8>,
}

impl<'a> RowWriter<'a> {
    pub(super) fn new(new_scratch: NewScratch<'a>) -> Self {
        Self { out: ContentWriter::new(new_scratch), row: Vec::new() }
    }

    /// Appends a row. Gaps at its end take no bytes.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn write(&mut self, row: &[Position]) -> io::Result<()> {
        let n_filled = row.iter().rposition(|&at| !is_gap(at)).map_or(0, |last| last + 1);
        self.row.clear();
        // A line has fewer bytes than a `u32` counts.
        self.row.extend((n_filled as u32).to_le_bytes());
        self.row.extend(row.iter().take(n_filled).flat_map(|&position| stored(position)));
        self.out.write(&self.row)
    }

    /// All rows.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn finish(self) -> io::Result<Content> {
        self.out.finish()
    }
}

/// What samples exactly at the origin mean in a format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AtOrigin {
    /// Positions.
    Positions,
    /// Positions, which the program that wrote the file may have meant as missing samples.
    Doubtful,
    /// Missing samples, if the motion does not pass through the origin.
    Missing,
}

/// The frames of a text file, one after another.
#[derive(Debug)]
pub(super) struct TextFrames {
    stored: ContentCursor,
    n_frames: u64,
    n_markers: usize,
    /// Whether all rows are complete, and have no length.
    is_rectangle: bool,
    /// For each row the number of frames without a row just before it; empty if there are none.
    missing_before: Vec<u64>,
    origin_gaps: Option<OriginGaps>,
    /// Number of the next frame, and of the next row.
    next: u64,
    next_row: usize,
    /// Frames to deliver before the next row; `None` if they are not counted yet.
    n_empty: Option<u64>,
    bytes: Vec<u8>,
}

impl TextFrames {
    /// The frames of [written](RowWriter) rows: `n_frames` of `n_markers`.
    pub(super) fn of_rows(
        rows: Content,
        (n_frames, n_markers): (u64, usize),
        missing_before: Vec<u64>,
    ) -> Self {
        Self {
            stored: ContentCursor::new(rows),
            n_frames,
            n_markers,
            is_rectangle: false,
            missing_before,
            origin_gaps: None,
            next: 0,
            next_row: 0,
            n_empty: None,
            bytes: Vec::new(),
        }
    }

    /// The frames of `n_frames` times `n_markers` [`stored`] positions; zeros are gaps.
    pub(super) fn of_rectangle(positions: Content, (n_frames, n_markers): (u64, usize)) -> Self {
        let frames = Self::of_rows(positions, (n_frames, n_markers), Vec::new());
        Self { is_rectangle: true, ..frames }
    }

    /// Returns to the first frame.
    pub(super) fn rewind(&mut self) {
        self.stored.rewind();
        (self.next, self.next_row, self.n_empty) = (0, 0, None);
        self.origin_gaps.iter_mut().for_each(OriginGaps::rewind);
    }

    /// Fills `row`, one position per marker. `false` at the end.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        if self.next >= self.n_frames {
            return Ok(false);
        }
        self.next += 1;
        let missing_before = self.missing_before.get(self.next_row).copied().unwrap_or(0);
        match self.n_empty.unwrap_or(missing_before).checked_sub(1) {
            Some(n_left) => {
                self.n_empty = Some(n_left);
                row.fill(GAP);
            }
            None => {
                (self.n_empty, self.next_row) = (None, self.next_row + 1);
                self.read_row(row)?;
            }
        }
        Ok(true)
    }

    fn read_row(&mut self, row: &mut [Position]) -> io::Result<()> {
        let n_stored = if self.is_rectangle {
            self.n_markers
        } else {
            let mut n_stored = [0; 4];
            self.stored.read_exact(&mut n_stored)?;
            u32::from_le_bytes(n_stored) as usize
        };
        self.bytes.resize(n_stored * POSITION_BYTES, 0);
        self.stored.read_exact(&mut self.bytes)?;
        let mut stored = self.bytes.as_chunks().0.iter();
        for position in row.iter_mut() {
            *position = stored.next().map_or(GAP, |&bytes| restored(bytes));
        }
        if let Some(gaps) = &mut self.origin_gaps {
            gaps.apply(row);
        }
        Ok(())
    }

    /// Calls `visit` with the positions of every frame.
    fn for_each_row(&mut self, visit: &mut dyn FnMut(&[Position])) -> io::Result<()> {
        self.rewind();
        let mut row = vec![GAP; self.n_markers];
        while self.next_frame(&mut row)? {
            visit(&row);
        }
        self.rewind();
        Ok(())
    }

    /// Checks the unit against the extent of the motion, and decides whether samples at the origin are positions or
    /// gaps.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn examine(
        &mut self,
        unit: &FileUnit,
        at_origin: AtOrigin,
        notes: &mut Notes,
    ) -> Result<()> {
        // Without markers there is nothing to measure.
        let n_frames = if self.n_markers == 0 { 0 } else { self.n_frames };
        let n_frames = usize::try_from(n_frames).unwrap_or(usize::MAX);
        let mut extent = MotionExtent::new(n_frames);
        let mut scan = OriginScan::new(self.n_markers);
        self.for_each_row(&mut |row| {
            extent.add_row(row);
            if at_origin != AtOrigin::Positions {
                scan.add_row(row);
            }
        })?;
        if at_origin == AtOrigin::Missing && scan.suspects().next().is_some() {
            let gaps = OriginGaps::find(&scan, n_frames, &mut |visit| self.for_each_row(visit))?;
            let samples = gaps.n_missing();
            if samples > 0 {
                notes.ambiguous(Ambiguity::Origin { samples, gaps: true });
                self.origin_gaps = Some(gaps);
                extent = MotionExtent::new(n_frames);
                self.for_each_row(&mut |row| extent.add_row(row))?;
            }
        }
        unit.check(&mut extent, notes);
        if at_origin == AtOrigin::Doubtful {
            if scan.needs_steps() {
                self.for_each_row(&mut |row| scan.add_steps(row))?;
            }
            scan.note(notes);
        }
        Ok(())
    }
}
