//! The study of (Shi et al. 2012) again, on takes that are given: their two tables, what their measures leave
//! out, both readings of their second step, and the default resampler beside them.

mod measure;
mod options;
pub mod paper;
pub mod tables;

use crate::{derivative::DerivativeError, measures::Counts, phases::Phase};

pub use self::{
    measure::{EXHAUSTIVE_FRAMES_MAX, measure, work},
    options::{Coder, Method, Options, Trial},
};

/// Bytes of a sample as raw float32.
const RAW_SAMPLE_BYTES: u64 = 12;

/// A stretch of a trial that is looked at on its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Piece {
    /// A phase, cut out and resampled on its own: table 1.
    Phase(Phase),
    /// A phase inside the trial: what the whole trial's resampling keeps in it.
    Within(Phase),
    /// The trial.
    Whole,
    /// So many frames from its first on: table 2.
    First(usize),
}

impl Piece {
    /// As tables say it.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Phase(phase) => phase.name().to_owned(),
            Self::Within(phase) => format!("{} inside the trial", phase.name()),
            Self::Whole => "whole".to_owned(),
            Self::First(frames) => format!("first {frames}"),
        }
    }
}

/// One piece of one trial, with one method at one tolerance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Which part of the trial.
    pub piece: Piece,
    /// How.
    pub method: Method,
    /// At which tolerance, mm.
    pub tolerance_mm: f64,
    /// What the paper's measures are made of.
    pub counts: Counts,
    /// The take of it, everything included; 0 where it was not coded on its own.
    pub file_bytes: u64,
    /// The largest distance of a sample, measured, mm.
    pub max_error_mm: f64,
}

/// One trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Results {
    /// Its file's name.
    pub name: String,
    /// Frames a second.
    pub rate_hz: f64,
    /// Its frames.
    pub frames: u64,
    /// Its markers.
    pub markers: u64,
    /// Its phases and their numbers of frames, or why there are none.
    pub phases: Result<Vec<(Phase, usize)>, String>,
    /// Everything measured.
    pub cells: Vec<Cell>,
    /// By method and tolerance (mm), each marker's errors of derivatives over the whole trial.
    pub derivatives: Vec<(Method, f64, Vec<DerivativeError>)>,
}

impl Results {
    pub(super) fn new(trial: &Trial) -> Self {
        let info = &trial.motion.info;
        let lengths = |parts: &Vec<crate::phases::Part>| {
            parts.iter().map(|part| (part.phase, part.frames.len())).collect()
        };
        Self {
            name: trial.name.clone(),
            rate_hz: info.rate_hz,
            frames: trial.motion.n_frames() as u64,
            markers: info.markers.len() as u64,
            phases: trial.phases.as_ref().map(lengths).map_err(Clone::clone),
            cells: Vec::new(),
            derivatives: Vec::new(),
        }
    }

    pub(super) fn add(&mut self, cell: Cell) {
        self.cells.push(cell);
    }
}

/// Pieces of several trials together: items and bytes are added up before anything is divided.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sum {
    /// Pieces.
    pub n: u64,
    /// Of which asynchronous resampling needs fewer items than synchronous (10).
    pub wins: u64,
    /// Of all.
    pub counts: Counts,
    /// Of all takes.
    pub file_bytes: u64,
    /// The largest of all, mm.
    pub max_error_mm: f64,
}

impl Sum {
    fn add(&mut self, cell: &Cell) {
        self.n += 1;
        self.wins += u64::from(cell.counts.asynchronous_wins());
        self.counts += cell.counts;
        self.file_bytes += cell.file_bytes;
        self.max_error_mm = self.max_error_mm.max(cell.max_error_mm);
    }

    /// Raw float32 bytes to bytes on disk, everything included.
    #[must_use]
    pub fn ratio(&self) -> Option<f64> {
        crate::measures::ratio(RAW_SAMPLE_BYTES * self.counts.samples, self.file_bytes)
    }
}

/// All trials.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Findings {
    /// Tolerances of table 1, mm.
    pub tolerances_mm: Vec<f64>,
    /// Tolerances and lengths of table 2.
    pub prefix_tolerances_mm: Vec<f64>,
    /// In frames.
    pub prefixes: Vec<usize>,
    /// Before derivatives, Hz.
    pub cutoff_hz: f64,
    /// In the order in which they were given.
    pub trials: Vec<Results>,
}

impl Findings {
    /// The sum over all trials that have such a piece; `None` where there is none.
    #[must_use]
    pub fn sum(&self, piece: Piece, method: Method, tolerance_mm: f64) -> Option<Sum> {
        self.sum_of(piece, method, tolerance_mm, |_| true)
    }

    /// The same of the trials with such a piece that the exhaustive search was tried on.
    #[must_use]
    pub fn sum_of_compared(&self, piece: Piece, method: Method, tolerance_mm: f64) -> Option<Sum> {
        let compared = |trial: &Results| {
            let mut cells = trial.cells.iter();
            cells.any(|cell| (cell.piece, cell.method) == (piece, Method::Exhaustive))
        };
        self.sum_of(piece, method, tolerance_mm, compared)
    }

    fn sum_of(
        &self,
        piece: Piece,
        method: Method,
        tolerance_mm: f64,
        wanted: impl Fn(&Results) -> bool,
    ) -> Option<Sum> {
        let mut sum = Sum::default();
        for cell in self.trials.iter().filter(|trial| wanted(trial)).flat_map(|trial| &trial.cells)
        {
            if (cell.piece, cell.method) == (piece, method) && cell.tolerance_mm == tolerance_mm {
                sum.add(cell);
            }
        }
        (sum.n > 0).then_some(sum)
    }

    /// Errors of derivatives over all trials and markers.
    #[must_use]
    pub fn derivatives(&self, method: Method, tolerance_mm: f64) -> Option<DerivativeError> {
        let mut sum = DerivativeError::default();
        let found = self.trials.iter().flat_map(|trial| &trial.derivatives);
        found
            .filter(|(by, at, _)| *by == method && *at == tolerance_mm)
            .flat_map(|(_, _, markers)| markers)
            .for_each(|marker| sum.add_all(marker));
        (sum.velocity_mm_s.n() > 0).then_some(sum)
    }
}
