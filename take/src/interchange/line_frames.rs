//! Which frame each line of a text file is, and the rate: by the numbers and times that lines begin with.
//!
//! A line that is missing is a frame without samples: were the lines behind it closed up, they would come too early.
//! Times are rounded (a spreadsheet shows 0.008, 0.017, 0.025 for 120 Hz), so that no single interval tells the rate, but
//! all of them together do: it is the frames between the first time and the last, over that time, and known within the
//! rounding over that time.

use super::text;

/// Share of the period by which an interval may differ from it, beside the rounding, before times are called uneven.
const EVEN: f64 = 0.01;
/// An interval of so many periods, beside the rounding, has lost frames in it; a shorter one is a frame that is late.
const GAP_PERIODS: f64 = 1.5;
/// Share by which the rate that a file states and the one that its times tell may differ.
const RATES_AGREE: f64 = 0.01;
/// A rate that is known no better than this share is said to be uncertain.
const RATE_IS_SURE: f64 = 1e-3;
/// So many steps of more than one frame each are a file that was thinned out; fewer are gaps.
const DECIMATED_MIN: usize = 3;
/// Digits behind the point that a rate may need: 59.94006.
const RATE_DIGITS_MAX: i32 = 6;

/// Numbers and times of the lines of frames, as they are read.
#[derive(Debug, Default)]
pub(super) struct LineFrames {
    n_lines: usize,
    numbers: Vec<u64>,
    times: Vec<f64>,
    rounding: Rounding,
}

/// What times are rounded to: a unit of the last digit of the longest.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rounding {
    digits: usize,
    has_exponents: bool,
}

impl Rounding {
    /// With one more time.
    pub(super) fn add(&mut self, cell: &[u8]) {
        self.has_exponents |= cell.iter().any(|b| b.eq_ignore_ascii_case(&b'e'));
        self.digits = self.digits.max(text::decimals(cell.trim_ascii()));
    }

    /// By how much the difference of two times may be off: half a unit each. 0 where that is not known.
    fn seconds(self) -> f64 {
        if self.has_exponents { 0.0 } else { 10f64.powi(-(self.digits.min(300) as i32)) }
    }
}

/// Frames a second of `steps` frames in a span of time: with the fewest digits that the rounding of the times allows.
pub(super) fn rate_of(steps: f64, span_s: f64, rounding: Rounding) -> Option<f64> {
    let rate = steps / span_s;
    if !(rate.is_finite() && rate > 0.0) {
        return None;
    }
    let slack = rate * (rounding.seconds() / span_s).max(1e-9);
    let rounded = (0..=RATE_DIGITS_MAX).map(|digits| {
        let scale = 10f64.powi(digits);
        (rate * scale).round() / scale
    });
    let mut fitting = rounded.filter(|rounded| (rounded - rate).abs() <= slack && *rounded > 0.0);
    Some(fitting.next().unwrap_or(rate))
}

/// What they say.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Placed {
    /// Frames a second; `None` where nothing tells.
    pub(super) rate_hz: Option<f64>,
    /// By line, how many frames before it have no line. Empty where none is missing.
    pub(super) missing_before: Vec<u64>,
}

impl LineFrames {
    /// The next line, by its cells of the frame's number and time; empty where there are none.
    pub(super) fn line(&mut self, number: &[u8], time: &[u8]) {
        self.n_lines += 1;
        self.numbers.extend(text::whole_number(number));
        if let Some(seconds) = text::number(time).filter(|seconds| seconds.is_finite()) {
            self.times.push(seconds);
            self.rounding.add(time);
        }
    }

    /// Number of the first frame.
    pub(super) fn first(&self) -> Option<u64> {
        self.numbers.first().copied()
    }

