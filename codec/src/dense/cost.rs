//! Counts the cost of decisions under a model that does not adapt, without coding them.

use super::model::ModelCoder;
use crate::coding::range::BinaryCoder;

/// Fraction bits of a cost: it is in 2^-10 bits.
pub(super) const COST_FRACTION_BITS: u32 = 10;

/// Cost of a decision by its probability in 2^-12, at the middle of each interval. Integers, so that every machine
/// makes the same plans: the binary digits of a logarithm come from repeated squaring.
static COSTS: [u16; 4096] = {
    let mut costs = [0; 4096];
    let mut i = 0;
    while i < costs.len() {
        // The mantissa of (2 i + 1) / 2^13, from 1 up to 2 in 2^-31.
        let odd = 2 * i as u64 + 1;
        let exponent = odd.ilog2();
        let mut mantissa = odd << (31 - exponent);
        let mut log = exponent as u16;
        let mut digit = 0;
        while digit < COST_FRACTION_BITS {
            mantissa = (mantissa * mantissa) >> 31;
            let above = mantissa >> 32;
            log = log << 1 | above as u16;
            mantissa >>= above;
            digit += 1;
        }
        costs[i] = (13 << COST_FRACTION_BITS) - log;
        i += 1;
    }
    costs
};

/// Counts the cost of decisions in 2^-10 bits.
#[derive(Debug, Default)]
pub(super) struct CostCounter {
    pub(super) cost: u64,
}

impl BinaryCoder for CostCounter {
    #[inline(always)]
    fn split(&mut self, probability: u32, bit: bool) -> bool {
        let probability = if bit { 65536 - probability } else { probability };
        self.cost += u64::from(COSTS[(probability >> 4) as usize % COSTS.len()]);
        bit
    }

    #[inline(always)]
    fn plain(&mut self, value: u64, n: u32) -> u64 {
        self.cost += u64::from(n) << COST_FRACTION_BITS;
        value & ((1 << n) - 1)
    }
}

impl ModelCoder for CostCounter {
    const LEARNS: bool = false;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_agree_with_the_logarithm() {
        for (i, &cost) in COSTS.iter().enumerate() {
            let bits = 13.0 - (2.0 * i as f64 + 1.0).log2();
            assert!((f64::from(cost) / 1024.0 - bits).abs() < 0.001_5, "{i}: {cost} for {bits}");
        }
        let mut counter = CostCounter::default();
        assert!(counter.split(1 << 15, true));
        assert_eq!(counter.plain(0b110_1010, 4), 0b1010);
        assert!(counter.cost.abs_diff(5 << COST_FRACTION_BITS) <= 2, "{}", counter.cost);
    }
}
