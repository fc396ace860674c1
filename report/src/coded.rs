//! What a take holds, read whole: its samples, and which of them it keeps.

use mocapd_codec::{ResamplerKind, Settings};
use mocapd_take::{
    TakeError, TakeEvent, TakeTraversal,
    damage::Problem,
    motion::{GAP, Motion, MotionInfo},
    reader::TakeInput,
    stretch::Span,
    traversal::{Decode, Progress},
};

use crate::{ReportError, measures::Counts};

/// Most rows times markers of a take that is looked at whole: 100 million, 1.3 GB in memory.
pub const SAMPLES_MAX: u64 = 100_000_000;

/// A take in memory.
#[derive(Debug, Clone)]
pub struct Coded {
    /// Its samples. Of what stands beside them, the rate, the markers, the subject and the number of frames
    /// are here.
    pub motion: Motion,
    /// By channel and row: whether the sample was kept, rather than interpolated.
    pub kept: Vec<Vec<bool>>,
    /// What it was coded with.
    pub settings: Option<Settings>,
    /// What could not be read.
    pub problems: Vec<Problem>,
}

/// The rows of a channel in one stretch.
struct Piece {
    first_row: usize,
    positions: Vec<[f32; 3]>,
    present: Vec<bool>,
    kept: Vec<bool>,
}

impl Coded {
    /// Reads a take to its end. What is damaged is a gap, and a problem.
    ///
    /// # Errors
    /// That it is no take, or larger than [`SAMPLES_MAX`].
    pub fn read(take: impl TakeInput) -> Result<Self, ReportError> {
        let mut pieces: Vec<Vec<Piece>> = Vec::new();
        let mut n_held = 0;
        let traversal = TakeTraversal::new(take, Decode::All);
        let take = traversal.run(|found, progress| match &found.event {
            TakeEvent::Stretch(stretch) if !found.is_refused && stretch.span.n_rows > 0 => {
                hold(progress, stretch.span, &mut pieces, &mut n_held)
            }
            _ => Ok(()),
        })?;
        let take = take.take;
        let info = MotionInfo {
            rate_hz: take.header.rate_hz,
            up: take.header.up_axis,
            n_frames: take.n_rows,
            markers: take.channels.iter().map(Into::into).collect(),
            subject: take.subject,
            ..MotionInfo::default()
        };
        let mut coded = Self {
            motion: Motion { info, positions_mm: Vec::new() },
            kept: Vec::new(),
            settings: Some(take.header.codec()?),
            problems: take.problems,
        };
        coded.place(&pieces)?;
        Ok(coded)
    }

    fn place(&mut self, pieces: &[Vec<Piece>]) -> Result<(), ReportError> {
        let MotionInfo { n_frames, markers, .. } = &self.motion.info;
        let (n_rows, n_markers) = (*n_frames as usize, markers.len());
        let n_samples = n_frames.saturating_mul(n_markers as u64);
        if n_samples > SAMPLES_MAX {
            return Err(too_large(n_samples).into());
        }
        self.motion.positions_mm = vec![GAP; n_rows * n_markers];
        self.kept = vec![vec![false; n_rows]; n_markers];
        for ((marker, kept), pieces) in self.kept.iter_mut().enumerate().zip(pieces) {
            for piece in pieces {
                for (i, position) in piece.positions.iter().enumerate() {
                    if piece.present[i] {
                        let row = piece.first_row + i;
                        self.motion.positions_mm[row * n_markers + marker] = *position;
                        kept[row] = piece.kept[i];
                    }
                }
            }
        }
        Ok(())
    }

    /// The counts of its samples and of those that it keeps.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let present: Vec<Vec<bool>> = (0..self.kept.len())
            .map(|marker| crate::column::Column::of(&self.motion, marker).0)
            .map(|column| column.iter().map(Option::is_some).collect())
            .collect();
        let channels: Vec<(&[bool], &[bool])> =
            present.iter().zip(&self.kept).map(|(p, k)| (&p[..], &k[..])).collect();
        Counts::of(&channels)
    }

    /// The largest distance between its samples and those of what it was made of, mm.
    #[must_use]
    pub fn max_error_mm(&self, original: &Motion) -> f64 {
        let pairs = self.motion.positions_mm.iter().zip(&original.positions_mm);
        pairs
            .filter_map(|(&a, &b)| {
                Some(crate::column::distance(crate::column::sample(a)?, crate::column::sample(b)?))
            })
            .fold(0.0, f64::max)
    }

    /// How it was coded, in words: `dense at 0.5 mm`.
    #[must_use]
    pub fn how(&self) -> String {
        match self.settings {
            Some(Settings { kind: ResamplerKind::Lossless, .. }) => "lossless".to_owned(),
            Some(Settings { kind, tolerance }) => format!("{kind} at {} mm", tolerance.mm()),
            None => String::new(),
        }
    }
}

fn too_large(n_samples: u64) -> TakeError {
    TakeError::InvalidArgument(format!(
        "{n_samples} positions are more than are looked at in one piece ({SAMPLES_MAX}): export a part of the take, \
         and import that"
    ))
}

/// Keeps what was decoded of a stretch.
fn hold(
    progress: &Progress,
    span: Span,
    pieces: &mut Vec<Vec<Piece>>,
    n_held: &mut u64,
) -> Result<(), TakeError> {
    for (channel, rows) in progress.rows().enumerate() {
        let Some(rows) = rows.filter(|rows| rows.has_samples()) else { continue };
        *n_held += rows.positions.len() as u64;
        if *n_held > SAMPLES_MAX {
            return Err(too_large(*n_held));
        }
        if pieces.len() <= channel {
            pieces.resize_with(channel + 1, Vec::new);
        }
        pieces[channel].push(Piece {
            first_row: span.first_row as usize,
            positions: rows.positions.clone(),
            present: rows.present.clone(),
            kept: rows.kept.clone(),
        });
    }
    Ok(())
}
