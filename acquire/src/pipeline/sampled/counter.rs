//! Derives lost and repeated samples from the numbers of a group's batches.

use mocapd_drivers::device::SampleBatch;
use mocapd_take::timeline::LossCauses;

/// Numbers at most this many seconds of samples behind are those of a batch that came late or twice: links do not reorder
/// further. Beyond it the device started again.
const LATE_S_MAX: f64 = 0.7;

/// How much earlier than the numbers say the time of a late batch may be: the batch before may have been stamped late.
const LATE_STAMP_S: f64 = 0.05;

/// Gaps up to this many seconds are never doubted, whatever the clock says: a few batches.
const DOUBTED_S_MIN: f64 = 0.5;

/// Numbers that advanced this many times further than the device's clock allows jumped: as for frames.
const CLOCK_FACTOR: f64 = 4.0;

/// Largest gap that counts as loss in any case: an hour at 1 MHz. A take can state it in few bytes.
const MISSING_MAX: i64 = 1 << 32;

/// Time by which a batch may differ from where the one before leads, in seconds, and still be of the same run: devices
/// stamp batches when they are read out. Two periods of a slow group exceed it.
const JITTER_S: f64 = 5e-3;

/// Difference of the rates of a device's clock and its converters over a gap: crystals and what a device does to them
/// stay well below.
const DRIFT: f64 = 1e-3;

/// The same of the rows of frames, whose samples have their rows by their numbers: their times need be only those of the
/// neighbourhood.
const ROW_JITTER_S: f64 = 0.1;

/// Follows the times of the rows of frames.
#[derive(Debug)]
pub(super) struct RowSteps {
    rate_hz: f64,
    tick_hz: f64,
    /// The last row's ticks, and how many rows were lost since.
    last: Option<(u64, u64)>,
    /// Time from the row before it to the last one, in seconds.
    step_s: Option<f64>,
}

impl RowSteps {
    pub(super) fn new(rate_hz: f64, tick_hz: u64) -> Self {
        Self { rate_hz, tick_hz: tick_hz as f64, last: None, step_s: None }
    }

    pub(super) fn lose(&mut self, rows: u64) {
        if let Some((_, lost)) = &mut self.last {
            *lost = lost.saturating_add(rows);
        }
    }

    /// Takes a row's time. Returns whether it is where the row before leads, at the rate or at the step before: a device whose
    /// steps are longer than its rate says has runs, too.
    pub(super) fn step(&mut self, device_ticks: u64) -> bool {
        let Some((before, lost)) = self.last.replace((device_ticks, 0)) else { return false };
        let passed_s = device_ticks.wrapping_sub(before).cast_signed() as f64 / self.tick_hz;
        let n_rows = lost.saturating_add(1) as f64;
        let last_step_s = self.step_s.replace(passed_s / n_rows);
        let leads_there = |step_s: f64| {
            let ahead_s = n_rows * step_s;
            let jitter_s = ROW_JITTER_S.max(2.0 / self.rate_hz) + DRIFT * ahead_s;
            (passed_s - ahead_s).abs() <= jitter_s
        };
        // Rows that were stamped alike follow each other, too.
        passed_s >= 0.0 && (leads_there(1.0 / self.rate_hz) || last_step_s.is_some_and(leads_there))
    }

    /// The device was away or started again.
    pub(super) fn rejoin(&mut self) {
        (self.last, self.step_s) = (None, None);
    }
}

/// What the numbers of a batch say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BatchStep {
    /// The next one, after `missing` samples.
    Next {
        missing: u64,
        causes: LossCauses,
        /// Whether its time is where the batch before leads.
        continues: bool,
    },
    /// It came before, or overlaps one that did.
    Duplicate,
    /// The numbers jumped as no loss explains, or began again.
    Jump,
}

/// What the next batch has if nothing is lost.
#[derive(Debug, Clone, Copy)]
struct Expected {
    first: u64,
    number: u32,
    device_ticks: u64,
}

