//! The phases of a jump, as defined by (Shi et al. 2012): detected from the pelvis and the feet, whose markers are
//! found by their labels, or read from a file.

use std::collections::BTreeMap;

use mocapd_take::{
    escape::from_cell,
    motion::{Motion, UpAxis},
};

use crate::{
    ReportError,
    column::{Column, Vector, norm},
    derivative::{Butterworth, by_axis},
    labels::{SubjectMarkers, subjects},
};
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

/// Cutoff of the low-pass before the search, Hz: a take-off lasts 0.3 s, and its end must be found within two frames.
const CUTOFF_HZ: f64 = 10.0;

/// Slowest vertical take-off velocity of a jump, mm/s: a rise of 5 cm. Walking stays below 400.
const TAKE_OFF_MM_S: f64 = 1000.0;

/// Plausible flight times, s: from a hop to more than a human can jump.
const FLIGHT_S: std::ops::RangeInclusive<f64> = 0.1..=1.2;

/// Standard gravity, mm/s^2; in flight the pelvis, near the centre of mass, has about this acceleration.
const GRAVITY_MM_S2: f64 = 9806.65;

/// Minimum height of both feet above the ground at some time of the flight, mm.
const FEET_ABOVE_GROUND_MM: f64 = 40.0;

/// Speed of the fastest marker above which the subject no longer stands still, before the jump, mm/s.
const MOVES_MM_S: f64 = 250.0;
/// Horizontal speed of pelvis or feet above which the subject walks, after the jump, mm/s.
const WALKS_MM_S: f64 = 200.0;

/// How long these speeds must be sustained, s.
const SUSTAINED_S: f64 = 0.15;

/// Why no phases were found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoJump {
    /// A required marker is missing; the text lists the labels that it may have.
    #[error("{0}")]
    NoMarker(String),
    /// The frame rate, in Hz, is too low for the filter.
    #[error("a rate of {0} Hz is too low to detect a jump")]
    TooSlow(f64),
    /// The pelvis or a foot has no sample in the take.
    #[error("{0} has no samples")]
    NeverSeen(&'static str),
    /// Neither the take nor the motion shows which axis is up.
    #[error("the up axis is unknown")]
    UpUnknown,
    /// No flight was found.
    #[error("no jump found: the pelvis is never in free fall")]
    NeverInFlight,
}

/// Heights (mm), speeds (mm/s) and accelerations (mm/s^2) of a take, row by row.
struct Signals {
    rate_hz: f64,
    /// Height of the pelvis, its vertical velocity and acceleration, and its horizontal speed.
    height: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
    pelvis_speed: Vec<f64>,
    /// Height of the lower foot above the ground, and horizontal speed of the faster foot.
    clearance: Vec<f64>,
    foot_speed: Vec<f64>,
    /// Speed of the fastest marker.
    fastest: Vec<f64>,
}

/// Detects the phases: each with its first frame, in order, beginning with frame 0.
///
/// # Errors
/// If a marker is missing, or the take has no jump.
pub fn find(motion: &Motion) -> Result<Vec<(Phase, usize)>, NoJump> {
    let sites = Sites::of(motion).map_err(NoJump::NoMarker)?;
    let signals = Signals::of(motion, &sites)?;
    let mut phases: Vec<(Phase, usize)> = Vec::new();
    let mut from = 0;
    for (leaves, lands) in signals.flights() {
        let first_of_take = phases.is_empty();
        for (phase, frame) in signals.phases_before(from, leaves, first_of_take) {
            push(&mut phases, phase, frame);
        }
        push(&mut phases, Phase::Flight, leaves);
        push(&mut phases, Phase::Settling, lands);
        from = signals.first_step(lands);
        if from < signals.height.len() {
            push(&mut phases, Phase::Walking, from);
        }
    }
    if phases.is_empty() {
        return Err(NoJump::NeverInFlight);
    }
    Ok(phases)
}

/// Appends a phase; it replaces those that begin at the same frame or later, and merges with an equal one.
fn push(phases: &mut Vec<(Phase, usize)>, phase: Phase, frame: usize) {
    while phases.pop_if(|last| last.1 >= frame).is_some() {}
    if phases.last().is_none_or(|last| last.0 != phase) {
        phases.push((phase, frame));
    }
}

