//! The threads that decode: from coded stretches to rows.

use std::io;

use crossbeam_channel::{Receiver, Sender};
use mocapd_codec::Settings;
use mocapd_take::{
    TakeError,
    motion::{GAP, Position},
    stretch::{Span, Stretch, StretchDecoder},
};

use super::jobs::Job;

/// Samples of a piece: 200 kB, which stay in a processor's cache while their columns become rows.
const PIECE_SAMPLES: usize = 1 << 14;

/// What a decoding thread gets.
pub(super) enum Coded {
    /// A stretch of the take.
    Stretch(OwnStretch),
    /// What follows is another job's.
    Next,
    /// There are no more.
    End,
    /// Something of the take is missing.
    Flaw,
    /// The file could not be read.
    Failed(TakeError),
}

/// What it gives.
pub(super) enum Decoded {
    Rows(Rows),
    Flaw,
    Next,
    End,
    Failed(io::Error),
}

/// A stretch out of the reader's memory.
pub(super) struct OwnStretch {
    pub(super) span: Span,
    pub(super) shared: Vec<u8>,
    pub(super) blocks: Vec<Vec<u8>>,
}

/// Successive rows, frame by frame.
#[derive(Debug, Default)]
pub(super) struct Rows {
    first_row: u64,
    n_rows: u64,
    positions: Vec<Position>,
}

impl Rows {
    /// The row after the last.
    pub(super) fn end_row(&self) -> u64 {
        self.first_row + self.n_rows
    }

    /// A row, if it is one of these.
    pub(super) fn row(&self, row: u64, n_markers: usize) -> Option<&[Position]> {
        let index = usize::try_from(row.checked_sub(self.first_row)?).ok()?;
        let start = index.checked_mul(n_markers)?;
        if row < self.end_row() { self.positions.get(start..start + n_markers) } else { None }
    }
}

/// Does one job after another, until nobody wants them any more.
pub(super) fn work(codec: Settings, n_markers: usize, jobs: &Receiver<Job>) {
    let mut decoder = StretchDecoder::new(codec);
    for Job { coded, decoded } in jobs {
        decode(&mut decoder, n_markers, &coded, &decoded);
    }
}

/// Decodes what comes, as rows, until nobody wants them any more.
fn decode(
    decoder: &mut StretchDecoder,
    n_markers: usize,
    coded: &Receiver<Coded>,
    decoded: &Sender<Decoded>,
) {
    for coded in coded {
        let sent = match coded {
            Coded::Stretch(stretch) => match decode_one(decoder, &stretch) {
                Ok(()) => send_rows(decoder, stretch.span, n_markers, decoded),
                Err(_) => decoded.send(Decoded::Flaw).is_ok(),
            },
            Coded::Next => decoded.send(Decoded::Next).is_ok(),
            Coded::End => decoded.send(Decoded::End).is_ok(),
            Coded::Flaw => decoded.send(Decoded::Flaw).is_ok(),
            Coded::Failed(error) => decoded.send(Decoded::Failed(io::Error::other(error))).is_ok(),
        };
        if !sent {
            return;
        }
    }
}

fn decode_one(decoder: &mut StretchDecoder, stretch: &OwnStretch) -> Result<(), TakeError> {
    decoder.decode(&Stretch {
        span: stretch.span,
        missing_before: false,
        timeline: None,
        shared: &stretch.shared,
        blocks: stretch.blocks.iter().map(Vec::as_slice).collect(),
        sizes: Default::default(),
    })
}

/// Sends what was decoded in pieces, columns turned into rows; `false` when nobody wants it any more.
fn send_rows(
    decoder: &StretchDecoder,
    span: Span,
    n_markers: usize,
    decoded: &Sender<Decoded>,
) -> bool {
    let n_rows = span.n_rows as usize;
    let piece_rows = (PIECE_SAMPLES / n_markers.max(1)).max(1);
    for first in (0..n_rows).step_by(piece_rows) {
        let n = piece_rows.min(n_rows - first);
        let mut positions = vec![GAP; n * n_markers];
        for (column, rows) in decoder.rows().take(n_markers).enumerate() {
            let Some(rows) = rows else { continue };
            let samples = rows.positions.iter().zip(&rows.present).skip(first).take(n);
            let places = positions.iter_mut().skip(column).step_by(n_markers);
            for (place, (&position, &present)) in places.zip(samples) {
                if present {
                    *place = position;
                }
            }
        }
        let first_row = span.first_row + first as u64;
        let rows = Rows { first_row, n_rows: n as u64, positions };
        if decoded.send(Decoded::Rows(rows)).is_err() {
            return false;
        }
    }
    true
}
