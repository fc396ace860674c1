//! Millimetres and micrometres.

/// To the nearest micrometre, halves away from zero. `None` when a coordinate is outside i32.
#[inline]
pub(super) fn micrometres(position_mm: [f32; 3]) -> Option<[i32; 3]> {
    let [x, y, z] = position_mm.map(|mm| {
        // A f32 times 1000 is exact in f64, and so is the half added: truncation rounds rightly.
        let um = f64::from(mm) * 1000.0;
        (um + 0.5f64.copysign(um)) as i64
    });
    Some([i32::try_from(x).ok()?, i32::try_from(y).ok()?, i32::try_from(z).ok()?])
}

/// The f32 nearest to it.
#[inline]
pub(super) fn millimetres(position_um: [i32; 3]) -> [f32; 3] {
    position_um.map(|um| (f64::from(um) / 1000.0) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_to_the_nearest_micrometre() {
        assert_eq!(micrometres([0.0005, -0.0005, 0.000_499]), Some([1, -1, 0]));
        assert_eq!(micrometres([1234.567, -0.0, 1e-30]), Some([1_234_567, 0, 0]));
        assert_eq!(
            micrometres([2_147_483.5, -2_147_483.5, 0.0]),
            Some([2_147_483_500, -2_147_483_500, 0])
        );
    }

    #[test]
    fn says_when_a_coordinate_does_not_fit() {
        assert_eq!(micrometres([2_147_484.0, 0.0, 0.0]), None);
        assert_eq!(micrometres([0.0, 0.0, -3.0e38]), None);
    }

    #[test]
    fn comes_back_within_half_a_micrometre_where_f32_can_hold_it() {
        for mm in [0.0f32, 0.001, 999.999, -4321.1235, 8000.0005] {
            let back = millimetres(micrometres([mm; 3]).unwrap())[0];
            assert!(
                (back - mm).abs() <= 0.0005 + mm.abs() * f32::EPSILON,
                "{mm} came back as {back}"
            );
        }
    }
}
