//! Measurement of one trial: every piece of it, with every method, at every tolerance.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use mocapd_codec::{Settings, Tolerance};
use mocapd_take::motion::Motion;

use super::{Cell, Coder, Method, Options, Piece, Results, Trial};
use crate::{ReportError, decoded::DecodedTake, derivative, measures::Counts};

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
