//! The study of Shi et al. (2012), repeated on given takes: their two tables, the size on disk that their measures
//! leave out, both readings of their second step, and the default resampler for comparison.

pub mod tables;

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use mocapd_codec::{ResamplerKind, Settings, SplineVariant, Tolerance};
use mocapd_take::motion::Motion;

use crate::{
    ReportError,
    decoded::{Counts, DecodedTake},
    derivative::{self, DerivativeError},
    phases::{Phase, PhaseSpan},
};

/// Size of a sample as raw float32, bytes.
const RAW_SAMPLE_BYTES: u64 = 12;

/// A piece of a trial that has its own results.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Piece {
    /// A phase, cut out and resampled on its own: table 1.
    Phase(Phase),
    /// A phase within the resampling of the whole trial.
    Within(Phase),
    /// The whole trial.
    Whole,
    /// The first frames of the trial, by number: table 2.
    First(usize),
}

impl Piece {
    /// The name in tables.
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

/// The results of one piece of one trial, with one method at one tolerance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// The piece of the trial.
    pub piece: Piece,
    /// The method.
    pub method: Method,
    /// The tolerance, mm.
    pub tolerance_mm: f64,
    /// The counts for the paper's measures.
    pub counts: Counts,
    /// Size of its take, bytes; 0 if the piece was not coded on its own.
    pub file_bytes: u64,
    /// The largest measured error of a sample, mm.
    pub max_error_mm: f64,
}

/// The results of one trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Results {
    /// Name of its file.
    pub name: String,
    /// Frame rate, Hz.
    pub rate_hz: f64,
    /// Number of frames.
    pub frames: u64,
    /// Number of markers.
    pub markers: u64,
    /// Its phases and their numbers of frames, or why there are none.
    pub phases: Result<Vec<(Phase, usize)>, String>,
    /// The results by piece, method and tolerance.
    pub cells: Vec<Cell>,
    /// The derivative errors of each marker over the whole trial, by method and tolerance (mm).
    pub derivatives: Vec<(Method, f64, Vec<DerivativeError>)>,
}

impl Results {
    pub(super) fn new(trial: &Trial) -> Self {
        let info = &trial.motion.info;
        let lengths = |parts: &Vec<PhaseSpan>| {
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

/// The results of several pieces together: items and bytes are summed before ratios are taken.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sum {
    /// Number of pieces.
    pub n: u64,
    /// Number of pieces for which asynchronous resampling needs fewer items than synchronous resampling (equation 10).
    pub wins: u64,
    /// The summed counts.
    pub counts: Counts,
    /// The summed sizes of the takes, bytes.
    pub file_bytes: u64,
    /// The largest error of all, mm.
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

    /// The ratio of raw float32 bytes to bytes on disk; `None` if the pieces were not coded on their own.
    #[must_use]
    pub fn ratio(&self) -> Option<f64> {
        super::decoded::ratio(RAW_SAMPLE_BYTES * self.counts.samples, self.file_bytes)
    }
}

/// The results of all trials.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Findings {
    /// Tolerances of table 1, mm.
    pub tolerances_mm: Vec<f64>,
    /// Tolerances of table 2, mm.
    pub prefix_tolerances_mm: Vec<f64>,
    /// Lengths of table 2, frames.
    pub prefixes: Vec<usize>,
    /// Cutoff of the low-pass before derivatives, Hz.
    pub cutoff_hz: f64,
    /// The trials, in the given order.
    pub trials: Vec<Results>,
}

impl Findings {
    /// The sum over all trials that have this piece; `None` if none has it.
    #[must_use]
    pub fn sum(&self, piece: Piece, method: Method, tolerance_mm: f64) -> Option<Sum> {
        self.sum_of(piece, method, tolerance_mm, |_| true)
    }

    /// The sum over those trials whose piece was also coded with the exhaustive search.
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
        filter: impl Fn(&Results) -> bool,
    ) -> Option<Sum> {
        let mut sum = Sum::default();
        for cell in self.trials.iter().filter(|trial| filter(trial)).flat_map(|trial| &trial.cells)
        {
            if (cell.piece, cell.method) == (piece, method) && cell.tolerance_mm == tolerance_mm {
                sum.add(cell);
            }
        }
        (sum.n > 0).then_some(sum)
    }

