//! Sorts samples that come in any order into a rectangle of frames and markers.

use std::io::{self, Read};

use crate::{
    foreign::content::{Content, ContentCursor, NewScratch, Spool},
    interchange::text::{POSITION_BYTES, stored},
    motion::Position,
};

/// A sample of the long layout.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlacedSample {
    pub(super) frame: u64,
    pub(super) column: usize,
    pub(super) position: Position,
}

/// Bytes of a sample: frame, column and position.
const SAMPLE_BYTES: usize = 8 + 4 + POSITION_BYTES;

impl PlacedSample {
    /// Its bytes. A take has fewer columns than a `u32` counts.
    pub(super) fn to_bytes(self) -> [u8; SAMPLE_BYTES] {
        let mut bytes = [0; SAMPLE_BYTES];
        bytes[..8].copy_from_slice(&self.frame.to_le_bytes());
        bytes[8..12].copy_from_slice(&(self.column as u32).to_le_bytes());
        bytes[12..].copy_from_slice(&stored(self.position));
        bytes
    }
}

/// Positions that are held between two writes: 4 kB of them. In files that are sorted by frame they are adjacent
/// samples; in others more would only be copied.
const HELD_POSITIONS: u64 = 341;

/// The positions of all frames and markers, frame by frame; zeros where there is none.
pub(super) struct Rectangle {
    content: Content,
    /// The positions that are held, and the number of the first.
    held: Vec<[u8; POSITION_BYTES]>,
    from: u64,
    n_positions: u64,
}

impl Rectangle {
    /// `n_positions` without any sample.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn new(n_positions: u64, new_scratch: NewScratch<'_>) -> io::Result<Self> {
        let n_bytes = n_positions.saturating_mul(POSITION_BYTES as u64);
        let content = Spool::new(new_scratch).zeros(n_bytes)?;
        Ok(Self { content, held: Vec::new(), from: 0, n_positions })
    }

    /// Stores samples; frames count from `first`. Returns how many replaced another sample.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn fill(
        &mut self,
        samples: Content,
        (first, n_markers): (u64, u64),
    ) -> io::Result<u64> {
        let n_samples = samples.len() / SAMPLE_BYTES as u64;
        let mut samples = ContentCursor::new(samples);
        let mut duplicates = 0;
        for _ in 0..n_samples {
            let (mut frame, mut column) = ([0; 8], [0; 4]);
            let mut position = [0; POSITION_BYTES];
            samples.read_exact(&mut frame)?;
            samples.read_exact(&mut column)?;
            samples.read_exact(&mut position)?;
            let row = u64::from_le_bytes(frame).saturating_sub(first);
            let place = row * n_markers + u64::from(u32::from_le_bytes(column));
            if let Some(held) = self.hold(place)? {
                duplicates += u64::from(*held != [0; POSITION_BYTES]);
                *held = position;
            }
        }
        Ok(duplicates)
    }

    /// The positions.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn finish(mut self) -> io::Result<Content> {
        self.write_held()?;
        Ok(self.content)
    }

    fn hold(&mut self, place: u64) -> io::Result<Option<&mut [u8; POSITION_BYTES]>> {
        let from = place - place % HELD_POSITIONS;
        if self.held.is_empty() || from != self.from {
            self.write_held()?;
            let n_held = self.n_positions.saturating_sub(from).min(HELD_POSITIONS);
            self.held.resize(n_held as usize, [0; POSITION_BYTES]);
            self.from = from;
            self.content.read_at(from * POSITION_BYTES as u64, self.held.as_flattened_mut())?;
        }
        Ok(self.held.get_mut((place - from) as usize))
    }

    fn write_held(&mut self) -> io::Result<()> {
        self.content.write_at(self.from * POSITION_BYTES as u64, self.held.as_flattened())
    }
}
