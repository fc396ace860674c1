//! Chunks: a length, a tag, and what it holds.

use std::io::{self, Write};

/// What chunks are.
pub(super) mod tags {
    pub(in super::super) const FILE_HEADER: u16 = 1;
    pub(in super::super) const STREAM_HEADER: u16 = 2;
    pub(in super::super) const SAMPLES: u16 = 3;
    pub(in super::super) const CLOCK_OFFSET: u16 = 4;
    pub(in super::super) const STREAM_FOOTER: u16 = 6;
}

/// Appends a length: how many bytes it has, 1, 4 or 8, and then those.
pub(super) fn put_length(out: &mut Vec<u8>, length: u64) {
    if let Ok(length) = u8::try_from(length) {
        out.extend([1, length]);
    } else if let Ok(length) = u32::try_from(length) {
        out.push(4);
        out.extend(length.to_le_bytes());
    } else {
        out.push(8);
        out.extend(length.to_le_bytes());
    }
}

/// Writes a chunk of several pieces.
pub(super) fn put_chunk(out: &mut dyn Write, tag: u16, pieces: &[&[u8]]) -> io::Result<()> {
    let length = pieces.iter().map(|piece| piece.len() as u64).sum::<u64>() + 2;
    let mut head = Vec::with_capacity(16);
    put_length(&mut head, length);
    head.extend(tag.to_le_bytes());
    out.write_all(&head)?;
    pieces.iter().try_for_each(|piece| out.write_all(piece))
}

/// Says that the times of a stream are those of the file: an offset of nothing, found at its beginning.
pub(super) fn put_own_clock(out: &mut dyn Write, stream: u32) -> io::Result<()> {
    let nothing = 0_f64.to_le_bytes();
    put_chunk(out, tags::CLOCK_OFFSET, &[&stream.to_le_bytes(), &nothing, &nothing])
}

/// Samples of a stream, gathered into a chunk.
pub(super) struct Samples {
    stream: u32,
    n: u64,
    bytes: Vec<u8>,
}

impl Samples {
    pub(super) fn new(stream: u32) -> Self {
        Self { stream, n: 0, bytes: Vec::new() }
    }

    /// Begins a sample with its time; its values are to be appended to what is given.
    pub(super) fn push(&mut self, time_s: f64) -> &mut Vec<u8> {
        self.n += 1;
        self.bytes.push(8);
        self.bytes.extend(time_s.to_le_bytes());
        &mut self.bytes
    }

    /// Bytes gathered.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Writes what was gathered.
    pub(super) fn flush(&mut self, out: &mut dyn Write) -> io::Result<()> {
        if self.n == 0 {
            return Ok(());
        }
        let mut head = self.stream.to_le_bytes().to_vec();
        put_length(&mut head, self.n);
        put_chunk(out, tags::SAMPLES, &[&head, &self.bytes])?;
        self.n = 0;
        self.bytes.clear();
        Ok(())
    }
}
