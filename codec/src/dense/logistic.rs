//! Probabilities and their logits, in integers.
//!
//! A probability has 16 bits, a logit ln(p / (1 - p)) is in 1/256.

use std::sync::LazyLock;

/// Logits are cut to plus and minus this.
pub(super) const MAX_LOGIT: i32 = 2047;

/// 65536 / (1 + exp(-x)) at x = -8, -7.875 ... 8.
const KNOTS: [i32; 129] = [
    22, 25, 28, 32, 36, 41, 47, 53, 60, 68, 77, 87, 98, 111, 126, 143, 162, 184, 208, 236, 267,
    302, 342, 387, 439, 497, 562, 636, 720, 815, 922, 1042, 1179, 1333, 1506, 1701, 1921, 2168,
    2446, 2758, 3108, 3500, 3938, 4427, 4971, 5577, 6249, 6992, 7812, 8714, 9702, 10782, 11955,
    13226, 14595, 16062, 17625, 19282, 21025, 22849, 24743, 26695, 28693, 30723, 32768, 34813,
    36843, 38841, 40793, 42687, 44511, 46254, 47911, 49474, 50941, 52310, 53581, 54754, 55834,
    56822, 57724, 58544, 59287, 59959, 60565, 61109, 61598, 62036, 62428, 62778, 63090, 63368,
    63615, 63835, 64030, 64203, 64357, 64494, 64614, 64721, 64816, 64900, 64974, 65039, 65097,
    65149, 65194, 65234, 65269, 65300, 65328, 65352, 65374, 65393, 65410, 65425, 65438, 65449,
    65459, 65468, 65476, 65483, 65489, 65495, 65500, 65504, 65508, 65511, 65514,
];

/// The probability of a logit, linear between the knots.
fn squashed(logit: i32) -> u16 {
    let at = logit + 2048;
    let (knot, rest) = ((at >> 5) as usize, at & 31);
    ((KNOTS[knot] * (32 - rest) + KNOTS[knot + 1] * rest + 16) >> 5) as u16
}

/// Tables both ways.
#[derive(Debug)]
pub(super) struct Logistic {
    probabilities: [u16; 2 * MAX_LOGIT as usize + 1],
    logits: [i16; 4096],
}

static TABLES: LazyLock<Logistic> = LazyLock::new(|| {
    let probabilities = std::array::from_fn(|i| squashed(i as i32 - MAX_LOGIT));
    // The smallest logit whose probability is not below the middle of the interval.
    let mut logit = -MAX_LOGIT;
    let logits = std::array::from_fn(|i| {
        while logit < MAX_LOGIT && i32::from(squashed(logit)) < i as i32 * 16 + 8 {
            logit += 1;
        }
        logit as i16
    });
    Logistic { probabilities, logits }
});

impl Logistic {
    /// The tables, built on first use.
    pub(super) fn tables() -> &'static Self {
        &TABLES
    }

    /// Of a logit in any range.
    pub(super) fn probability(&self, logit: i64) -> i32 {
        let logit = logit.clamp(-i64::from(MAX_LOGIT), i64::from(MAX_LOGIT)) as i32;
        i32::from(self.probabilities[(logit + MAX_LOGIT) as usize])
    }

    /// Of a probability.
    pub(super) fn logit(&self, probability: u16) -> i32 {
        i32::from(self.logits[usize::from(probability >> 4)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_agree_with_the_logistic_function() {
        let tables = Logistic::tables();
        for logit in -MAX_LOGIT..=MAX_LOGIT {
            let truth = 65536.0 / (1.0 + (-f64::from(logit) / 256.0).exp());
            assert!((f64::from(tables.probability(logit.into())) - truth).abs() < 20.0, "{logit}");
        }
        for p in (0..=u16::MAX).step_by(7) {
            let back = tables.probability(tables.logit(p).into());
            // A logit step is up to 64 wide, a bucket of probabilities 16.
            assert!((back - i32::from(p)).abs() <= 80, "{p} {back}");
        }
        assert!(tables.logits.is_sorted());
    }
}
