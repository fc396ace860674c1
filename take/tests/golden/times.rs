//! The times and losses of a recording's rows: seeded, in integers.

use mocapd_take::timeline::{LossCauses, RowTime, Timeline};

use super::motion::Random;

/// Rows per second.
pub(crate) const RATE_HZ: u64 = 120;

/// Ticks per second.
pub(crate) const TICK_HZ: u64 = 1_000_000;

/// Rows of a full stretch.
pub(crate) const STRETCH_ROWS: u32 = 60;

/// A stretch of a recording.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan {
    pub(crate) key: bool,
    /// Rows lost before it, and the causes.
    pub(crate) lost_before: (u64, LossCauses),
    pub(crate) n_rows: u32,
    /// Offsets of rows lost inside it, and the causes.
    pub(crate) lost: &'static [(u64, LossCauses)],
    /// Whether no marker is visible.
    pub(crate) empty: bool,
}

const NOTHING: Plan = Plan {
    key: false,
    lost_before: (0, LossCauses(0)),
    n_rows: STRETCH_ROWS,
    lost: &[],
    empty: false,
};

/// Three and a half seconds: a short first stretch, an empty one, rows lost for every cause, two keys.
pub(crate) const PLANS: [Plan; 8] = [
    Plan { key: true, n_rows: 6, ..NOTHING },
    NOTHING,
    Plan { lost: &[(20, LossCauses::NOT_RECEIVED), (21, LossCauses::NOT_RECEIVED)], ..NOTHING },
    Plan { empty: true, ..NOTHING },
    Plan { lost: &[(9, LossCauses::RING_FULL), (10, LossCauses::NOT_RECEIVED)], ..NOTHING },
    // Not received while the device was disconnected.
    Plan { key: true, lost_before: (70, LossCauses(1 | 4)), ..NOTHING },
    Plan { n_rows: 27, ..NOTHING },
    // The take ends with lost rows.
    Plan { lost_before: (4, LossCauses::NOT_RECEIVED), n_rows: 0, ..NOTHING },
];

/// Number of rows.
pub(crate) fn n_rows() -> usize {
    PLANS.iter().map(|plan| plan.lost_before.0 as usize + plan.n_rows as usize).sum()
}

/// The time lines of [`PLANS`].
pub(crate) fn timelines() -> Vec<Timeline> {
    let mut random = Random(9);
    let mut arrived_10us = 0;
    let mut row = 0;
    let timeline = |plan: &Plan| {
        let mut timeline = Timeline::default();
        timeline.restart(row);
        timeline.push_lost(plan.lost_before.0, plan.lost_before.1);
        for offset in 0..u64::from(plan.n_rows) {
            let at = row + timeline.n_rows();
            match plan.lost.iter().find(|lost| lost.0 == offset) {
                Some(&(_, causes)) => timeline.push_lost(1, causes),
                None => timeline.push(time(at, &mut random, &mut arrived_10us)),
            }
        }
        row += timeline.n_rows();
        timeline
    };
    PLANS.iter().map(timeline).collect()
}

fn time(row: u64, random: &mut Random, arrived_10us: &mut u64) -> RowTime {
    // A clock that is sometimes a tick late, and jumps once.
    let slips = u64::from(random.below(40) == 0) + if row > 110 { 1_234 } else { 0 };
    // The host's clock runs 40 ppm fast. Every eighth frame arrives together with the previous one; some are delayed.
    let due = 123_456_789 + row * 2_500_100 / 3_000 + random.below(25);
    let held_back = if (150..156).contains(&row) { 15_000 } else { 0 };
    if row % 8 != 7 {
        *arrived_10us = (*arrived_10us).max(due + held_back);
    }
    RowTime {
        device_ticks: 5_000_000_000 + row * TICK_HZ / RATE_HZ + slips,
        arrival_10us: *arrived_10us,
        timecode: (row >= 30).then(|| timecode(row / 4)),
    }
}

/// At 30 frames per second, past midnight.
fn timecode(frame: u64) -> [u8; 4] {
    let frames = (24 * 3600 - 2) * 30 + 10 + frame;
    let seconds = frames / 30 % (24 * 3600);
    [seconds / 3600, seconds / 60 % 60, seconds % 60, frames % 30].map(|part| part as u8)
}
