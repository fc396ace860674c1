//! What contexts make of a size: its class.

/// Of a size up to 10: 0, 1, 2, 3 or 4, 5 to 9, more.
const SIX: [u8; 11] = [0, 1, 2, 3, 3, 4, 4, 4, 4, 4, 5];

/// Where a class of activities ends and the next one begins, in 1/256.
const LIMITS: [u32; 7] = [5, 20, 51, 102, 205, 410, 1024];
const LAST_LIMIT: usize = 1024;

/// Classes of activities up to the last limit.
static EIGHT: [u8; LAST_LIMIT + 1] = {
    let mut table = [0; LAST_LIMIT + 1];
    let (mut activity, mut class) = (0, 0);
    while activity <= LAST_LIMIT {
        if activity as u32 == LIMITS[class as usize] {
            class += 1;
        }
        table[activity] = class;
        activity += 1;
    }
    table
};

/// Of a sum of magnitudes: 0, 1, 2, 3 or 4, 5 to 9, more.
#[inline(always)]
pub(super) fn six(sum: i32) -> usize {
    usize::from(SIX[(sum as usize).min(SIX.len() - 1)])
}

/// Of an activity in 1/256.
#[inline(always)]
pub(super) fn eight(activity: i32) -> usize {
    usize::from(EIGHT[(activity as usize).min(LAST_LIMIT)])
}

/// Half octaves of an expectation in 1/256; nothing below 4.
#[inline(always)]
pub(super) fn thirty_two(expectation: i32) -> usize {
    let expectation = expectation.max(3) as usize;
    let octave = expectation.ilog2() as usize;
    // The first two bits are 2 or 3: 3 is the last of class 0, of octave 1.
    ((expectation >> (octave - 1)) + 2 * octave - 5).min(31)
}

/// 0 zero, 1 positive, 2 negative.
#[inline(always)]
pub(super) fn sign(step: i16) -> usize {
    usize::from(step > 0) + 2 * usize::from(step < 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_begin_where_they_are_said_to() {
        assert_eq!([0, 1, 2, 3, 4, 5, 9, 10, 8100].map(six), [0, 1, 2, 3, 3, 4, 4, 5, 5]);
        for activity in 0..3000 {
            let passed = LIMITS.iter().filter(|&&limit| activity as u32 >= limit).count();
            assert_eq!(eight(activity), passed, "{activity}");
        }
        assert_eq!([0, 3, 4, 5, 6, 7, 8, 11, 12].map(thirty_two), [0, 0, 1, 1, 2, 2, 3, 3, 4]);
        assert_eq!(thirty_two(i32::MAX), 31);
        assert_eq!([-3, 0, 2].map(sign), [2, 0, 1]);
    }
}