impl Signals {
    fn of(motion: &Motion, sites: &Sites) -> Result<Self, NoJump> {
        let rate_hz = motion.info.rate_hz;
        let filter = Butterworth::new(CUTOFF_HZ, rate_hz).map_err(|_| NoJump::TooSlow(rate_hz))?;
        let smooth = |column: &Column| -> Option<Vec<Vector>> {
            Some(by_axis(&column.bridged()?, |values| filter.filter(values)))
        };
        let pelvis = smooth(&sites.pelvis(motion)).ok_or(NoJump::NeverSeen("the pelvis"))?;
        let [left, right] = sites.feet.map(|foot| smooth(&Column::of(motion, foot)));
        let (left, right) = left.zip(right).ok_or(NoJump::NeverSeen("a foot"))?;
        let up = up_axis(motion, &pelvis, &left).ok_or(NoJump::UpUnknown)?;
        let heights = |of: &[Vector]| -> Vec<f64> { of.iter().map(|at| up.1 * at[up.0]).collect() };
        let height = heights(&pelvis);
        let velocity = derivative(&height, rate_hz);
        let acceleration = derivative(&velocity, rate_hz);
        let feet: Vec<Vec<f64>> = [&left, &right].map(|foot| above_ground(heights(foot))).into();
        let sideways = |of: &[Vector]| {
            let mut flat = of.to_vec();
            flat.iter_mut().for_each(|at| at[up.0] = 0.0);
            speed(&flat, rate_hz)
        };
        let larger = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(&b).map(|(a, b)| a.max(*b)).collect();
        let fastest = (0..motion.info.markers.len())
            .filter_map(|marker| smooth(&Column::of(motion, marker)))
            .map(|at| speed(&at, rate_hz))
            .reduce(larger)
            .unwrap_or_default();
        Ok(Self {
            rate_hz,
            pelvis_speed: sideways(&pelvis),
            clearance: feet[0].iter().zip(&feet[1]).map(|(a, b)| a.min(*b)).collect(),
            foot_speed: larger(sideways(&left), sideways(&right)),
            height,
            velocity,
            acceleration,
            fastest,
        })
    }

    /// The first and one past the last row of each flight: after a peak of vertical velocity, while the pelvis
    /// accelerates downwards with more than half of gravity.
    fn flights(&self) -> Vec<(usize, usize)> {
        let n = self.velocity.len();
        let mut flights = Vec::new();
        let mut row = 1;
        while row + 1 < n {
            let v = &self.velocity;
            let is_peak = v[row] >= v[row - 1] && v[row] > v[row + 1];
            if !is_peak || v[row] < TAKE_OFF_MM_S {
                row += 1;
                continue;
            }
            let falls = |row: usize| self.acceleration[row] < -0.5 * GRAVITY_MM_S2;
            let leaves = (row..n).find(|&row| falls(row)).unwrap_or(n);
            // A flight passes its apex; less acceleration before that comes from the body, not from the ground.
            let top = (leaves..n).find(|&row| self.velocity[row] <= 0.0).unwrap_or(n);
            let lands = (top..n).find(|&row| !falls(row)).unwrap_or(n);
            let seconds = (lands - leaves) as f64 / self.rate_hz;
            let feet_mm = self.clearance[leaves.min(n)..lands].iter().copied().fold(0.0, f64::max);
            if lands < n && FLIGHT_S.contains(&seconds) && feet_mm > FEET_ABOVE_GROUND_MM {
                flights.push((leaves, lands));
                row = lands;
            } else {
                row += 1;
            }
        }
        flights
    }

