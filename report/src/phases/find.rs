//! Finds the phases of jumps from the pelvis and the feet.
//!
//! In flight the pelvis falls: that, and feet above where they stand, is what a jump is here. From each flight the
//! search goes back to the crouch and to the swings before it, and forward to the first step after it.

use mocapd_take::motion::{Motion, UpAxis};

use super::Phase;
use crate::{
    column::{Column, Vector},
    derivative::Butterworth,
    sites::Sites,
};

/// Cutoff of what the search looks at, Hz: a take-off lasts 0.3 s, and its end is to be found within two frames.
const CUTOFF_HZ: f64 = 10.0;

/// Slowest take-off of a jump, mm/s upwards: a rise of 5 cm. Walking is below 400.
const TAKE_OFF_MM_S: f64 = 1000.0;

/// Times in the air, seconds: from a hop to more than anybody jumps.
const FLIGHT_S: std::ops::RangeInclusive<f64> = 0.1..=1.2;

/// Standard gravity; in the air the pelvis falls with about as much, since it is near the centre of mass.
const GRAVITY_MM_S2: f64 = 9806.65;

/// How high both feet are above where they stand, in some frame of the flight, mm.
const FEET_MM: f64 = 40.0;

/// Who stands still moves no slower than this, mm/s: any marker for the beginning, pelvis or feet for the end.
const MOVES_MM_S: f64 = 250.0;
const WALKS_MM_S: f64 = 200.0;

/// For how long that must go on, seconds.
const GOES_ON_S: f64 = 0.15;

/// Why no phases were found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoJump {
    /// No marker is at a site that the search looks at; what is missing, and what markers may be called.
    #[error("{0}")]
    NoMarker(String),
    /// This rate, in Hz.
    #[error("{0} Hz is too slow to see a jump")]
    TooSlow(f64),
    /// Markers that are never there: the pelvis, or a foot.
    #[error("{0} was never seen")]
    NeverSeen(&'static str),
    /// Neither the take nor the motion tells which axis is up.
    #[error("which way is up cannot be told")]
    UpUnknown,
    /// No flight was found.
    #[error("the pelvis is never in flight: nothing here is a jump")]
    NeverInFlight,
}

/// Heights and speeds of a take, row by row.
struct Signals {
    rate_hz: f64,
    /// Pelvis: height in mm, its first and second derivative, and how fast it moves sideways.
    height: Vec<f64>,
    rise: Vec<f64>,
    lift: Vec<f64>,
    drift: Vec<f64>,
    /// Feet: the lower one's height above where it stands, and how fast the faster one moves sideways.
    feet: Vec<f64>,
    step: Vec<f64>,
    /// The fastest marker.
    fastest: Vec<f64>,
}

/// Each phase and its first frame, in order, from frame 0 on.
///
/// # Errors
/// Which marker is missing, or that nothing in the take is a jump.
pub fn find(motion: &Motion) -> Result<Vec<(Phase, usize)>, NoJump> {
    let sites = Sites::of(motion).map_err(NoJump::NoMarker)?;
    let signals = Signals::of(motion, &sites)?;
    let mut phases: Vec<(Phase, usize)> = Vec::new();
    let mut from = 0;
    for (leaves, lands) in signals.flights() {
        let first_of_take = phases.is_empty();
        for (phase, frame) in signals.before(from, leaves, first_of_take) {
            push(&mut phases, phase, frame);
        }
        push(&mut phases, Phase::Flight, leaves);
        push(&mut phases, Phase::Settling, lands);
        from = signals.walks_from(lands);
        if from < signals.height.len() {
            push(&mut phases, Phase::Walking, from);
        }
    }
    if phases.is_empty() {
        return Err(NoJump::NeverInFlight);
    }
    Ok(phases)
}

