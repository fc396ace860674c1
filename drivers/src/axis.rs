//! The axes of frames and of samples: counters of what was captured, out of vendors' numbers and time stamps.
//!
//! *Frames* of some systems have a number and a time stamp. Live, the number may stand still while the time goes on, as QTM's
//! does (<https://github.com/qualisys/qualisys_python_sdk/issues/37>). The time, in whole microseconds, then tells how many
//! frames have passed. Where the number advances, it is what counts: a time stamp may be late.
//!
//! *Samples* of LSL have no numbers, so those that are missing show in the time stamps alone.
//! A feed is a TCP connection: what its sender hands over arrives, once and in order. A sample that is missing between two time
//! stamps was never sent, or left the sender's buffer while nobody read it. Senders that stamp at the end of a sleep jitter,
//! and catch up; that is no gap. A gap is therefore counted only where stamps have been regular, the step is a whole number of
//! periods, and the sample after it does not catch up.

/// The last frame that was not late.
#[derive(Debug, Clone, Copy)]
struct LastFrame {
    number: u32,
    time_us: u64,
    counter: u32,
    /// When it should have been exposed, where time counts: time stamps that jitter must not add up.
    grid_us: f64,
    /// Whether its number was that of the frame before it.
    stood_still: bool,
}

/// Frames by their numbers or times, as a counter that wraps.
#[derive(Debug, Default)]
pub(crate) struct FrameAxis {
    /// Duration of a frame.
    period_us: f64,
    last: Option<LastFrame>,
}

/// A number that goes back by more is no late frame: the count began again. The recorder applies the same rule.
const LATE_MAX: i64 = 64;

/// Part of a time stamp's deviation that the grid takes over: it follows a true rate that differs from the stated one, and
/// hardly a single stamp.
const GRID_GAIN: f64 = 0.125;

impl FrameAxis {
    /// An axis for frames at this rate.
    pub(crate) fn new(rate_millihertz: u32) -> Self {
        Self { period_us: 1e9 / f64::from(rate_millihertz.max(1)), last: None }
    }

    /// The counter of a frame. Of two equal ones, the second is a duplicate, and one below the last is late.
    pub(crate) fn counter(&mut self, number: u32, time_us: u64) -> u32 {
        let Some(last) = self.last else {
            let grid_us = time_us as f64;
            let first = LastFrame { number, time_us, counter: number, grid_us, stood_still: false };
            self.last = Some(first);
            return number;
        };
        let by_number = i64::from(number.wrapping_sub(last.number).cast_signed());
        let elapsed_us = time_us.wrapping_sub(last.time_us).cast_signed();
        // A number that stood still may jump to where it should be: what passed meanwhile was counted by time.
        let stands_still = by_number == 0;
        let counts_time = stands_still || (last.stood_still && by_number > 0 && elapsed_us > 0);
        let steps = if counts_time { self.frames_until(&last, elapsed_us) } else { by_number };
        let counter = last.counter.wrapping_add(steps as u32);
        let is_late = (-LATE_MAX..=0).contains(&steps) && elapsed_us <= 0;
        if !is_late {
            let expected_us = last.grid_us + steps as f64 * self.period_us;
            let deviation_us = time_us as f64 - expected_us;
            let grid_us = if counts_time && deviation_us.abs() < self.period_us {
                expected_us + GRID_GAIN * deviation_us
            } else {
                time_us as f64
            };
            let stood_still = stands_still;
            self.last = Some(LastFrame { number, time_us, counter, grid_us, stood_still });
        }
        counter
    }

    /// Frames from the last one to one that is so much later: at least one in either direction, unless the time is the same.
    fn frames_until(&self, last: &LastFrame, elapsed_us: i64) -> i64 {
        let since_grid_us = last.time_us as f64 + elapsed_us as f64 - last.grid_us;
        let frames = (since_grid_us / self.period_us).round() as i64;
        // Beyond this the recorder takes it for a jump in any case.
        let frames = frames.clamp(i64::from(i32::MIN), i64::from(i32::MAX));
        match elapsed_us {
            0 => 0,
            1.. => frames.max(1),
            _ => frames.min(-1),
        }
    }
}

/// Time over which the rate is measured, in microseconds: a stamp that is late by a frame changes it by little.
const RATE_WINDOW_US: u64 = 1_000_000;

/// Part by which the measured rate may differ from the stated one: clocks differ by a ten-thousandth.
const RATE_DEVIATION_MAX: f64 = 0.02;