    /// The phases before the flight that begins at `leaves`, from frame `from` on.
    fn phases_before(&self, from: usize, leaves: usize, is_first: bool) -> Vec<(Phase, usize)> {
        // The take-off begins at the lowest point of the crouch, where the pelvis begins to rise.
        let fastest = self.velocity[leaves];
        let take_off = (from..leaves).rev().find(|&row| self.velocity[row] < 0.04 * fastest);
        let take_off = take_off.map_or(from, |row| row + 1);
        // The last swing begins where the pelvis was last near its highest before that crouch.
        let low = self.height[take_off.min(leaves)];
        let before = &self.height[from..take_off];
        let usual = before.iter().copied().fold(low, f64::max);
        let near_top = usual - 0.25 * (usual - low);
        let mut last_swing = (from..take_off).rev().find(|&row| self.height[row] >= near_top);
        // Back from there to the local maximum.
        while let Some(row) =
            last_swing.filter(|&row| row > from && self.height[row - 1] > self.height[row])
        {
            last_swing = Some(row - 1);
        }
        let last_swing = last_swing.unwrap_or(from);
        let swings = if is_first {
            self.sustained(from..last_swing, |row| self.fastest[row] > MOVES_MM_S)
        } else {
            // After an earlier jump the swings begin at the end of the last step.
            let walks = (from..last_swing).rev().find(|&row| self.foot_speed[row] > WALKS_MM_S);
            Some(walks.map_or(from, |row| row + 1))
        };
        let mut phases = Vec::new();
        if is_first {
            phases.push((Phase::Standing, from));
        }
        phases.extend(swings.map(|row| (Phase::Swings, row)));
        phases.extend([(Phase::LastSwing, last_swing), (Phase::TakeOff, take_off)]);
        phases
    }

    /// The first step after landing, once the body is at rest over its feet; the number of rows if there is none.
    fn first_step(&self, lands: usize) -> usize {
        let n = self.height.len();
        let rows = lands..n;
        // While the landing is absorbed, a foot may slide and the pelvis still moves.
        let still =
            |i: &usize| self.pelvis_speed[*i] < WALKS_MM_S && self.foot_speed[*i] < WALKS_MM_S;
        let Some(rests) = rows.clone().find(still) else { return n };
        let steps =
            |row: usize| self.foot_speed[row] > WALKS_MM_S || self.pelvis_speed[row] > WALKS_MM_S;
        self.sustained(rests..n, steps).unwrap_or(n)
    }

    /// The first row from which a condition holds for [`SUSTAINED_S`].
    fn sustained(&self, rows: std::ops::Range<usize>, is: impl Fn(usize) -> bool) -> Option<usize> {
        let n_rows = (SUSTAINED_S * self.rate_hz).ceil() as usize;
        let start = rows.start;
        let run = crate::column::runs(rows.map(is)).find(|run| run.len() >= n_rows)?;
        Some(start + run.start)
    }
}

/// The up axis and its sign: as stated by the source, else the axis on which pelvis and foot are farthest apart.
fn up_axis(motion: &Motion, pelvis: &[Vector], foot: &[Vector]) -> Option<(usize, f64)> {
    match motion.info.up {
        UpAxis::X => return Some((0, 1.0)),
        UpAxis::Y => return Some((1, 1.0)),
        UpAxis::Z => return Some((2, 1.0)),
        UpAxis::Unknown => {}
    }
    let mut sum = [0.0; 3];
    for (a, b) in pelvis.iter().zip(foot) {
        sum.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a - b);
    }
    let axis = (0..3).max_by(|&a, &b| sum[a].abs().total_cmp(&sum[b].abs()))?;
    (sum[axis] != 0.0).then(|| (axis, sum[axis].signum()))
}

/// Heights above the ground, taken to be the 20th percentile of a foot's heights.
fn above_ground(mut heights: Vec<f64>) -> Vec<f64> {
    let mut sorted = heights.clone();
    sorted.sort_by(f64::total_cmp);
    let ground = sorted.get(sorted.len() / 5).copied().unwrap_or(0.0);
    heights.iter_mut().for_each(|height| *height -= ground);
    heights
}

/// The derivative per second by central differences; one-sided at the ends.
fn derivative(values: &[f64], rate_hz: f64) -> Vec<f64> {
    let last = values.len().saturating_sub(1);
    let slope = |row: usize| {
        let (from, to) = (row.saturating_sub(1), (row + 1).min(last));
        (values[to] - values[from]) * rate_hz / (to - from).max(1) as f64
    };
    (0..values.len()).map(slope).collect()
}

/// The speed of a position, per second.
fn speed(of: &[Vector], rate_hz: f64) -> Vec<f64> {
    by_axis(of, |values| derivative(values, rate_hz)).into_iter().map(norm).collect()
}

