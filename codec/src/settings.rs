//! Which resampler, and what it is asked for.

use std::{fmt, str::FromStr};

use crate::{
    BlockDecoder, BlockEncoder, CodecError, Rows, SplineVariant, Tolerance,
    dense::Dense,
    fast::Fast,
    frame::{self, FramedDecoder, FramedEncoder, PayloadDecoder, PayloadEncoder},
    lossless::Lossless,
    spline::{self, Spline},
};

/// The resamplers. [`Display`](fmt::Display) writes and [`FromStr`] reads the name that a container of
/// blocks stores: `dense`, `fast`, `lossless`, `spline:worst-sample`...
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum ResamplerKind {
    /// Smallest files: adaptive, quantised inside the tolerance, context-coded.
    #[default]
    Dense,
    /// The same contract at bus speed.
    Fast,
    /// Bit-exact float32.
    Lossless,
    /// The published method: asynchronous greedy cubic-spline knots. Offline only.
    Spline(SplineVariant),
    /// The published rival: one set of key times for all channels. Offline only.
    Sync(SplineVariant),
}

impl ResamplerKind {
    /// Whether it can run while the samples arrive, stretch by stretch.
    #[must_use]
    pub fn is_live(self) -> bool {
        !matches!(self, Self::Spline(_) | Self::Sync(_))
    }

    /// Whether it keeps every bit, so that a tolerance has no meaning.
    #[must_use]
    pub fn is_lossless(self) -> bool {
        self == Self::Lossless
    }
}

impl fmt::Display for ResamplerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Dense => "dense",
            Self::Fast => "fast",
            Self::Lossless => "lossless",
            Self::Spline(SplineVariant::WorstSample) => "spline:worst-sample",
            Self::Spline(SplineVariant::Exhaustive) => "spline:exhaustive",
            Self::Sync(SplineVariant::WorstSample) => "sync:worst-sample",
            Self::Sync(SplineVariant::Exhaustive) => "sync:exhaustive",
        })
    }
}

impl FromStr for ResamplerKind {
    type Err = CodecError;

    fn from_str(name: &str) -> Result<Self, CodecError> {
        Ok(match name {
            "dense" => Self::Dense,
            "fast" => Self::Fast,
            "lossless" => Self::Lossless,
            "spline" | "spline:worst-sample" => Self::Spline(SplineVariant::WorstSample),
            "spline:exhaustive" => Self::Spline(SplineVariant::Exhaustive),
            "sync" | "sync:worst-sample" => Self::Sync(SplineVariant::WorstSample),
            "sync:exhaustive" => Self::Sync(SplineVariant::Exhaustive),
            _ => {
                return Err(CodecError::InvalidArgument(format!(
                    "no resampler is called '{name}': use dense, fast, lossless, \
                     spline[:worst-sample|:exhaustive] or sync[:worst-sample|:exhaustive]"
                )));
            }
        })
    }
}

/// What encoder and decoder must agree on: a container of blocks stores both, and the
/// [`BLOCK_VERSION`](crate::BLOCK_VERSION).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Which resampler.
    pub kind: ResamplerKind,
    /// Ignored by `lossless`.
    pub tolerance: Tolerance,
}

impl Settings {
    /// A new encoder for one group of channels; allocate one a group, at start. It may move to another
    /// thread between two blocks.
    ///
    /// Without a key block it is as behind a key block without samples; so is a new decoder.
    #[must_use]
    pub fn encoder(&self) -> Box<dyn BlockEncoder> {
        match self.kind {
            ResamplerKind::Dense => self.framed(Dense::new),
            ResamplerKind::Fast => self.framed(Fast::new),
            ResamplerKind::Lossless => self.framed(|_| Lossless::default()),
            ResamplerKind::Spline(variant) => {
                self.framed(|tolerance| Spline::asynchronous(tolerance, variant))
            }
            ResamplerKind::Sync(_) => self.framed(Spline::synchronous),
        }
    }

    fn framed<P>(&self, payload: impl Fn(Tolerance) -> P) -> Box<dyn BlockEncoder>
    where
        P: PayloadEncoder + PayloadDecoder + 'static,
    {
        Box::new(FramedEncoder::new(payload, self.tolerance))
    }

    /// A new decoder for one group of channels. It may move to another thread between two blocks.
    #[must_use]
    pub fn decoder(&self) -> Box<dyn BlockDecoder> {
        let tolerance = self.tolerance;
        match self.kind {
            ResamplerKind::Dense => Box::new(FramedDecoder::new(Dense::new(tolerance), tolerance)),
            ResamplerKind::Fast => Box::new(FramedDecoder::new(Fast::new(tolerance), tolerance)),
            ResamplerKind::Lossless => Box::new(FramedDecoder::new(Lossless::default(), tolerance)),
            ResamplerKind::Spline(variant) => {
                Box::new(FramedDecoder::new(Spline::asynchronous(tolerance, variant), tolerance))
            }
            ResamplerKind::Sync(_) => {
                Box::new(FramedDecoder::new(Spline::synchronous(tolerance), tolerance))
            }
        }
    }

    /// What all channels of a stretch share, coded: `sync`'s key times; empty for every other kind.
    ///
    /// # Errors
    /// `InvalidArgument` when a present sample is not finite, when the channels differ in rows, or
    /// when a run is too long for the exhaustive variant.
    pub fn plan(&self, channels: &[Rows<'_>]) -> Result<Vec<u8>, CodecError> {
        match self.kind {
            ResamplerKind::Sync(variant) => spline::plan(channels, self.tolerance, variant),
            _ => Ok(Vec::new()),
        }
    }

    /// Most bytes that `encode` can append for a block of so many channels, up to
    /// [`GROUP_CHANNELS`](crate::GROUP_CHANNELS), and of as many rows as memory can hold of each.
    #[must_use]
    pub fn max_block_bytes(&self, n_channels: usize, n_rows: usize) -> usize {
        let most = match self.kind {
            ResamplerKind::Spline(_) | ResamplerKind::Sync(_) => frame::max_block_bytes::<Spline>,
            ResamplerKind::Dense => frame::max_block_bytes::<Dense>,
            ResamplerKind::Fast => frame::max_block_bytes::<Fast>,
            ResamplerKind::Lossless => frame::max_block_bytes::<Lossless>,
        };
        most(n_channels, n_rows)
    }
}
