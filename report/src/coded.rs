//! What a take holds, read whole: its samples, and which of them it keeps.

use mocapd_codec::{ResamplerKind, Settings};
use mocapd_take::{
    TakeError, TakeEvent,
    motion::{GAP, Motion},
    reader::{TakeInput, read_events},
    stretch::StretchDecoder,
    table::ChannelTable,
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
    /// What could not be read, one sentence each.
    pub problems: Vec<String>,
}

/// One block's channel: its first row, its rows.
type Piece = (usize, Vec<[f32; 3]>, Vec<bool>, Vec<bool>);

impl Coded {
    /// Reads a take to its end. What is damaged is a gap, and a problem.
    ///
    /// # Errors
    /// That it is no take, or larger than [`SAMPLES_MAX`].
    pub fn read(take: impl TakeInput) -> Result<Self, ReportError> {
        let mut coded =
            Self { motion: Motion::default(), kept: vec![], settings: None, problems: vec![] };
        let mut table = ChannelTable::default();
        let mut decoder = None;
        let mut pieces: Vec<Vec<Piece>> = Vec::new();
        let (mut n_rows, mut n_held) = (0_usize, 0_u64);
        read_events(take, |event| {
            match event {
                TakeEvent::Header(header) => {
                    coded.motion.info.rate_hz = header.rate_hz;
                    coded.motion.info.up = mocapd_take::motion::UpAxis::from_code(header.up_axis);
                    table.append(&header.channels);
                    let settings = header.codec()?;
                    coded.settings = Some(settings);
                    decoder = Some(StretchDecoder::new(settings));
                }
                TakeEvent::Subject(subject) => coded.motion.info.subject = Some(*subject),
                TakeEvent::Channels(more) => table.append(&more),
                TakeEvent::Stretch(stretch) => {
                    let Some(decoder) = &mut decoder else { return Ok(()) };
                    let span = stretch.span;
                    table.stated(stretch.stated_channels());
                    let is_again = span.first_row < n_rows as u64;
                    n_rows = n_rows.max(usize::try_from(span.end_row()).unwrap_or(usize::MAX));
                    if span.n_rows == 0 {
                        return Ok(());
                    }
                    if is_again {
                        decoder.pass();
                        coded
                            .problems
                            .push(format!("frames from {} on come twice", span.first_row));
                        return Ok(());
                    }
                    if let Err(error) = decoder.decode(&stretch) {
                        coded.problems.push(format!("frames from {} on: {error}", span.first_row));
                        return Ok(());
                    }
                    for (channel, rows) in decoder.rows().enumerate() {
                        let Some(rows) = rows.filter(|rows| rows.has_samples()) else { continue };
                        n_held += rows.positions.len() as u64;
                        if n_held > SAMPLES_MAX {
                            return Err(too_large(n_held));
                        }
                        if pieces.len() <= channel {
                            pieces.resize_with(channel + 1, Vec::new);
                        }
                        pieces[channel].push((
                            span.first_row as usize,
                            rows.positions.clone(),
                            rows.present.clone(),
                            rows.kept.clone(),
                        ));
                    }
                }
                TakeEvent::Unplaced { n_rows, .. } => {
                    coded.problems.push(format!("{n_rows} frames depend on damaged ones"));
                }
                TakeEvent::Damaged { offset, message, .. } => {
                    table.damaged();
                    coded.problems.push(format!("byte {offset}: {message}"));
                }
                TakeEvent::End { finished: false, .. } => {
                    coded.problems.push("the take was cut off: its end is missing".to_owned());
                }
                _ => {}
            }
            Ok(())
        })?;
        coded.motion.info.markers = table.channels().iter().map(Into::into).collect();
        coded.place(&pieces, n_rows)?;
        Ok(coded)
    }

    fn place(&mut self, pieces: &[Vec<Piece>], n_rows: usize) -> Result<(), ReportError> {
        let n_markers = self.motion.info.markers.len();
        let n_samples = (n_rows as u64).saturating_mul(n_markers as u64);
        if n_samples > SAMPLES_MAX {
            return Err(too_large(n_samples).into());
        }
        self.motion.info.n_frames = n_rows as u64;
        self.motion.positions_mm = vec![GAP; n_rows * n_markers];
        self.kept = vec![vec![false; n_rows]; n_markers];
        for ((marker, kept), pieces) in self.kept.iter_mut().enumerate().zip(pieces) {
            for (first_row, positions, present, kept_here) in pieces {
                for (i, position) in positions.iter().enumerate().filter(|(i, _)| present[*i]) {
                    let row = first_row + i;
                    self.motion.positions_mm[row * n_markers + marker] = *position;
                    kept[row] = kept_here[i];
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