/// Labels of the pelvis, in the form of [`crate::labels::site_key`] and in order of preference.
const PELVIS: &[&str] = &["pelvis", "hips", "root", "sacrum", "sacr", "midhip", "vsacral", "vsac"];
/// Without a pelvis marker it is the mean of these: all markers of the first set that is complete.
const AROUND_PELVIS: &[&[&str]] =
    &[&["lasi", "rasi", "lpsi", "rpsi"], &["lasis", "rasis"], &["lasi", "rasi"], &["lhip", "rhip"]];
const LEFT_FOOT: &[&str] = &["lankle", "lank", "lfoot", "lheel", "lhee"];
const RIGHT_FOOT: &[&str] = &["rankle", "rank", "rfoot", "rheel", "rhee"];

/// The markers from which the phases of a jump are detected.
#[derive(Debug, Clone, PartialEq)]
pub struct Sites {
    /// Columns whose mean is the pelvis.
    pub pelvis: Vec<usize>,
    /// Columns of the left and the right foot.
    pub feet: [usize; 2],
}

impl Sites {
    /// The sites of the first subject (`name:site`) that has them all.
    ///
    /// # Errors
    /// A message that names the missing site.
    pub fn of(motion: &Motion) -> Result<Self, String> {
        let subjects = subjects(motion.info.markers.iter().map(|marker| marker.label.as_str()));
        let mut found = subjects.iter().map(Self::of_subject);
        let first = found.next().unwrap_or_else(|| Self::of_subject(&SubjectMarkers::default()));
        first.or_else(|missing| found.find_map(Result::ok).ok_or(missing))
    }

    fn of_subject(subject: &SubjectMarkers<'_>) -> Result<Self, String> {
        let all = |names: &&[&str]| names.iter().map(|name| subject.first(&[name])).collect();
        let pelvis = subject.first(PELVIS).map(|pelvis| vec![pelvis]);
        let pelvis = pelvis
            .or_else(|| AROUND_PELVIS.iter().find_map(all))
            .ok_or("no marker is labelled pelvis, hips, sacrum or l_hip and r_hip")?;
        let foot = |names: &[&str], side: &str| {
            let missing = format!("no marker is labelled {side}_ankle, {side}_foot or {side}_heel");
            subject.first(names).ok_or(missing)
        };
        Ok(Self { pelvis, feet: [foot(LEFT_FOOT, "l")?, foot(RIGHT_FOOT, "r")?] })
    }

    /// The position of the pelvis over the take.
    #[must_use]
    pub fn pelvis(&self, motion: &Motion) -> Column {
        let columns: Vec<Column> =
            self.pelvis.iter().map(|&column| Column::of(motion, column)).collect();
        Column::mean(&columns)
    }
}

#[cfg(test)]
mod tests {
    use mocapd_take::motion::{Marker, MotionInfo};

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

    fn motion(labels: &[&str]) -> Motion {
        let marker = |label: &&str| Marker { label: (*label).to_owned(), labelled: true };
        let markers = labels.iter().map(marker).collect();
        Motion { info: MotionInfo { markers, ..Default::default() }, positions_mm: vec![] }
    }

    #[test]
    fn sites_of_several_marker_sets() {
        let ours = motion(&["head", "pelvis", "l_ankle", "r_ankle"]);
        assert_eq!(Sites::of(&ours), Ok(Sites { pelvis: vec![1], feet: [2, 3] }));
        let gait = motion(&["S1:LASI", "S1:RASI", "S1:LPSI", "S1:RPSI", "S1:LANK", "S1:RANK"]);
        assert_eq!(Sites::of(&gait), Ok(Sites { pelvis: vec![0, 1, 2, 3], feet: [4, 5] }));
        let two = ["A:pelvis", "A:l_ankle", "B:l_ankle", "B:r_ankle", "B:hips"];
        assert_eq!(Sites::of(&motion(&two)), Ok(Sites { pelvis: vec![4], feet: [2, 3] }));
        assert!(Sites::of(&motion(&["pelvis", "l_ankle"])).unwrap_err().contains("r_ankle"));
        assert!(Sites::of(&motion(&["u001"])).unwrap_err().contains("pelvis"));
    }
}
