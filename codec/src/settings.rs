//! The choice of a resampler and its tolerance, and the encoders and decoders they give.

use std::{fmt, str::FromStr};

use crate::{
    BlockDecoder, BlockEncoder, CodecError, Rows, SplineVariant, Tolerance,
    dense::{Dense, Effort, PlanningEncoder},
    fast::Fast,
    frame::{self, FramedDecoder, FramedEncoder, PayloadDecoder, PayloadEncoder},
    lossless::Lossless,
    sampled::Predictive,
    spline::{self, Spline},
};

/// The resamplers. [`Display`](fmt::Display) writes and [`FromStr`] parses the name that a container of
/// blocks stores: `dense`, `fast`, `lossless`, `spline:worst-sample`...
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum ResamplerKind {
    /// The smallest blocks: adaptive sampling, quantised inside the tolerance, coded with adaptive contexts.
    #[default]
    Dense,
    /// The fastest: adaptive sampling with fixed code tables.
    Fast,
    /// Bit-exact float32, as packed differences: fast enough for any recording.
    Lossless,
    /// Bit-exact float32 in fewer bytes, predicted across time and markers: for imports.
    LosslessPredictive,
    /// Asynchronous greedy cubic-spline knots (Shi et al. 2012). Offline only.
    Spline(SplineVariant),
    /// Synchronous sampling (Shi et al. 2012): one set of key times for all channels. Offline only.
    Sync(SplineVariant),
}

impl ResamplerKind {
    /// Whether it can encode stretch by stretch while samples arrive.
    #[must_use]
    pub fn is_live(self) -> bool {
        !matches!(self, Self::Spline(_) | Self::Sync(_))
    }

    /// Whether it is bit-exact, so that the tolerance has no meaning.
    #[must_use]
    pub fn is_lossless(self) -> bool {
        matches!(self, Self::Lossless | Self::LosslessPredictive)
    }
}

impl fmt::Display for ResamplerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Dense => "dense",
            Self::Fast => "fast",
            Self::Lossless => "lossless",
            Self::LosslessPredictive => "lossless:predictive",
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
            "lossless:predictive" => Self::LosslessPredictive,
            "spline" | "spline:worst-sample" => Self::Spline(SplineVariant::WorstSample),
            "spline:exhaustive" => Self::Spline(SplineVariant::Exhaustive),
            "sync" | "sync:worst-sample" => Self::Sync(SplineVariant::WorstSample),
            "sync:exhaustive" => Self::Sync(SplineVariant::Exhaustive),
            _ => {
                return Err(CodecError::InvalidArgument(format!(
                    "unknown resampler '{name}': use dense, fast, lossless[:predictive], \
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
    /// The resampler.
    pub kind: ResamplerKind,
    /// The largest error allowed. `lossless` ignores it.
    pub tolerance: Tolerance,
}

impl Settings {
    /// A new encoder for one group of channels; create one per group at start. It may move to another
    /// thread between two blocks.
    ///
    /// A new encoder is in the state after an empty key block, and so is a new decoder.
    #[must_use]
    pub fn encoder(&self) -> Box<dyn BlockEncoder> {
        match self.kind {
            ResamplerKind::Dense => self.framed(Dense::new),
            ResamplerKind::Fast => self.framed(Fast::new),
            ResamplerKind::Lossless => self.framed(|_| Lossless::default()),
            ResamplerKind::LosslessPredictive => self.framed(|_| Predictive::new()),
            ResamplerKind::Spline(variant) => {
                self.framed(|tolerance| Spline::asynchronous(tolerance, variant))
            }
            ResamplerKind::Sync(_) => self.framed(Spline::synchronous),
        }
    }

    /// An encoder like [`encoder`](Self::encoder) that takes more time to make the blocks of `dense` smaller. It is for
    /// whole takes: it allocates while it encodes. Decoders do not know the effort.
    #[must_use]
    pub fn encoder_with(&self, effort: Effort) -> Box<dyn BlockEncoder> {
        match self.kind {
            ResamplerKind::Dense if effort > Effort::MIN => {
                self.framed(|tolerance| PlanningEncoder::new(tolerance, effort))
            }
            _ => self.encoder(),
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
            ResamplerKind::LosslessPredictive => {
                Box::new(FramedDecoder::new(Predictive::new(), tolerance))
            }
            ResamplerKind::Spline(variant) => {
                Box::new(FramedDecoder::new(Spline::asynchronous(tolerance, variant), tolerance))
            }
            ResamplerKind::Sync(_) => {
                Box::new(FramedDecoder::new(Spline::synchronous(tolerance), tolerance))
            }
        }
    }

    /// The bytes that all channels of a stretch share: the key times of `sync`; empty for every other kind.
    ///
    /// # Errors
    /// `InvalidArgument` when a present sample is not finite, when the channels differ in their number of
    /// rows, or when a run is too long for the exhaustive variant.
    pub fn plan(&self, channels: &[Rows<'_>]) -> Result<Vec<u8>, CodecError> {
        match self.kind {
            ResamplerKind::Sync(variant) => spline::plan(channels, self.tolerance, variant),
            _ => Ok(Vec::new()),
        }
    }

    /// The most bytes that `encode` can append for a block of `n_channels` channels, up to
    /// [`GROUP_CHANNELS`](crate::GROUP_CHANNELS), of `n_rows` rows each.
    #[must_use]
    pub fn max_block_bytes(&self, n_channels: usize, n_rows: usize) -> usize {
        let most = match self.kind {
            ResamplerKind::Spline(_) | ResamplerKind::Sync(_) => frame::max_block_bytes::<Spline>,
            ResamplerKind::Dense => frame::max_block_bytes::<Dense>,
            ResamplerKind::Fast => frame::max_block_bytes::<Fast>,
            ResamplerKind::Lossless => frame::max_block_bytes::<Lossless>,
            ResamplerKind::LosslessPredictive => frame::max_block_bytes::<Predictive>,
        };
        most(n_channels, n_rows)
    }
}
