//! The sample axis: LSL numbers no samples, so those that are missing show in the time stamps alone.
//!
//! A feed is a TCP connection: what its sender hands over arrives, once and in order. A sample that is missing between two time
//! stamps was never sent, or left the sender's buffer while nobody read it. Senders that stamp at the end of a sleep jitter,
//! and catch up; that is no gap. A gap is therefore counted only where stamps have been regular, the step is a whole number of
//! periods, and the sample after it does not catch up.

/// Part of a step's deviation, in periods, that the mean deviation takes over: some sixteen samples decide.
const GAIN: f64 = 1.0 / 16.0;

/// The mean deviation, in periods, up to which steps of one and of two periods are told apart in any case.
const STEADY_MAX: f64 = 0.2;

/// By how much a step of several periods may deviate from a whole number of them, and per period: nominal rates are off by a
/// tenth of a per cent.
const FIT: f64 = 0.25;
const FIT_PER_PERIOD: f64 = 1e-3;

/// Time stamps that lead the host's clock by so much more than any before were set, or their clock was. What waited in a queue,
/// however long, leads by less.
const LEAD_MARGIN_S: f64 = 0.5;

/// What is forgotten of the lead in a second, because clocks drift, and at most from one sample to the next.
const LEAD_DECAY: f64 = 200e-6;
const LEAD_DECAY_MAX_S: f64 = 0.1;

/// Longest gap that is counted, in samples, as for the numbers of frames: 17 minutes at 1000 Hz. A longer one is a pause.
const MISSING_MAX: f64 = 1_048_575.0;

/// When a sample was taken and when it was read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stamp {
    pub(super) time_s: f64,
    pub(super) read_ns: u64,
}

/// Numbers the samples of a stream; the numbers of missing ones are left out.
#[derive(Debug)]
pub(super) struct SampleAxis {
    /// `None` for a stream without a fixed rate, whose samples are numbered one by one.
    period_s: Option<f64>,
    next: u64,
    last: Option<Stamp>,
    /// The most by which time stamps have led the host's clock when they were read, in seconds, since they were set.
    lead_s: f64,
    /// The mean deviation of steps from whole numbers of periods, in periods.
    deviation: f64,
    /// Steps that it is the mean of, of the last ones.
    steps: f64,
    /// Whether the connection was lost since the last sample.
    rejoins: bool,
    /// Samples that are missing, but for those of outages.
    missing: u64,
}

impl SampleAxis {
    pub(super) fn new(period_s: Option<f64>) -> Self {
        let (next, last, missing) = (0, None, 0);
        Self {
            period_s,
            next,
            last,
            lead_s: f64::NAN,
            deviation: 1.0,
            steps: 0.0,
            rejoins: false,
            missing,
        }
    }

    /// The connection was lost: what was sent since is missing.
    pub(super) fn rejoin(&mut self) {
        self.rejoins = self.last.is_some();
    }

    /// Samples that are missing, but for those of outages.
    pub(super) fn missing(&self) -> u64 {
        self.missing
    }

    /// The number of the next sample. `following` is the time of the one after it, if that has arrived; without it the
    /// answer may be `None`, which means to wait for it, if `may_wait`.
    pub(super) fn number(
        &mut self,
        at: Stamp,
        following: impl FnOnce() -> Option<f64>,
        may_wait: bool,
    ) -> Option<u64> {
        let lead_s = at.time_s - at.read_ns as f64 * 1e-9;
        let missing = match (self.period_s, self.last) {
            (Some(period_s), Some(last)) => {
                self.missing_since(last, at, period_s, following, may_wait)?
            }
            _ => 0,
        };
        self.rejoins = false;
        let is_set = self.is_set(self.last, at);
        let host_s =
            self.last.map_or(0.0, |last| at.read_ns.saturating_sub(last.read_ns) as f64 * 1e-9);
        let earlier_s = self.lead_s - (LEAD_DECAY * host_s).min(LEAD_DECAY_MAX_S);
        self.lead_s = if is_set || self.lead_s.is_nan() { lead_s } else { earlier_s.max(lead_s) };
        let number = self.next.saturating_add(missing);
        self.next = number.saturating_add(1);
        self.last = Some(at);
        Some(number)
    }

    /// Whether a clock was set between two samples.
    fn is_set(&self, last: Option<Stamp>, at: Stamp) -> bool {
        let lead_s = at.time_s - at.read_ns as f64 * 1e-9;
        // A stamp that is no number was not set forth either.
        let goes_on = last.is_none_or(|last| at.time_s >= last.time_s);
        let is_led = self.lead_s.is_nan() || lead_s <= self.lead_s + LEAD_MARGIN_S;
        !(goes_on && is_led)
    }

    fn missing_since(
        &mut self,
        last: Stamp,
        at: Stamp,
        period_s: f64,
        following: impl FnOnce() -> Option<f64>,
        may_wait: bool,
    ) -> Option<u64> {
        let periods = (at.time_s - last.time_s) / period_s;
        let is_set = self.is_set(Some(last), at) || periods > MISSING_MAX;
        let steps = periods.round().max(1.0);
        if is_set || self.rejoins {
            return Some(if is_set { 0 } else { steps as u64 - 1 });
        }
        let looks_missing = steps >= 2.0 && self.deviation <= STEADY_MAX && fits(periods);
        let is_missing = looks_missing
            && match following() {
                Some(time_s) => {
                    let after = (time_s - at.time_s) / period_s;
                    after >= 0.5 && fits(after)
                }
                None if may_wait => return None,
                None => true,
            };
        let counted = if is_missing { steps } else { 1.0 };
        // The first steps count for as much as there are: a stream is not regular before it has shown it.
        self.steps += 1.0;
        let gain = GAIN.max(1.0 / self.steps);
        self.deviation += gain * ((periods - counted).abs().min(1.0) - self.deviation);
        let missing = counted as u64 - 1;
        self.missing += missing;
        Some(missing)
    }
}

