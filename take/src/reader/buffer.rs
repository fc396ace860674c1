//! The bytes that the reader holds.

use std::ops::{Deref, DerefMut};

use super::READ_BYTES;
use crate::chunk::WINDOW_BYTES;

/// Largest buffer in ordinary use: a search window, and a read that arrives while the window lacks a byte.
const ORDINARY_BYTES_MAX: usize = WINDOW_BYTES + READ_BYTES;

/// Bytes with initialised space after them, into which files are read without another copy.
#[derive(Debug, Default)]
pub(super) struct ReadBuffer {
    /// The bytes and the space.
    storage: Vec<u8>,
    /// Number of bytes.
    len: usize,
}

impl ReadBuffer {
    /// Space for the next `n` bytes.
    pub(super) fn space(&mut self, n: usize) -> &mut [u8] {
        let (capacity, needed) = (self.storage.len(), self.len + n);
        if needed > capacity {
            // Twice the bytes that are held, as a vector would; near the window size less is enough.
            let grown = if self.len < WINDOW_BYTES { 2 * self.len } else { self.len / 4 * 5 };
            let is_ordinary = needed <= ORDINARY_BYTES_MAX;
            let grown = if is_ordinary { grown.min(ORDINARY_BYTES_MAX) } else { grown }.max(needed);
            self.storage.reserve_exact(grown - capacity);
            self.storage.resize(grown, 0);
        }
        &mut self.storage[self.len..needed]
    }

    /// Adds the first `n` bytes of the last [`space`](Self::space), which were written.
    pub(super) fn fill(&mut self, n: usize) {
        self.len = (self.len + n).min(self.storage.len());
    }

    /// Removes the first `n` bytes.
    pub(super) fn remove_front(&mut self, n: usize) {
        self.storage.copy_within(n..self.len, 0);
        self.len -= n;
    }

    pub(super) fn clear(&mut self) {
        self.len = 0;
    }
}

impl Deref for ReadBuffer {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.storage[..self.len]
    }
}

impl DerefMut for ReadBuffer {
    fn deref_mut(&mut self) -> &mut [u8] {
        &mut self.storage[..self.len]
    }
}
