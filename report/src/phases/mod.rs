//! The phases of a jump, as defined by (Shi et al. 2012): detected from the pelvis and the feet, or read from a file.

mod find;

use std::collections::BTreeMap;

use mocapd_take::escape::from_cell;

use crate::ReportError;

pub use self::find::{NoJump, find};

pub use mocapd_take::phase::Phase;

/// A phase and its range of frames in a trial.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PhaseSpan {
    /// The phase.
    pub phase: Phase,
    /// Its frames, from 0.
    pub frames: std::ops::Range<usize>,
}

/// The frame ranges of phases from their first frames, in order; the last one ends with the take. Empty ones are left
/// out.
#[must_use]
pub fn parts(starts: &[(Phase, usize)], n_frames: usize) -> Vec<PhaseSpan> {
    let ends = starts.iter().skip(1).map(|start| start.1).chain([n_frames]);
    let frames = |from: usize, to: usize| from.min(n_frames)..to.min(n_frames);
    let parts = starts.iter().zip(ends);
    let parts = parts.map(|(&(phase, from), to)| PhaseSpan { phase, frames: frames(from, to) });
    parts.filter(|part| !part.frames.is_empty()).collect()
}

/// The first line of a file of phases.
const HEADER: &str = "file,phase,first_frame";

/// Parses a file of phases: for each file name (without folder) its phases and their first frames, from 0. Empty lines
/// and lines that begin with `#` are ignored.
///
/// # Errors
/// `InvalidArgument` with the number of the malformed line, and what was expected.
pub fn parse(text: &str) -> Result<BTreeMap<String, Vec<(Phase, usize)>>, ReportError> {
    let lines = text.lines().zip(1..).map(|(line, number)| (line.trim(), number));
    let mut lines = lines.filter(|(line, _)| !line.is_empty() && !line.starts_with('#'));
    let bad =
        |number: u32, what: String| ReportError::InvalidArgument(format!("line {number}: {what}"));
    match lines.next() {
        Some((HEADER, _)) => {}
        Some((line, number)) => {
            return Err(bad(number, format!("expected '{HEADER}', found '{line}'")));
        }
        None => return Err(bad(1, format!("expected '{HEADER}', found nothing"))),
    }
    let mut found: BTreeMap<String, Vec<(Phase, usize)>> = BTreeMap::new();
    for (line, number) in lines {
        // File names may contain commas; the two columns after them cannot.
        let mut cells = line.rsplitn(3, ',').map(str::trim);
        let (frame, phase, file) = (cells.next(), cells.next(), cells.next());
        let (Some(frame), Some(phase), Some(file)) = (frame, phase, file) else {
            let what = format!("expected a file, a phase and a frame, found '{line}'");
            return Err(bad(number, what));
        };
        let names = || Phase::ALL.map(Phase::name).join(", ");
        let phase = Phase::from_name(phase)
            .ok_or_else(|| bad(number, format!("unknown phase '{phase}': use {}", names())))?;
        let frame = frame
            .parse()
            .map_err(|_| bad(number, format!("expected a frame number from 0, found '{frame}'")))?;
        let phases = found.entry(from_cell(file).into_owned()).or_default();
        if phases.last().is_some_and(|&(_, before)| before >= frame) {
            let what = format!("the phases of {file} are not in ascending order of frames");
            return Err(bad(number, what));
        }
        phases.push((phase, frame));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_and_their_phases() {
        let text = "# by hand\nfile,phase,first_frame\na.c3d,swings,10\na.c3d,last swing,40\n\nb, c.csv,walking,0\n";
        let found = parse(text).unwrap();
        assert_eq!(found["a.c3d"], [(Phase::Swings, 10), (Phase::LastSwing, 40)]);
        assert_eq!(found["b, c.csv"], [(Phase::Walking, 0)]);
    }

    #[test]
    fn malformed_lines_are_reported_with_their_numbers() {
        let head = "file,phase,first_frame\n";
        for (text, line, fact) in [
            ("", 1, "file,phase,first_frame"),
            ("a,b\n", 1, "file,phase,first_frame"),
            (&format!("{head}a.c3d,10\n"), 2, ""),
            (&format!("{head}a.c3d,dive,10\n"), 2, "standing, swings"),
            (&format!("{head}a.c3d,swings,-1\n"), 2, "'-1'"),
            (&format!("{head}a.c3d,swings,9\na.c3d,take-off,9\n"), 3, ""),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(&format!("line {line}")), "{text}: {error}");
            assert!(error.contains(fact), "{text}: {error}");
        }
    }
}