/// Whether a step is a whole number of periods.
fn fits(periods: f64) -> bool {
    (periods - periods.round()).abs() <= FIT + FIT_PER_PERIOD * periods
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers of samples at these times, in periods of 10 ms, each read when it was taken.
    fn numbers(axis: &mut SampleAxis, times: &[f64]) -> Vec<u64> {
        let stamp = |periods: f64| Stamp {
            time_s: 100.0 + periods * 0.01,
            read_ns: ((100.0 + periods * 0.01) * 1e9) as u64,
        };
        let following = |at: usize| times.get(at + 1).map(|periods| stamp(*periods).time_s);
        let number = |(at, periods): (usize, &f64)| {
            axis.number(stamp(*periods), || following(at), false).unwrap()
        };
        times.iter().enumerate().map(number).collect()
    }

    fn axis() -> SampleAxis {
        SampleAxis::new(Some(0.01))
    }

    #[test]
    fn samples_that_are_missing_between_regular_ones_leave_their_numbers_out() {
        let mut axis = axis();
        let times = [0.0, 1.0, 2.01, 5.0, 6.0, 8.0, 9.99, 11.0];
        assert_eq!(numbers(&mut axis, &times), [0, 1, 2, 5, 6, 8, 10, 11]);
        assert_eq!(axis.missing(), 4);
    }

    #[test]
    fn a_sender_that_was_late_and_catches_up_has_left_nothing_out() {
        let mut axis = axis();
        let times = [0.0, 1.0, 2.0, 6.0, 6.01, 6.02, 6.03, 7.0, 8.0];
        assert_eq!(numbers(&mut axis, &times), [0, 1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(axis.missing(), 0);
    }

    #[test]
    fn stamps_that_jitter_by_periods_show_no_gaps() {
        let mut axis = axis();
        let jittered: Vec<f64> =
            (0..200).map(|at| f64::from(at) + f64::from(at * 7 % 5) * 0.6).collect();
        let mut sorted = jittered;
        sorted.sort_by(f64::total_cmp);
        let found = numbers(&mut axis, &sorted);
        assert!(found.windows(2).all(|pair| pair[1] == pair[0] + 1), "{found:?}");
        assert_eq!(axis.missing(), 0);
    }

    #[test]
    fn a_clock_that_is_set_leaves_nothing_out() {
        let mut axis = axis();
        let at = |time_s, read_ns| Stamp { time_s, read_ns };
        assert_eq!(axis.number(at(5.0, 0), || None, false), Some(0));
        assert_eq!(axis.number(at(15.0, 10_000_000), || None, false), Some(1), "ten seconds on");
        assert_eq!(axis.number(at(3.0, 20_000_000), || None, false), Some(2), "back");
        assert_eq!(axis.number(at(f64::NAN, 30_000_000), || None, false), Some(3), "no number");
        assert_eq!(axis.number(at(3.02, 40_000_000), || None, false), Some(4));
    }

    #[test]
    fn a_gap_behind_a_backlog_is_no_clock_that_was_set() {
        let mut axis = axis();
        numbers(&mut axis, &[0.0, 1.0, 2.0]);
        // Nobody read for 20 s; then come, at once, what the system kept, and what the sender still had.
        let read_ns = 120_000_000_000;
        let mut number = |periods: f64| {
            let at = Stamp { time_s: 100.0 + periods * 0.01, read_ns };
            axis.number(at, || Some(at.time_s + 0.01), true).unwrap()
        };
        assert_eq!([3.0, 4.0, 1504.0, 1505.0].map(&mut number), [3, 4, 1504, 1505]);
        assert_eq!(axis.missing(), 1499);
    }

    #[test]
    fn a_gap_waits_for_the_sample_after_it() {
        let mut axis = axis();
        numbers(&mut axis, &[0.0, 1.0]);
        let at = Stamp { time_s: 100.04, read_ns: 100_040_000_000 };
        assert_eq!(axis.number(at, || None, true), None);
        assert_eq!(axis.number(at, || Some(100.05), true), Some(4));
    }

    #[test]
    fn after_an_outage_the_time_tells_how_many_are_missing() {
        let mut axis = axis();
        numbers(&mut axis, &[0.0, 1.0, 2.0]);
        axis.rejoin();
        assert_eq!(numbers(&mut axis, &[502.3]), [502]);
        assert_eq!(axis.missing(), 0, "they are those of the outage");
        axis.rejoin();
        let early = Stamp { time_s: 1.0, read_ns: 200_000_000_000 };
        assert_eq!(axis.number(early, || None, true), Some(503), "its clock began anew");
    }

    #[test]
    fn samples_without_a_rate_are_numbered_one_by_one() {
        let mut axis = SampleAxis::new(None);
        assert_eq!(numbers(&mut axis, &[0.0, 7.0, 7.0, 3.0]), [0, 1, 2, 3]);
    }
}