/// Follows the numbers of a group.
#[derive(Debug)]
pub(super) struct SampleCounter {
    expected: Option<Expected>,
    /// What was expected when the device's clock last jumped: batches from before may still come.
    before_jump: Option<Expected>,
    /// Whether the device was away, or started again, since the last batch.
    rejoining: bool,
    rate_hz: f64,
    tick_hz: f64,
    /// Of a group with one sample a frame.
    rows: Option<RowSteps>,
}

impl SampleCounter {
    pub(super) fn new(rate_hz: f64, tick_hz: u64) -> Self {
        Self {
            expected: None,
            before_jump: None,
            rejoining: false,
            rate_hz,
            tick_hz: tick_hz as f64,
            rows: None,
        }
    }

    /// For a group with one sample a frame, at the frame's time: its runs go on as those of rows do.
    pub(super) fn of_rows(rate_hz: f64, tick_hz: u64) -> Self {
        Self { rows: Some(RowSteps::new(rate_hz, tick_hz)), ..Self::new(rate_hz, tick_hz) }
    }

    /// The device's numbers may begin again with the next batch.
    pub(super) fn rejoin(&mut self) {
        self.rejoining = self.expected.is_some();
    }

    pub(super) fn step(&mut self, batch: &SampleBatch<'_>) -> BatchStep {
        let rejoins = std::mem::take(&mut self.rejoining);
        let step = match self.expected {
            None => BatchStep::Next { missing: 0, causes: LossCauses(0), continues: false },
            Some(expected) => self.compare(batch, expected, rejoins),
        };
        if step == BatchStep::Duplicate {
            return step;
        }
        let step = self.in_step_with_rows(step, batch, rejoins);
        match step {
            BatchStep::Next { continues: false, .. } if !rejoins => {
                self.before_jump = self.expected;
            }
            BatchStep::Jump => self.before_jump = None,
            _ if rejoins => self.before_jump = None,
            _ => {}
        }
        let n = batch.n_samples() as u64;
        let passed = (n as f64 * self.tick_hz / self.rate_hz).round() as u64;
        self.expected = Some(Expected {
            first: batch.first.wrapping_add(n),
            number: batch.number.wrapping_add(1),
            device_ticks: batch.device_ticks.wrapping_add(passed),
        });
        step
    }

    fn in_step_with_rows(
        &mut self,
        step: BatchStep,
        batch: &SampleBatch<'_>,
        rejoins: bool,
    ) -> BatchStep {
        let Some(rows) = &mut self.rows else { return step };
        let BatchStep::Next { missing, causes, .. } = step else {
            rows.rejoin();
            rows.step(batch.device_ticks);
            return step;
        };
        if rejoins {
            rows.rejoin();
        }
        rows.lose(missing);
        // The end of a series states how many there were, and has none.
        let continues = batch.n_samples() == 0 || rows.step(batch.device_ticks);
        BatchStep::Next { missing, causes, continues }
    }

    /// How far a batch is ahead of what is expected, in samples, in seconds by its numbers and in seconds by its clock.
    fn ahead(&self, batch: &SampleBatch<'_>, expected: Expected) -> (i64, f64, f64) {
        let ahead = batch.first.wrapping_sub(expected.first).cast_signed();
        let ticks = batch.device_ticks.wrapping_sub(expected.device_ticks).cast_signed() as f64;
        (ahead, ahead as f64 / self.rate_hz, ticks / self.tick_hz)
    }

    /// Whether a batch came before one that led to `expected`, by its numbers and by its clock.
    fn is_late(&self, batch: &SampleBatch<'_>, expected: Expected) -> bool {
        let (ahead, ahead_s, passed_s) = self.ahead(batch, expected);
        let has_its_time = (ahead_s - LATE_STAMP_S..=ahead_s + JITTER_S).contains(&passed_s);
        ahead < 0 && -ahead_s <= LATE_S_MAX && has_its_time
    }

