//! The inputs of the study: trials, methods, tolerances, and the coder.

use mocapd_codec::{ResamplerKind, Settings, SplineVariant};
use mocapd_take::motion::Motion;

use crate::phases::PhaseSpan;

/// A resampler, and for the published method the reading of its step 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Method {
    /// The published method; step 2 inserts the sample with the largest error.
    WorstSample,
    /// The published method; step 2 tries every sample.
    Exhaustive,
    /// Synchronous resampling, at the union of the knots of [`WorstSample`](Self::WorstSample).
    Sync,
    /// mocapd's default resampler.
    Dense,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 4] = [Self::WorstSample, Self::Exhaustive, Self::Sync, Self::Dense];

    /// The resampler of this method.
    #[must_use]
    pub fn kind(self) -> ResamplerKind {
        match self {
            Self::WorstSample => ResamplerKind::Spline(SplineVariant::WorstSample),
            Self::Exhaustive => ResamplerKind::Spline(SplineVariant::Exhaustive),
            Self::Sync => ResamplerKind::Sync(SplineVariant::WorstSample),
            Self::Dense => ResamplerKind::Dense,
        }
    }

    /// The name, as for `--resampler`.
    #[must_use]
    pub fn name(self) -> String {
        self.kind().to_string()
    }
}

/// A trial to study.
#[derive(Debug, Clone)]
pub struct Trial {
    /// Name of its file.
    pub name: String,
    /// Its motion.
    pub motion: Motion,
    /// Its phases, or why there are none; it is then studied only as a whole.
    pub phases: Result<Vec<PhaseSpan>, String>,
}

/// The parameters of the study.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Tolerances (`ErrLim`) of table 1, mm, ascending.
    pub tolerances_mm: Vec<f64>,
    /// Tolerances of table 2, mm.
    pub prefix_tolerances_mm: Vec<f64>,
    /// Lengths of table 2, frames.
    pub prefixes: Vec<usize>,
    /// Cutoff before derivatives, Hz.
    pub cutoff_hz: f64,
}

impl Default for Options {
    /// The parameters of the paper.
    fn default() -> Self {
        Self {
            tolerances_mm: super::paper::TOLERANCES_MM.to_vec(),
            prefix_tolerances_mm: super::paper::PREFIX_TOLERANCES_MM.to_vec(),
            prefixes: super::paper::PREFIXES.to_vec(),
            cutoff_hz: crate::derivative::CUTOFF_HZ,
        }
    }
}

/// Codes takes in memory, byte for byte as on disk.
pub trait Coder {
    /// The bytes of a take of `motion` coded with `settings`.
    ///
    /// # Errors
    /// A message if it cannot be coded.
    fn take(&self, motion: &Motion, settings: &Settings) -> Result<Vec<u8>, String>;
}
