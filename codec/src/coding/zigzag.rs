//! Signed to unsigned integers, small magnitudes first: 0, -1, 1, -2, 2, ...

pub(crate) const fn encode(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

pub(crate) const fn decode(code: u64) -> i64 {
    (code >> 1) as i64 ^ -((code & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_trips_in_order_of_magnitude() {
        for (code, value) in [0, -1, 1, -2, 2].into_iter().enumerate() {
            assert_eq!(encode(value), code as u64);
        }
        for value in [i64::MIN, i64::MIN + 1, -77, 0, 1 << 40, i64::MAX] {
            assert_eq!(decode(encode(value)), value);
        }
    }
}
