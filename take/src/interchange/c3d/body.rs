//! The frames of a C3D file to be written.

use std::io;

use super::columns::unordered;
use super::foreign::{KeptSamples, kept_parameters};
use super::gap_coordinates::KeptCoordinates;
use super::read::is_missing;
use crate::motion::{GAP, MotionInfo, Position, is_gap};

/// The fourth word of a missing sample.
const MISSING: f32 = -1.0;

/// What a point of the written file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Point {
    Marker(usize),
    ModelOutput(usize),
}

/// What goes into each frame.
pub(super) struct Body<'a> {
    /// The points in order.
    pub(super) points: Vec<Point>,
    analog: Option<KeptSamples<'a>>,
    residuals: Option<KeptSamples<'a>>,
    outputs: Option<KeptSamples<'a>>,
    under_gaps: Option<KeptCoordinates<'a>>,
    /// The words under the gaps of the frame under way, for each marker; all `None` between frames.
    under_gap: Vec<Option<[f32; 4]>>,
    unsigned_analog: bool,
    /// What is taken from the analog samples of each channel; empty for nothing.
    pub(super) analog_offsets: Vec<f64>,
}

impl<'a> Body<'a> {
    /// For frames from number `first_frame` on.
    ///
    /// # Errors
    /// Those of reading what was kept.
    pub(super) fn new(info: &'a MotionInfo, first_frame: u64) -> io::Result<Self> {
        let foreign = &info.foreign;
        let outputs = KeptSamples::model_outputs(foreign, first_frame)?;
        let n_markers = info.markers.len();
        Ok(Self {
            under_gaps: KeptCoordinates::parse(foreign, n_markers, first_frame)?,
            under_gap: vec![None; n_markers],
            analog_offsets: Vec::new(),
            points: places(n_markers, outputs.as_ref().map_or(&[], |kept| &kept.points)),
            analog: KeptSamples::analog(foreign, first_frame)?,
            residuals: KeptSamples::residuals(foreign, first_frame)?
                .filter(|kept| kept.n_signals == n_markers),
            outputs,
            unsigned_analog: kept_parameters(foreign)?
                .and_then(|(_, parameters)| parameters.text("ANALOG", "FORMAT"))
                .is_some_and(|format| format.eq_ignore_ascii_case("UNSIGNED")),
        })
    }

    /// Points a frame, model outputs included.
    pub(super) fn n_points(&self) -> usize {
        self.points.len()
    }

    /// Analog samples a frame and channel, and channels.
    pub(super) fn analog_shape(&self) -> (usize, usize) {
        self.analog.as_ref().map_or((0, 0), |kept| (kept.ratio, kept.n_signals))
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// Those of reading what was kept.
    pub(super) fn push_frame(&mut self, row: &[Position], buffer: &mut Vec<u8>) -> io::Result<()> {
        let is_wide = self.residuals.as_ref().is_some_and(|kept| kept.width == 4);
        let residuals = self.residuals.as_mut().map(KeptSamples::next_frame).transpose()?.flatten();
        let outputs = self.outputs.as_mut().map(KeptSamples::next_frame).transpose()?.flatten();
        if let Some(kept) = &mut self.under_gaps {
            for &(marker, words) in kept.next_frame()? {
                if let Some(place) = self.under_gap.get_mut(marker) {
                    *place = Some(words);
                }
            }
        }
        for &point in &self.points {
            let words = match point {
                Point::Marker(index) => {
                    let position = row.get(index).copied().unwrap_or(GAP);
                    let fourth = residuals.and_then(|words| {
                        let &word = words.get(index)?;
                        Some(if is_wide {
                            f32::from_bits(unordered(word))
                        } else {
                            f32::from(word as i16)
                        })
                    });
                    let under_gap = self.under_gap.get_mut(index).and_then(Option::take);
                    marker_words(position, fourth, under_gap)
                }
                Point::ModelOutput(index) => outputs
                    .and_then(|words| words.as_chunks::<4>().0.get(index))
                    .map_or([0.0, 0.0, 0.0, MISSING], |w| {
                        w.map(|bits| f32::from_bits(unordered(bits)))
                    }),
            };
            words.iter().for_each(|word| buffer.extend(word.to_le_bytes()));
        }
        let (ratio, n_channels) = self.analog_shape();
        let unsigned = self.unsigned_analog;
        let Some(kept) = self.analog.as_mut() else { return Ok(()) };
        let present = kept.begin_frame();
        let wide = kept.width == 4;
        for _ in 0..ratio {
            match if present { kept.next()? } else { None } {
                Some(words) => words.iter().enumerate().for_each(|(channel, &word)| {
                    let mut value = if wide {
                        f32::from_bits(unordered(word))
                    } else if unsigned {
                        word as f32
                    } else {
                        f32::from(word as i16)
                    };
                    if let Some(offset) = self.analog_offsets.get(channel) {
                        value = (f64::from(value) - offset) as f32;
                    }
                    buffer.extend(value.to_le_bytes());
                }),
                None => buffer.extend(std::iter::repeat_n(0, 4 * n_channels)),
            }
        }
        Ok(())
    }
}

/// A marker's four words. A fourth word that would say "missing" does not stand beside a position; what a missing sample
/// had for coordinates stands there again.
fn marker_words(position: Position, fourth: Option<f32>, under_gap: Option<[f32; 4]>) -> [f32; 4] {
    if is_gap(position) {
        return under_gap.unwrap_or([0.0, 0.0, 0.0, MISSING]);
    }
    let [x, y, z] = position;
    [x, y, z, fourth.filter(|&word| !is_missing(word)).unwrap_or(0.0)]
}

/// The points in order: model outputs at their own places, markers in between.
fn places(n_markers: usize, outputs: &[usize]) -> Vec<Point> {
    let n_points = n_markers + outputs.len();
    let mut points = Vec::with_capacity(n_points);
    let mut next_output = 0;
    let mut next_marker = 0;
    for place in 0..n_points {
        let here = outputs.get(next_output).is_some_and(|&at| at <= place);
        if here || next_marker == n_markers {
            points.push(Point::ModelOutput(next_output));
            next_output += 1;
        } else {
            points.push(Point::Marker(next_marker));
            next_marker += 1;
        }
    }
    points
}