/// Windows in a row that must show it: a clock or a number that jumps spoils one.
const RATE_WINDOWS: u32 = 2;

/// Compares the rate of frames by their numbers and times with the stated one.
#[derive(Debug, Default)]
pub(super) struct RateCheck {
    /// The first frame of the window, and the last one: number and time.
    window: Option<[(u32, u64); 2]>,
    n_deviating: u32,
    is_reported: bool,
}

impl RateCheck {
    /// Follows a frame. Returns the rate in Hz, once, when it is another than the stated one.
    pub(super) fn follow(&mut self, number: u32, time_us: u64, rate_hz: f64) -> Option<f64> {
        let here = (number, time_us);
        let [first, last] = self.window.get_or_insert([here; 2]);
        let ahead = number.wrapping_sub(last.0).cast_signed();
        if (-LATE_MAX..=0).contains(&i64::from(ahead)) && time_us <= last.1 {
            // A datagram that came late or twice.
            return None;
        }
        if ahead <= 0 || time_us <= last.1 {
            // A number that stands still counts nothing, and one that began again nothing with those before.
            self.window = Some([here; 2]);
            self.n_deviating = 0;
            return None;
        }
        *last = here;
        let elapsed_us = time_us - first.1;
        if elapsed_us < RATE_WINDOW_US {
            return None;
        }
        let measured_hz = f64::from(number.wrapping_sub(first.0)) * 1e6 / elapsed_us as f64;
        self.window = Some([here; 2]);
        let deviates = (measured_hz / rate_hz - 1.0).abs() > RATE_DEVIATION_MAX;
        self.n_deviating = if deviates { self.n_deviating + 1 } else { 0 };
        let is_new = self.n_deviating >= RATE_WINDOWS && !self.is_reported;
        self.is_reported |= is_new;
        is_new.then_some(measured_hz)
    }
}

/// Largest gap that counts as loss; beyond it the counter jumped: 17 minutes at 1000 Hz.
const FRAMES_MISSING_MAX: i32 = 1 << 20;

/// Largest gap after an outage for a counter that has gone on: a day and more at 10 kHz.
const OUTAGE_MAX: i32 = 1 << 30;

/// A frame at most this far behind came late or twice: links do not reorder further. Beyond it the
/// device started again.
const LATE_MIN: i32 = -64;

/// Gaps up to this size are never doubted: a clock read late by a few frame times does not refute the counter.
const DOUBTED_MIN: i32 = 8;

/// A counter that advanced this many times further than the device's own clock allows did not lose frames. Far from
/// 1: the true rate may differ from the stated one, and the clock may be set while frames are lost.
const CLOCK_FACTOR: f64 = 4.0;

/// What a frame's counter says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeqStep {
    /// The next frame, after `missing` frames that did not arrive.
    Next {
        /// How many.
        missing: u32,
    },
    /// Received before, or late: its row is closed.
    Stale,
    /// The counter jumped as no loss explains; the frame counts as the next one.
    Jump,
}

/// Follows the counter, which wraps.
#[derive(Debug, Default)]
pub struct FrameCounter {
    last: Option<(u32, u64)>,
    /// Ticks of the device's clock from a frame to the next; 0 when unknown.
    frame_ticks: f64,
}

impl FrameCounter {
    /// A counter of frames at this rate, with a clock of so many ticks a second.
    #[must_use]
    pub fn new(rate_hz: f64, tick_hz: u64) -> Self {
        Self { last: None, frame_ticks: tick_hz as f64 / rate_hz }
    }

    /// Whether, by its own clock, the device cannot have produced `ahead` frames since the last one.
    fn is_ahead_of_clock(&self, ahead: i32, ticks: u64, last_ticks: u64) -> bool {
        // A clock that went back proves nothing.
        let elapsed = ticks.checked_sub(last_ticks).filter(|elapsed| *elapsed > 0);
        elapsed.is_some_and(|elapsed| {
            ahead > DOUBTED_MIN
                && f64::from(ahead) * self.frame_ticks > CLOCK_FACTOR * elapsed as f64
        })
    }

    /// How many frames before the last one the device's clock showed `ticks`; `None` without a frame, or a clock that jumped.
    #[must_use]
    pub fn frames_back(&self, ticks: u64) -> Option<u64> {
        let (_, last_ticks) = self.last?;
        let frames = last_ticks.checked_sub(ticks)? as f64 / self.frame_ticks;
        (frames < f64::from(FRAMES_MISSING_MAX)).then_some(frames.round() as u64)
    }