    fn compare(&self, batch: &SampleBatch<'_>, expected: Expected, rejoins: bool) -> BatchStep {
        let (ahead, ahead_s, passed_s) = self.ahead(batch, expected);
        if ahead < 0 {
            let mut tracks = std::iter::once(expected).chain(self.before_jump);
            // A device that started again may number as before, but its clock did, too.
            let is_late = !rejoins && tracks.any(|expected| self.is_late(batch, expected));
            return if is_late { BatchStep::Duplicate } else { BatchStep::Jump };
        }
        // A clock that went back proves nothing, unless the device was away.
        let is_refuted = match passed_s {
            passed_s if passed_s < -JITTER_S => rejoins,
            passed_s => ahead_s > DOUBTED_S_MIN && ahead_s > CLOCK_FACTOR * passed_s,
        };
        if is_refuted || ahead > MISSING_MAX {
            return BatchStep::Jump;
        }
        let causes = match batch.number == expected.number {
            _ if rejoins => LossCauses::DISCONNECTED,
            true => LossCauses::DROPPED_BY_DEVICE,
            false => LossCauses::NOT_RECEIVED,
        };
        let apart_s = (passed_s - ahead_s).abs();
        let continues = apart_s <= JITTER_S.max(2.0 / self.rate_hz) + DRIFT * ahead_s;
        BatchStep::Next { missing: ahead.cast_unsigned(), causes, continues: continues && !rejoins }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: LossCauses = LossCauses(0);
    const TEN: [f32; 10] = [0.0; 10];

    /// A batch of ten samples at 1000 Hz by a clock of 1 MHz.
    fn step(counter: &mut SampleCounter, number: u32, first: u64, device_ticks: u64) -> BatchStep {
        counter.step(&SampleBatch {
            group: 0,
            number,
            first,
            device_ticks,
            form: Default::default(),
            n_channels: 1,
            samples: &TEN,
        })
    }

    fn next(missing: u64, causes: LossCauses, continues: bool) -> BatchStep {
        BatchStep::Next { missing, causes, continues }
    }

    #[test]
    fn rows_go_on_through_jitter_and_losses_but_not_through_jumps_of_the_clock() {
        let mut rows = RowSteps::new(100.0, 1_000_000);
        assert!(!rows.step(5_000_000), "there is none before");
        assert!(rows.step(5_010_000) && rows.step(5_090_000), "stamped late");
        rows.lose(20);
        assert!(rows.step(5_300_000));
        assert!(rows.step(5_300_000) && rows.step(5_300_000), "the clock stood");
        assert!(!rows.step(5_100_000), "it went back");
        assert!(rows.step(5_110_000) && !rows.step(6_000_000), "it jumped");
        rows.rejoin();
        assert!(!rows.step(6_010_000));
    }

    fn started() -> SampleCounter {
        let mut counter = SampleCounter::new(1000.0, 1_000_000);
        assert_eq!(step(&mut counter, 5, 100, 7_000_000), next(0, NONE, false));
        counter
    }

    #[test]
    fn rows_whose_steps_are_longer_than_the_rate_says_are_of_one_run() {
        let mut rows = RowSteps::new(100.0, 1_000_000);
        let mut counter = SampleCounter::of_rows(100.0, 1_000_000);
        let mut poses = |number: u32, device_ticks: u64| {
            let samples = &TEN[..1];
            let (group, first, form) = (16, number.into(), Default::default());
            counter.step(&SampleBatch {
                group,
                number,
                first,
                device_ticks,
                form,
                n_channels: 1,
                samples,
            })
        };
        let causes = LossCauses::DROPPED_BY_DEVICE;
        for frame in 0..100_u32 {
            // 200 ms, give or take 40.
            let ticks = 7_000_000 + u64::from(frame) * 200_000 + u64::from(frame % 3) * 20_000;
            let continues = frame > 1;
            assert_eq!(rows.step(ticks), continues, "frame {frame}");
            let wanted = next(0, if frame > 0 { causes } else { NONE }, continues);
            assert_eq!(poses(frame, ticks), wanted, "frame {frame}");
        }
        assert!(!rows.step(60_000_000), "a pause");
        assert!(matches!(poses(100, 5_000_000), BatchStep::Next { continues: false, .. }), "back");
    }

    #[test]
    fn batch_numbers_tell_a_loss_on_the_link_from_one_in_the_device() {
        let mut counter = started();
        let causes = LossCauses::DROPPED_BY_DEVICE;
        assert_eq!(step(&mut counter, 6, 110, 7_010_000), next(0, causes, true));
        assert_eq!(step(&mut counter, 8, 130, 7_030_100), next(10, LossCauses::NOT_RECEIVED, true));
        assert_eq!(step(&mut counter, 9, 160, 7_060_000), next(20, causes, true));
    }

    #[test]
    fn batches_that_come_twice_or_overlap_are_duplicates_and_change_nothing() {
        let mut counter = started();
        assert_eq!(step(&mut counter, 5, 100, 7_000_000), BatchStep::Duplicate);
        assert_eq!(step(&mut counter, 4, 90, 6_990_000), BatchStep::Duplicate);
        assert_eq!(step(&mut counter, 6, 105, 7_005_000), BatchStep::Duplicate);
        assert_eq!(
            step(&mut counter, 6, 110, 7_010_000),
            next(0, LossCauses::DROPPED_BY_DEVICE, true)
        );
    }

    #[test]
    fn numbers_that_begin_again_or_run_ahead_of_the_clock_are_jumps() {
        let mut counter = started();
        assert_eq!(step(&mut counter, 0, 0, 0), BatchStep::Jump, "both began again");
        assert_eq!(step(&mut counter, 1, 5, 10_500), BatchStep::Jump, "its clock went on");
        assert_eq!(step(&mut counter, 2, 50_000, 30_000), BatchStep::Jump, "50 s in 10 ms");
        assert_eq!(step(&mut counter, 3, u64::MAX, 40_000), BatchStep::Jump, "51 s back");
        assert_eq!(step(&mut counter, 4, 9, 50_000), next(0, LossCauses::DROPPED_BY_DEVICE, true));
    }

    #[test]
    fn a_clock_that_jumps_begins_a_run_and_loses_nothing() {
        let mut counter = started();
        let causes = LossCauses::DROPPED_BY_DEVICE;
        assert_eq!(step(&mut counter, 6, 110, 2_000_000), next(0, causes, false));
        assert_eq!(step(&mut counter, 7, 120, 2_010_000), next(0, causes, true));
        assert_eq!(step(&mut counter, 8, 130, 9_000_000), next(0, causes, false));
        assert_eq!(step(&mut counter, 9, 140, 9_014_000), next(0, causes, true), "read out late");
    }

    #[test]
    fn a_batch_from_before_a_jump_of_the_clock_is_a_duplicate_behind_it() {
        let mut counter = started();
        let causes = LossCauses::DROPPED_BY_DEVICE;
        assert_eq!(step(&mut counter, 6, 110, 2_000_000), next(0, causes, false));
        assert_eq!(step(&mut counter, 5, 100, 7_000_000), BatchStep::Duplicate, "by the old clock");
        assert_eq!(step(&mut counter, 6, 110, 2_000_000), BatchStep::Duplicate, "by the new one");
        assert_eq!(step(&mut counter, 7, 120, 2_010_000), next(0, causes, true));
        assert_eq!(step(&mut counter, 0, 0, 0), BatchStep::Jump, "it started again");
        assert_eq!(
            step(&mut counter, 0, 0, 7_000_000),
            BatchStep::Jump,
            "the old clock is forgotten"
        );
    }

    #[test]
    fn after_an_outage_numbers_continue_or_begin_again() {
        let mut counter = started();
        counter.rejoin();
        let missing = next(4_990, LossCauses::DISCONNECTED, false);
        assert_eq!(step(&mut counter, 505, 5_100, 12_000_000), missing);
        counter.rejoin();
        assert_eq!(step(&mut counter, 0, 0, 0), BatchStep::Jump);
        counter.rejoin();
        assert_eq!(step(&mut counter, 0, 0, 0), BatchStep::Jump, "the same numbers as before");
        let mut counter = SampleCounter::new(1000.0, 1_000_000);
        counter.rejoin();
        assert_eq!(step(&mut counter, 9, 77, 5), next(0, NONE, false), "nothing came before");
    }
}
