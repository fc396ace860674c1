//! Probabilities and their logits, in integers.
//!
//! A probability has 16 bits, a logit ln(p / (1 - p)) is in 1/256.

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

/// Odds of a mixed bit are not less than this, nor more than 2^16 less this.
const LEAST: i32 = 24;

/// The probability of a logit, linear between the knots.
const fn squashed(logit: i32) -> i32 {
    let at = logit + 2048;
    let (knot, rest) = ((at >> 5) as usize, at & 31);
    (KNOTS[knot] * (32 - rest) + KNOTS[knot + 1] * rest + 16) >> 5
}

/// What is left of 2^16 by the probabilities of all logits.
static UNSET: [u16; 2 * MAX_LOGIT as usize + 1] = {
    let mut table = [0; 2 * MAX_LOGIT as usize + 1];
    let mut logit = -MAX_LOGIT;
    while logit <= MAX_LOGIT {
        let unset = (1 << 16) - squashed(logit);
        let least = if unset < LEAST { LEAST } else { unset };
        let most = (1 << 16) - LEAST;
        table[(logit + MAX_LOGIT) as usize] = if least > most { most } else { least } as u16;
        logit += 1;
    }
    table
};

/// By interval of probabilities: the smallest logit whose probability is not below the middle of it.
static LOGITS: [i16; 4096] = {
    let mut table = [0; 4096];
    let mut logit = -MAX_LOGIT;
    let mut i = 0;
    while i < table.len() {
        while logit < MAX_LOGIT && squashed(logit) < i as i32 * 16 + 8 {
            logit += 1;
        }
        table[i] = logit as i16;
        i += 1;
    }
    table
};

/// The probability of a bit not being set, of a logit in any range; never 0 or 2^16.
#[inline(always)]
pub(super) fn unset(logit: i64) -> u32 {
    let logit = logit.clamp(-i64::from(MAX_LOGIT), i64::from(MAX_LOGIT));
    u32::from(UNSET[(logit + i64::from(MAX_LOGIT)) as usize])
}

/// The logit of a probability.
#[inline(always)]
pub(super) const fn logit(probability: u16) -> i32 {
    LOGITS[(probability >> 4) as usize] as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_agree_with_the_logistic_function() {
        let probability = |logit: i32| 65536 - unset(logit.into()) as i32;
        for logit in -MAX_LOGIT..=MAX_LOGIT {
            let truth = 65536.0 / (1.0 + (-f64::from(logit) / 256.0).exp());
            assert!((f64::from(probability(logit)) - truth).abs() < 20.0, "{logit}");
        }
        for p in (0..=u16::MAX).step_by(7) {
            let back = probability(logit(p));
            // A logit step is up to 64 wide, a bucket of probabilities 16.
            assert!((back - i32::from(p)).abs() <= 80, "{p} {back}");
        }
        assert!(LOGITS.is_sorted());
    }
}