    /// The derivative errors over all trials and markers; `None` if there are none.
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
            tolerances_mm: TOLERANCES_MM.to_vec(),
            prefix_tolerances_mm: PREFIX_TOLERANCES_MM.to_vec(),
            prefixes: PREFIXES.to_vec(),
            cutoff_hz: derivative::CUTOFF_HZ,
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

/// Longest piece for the exhaustive search, frames. Its work grows with the third power of them: half a second per
/// channel and tolerance, half a minute per trial.
pub const EXHAUSTIVE_FRAMES_MAX: usize = 256;

/// A piece to measure, its frames, and the methods and tolerances (mm) to measure it with.
type Task = (Piece, Range<usize>, Vec<Method>, Vec<f64>);

/// The final value of the progress of [`measure`]: samples times settings.
#[must_use]
pub fn work(trial: &Trial, options: &Options, with_exhaustive: bool) -> u64 {
    let n_markers = trial.motion.info.markers.len();
    let tasks = tasks(trial, options, with_exhaustive);
    let samples = tasks.iter().map(|(_, frames, methods, tolerances)| {
        (frames.len() * n_markers * methods.len() * tolerances.len()) as u64
    });
    samples.sum()
}

/// Codes all pieces of a trial with all methods and tolerances; `progress` counts samples. With `with_exhaustive` the
/// exhaustive search is tried on pieces up to [`EXHAUSTIVE_FRAMES_MAX`].
///
/// # Errors
/// If the coder fails, or a take that it made does not match its input.
pub fn measure(
    trial: &Trial,
    options: &Options,
    with_exhaustive: bool,
    coder: &dyn Coder,
    progress: &AtomicU64,
) -> Result<Results, ReportError> {
    let mut results = Results::new(trial);
    for (piece, frames, methods, tolerances) in tasks(trial, options, with_exhaustive) {
        let motion = part(&trial.motion, frames);
        for &tolerance_mm in &tolerances {
            for &method in &methods {
                let tolerance = Tolerance::from_mm(tolerance_mm)
                    .map_err(|error| ReportError::InvalidArgument(error.to_string()))?;
                let settings = Settings { kind: method.kind(), tolerance };
                let bytes = coder.take(&motion, &settings).map_err(ReportError::Coder)?;
                let decoded = DecodedTake::read(&bytes[..])?;
                check(&decoded, &motion, tolerance_mm)?;
                let (counts, file_bytes) = (decoded.counts(), bytes.len() as u64);
                let max_error_mm = decoded.max_error_mm(&motion);
                results.add(Cell { piece, method, tolerance_mm, counts, file_bytes, max_error_mm });
                if piece == Piece::Whole {
                    whole(trial, method, tolerance_mm, &decoded, options, &mut results)?;
                }
                progress.fetch_add(motion.positions_mm.len() as u64, Ordering::Relaxed);
            }
        }
    }
    Ok(results)
}

fn tasks(trial: &Trial, options: &Options, with_exhaustive: bool) -> Vec<Task> {
    let n_frames = trial.motion.n_frames();
    let methods = |n_frames: usize| {
        let mut methods = vec![Method::WorstSample, Method::Sync, Method::Dense];
        if with_exhaustive && n_frames <= EXHAUSTIVE_FRAMES_MAX {
            methods.push(Method::Exhaustive);
        }
        methods
    };
    let tolerances = &options.tolerances_mm;
    let mut tasks: Vec<Task> = Vec::new();
    for part in trial.phases.iter().flatten() {
        let piece = Piece::Phase(part.phase);
        tasks.push((piece, part.frames.clone(), methods(part.frames.len()), tolerances.clone()));
    }
    tasks.push((Piece::Whole, 0..n_frames, methods(n_frames), tolerances.clone()));
    for &length in options.prefixes.iter().filter(|&&length| length <= n_frames) {
        let methods = vec![Method::WorstSample, Method::Dense];
        let tolerances = options.prefix_tolerances_mm.clone();
        tasks.push((Piece::First(length), 0..length, methods, tolerances));
    }
    tasks
}

/// The trajectories of these frames, without foreign data.
fn part(motion: &Motion, frames: Range<usize>) -> Motion {
    let mut info = motion.info.clone();
    info.foreign.clear();
    info.n_frames = frames.len() as u64;
    let n_markers = info.markers.len();
    let positions = frames.start * n_markers..frames.end * n_markers;
    let positions_mm = motion.positions_mm.get(positions).unwrap_or_default().to_vec();
    Motion { info, positions_mm }
}

/// Checks a decoded take against its input: no problem, all samples, all errors within the tolerance.
fn check(decoded: &DecodedTake, motion: &Motion, tolerance_mm: f64) -> Result<(), ReportError> {
    let n_samples = |motion: &Motion| {
        motion.positions_mm.iter().filter(|&&at| !mocapd_take::motion::is_gap(at)).count()
    };
    let (found, expected) = (n_samples(&decoded.motion), n_samples(motion));
    let error_mm = decoded.max_error_mm(motion);
    if let Some(problem) = decoded.problems.first() {
        return Err(ReportError::Coder(problem.to_string()));
    }
    if found != expected || error_mm > tolerance_mm {
        return Err(ReportError::Coder(format!(
            "{found} of {expected} samples decoded, max error {error_mm} mm: please report this bug"
        )));
    }
    Ok(())
}

/// Adds the results that only whole trials have: samples kept by phase, and derivatives.
fn whole(
    trial: &Trial,
    method: Method,
    tolerance_mm: f64,
    decoded: &DecodedTake,
    options: &Options,
    results: &mut Results,
) -> Result<(), ReportError> {
    if method == Method::WorstSample {
        for part in trial.phases.iter().flatten() {
            let counts = counts_within(decoded, part.frames.clone());
            let piece = Piece::Within(part.phase);
            let (file_bytes, max_error_mm) = (0, 0.0);
            results.add(Cell { piece, method, tolerance_mm, counts, file_bytes, max_error_mm });
        }
    }
    if matches!(method, Method::WorstSample | Method::Dense)
        && options.cutoff_hz < 0.5 * trial.motion.info.rate_hz
    {
        let found = derivative::by_marker(&decoded.motion, &trial.motion, options.cutoff_hz)?;
        results.derivatives.push((method, tolerance_mm, found));
    }
    Ok(())
}

/// The counts of a range of frames of a decoded take.
fn counts_within(decoded: &DecodedTake, frames: Range<usize>) -> Counts {
    let cut = |kept: &Vec<bool>| kept.get(frames.clone()).unwrap_or_default().to_vec();
    let part = DecodedTake {
        motion: part(&decoded.motion, frames.clone()),
        kept: decoded.kept.iter().map(cut).collect(),
        settings: decoded.settings,
        problems: Vec::new(),
    };
    part.counts()
}

/// Tolerances (`ErrLim`) of table 1, mm.
pub const TOLERANCES_MM: [f64; 5] = [1.0, 5.0, 10.0, 15.0, 20.0];

/// Columns of table 1.
pub const COLUMNS: [Piece; 7] = [
    Piece::Phase(Phase::Swings),
    Piece::Phase(Phase::LastSwing),
    Piece::Phase(Phase::TakeOff),
    Piece::Phase(Phase::Flight),
    Piece::Phase(Phase::Settling),
    Piece::Phase(Phase::Walking),
    Piece::Whole,
];

/// Table 1: SR2 by `ErrLim` and phase.
const TABLE_1: [[f64; 7]; 5] = [
    [3.94, 4.34, 2.01, 2.85, 4.71, 5.12, 4.70],
    [5.08, 5.94, 2.64, 3.97, 7.21, 7.85, 6.94],
    [5.47, 6.83, 3.04, 4.73, 8.86, 9.53, 8.07],
    [5.79, 7.39, 3.16, 5.15, 10.4, 11.56, 8.76],
    [6.15, 7.88, 3.16, 5.31, 11.1, 13.24, 9.45],
];

/// Tolerances (`ErrLim`) of table 2, mm.
pub const PREFIX_TOLERANCES_MM: [f64; 2] = [10.0, 20.0];

/// Lengths of table 2, frames from the beginning.
pub const PREFIXES: [usize; 12] = [50, 100, 150, 200, 250, 300, 350, 400, 450, 500, 550, 600];

/// Table 2: SR2 by `ErrLim` and length.
const TABLE_2: [[f64; 12]; 2] = [
    [12.8, 16.0, 10.4, 10.5, 12.7, 11.3, 4.6, 6.3, 5.7, 8.5, 11.0, 8.0],
    [12.8, 18.6, 17.3, 13.1, 16.0, 14.0, 5.0, 7.1, 6.3, 10.1, 13.2, 9.4],
];

/// The SR2 that the paper prints for a piece at a tolerance; `None` if it has none.
#[must_use]
pub fn sr2(piece: Piece, tolerance_mm: f64) -> Option<f64> {
    let row = |tolerances: &[f64]| tolerances.iter().position(|&mm| mm == tolerance_mm);
    match piece {
        Piece::First(frames) => {
            let column = PREFIXES.iter().position(|&length| length == frames)?;
            Some(TABLE_2[row(&PREFIX_TOLERANCES_MM)?][column])
        }
        piece => {
            let column = COLUMNS.iter().position(|&column| column == piece)?;
            Some(TABLE_1[row(&TOLERANCES_MM)?][column])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_of_both_tables() {
        assert_eq!(sr2(Piece::Phase(Phase::TakeOff), 1.0), Some(2.01));
        assert_eq!(sr2(Piece::Whole, 20.0), Some(9.45));
        assert_eq!(sr2(Piece::First(350), 10.0), Some(4.6));
        assert_eq!(sr2(Piece::First(350), 1.0), None);
        assert_eq!(sr2(Piece::Phase(Phase::Standing), 1.0), None);
        assert_eq!(sr2(Piece::Whole, 2.0), None);
    }
}