/// A phase that begins where the one before did takes its place.
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
            let bridged = column.bridged()?;
            Some(crate::derivative::filtered(&filter, &bridged))
        };
        let pelvis = smooth(&sites.pelvis(motion)).ok_or(NoJump::NeverSeen("the pelvis"))?;
        let [left, right] = sites.feet.map(|foot| smooth(&Column::of(motion, foot)));
        let (left, right) = left.zip(right).ok_or(NoJump::NeverSeen("a foot"))?;
        let up = up_axis(motion, &pelvis, &left).ok_or(NoJump::UpUnknown)?;
        let heights = |of: &[Vector]| -> Vec<f64> { of.iter().map(|at| up.1 * at[up.0]).collect() };
        let height = heights(&pelvis);
        let rise = derivative(&height, rate_hz);
        let lift = derivative(&rise, rate_hz);
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
            drift: sideways(&pelvis),
            feet: feet[0].iter().zip(&feet[1]).map(|(a, b)| a.min(*b)).collect(),
            step: larger(sideways(&left), sideways(&right)),
            height,
            rise,
            lift,
            fastest,
        })
    }

    /// Leaving and touching the ground: between the fastest rise and the fastest fall, as long as the pelvis falls
    /// with more than half of gravity.
    fn flights(&self) -> Vec<(usize, usize)> {
        let n = self.rise.len();
        let mut flights = Vec::new();
        let mut row = 1;
        while row + 1 < n {
            let is_peak =
                self.rise[row] >= self.rise[row - 1] && self.rise[row] > self.rise[row + 1];
            if !is_peak || self.rise[row] < TAKE_OFF_MM_S {
                row += 1;
                continue;
            }
            let falls = |row: usize| self.lift[row] < -0.5 * GRAVITY_MM_S2;
            let leaves = (row..n).find(|&row| falls(row)).unwrap_or(n);
            // The flight goes over the top: a dip in the fall before that is the body's, not the ground's.
            let top = (leaves..n).find(|&row| self.rise[row] <= 0.0).unwrap_or(n);
            let lands = (top..n).find(|&row| !falls(row)).unwrap_or(n);
            let seconds = (lands - leaves) as f64 / self.rate_hz;
            let feet_mm = self.feet[leaves.min(n)..lands].iter().copied().fold(0.0, f64::max);
            if lands < n && FLIGHT_S.contains(&seconds) && feet_mm > FEET_MM {
                flights.push((leaves, lands));
                row = lands;
            } else {
                row += 1;
            }
        }
        flights
    }

    /// What comes before leaving the ground, not before frame `from`.
    fn before(&self, from: usize, leaves: usize, is_first: bool) -> Vec<(Phase, usize)> {
        // The crouch is at its lowest where the pelvis begins to rise.
        let fastest = self.rise[leaves];
        let take_off = (from..leaves).rev().find(|&row| self.rise[row] < 0.04 * fastest);
        let take_off = take_off.map_or(from, |row| row + 1);
        // The last swing begins where the pelvis was last as high as it gets before that crouch.
        let low = self.height[take_off.min(leaves)];
        let before = &self.height[from..take_off];
        let usual = before.iter().copied().fold(low, f64::max);
        let near_top = usual - 0.25 * (usual - low);
        let mut last_swing = (from..take_off).rev().find(|&row| self.height[row] >= near_top);
        // From there back to the very top.
        while let Some(row) =
            last_swing.filter(|&row| row > from && self.height[row - 1] > self.height[row])
        {
            last_swing = Some(row - 1);
        }
        let last_swing = last_swing.unwrap_or(from);
        let swings = if is_first {
            self.goes_on(from..last_swing, |row| self.fastest[row] > MOVES_MM_S)
        } else {
            // After a jump the walk ends where the feet stand for the last time.
            let walks = (from..last_swing).rev().find(|&row| self.step[row] > WALKS_MM_S);
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

    /// The first step after touching the ground, once the body has come to rest over its feet.
    fn walks_from(&self, lands: usize) -> usize {
        let n = self.height.len();
        let rows = lands..n;
        // A foot slides and the pelvis swings on as the landing is absorbed.
        let still = |row: &usize| self.drift[*row] < WALKS_MM_S && self.step[*row] < WALKS_MM_S;
        let Some(rests) = rows.clone().find(still) else { return n };
        let steps = |row: usize| self.step[row] > WALKS_MM_S || self.drift[row] > WALKS_MM_S;
        self.goes_on(rests..n, steps).unwrap_or(n)
    }

    /// Where something begins that then goes on for a while.
    fn goes_on(&self, rows: std::ops::Range<usize>, is: impl Fn(usize) -> bool) -> Option<usize> {
        let wanted = (GOES_ON_S * self.rate_hz).ceil() as usize;
        let start = rows.start;
        let run = crate::column::runs(rows.map(is)).find(|run| run.len() >= wanted)?;
        Some(start + run.start)
    }
}

/// Which axis is up, and which way: what the source says, else the axis on which the pelvis is most above a foot.
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

/// Above where a foot stands: the height below which it is a fifth of the time.
fn above_ground(mut heights: Vec<f64>) -> Vec<f64> {
    let mut sorted = heights.clone();
    sorted.sort_by(f64::total_cmp);
    let ground = sorted.get(sorted.len() / 5).copied().unwrap_or(0.0);
    heights.iter_mut().for_each(|height| *height -= ground);
    heights
}

/// Central differences, a second; one-sided at the ends.
fn derivative(values: &[f64], rate_hz: f64) -> Vec<f64> {
    let last = values.len().saturating_sub(1);
    (0..values.len())
        .map(|row| {
            let (from, to) = (row.saturating_sub(1), (row + 1).min(last));
            (values[to] - values[from]) * rate_hz / (to - from).max(1) as f64
        })
        .collect()
}

fn speed(of: &[Vector], rate_hz: f64) -> Vec<f64> {
    let axes: [Vec<f64>; 3] = std::array::from_fn(|axis| {
        let values: Vec<f64> = of.iter().map(|at| at[axis]).collect();
        derivative(&values, rate_hz)
    });
    (0..of.len())
        .map(|row| crate::column::norm(std::array::from_fn(|axis| axes[axis][row])))
        .collect()
}