    /// The first frame after an outage: the number of frames missing in between, or `None` when counter and clock do
    /// not continue from where they were, because the device lost its power.
    pub fn rejoin(&mut self, seq: u32, device_ticks: u64) -> Option<u32> {
        let last = self.last.replace((seq, device_ticks));
        let Some((last, ticks)) = last else { return Some(0) };
        match seq.wrapping_sub(last).cast_signed() {
            ahead @ 1..=OUTAGE_MAX if device_ticks > ticks => {
                // The counter stood still while the device was stopped, but its clock continued.
                let elapsed = (device_ticks - ticks) as f64 / self.frame_ticks;
                let by_clock = if elapsed.is_finite() { elapsed.round() as i64 } else { 0 };
                let slack = i64::from(DOUBTED_MIN).max(i64::from(ahead) / 100);
                let stood_still = by_clock - i64::from(ahead) > slack;
                let ahead =
                    if stood_still { by_clock.min(OUTAGE_MAX.into()) } else { ahead.into() };
                Some(ahead as u32 - 1)
            }
            _ => None,
        }
    }

    /// A frame during the stream. The device's clock distinguishes a late frame from a counter that started again.
    pub fn step(&mut self, seq: u32, device_ticks: u64) -> SeqStep {
        let step = match self.last {
            None => SeqStep::Next { missing: 0 },
            Some((last, ticks)) => match seq.wrapping_sub(last).cast_signed() {
                ahead @ 1.. if self.is_ahead_of_clock(ahead, device_ticks, ticks) => SeqStep::Jump,
                ahead @ 1..=FRAMES_MISSING_MAX => SeqStep::Next { missing: ahead as u32 - 1 },
                LATE_MIN..=0 if device_ticks <= ticks => return SeqStep::Stale,
                _ => SeqStep::Jump,
            },
        };
        self.last = Some((seq, device_ticks));
        step
    }
}

/// Frames that a system has produced by their counters, where it does not state how many: as the recorder counts them, so that
/// both agree after a jump, too.
#[derive(Debug, Default)]
pub(crate) struct ProducedFrames {
    counter: FrameCounter,
    produced: u64,
}

impl ProducedFrames {
    pub(crate) fn new(rate_millihertz: u32, tick_hz: u64) -> Self {
        let rate_hz = f64::from(rate_millihertz.max(1)) / 1000.0;
        Self { counter: FrameCounter::new(rate_hz, tick_hz), produced: 0 }
    }

    /// Counts a frame. Returns `false` for one that came before, or late.
    pub(crate) fn follow(&mut self, seq: u32, ticks: u64) -> bool {
        let step = self.counter.step(seq, ticks);
        self.produced += match step {
            SeqStep::Next { missing } => u64::from(missing) + 1,
            SeqStep::Jump => 1,
            SeqStep::Stale => 0,
        };
        step != SeqStep::Stale
    }

    pub(crate) fn produced(&self) -> u64 {
        self.produced
    }
}

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

/// The same where the connection was lost: as far as the recorder counts samples, weeks at 2000 Hz.
const OUTAGE_MISSING_MAX: f64 = 4_294_967_296.0;

/// When a sample was taken and when it was read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stamp {
    pub(crate) time_s: f64,
    pub(crate) read_ns: u64,
}

