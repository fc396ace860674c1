//! The analog channels of a take that was imported from a C3D file, in physical units.
//!
//! C3D stores samples as its converter delivered them. The value of a sample, in the unit that ANALOG:UNITS states, is
//! `(sample - OFFSET) * SCALE * GEN_SCALE` (The C3D File Format: User Guide, Motion Lab Systems, 2021, chapters
//! ANALOG:OFFSET and `ANALOG:GEN_SCALE`); this holds for integers and floats alike. ANALOG:FORMAT states whether integers
//! are signed. `docs/foreign.md` has the layout of the parts that samples and parameters are kept in.

use std::io;

pub use crate::interchange::c3d::AnalogChannel;
use crate::{
    TakeError,
    interchange::c3d::{self, Parameters, PartSamples},
    motion::MotionInfo,
};

/// Values of a block, unless a single frame has more: half a MiB. A block is then decoded in a fraction of a
/// millisecond, and fits in the processor's cache.
const BLOCK_VALUES: usize = 1 << 16;

/// Whether analog samples and force plates need the content of foreign parts of a kind. Pass this to
/// [`TakeFrames::open_with`](crate::TakeFrames::open_with).
#[must_use]
pub fn is_needed(kind: &str) -> bool {
    [c3d::PARAMETERS, c3d::ANALOG].contains(&kind)
}

/// The analog samples of a take, or of a part of one, read in blocks of frames, in bounded memory.
#[derive(Debug)]
pub struct AnalogSamples<'a> {
    channels: Vec<AnalogChannel>,
    stored: PartSamples<'a>,
    is_unsigned: bool,
    rate_hz: f64,
    n_frames: u64,
    frames_left: u64,
    warnings: Vec<String>,
}

impl<'a> AnalogSamples<'a> {
    /// Starts at the first frame of `info`: those of a part of a take ([`MotionInfo::cut`]) have the samples of its own
    /// frames. `None` if the take has no analog samples.
    ///
    /// # Errors
    /// `InvalidArgument` if the content of a part in [`is_needed`] was not read, or has another layout; `Io` if its
    /// scratch file cannot be read.
    pub fn open(info: &'a MotionInfo) -> Result<Option<Self>, TakeError> {
        let parameters = parameters(info)?;
        let samples = Self::from_frame(info, parameters.as_ref(), info.source.first_frame)?;
        Ok(samples.map(|samples| samples.with_frames(info.n_frames)))
    }

    /// The samples that are kept of the frames with numbers `first` to `last`.
    pub(super) fn kept(
        info: &'a MotionInfo,
        parameters: Option<&Parameters>,
        first: u64,
        last: u64,
    ) -> Result<Option<Self>, TakeError> {
        let Some(samples) = Self::from_frame(info, parameters, first)? else { return Ok(None) };
        let header = &samples.stored.header;
        let end = header.first_frame.saturating_add(header.n_frames as u64);
        let n_frames = last.saturating_add(1).min(end).saturating_sub(first);
        Ok(Some(samples.with_frames(n_frames)))
    }

    fn with_frames(self, n_frames: u64) -> Self {
        Self { n_frames, frames_left: n_frames, ..self }
    }