    /// Which frame each line is, and the rate where the file states none. No more than `frames_max` frames.
    pub(super) fn place(
        &self,
        stated_hz: Option<f64>,
        frames_max: usize,
        warnings: &mut Vec<String>,
    ) -> Placed {
        let by_number = self.steps_by_number(warnings);
        let by_time = self.steps_by_time(stated_hz, by_number.as_deref(), warnings);
        let rate_hz = stated_hz.or_else(|| {
            let steps = by_time.as_deref().map(|steps| steps.iter().map(|&step| step as f64).sum());
            let steps = steps.unwrap_or(self.times.len().saturating_sub(1) as f64);
            rate_of(steps, self.times.last()? - self.times.first()?, self.rounding)
        });
        let Some(steps) = by_time.or(by_number) else {
            return Placed { rate_hz, ..Placed::default() };
        };
        let missing: u64 = steps.iter().map(|step| step - 1).fold(0, u64::saturating_add);
        if missing == 0 {
            return Placed { rate_hz, ..Placed::default() };
        }
        if missing.saturating_add(self.n_lines as u64) > frames_max as u64 {
            warnings.push(format!(
                "By their numbers and times {missing} frames have no line, more than a file of this size can mean; lines were \
                 taken as successive frames."
            ));
            return Placed { rate_hz, ..Placed::default() };
        }
        warnings.push(format!("{missing} frames have no line in the file; they are gaps."));
        let missing_before = std::iter::once(0).chain(steps.iter().map(|step| step - 1)).collect();
        Placed { rate_hz, missing_before }
    }

    /// Frames from a line to the next, by their numbers: where every n-th frame is there, those are the frames.
    fn steps_by_number(&self, warnings: &mut Vec<String>) -> Option<Vec<u64>> {
        if self.numbers.len() != self.n_lines || self.n_lines < 2 {
            return None;
        }
        let falls = self.numbers.array_windows().filter(|[a, b]| b <= a).count();
        if falls > 0 {
            warnings.push(format!(
                "Frame numbers do not rise in {falls} places; lines were taken as successive frames."
            ));
            return None;
        }
        let steps: Vec<u64> = self.numbers.array_windows().map(|[a, b]| b - a).collect();
        let common = steps.iter().copied().fold(0, greatest_common_divisor).max(1);
        let every = if steps.len() < DECIMATED_MIN { 1 } else { common };
        if every > 1 {
            warnings.push(format!(
                "Of {every} frames by their numbers one is there; those are the frames."
            ));
        }
        Some(steps.into_iter().map(|step| step / every).collect())
    }

    /// Frames from a line to the next, by the times; by the numbers where the times agree with them.
    fn steps_by_time(
        &self,
        stated_hz: Option<f64>,
        by_number: Option<&[u64]>,
        warnings: &mut Vec<String>,
    ) -> Option<Vec<u64>> {
        if self.times.len() != self.n_lines || self.n_lines < 2 {
            return None;
        }
        let intervals: Vec<f64> = self.times.array_windows().map(|[a, b]| b - a).collect();
        let usual = usual_intervals(&intervals)?;
        let rounding_s = self.rounding.seconds().min(usual.spread_s);
        let told_hz = 1.0 / usual.mean_s;
        if let Some(stated_hz) = stated_hz
            && (usual.mean_s * stated_hz - 1.0).abs() > RATES_AGREE + rounding_s * stated_hz
        {
            warnings.push(format!(
                "The file states {stated_hz} Hz, and its times tell {told_hz:.3} Hz; {stated_hz} Hz was taken."
            ));
        }
        let by_time: Vec<u64> = intervals
            .iter()
            .map(|&interval_s| {
                let is_gap = interval_s > GAP_PERIODS * usual.mean_s + rounding_s;
                if is_gap { (interval_s / usual.mean_s).round().max(1.0) as u64 } else { 1 }
            })
            .collect();
        let off_s = |step: u64, interval_s: f64| (interval_s - step as f64 * usual.mean_s).abs();
        if let Some(by_number) = by_number {
            let disagree = by_number.iter().zip(&intervals);
            let disagree = disagree
                .filter(|&(&step, &s)| off_s(step, s) > 0.5 * usual.mean_s + rounding_s)
                .count();
            if disagree == 0 {
                return Some(by_number.to_vec());
            }
            warnings.push(format!(
                "Frame numbers and times disagree in {disagree} places; the times were taken."
            ));
        }
        let uneven = by_time
            .iter()
            .zip(&intervals)
            .filter(|&(&step, &s)| off_s(step, s) > EVEN * usual.mean_s + rounding_s + 2e-6)
            .count();
        if uneven > 0 {
            warnings.push(format!(
                "{uneven} of {} intervals differ from the usual one of {:.6} s; frames were taken as even.",
                intervals.len(),
                usual.mean_s
            ));
        }
        let span_s = self.times.last()? - self.times.first()?;
        if stated_hz.is_none() && rounding_s / span_s > RATE_IS_SURE {
            warnings.push(format!(
                "Times are rounded to {rounding_s} s: the rate is known to within {:.2} Hz.",
                told_hz * rounding_s / span_s
            ));
        }
        Some(by_time)
    }
}