/// Numbers the samples of a stream; the numbers of missing ones are left out.
#[derive(Debug)]
pub(crate) struct SampleAxis {
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
    pub(crate) fn new(period_s: Option<f64>) -> Self {
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
    pub(crate) fn rejoin(&mut self) {
        self.rejoins = self.last.is_some();
    }

    /// Samples that are missing, but for those of outages.
    pub(crate) fn missing(&self) -> u64 {
        self.missing
    }

    /// The number of the next sample. `following` is the time of the one after it, if that has arrived; without it the
    /// answer may be `None`, which means to wait for it, if `may_wait`.
    pub(crate) fn number(
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
        let missing_max = if self.rejoins { OUTAGE_MISSING_MAX } else { MISSING_MAX };
        let is_set = self.is_set(Some(last), at) || periods > missing_max;
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

    fn counters(frames: &[(u32, u64)]) -> Vec<u32> {
        let mut axis = FrameAxis::new(100_000);
        frames.iter().map(|(number, time_us)| axis.counter(*number, *time_us)).collect()
    }

    #[test]
    fn another_rate_is_noticed_once_and_jumps_are_not() {
        const NONE: [u64; 0] = [];
        let run = |frame: &dyn Fn(u32) -> (u32, u64)| -> Vec<u64> {
            let mut check = RateCheck::default();
            let frames = (0..1000).map(frame);
            let follow = |(number, time_us)| check.follow(number, time_us, 100.0);
            frames.filter_map(follow).map(|hz| hz.round() as u64).collect()
        };
        let at = |number: u32, period_us: u64| (number, u64::from(number) * period_us);
        assert_eq!(run(&|n| at(n, 10_000)), NONE);
        assert_eq!(run(&|n| at(n, 10_050)), NONE, "a clock that is half a percent off");
        let changes = |n: u32| {
            let (slow, fast) = (n.min(500), n.saturating_sub(500));
            (n, u64::from(slow) * 10_000 + u64::from(fast) * 5_000)
        };
        assert_eq!(run(&changes), [200]);
        // Every second number, as from a QTM that processes half of the frames.
        assert_eq!(run(&|n| at(2 * n, 10_000)), NONE);
        assert_eq!(run(&|n| (1, u64::from(n) * 5_000)), NONE, "it stands still");
        assert_eq!(run(&|n| (n + 400 * (n / 300), u64::from(n) * 10_000)), NONE, "it jumps");
    }

    #[test]
    fn numbers_count_where_they_advance() {
        // A late time stamp between 7 and 8, then two frames missing.
        assert_eq!(counters(&[(7, 0), (8, 14_000), (9, 20_000), (12, 50_000)]), [7, 8, 9, 12]);
        assert_eq!(counters(&[(u32::MAX, 0), (0, 10_000), (1, 20_000)]), [u32::MAX, 0, 1]);
    }

    #[test]
    fn time_counts_where_the_number_stands_still() {
        let frames = [(1, 0), (1, 10_000), (1, 20_001), (1, 49_998), (1, 60_000)];
        assert_eq!(counters(&frames), [1, 2, 3, 6, 7]);
        // Two frames of 10 ms that QTM stamped 3 ms apart are still two.
        assert_eq!(counters(&[(1, 0), (1, 3_000)]), [1, 2]);
    }

    #[test]
    fn jitter_of_time_stamps_does_not_add_up() {
        // 3 ms late, the next one lost, and 4 ms early: intervals of 13 ms, of which none is two frames.
        assert_eq!(counters(&[(1, 0), (1, 13_000), (1, 26_000)]), [1, 2, 4]);
        // A true rate that is 0.1 % below the stated one.
        let frames: Vec<_> = (0..5000).map(|k| (1, k * 10_010)).collect();
        assert_eq!(counters(&frames), (1..=5000).collect::<Vec<_>>());
    }

    #[test]
    fn a_number_that_catches_up_is_not_counted_twice() {
        let frames = [(1, 0), (1, 10_000), (1, 20_000), (4, 30_000), (5, 40_000), (7, 60_000)];
        assert_eq!(counters(&frames), [1, 2, 3, 4, 5, 7]);
    }

    #[test]
    fn late_frames_and_duplicates_move_nothing() {
        let by_number = [(5, 50_000), (7, 70_000), (6, 60_000), (7, 70_000), (8, 80_000)];
        assert_eq!(counters(&by_number), [5, 7, 6, 7, 8]);
        let by_time = [(1, 50_000), (1, 70_000), (1, 60_000), (1, 70_000), (1, 80_000)];
        assert_eq!(counters(&by_time), [1, 3, 2, 3, 4]);
    }

    #[test]
    fn a_number_that_begins_to_advance_goes_on() {
        assert_eq!(counters(&[(1, 0), (1, 10_000), (2, 20_000), (3, 30_000)]), [1, 2, 3, 4]);
    }

    #[test]
    fn a_count_that_begins_again_goes_far_back() {
        assert_eq!(counters(&[(500, 5_000_000), (1, 10_000), (2, 20_000)]), [500, 1, 2]);
    }

    #[test]
    fn counter_wraps_around() {
        let mut counter = FrameCounter::default();
        assert_eq!(counter.step(u32::MAX - 1, 10), SeqStep::Next { missing: 0 });
        assert_eq!(counter.step(u32::MAX, 20), SeqStep::Next { missing: 0 });
        assert_eq!(counter.step(2, 50), SeqStep::Next { missing: 2 });
        assert_eq!(counter.step(2, 50), SeqStep::Stale);
        assert_eq!(counter.step(1, 40), SeqStep::Stale);
        assert_eq!(counter.step(3, 60), SeqStep::Next { missing: 0 });
    }

    #[test]
    fn a_time_is_that_of_an_earlier_frame() {
        let mut counter = FrameCounter::new(100.0, 1000);
        assert_eq!(counter.frames_back(5), None, "no frame yet");
        counter.step(7, 500);
        assert_eq!(counter.frames_back(500), Some(0));
        assert_eq!(counter.frames_back(476), Some(2));
        assert_eq!(counter.frames_back(511), None, "after the last frame");
    }

    #[test]
    fn after_an_outage_a_device_continues_or_restarts() {
        let mut counter = FrameCounter::default();
        assert_eq!(counter.rejoin(7, 10), Some(0), "nothing came before");
        assert_eq!(counter.rejoin(20, 300), Some(12));
        assert_eq!(counter.rejoin(0, 5), None, "counter and clock began anew");
        assert_eq!(counter.step(1, 15), SeqStep::Next { missing: 0 });
        assert_eq!(counter.rejoin(1, 15), None, "as early as before, by another clock");
        assert_eq!(counter.rejoin(9, 3), None, "a clock that went back");
        counter.step(u32::MAX, 400);
        assert_eq!(counter.rejoin(2, 500), Some(2), "through the wrap");
    }

    #[test]
    fn after_an_outage_the_clock_counts_if_the_counter_stood_still() {
        let mut counter = FrameCounter::new(100.0, 1000);
        counter.step(10, 100);
        assert_eq!(counter.rejoin(11, 5_100), Some(499), "stopped for five seconds");
        assert_eq!(counter.rejoin(111, 6_100), Some(99), "they agree");
        assert_eq!(counter.rejoin(112, 6_180), Some(0), "a clock that is read late says little");
    }

    #[test]
    fn a_counter_that_is_ahead_of_its_own_clock_is_a_jump() {
        let mut counter = FrameCounter::new(100.0, 1000);
        counter.step(0, 0);
        assert_eq!(counter.step(501, 5010), SeqStep::Next { missing: 500 }, "five seconds elapsed");
        assert_eq!(counter.step(1002, 5020), SeqStep::Jump, "a hundredth elapsed");
        assert_eq!(counter.step(1003, 5030), SeqStep::Next { missing: 0 });
        assert_eq!(counter.step(1010, 5040), SeqStep::Next { missing: 6 }, "too few to doubt");
        assert_eq!(counter.step(1111, 5300), SeqStep::Next { missing: 100 }, "a misstated rate");
        assert_eq!(counter.step(1212, 4000), SeqStep::Next { missing: 100 }, "a clock set back");
        let mut counter = FrameCounter::default();
        counter.step(0, 0);
        assert_eq!(counter.step(501, 1), SeqStep::Next { missing: 500 }, "an unknown clock");
    }

    #[test]
    fn a_counter_that_starts_again_is_a_jump() {
        let mut counter = FrameCounter::default();
        counter.step(500, 10);
        assert_eq!(counter.step(480, 20), SeqStep::Jump, "its clock went on");
        assert_eq!(counter.step(0, 5), SeqStep::Jump, "counter and clock began anew");
        assert_eq!(counter.step(1, 30), SeqStep::Next { missing: 0 });
        assert_eq!(counter.step(1 << 30, 40), SeqStep::Jump);
    }

    #[test]
    fn frames_that_were_produced_are_counted_through_jumps() {
        let mut frames = ProducedFrames::new(100_000, 1_000_000);
        let times = [(0, 0), (1, 10_000), (4, 40_000), (3, 30_000), (4, 40_000)];
        let new = times.map(|(seq, ticks)| frames.follow(seq, ticks));
        assert_eq!((new, frames.produced()), ([true, true, true, false, false], 5));
        assert!(frames.follow(50_000_004, 50_000) && frames.follow(50_000_005, 60_000));
        assert_eq!(frames.produced(), 7, "forth");
        assert!(frames.follow(10, 70_000) && frames.follow(12, 90_000));
        assert_eq!(frames.produced(), 10, "back");
    }

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
    fn after_a_long_outage_the_time_counts_as_well() {
        let mut axis = axis();
        numbers(&mut axis, &[0.0, 1.0, 2.0]);
        assert_eq!(numbers(&mut axis, &[2_000_003.0]), [3], "a pause");
        axis.rejoin();
        assert_eq!(numbers(&mut axis, &[5_000_003.0]), [3_000_003], "eight hours");
    }

    #[test]
    fn samples_without_a_rate_are_numbered_one_by_one() {
        let mut axis = SampleAxis::new(None);
        assert_eq!(numbers(&mut axis, &[0.0, 7.0, 7.0, 3.0]), [0, 1, 2, 3]);
    }
}