    /// Starts at the frame with number `first_frame`, without frames to read.
    fn from_frame(
        info: &'a MotionInfo,
        parameters: Option<&Parameters>,
        first_frame: u64,
    ) -> Result<Option<Self>, TakeError> {
        let Some(part) = info.foreign.iter().find(|part| part.kind == c3d::ANALOG) else {
            return Ok(None);
        };
        let Some(stored) = PartSamples::analog(&info.foreign, first_frame)? else {
            return Err(unread(&part.kind, part.data.is_empty()));
        };
        let (n_signals, ratio) = (stored.header.n_signals, stored.header.ratio);
        if n_signals == 0 || stored.header.n_frames == 0 {
            return Ok(None);
        }
        // A frame is read as a whole.
        if n_signals.saturating_mul(ratio) as u64 > c3d::ANALOG_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "{} states {n_signals} channels of {ratio} samples a frame, more than a C3D file can hold: the take is \
                 damaged",
                part.kind
            )));
        }
        let mut warnings = Vec::new();
        let defaults = Parameters::default();
        if parameters.is_none() {
            warnings.push(format!(
                "{} is missing: the values are the stored samples.",
                c3d::PARAMETERS
            ));
        }
        let parameters = parameters.unwrap_or(&defaults);
        Ok(Some(Self {
            channels: c3d::analog_channels(parameters, stored.header.n_signals, &mut warnings),
            is_unsigned: c3d::is_analog_unsigned(parameters),
            rate_hz: info.rate_hz * stored.header.ratio as f64,
            n_frames: 0,
            frames_left: 0,
            stored,
            warnings,
        }))
    }

    /// The channels, in the order of the file.
    #[must_use]
    pub fn channels(&self) -> &[AnalogChannel] {
        &self.channels
    }

    /// Samples of a channel in a frame.
    #[must_use]
    pub fn samples_per_frame(&self) -> usize {
        self.stored.header.ratio
    }

    /// Samples of a channel in a second: the rate of the frames times the samples in a frame.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Number of frames from the first on.
    #[must_use]
    pub fn n_frames(&self) -> u64 {
        self.n_frames
    }

    /// What the parameters leave open, and how it was read, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Replaces `block` by the values of the next frames, and returns their number; 0 at the end. One value per channel
    /// for the first sample of a frame, then for its next sample, and so on: `block[(frame * samples_per_frame +
    /// sample) * channels + channel]`. A sample that the file does not have is NaN: the take has a frame that the kept
    /// part lacks.
    ///
    /// # Errors
    /// Those of the scratch file that the samples may be in.
    pub fn next_block(&mut self, block: &mut Vec<f64>) -> io::Result<usize> {
        block.clear();
        let per_frame = self.samples_per_frame().saturating_mul(self.channels.len());
        let n_frames = (BLOCK_VALUES / per_frame.max(1)).max(1);
        let n_frames = (n_frames as u64).min(self.frames_left);
        for _ in 0..n_frames {
            self.push_frame(block)?;
        }
        self.frames_left -= n_frames;
        Ok(n_frames as usize)
    }

    fn push_frame(&mut self, block: &mut Vec<f64>) -> io::Result<()> {
        let (width, ratio) = (self.stored.header.width, self.stored.header.ratio);
        let is_kept = self.stored.begin_frame();
        for _ in 0..ratio {
            match if is_kept { self.stored.next()? } else { None } {
                Some(stored) => {
                    block.extend(stored.iter().zip(&self.channels).map(|(&sample, channel)| {
                        let stored = c3d::sample_value(width, sample, self.is_unsigned);
                        channel.value(f64::from(stored))
                    }));
                }
                None => block.extend(std::iter::repeat_n(f64::NAN, self.channels.len())),
            }
        }
        Ok(())
    }
}

/// The parameters of the file; `None` if the take has none.
///
/// # Errors
/// `InvalidArgument` if they were not read, or have another layout; `Io` if their scratch file cannot be read.
pub(crate) fn parameters(info: &MotionInfo) -> Result<Option<Parameters>, TakeError> {
    let Some(part) = info.foreign.iter().find(|part| part.kind == c3d::PARAMETERS) else {
        return Ok(None);
    };
    match c3d::kept_parameters(&info.foreign)? {
        Some((_, parameters)) => Ok(Some(parameters)),
        None => Err(unread(&part.kind, part.data.is_empty())),
    }
}

fn unread(kind: &str, is_empty: bool) -> TakeError {
    TakeError::InvalidArgument(if is_empty {
        format!("the content of {kind} was not read: open the take with foreign::analog::is_needed")
    } else {
        format!("{kind} is damaged, or has a layout that only a newer mocapd reads")
    })
}
