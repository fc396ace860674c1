//! What is studied, and how.

use mocapd_codec::{ResamplerKind, Settings, SplineVariant};
use mocapd_take::motion::Motion;

use crate::phases::Part;

/// A resampler, and the reading of the published method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Method {
    /// The published method; step 2 inserts the sample that is off the most.
    WorstSample,
    /// The published method; step 2 tries every sample.
    Exhaustive,
    /// Its synchronous rival, from the first reading's knots.
    Sync,
    /// The default.
    Dense,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::WorstSample, Self::Exhaustive, Self::Sync, Self::Dense];

    /// The resampler behind it.
    #[must_use]
    pub fn kind(self) -> ResamplerKind {
        match self {
            Self::WorstSample => ResamplerKind::Spline(SplineVariant::WorstSample),
            Self::Exhaustive => ResamplerKind::Spline(SplineVariant::Exhaustive),
            Self::Sync => ResamplerKind::Sync(SplineVariant::WorstSample),
            Self::Dense => ResamplerKind::Dense,
        }
    }

    /// As `--resampler` takes it.
    #[must_use]
    pub fn name(self) -> String {
        self.kind().to_string()
    }
}

/// One trial.
#[derive(Debug, Clone)]
pub struct Trial {
    /// Its file's name.
    pub name: String,
    /// Its samples.
    pub motion: Motion,
    /// Its phases, or why there are none: it is then studied as a whole only.
    pub phases: Result<Vec<Part>, String>,
}

/// What is measured.
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
    /// The paper's.
    fn default() -> Self {
        Self {
            tolerances_mm: super::paper::TOLERANCES_MM.to_vec(),
            prefix_tolerances_mm: super::paper::PREFIX_TOLERANCES_MM.to_vec(),
            prefixes: super::paper::PREFIXES.to_vec(),
            cutoff_hz: crate::derivative::CUTOFF_HZ,
        }
    }
}

/// Makes takes in memory: every byte that a take of these samples would have on disk.
pub trait Coder {
    /// Codes `motion` as `settings` say.
    ///
    /// # Errors
    /// Why it cannot be, in words.
    fn take(&self, motion: &Motion, settings: &Settings) -> Result<Vec<u8>, String>;
}
