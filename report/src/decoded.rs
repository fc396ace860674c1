//! A take decoded into memory: its samples, and which of them are knots.

use mocapd_codec::Settings;
use mocapd_take::{
    TakeError, TakeEvent, TakeTraversal,
    damage::Problem,
    motion::{GAP, Motion, MotionInfo},
    reader::TakeInput,
    stretch::Span,
    traversal::{Decode, Progress},
};

use crate::{ReportError, column, measures::Counts};

/// Largest take that is decoded into memory, rows times markers: 100 million, 1.3 GB.
pub const SAMPLES_MAX: u64 = 100_000_000;

/// A take decoded into memory.
#[derive(Debug, Clone)]
pub struct DecodedTake {
    /// The samples. Of the metadata only the rate, the up axis, the markers, the subject and the number of frames are
    /// set.
    pub motion: Motion,
    /// By channel and row: whether the sample was kept (a knot) rather than interpolated.
    pub kept: Vec<Vec<bool>>,
    /// The resampler and tolerance of the take.
    pub settings: Option<Settings>,
    /// Damage found while reading.
    pub problems: Vec<Problem>,
}

/// The rows of a channel in one stretch.
struct StretchRows {
    first_row: usize,
    positions: Vec<[f32; 3]>,
    present: Vec<bool>,
    kept: Vec<bool>,
}

impl DecodedTake {
    /// Reads a take to its end. Damaged samples become gaps, and the damage is listed in `problems`.
    ///
    /// # Errors
    /// If it is not a take, or is larger than [`SAMPLES_MAX`].
    pub fn read(take: impl TakeInput) -> Result<Self, ReportError> {
        let mut stretches: Vec<Vec<StretchRows>> = Vec::new();
        let mut n_stored = 0;
        let traversal = TakeTraversal::new(take, Decode::All);
        let take = traversal.run(|found, progress| match &found.event {
            TakeEvent::Stretch(stretch) if !found.is_refused && stretch.span.n_rows > 0 => {
                store(progress, stretch.span, &mut stretches, &mut n_stored)
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
        let mut decoded = Self {
            motion: Motion { info, positions_mm: Vec::new() },
            kept: Vec::new(),
            settings: Some(take.header.codec()?),
            problems: take.problems,
        };
        decoded.place(&stretches)?;
        Ok(decoded)
    }

    /// Copies the decoded stretches of each channel to their rows.
    fn place(&mut self, stretches: &[Vec<StretchRows>]) -> Result<(), ReportError> {
        let MotionInfo { n_frames, markers, .. } = &self.motion.info;
        let (n_rows, n_markers) = (*n_frames as usize, markers.len());
        let n_samples = n_frames.saturating_mul(n_markers as u64);
        if n_samples > SAMPLES_MAX {
            return Err(too_large(n_samples).into());
        }
        self.motion.positions_mm = vec![GAP; n_rows * n_markers];
        self.kept = vec![vec![false; n_rows]; n_markers];
        for ((marker, kept), stretches) in self.kept.iter_mut().enumerate().zip(stretches) {
            for stretch in stretches {
                for (i, position) in stretch.positions.iter().enumerate() {
                    if stretch.present[i] {
                        let row = stretch.first_row + i;
                        self.motion.positions_mm[row * n_markers + marker] = *position;
                        kept[row] = stretch.kept[i];
                    }
                }
            }
        }
        Ok(())
    }

    /// Counts of samples present and kept, for the storage measures.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let present: Vec<Vec<bool>> = (0..self.kept.len())
            .map(|marker| column::Column::of(&self.motion, marker).0)
            .map(|column| column.iter().map(Option::is_some).collect())
            .collect();
        let channels: Vec<(&[bool], &[bool])> =
            present.iter().zip(&self.kept).map(|(p, k)| (&p[..], &k[..])).collect();
        Counts::of(&channels)
    }

    /// The largest distance between a sample and that of `original`, mm.
    #[must_use]
    pub fn max_error_mm(&self, original: &Motion) -> f64 {
        let pairs = self.motion.positions_mm.iter().zip(&original.positions_mm);
        pairs
            .filter_map(|(&a, &b)| Some(column::distance(column::sample(a)?, column::sample(b)?)))
            .fold(0.0, f64::max)
    }

    /// The resampler and tolerance as text: `dense at 0.5 mm`.
    #[must_use]
    pub fn coding(&self) -> String {
        match self.settings {
            Some(Settings { kind, .. }) if kind.is_lossless() => "lossless".to_owned(),
            Some(Settings { kind, tolerance }) => format!("{kind} at {} mm", tolerance.mm()),
            None => String::new(),
        }
    }
}

fn too_large(n_samples: u64) -> TakeError {
    TakeError::InvalidArgument(format!(
        "{n_samples} positions do not fit into memory (at most {SAMPLES_MAX}): export a part of the take with --from \
         and --to, and import that"
    ))
}

/// Stores the decoded rows of a stretch.
fn store(
    progress: &Progress,
    span: Span,
    stretches: &mut Vec<Vec<StretchRows>>,
    n_stored: &mut u64,
) -> Result<(), TakeError> {
    for (channel, rows) in progress.rows().enumerate() {
        let Some(rows) = rows.filter(|rows| rows.has_samples()) else { continue };
        *n_stored += rows.positions.len() as u64;
        if *n_stored > SAMPLES_MAX {
            return Err(too_large(*n_stored));
        }
        if stretches.len() <= channel {
            stretches.resize_with(channel + 1, Vec::new);
        }
        stretches[channel].push(StretchRows {
            first_row: span.first_row as usize,
            positions: rows.positions.clone(),
            present: rows.present.clone(),
            kept: rows.kept.clone(),
        });
    }
    Ok(())
}