/// The intervals between two lines where no frame is missing.
struct Usual {
    mean_s: f64,
    /// From the shortest to the longest.
    spread_s: f64,
}

/// `None` where times do not rise.
fn usual_intervals(intervals: &[f64]) -> Option<Usual> {
    let mut sorted = intervals.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = *sorted.get(sorted.len().checked_sub(1)? / 2)?;
    if !(median > 0.0 && *sorted.first()? >= 0.0) {
        return None;
    }
    let usual = sorted.get(..sorted.partition_point(|&s| s <= GAP_PERIODS * median))?;
    let mean_s = usual.iter().sum::<f64>() / usual.len() as f64;
    Some(Usual { mean_s, spread_s: usual.last()? - usual.first()? })
}

fn greatest_common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines of these frames, with times to so many digits.
    fn lines(frames: &[u64], rate_hz: f64, digits: usize) -> LineFrames {
        let mut lines = LineFrames::default();
        for frame in frames {
            lines.line(b"", format!("{:.digits$}", *frame as f64 / rate_hz).as_bytes());
        }
        lines
    }

    #[test]
    fn a_rate_is_told_by_all_times_together() {
        for (rate_hz, digits, n) in
            [(120.0, 3, 50), (120.0, 2, 500), (59.94, 4, 2000), (10.0, 1, 20), (100.0, 9, 4)]
        {
            let frames: Vec<u64> = (0..n).collect();
            let placed = lines(&frames, rate_hz, digits).place(None, 10_000, &mut Vec::new());
            assert_eq!(placed.rate_hz, Some(rate_hz), "{rate_hz} Hz to {digits} digits");
            assert_eq!(placed.missing_before, [0; 0], "{rate_hz} Hz to {digits} digits");
        }
    }

    #[test]
    fn a_line_that_is_missing_is_a_frame() {
        for (rate_hz, digits) in [(120.0, 3), (100.0, 2), (10.0, 1), (240.0, 6)] {
            let frames: Vec<u64> =
                (0..60).filter(|frame| ![7, 20, 21, 22].contains(frame)).collect();
            let mut warnings = Vec::new();
            let placed = lines(&frames, rate_hz, digits).place(None, 1000, &mut warnings);
            assert_eq!(placed.rate_hz, Some(rate_hz), "{warnings:?}");
            let missing: Vec<_> =
                placed.missing_before.iter().enumerate().filter(|(_, n)| **n > 0).collect();
            assert_eq!(missing, [(7, &1), (19, &3)], "{rate_hz} Hz: {warnings:?}");
            assert!(warnings.iter().any(|said| said.contains("4 frames")), "{warnings:?}");
        }
    }

    #[test]
    fn numbers_tell_what_times_do_not_contradict() {
        let of = |cells: &[(&str, &str)]| {
            let mut lines = LineFrames::default();
            cells.iter().for_each(|(number, time)| lines.line(number.as_bytes(), time.as_bytes()));
            let mut warnings = Vec::new();
            (lines.place(None, 100, &mut warnings), warnings)
        };
        // Without times, and every second frame.
        let (placed, _) = of(&[("1", ""), ("3", ""), ("7", ""), ("9", "")]);
        assert_eq!((placed.rate_hz, placed.missing_before), (None, vec![0, 0, 1, 0]));
        // Renumbered behind a gap.
        let (placed, warnings) = of(&[("1", "0"), ("2", "0.1"), ("3", "0.2"), ("4", "0.5")]);
        assert_eq!((placed.rate_hz, placed.missing_before), (Some(10.0), vec![0, 0, 0, 2]));
        assert_eq!(warnings.len(), 2, "{warnings:?}");
        // Nothing that rises.
        let (placed, warnings) = of(&[("2", "0.1"), ("1", "0.1"), ("2", "0.1")]);
        assert_eq!((placed, warnings.len()), (Placed::default(), 1));
        // A slip of the keyboard is not a day without frames.
        let (placed, warnings) = of(&[("1", "0.1"), ("2", "0.2"), ("9000000", "900000.0")]);
        assert_eq!((placed.missing_before.len(), warnings.len()), (0, 1), "{warnings:?}");
    }
}
