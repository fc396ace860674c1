//! What an encoder chooses for rows: their residuals in steps, and with these the points.

/// Adding this and taking it off again rounds to the nearest integer, for values within 2^22; and its bits are then
/// that integer more.
const ROUND: f32 = 12_582_912.0;

/// Of a symbol: an axis is larger than +-1, and more must be written than the symbol.
pub(super) const LARGER: u8 = 1 << 7;

/// What it is chosen by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rule {
    pub(super) step: f32,
    pub(super) inverse: f32,
    /// Square of the tolerance.
    pub(super) ball: f32,
    /// Square of the largest distance that can be coded.
    pub(super) reach: f32,
}

/// One row.
pub(super) struct Chosen {
    pub(super) point: [f32; 3],
    pub(super) steps: [i32; 3],
    /// As without low bits; [`LARGER`] is set where it is not all.
    pub(super) symbol: u8,
    /// Of the magnitudes, cut to a byte.
    pub(super) sum: u8,
    /// A residual cannot be coded.
    pub(super) out_of_reach: bool,
}

impl Rule {
    /// Chooses for a row. Those of the `FINEST` level, on which nothing depends, have one step of +-1 less where that
    /// stays inside the ball. There is no branch: it is done to rows side by side.
    #[inline(always)]
    pub(super) fn row<const FINEST: bool>(self, target: [f32; 3], prediction: [f32; 3]) -> Chosen {
        let off = [0, 1, 2].map(|axis| target[axis] - prediction[axis]);
        let square = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
        // Not so where it is not a number.
        let in_reach = square <= self.reach;
        let scale = if square <= self.ball { 0.0 } else { self.inverse };
        let mut steps = off.map(|off| (off * scale + ROUND) - ROUND);
        if FINEST {
            steps = self.shorten(off, steps);
        }
        let values =
            steps.map(|steps| (steps + ROUND).to_bits().wrapping_sub(ROUND.to_bits()) as i32);
        let magnitudes = values.map(i32::unsigned_abs);
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let small = magnitudes[axis].wrapping_add(values[axis] as u32 >> 31);
            if magnitudes[axis] > 1 { 3 } else { small }
        });
        let [a, b, c] = magnitudes;
        let larger = if a.max(b).max(c) > 1 { u32::from(LARGER) } else { 0 };
        Chosen {
            point: [0, 1, 2].map(|axis| prediction[axis] + steps[axis] * self.step),
            steps: values,
            symbol: (x << 4 | y << 2 | z | larger) as u8,
            // Beyond what can be coded, these and the symbol are not looked at.
            sum: a.wrapping_add(b).wrapping_add(c).min(255) as u8,
            out_of_reach: !in_reach,
        }
    }

    /// Leaves out the step of +-1 that is missed least, where all else is inside the ball without it. Without a
    /// branch: it is done to rows side by side.
    #[inline(always)]
    fn shorten(self, off: [f32; 3], steps: [f32; 3]) -> [f32; 3] {
        let rest = [0, 1, 2].map(|axis| off[axis] - steps[axis] * self.step);
        let error = rest[0] * rest[0] + rest[1] * rest[1] + rest[2] * rest[2];
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let more = off[axis] * off[axis] - rest[axis] * rest[axis];
            if steps[axis].abs() == 1.0 { more } else { f32::INFINITY }
        });
        // Compared one by one: which of three it is would become a branch.
        let y_before_x = y < x;
        let least = if y_before_x { y } else { x };
        let z_first = z < least;
        let least = if z_first { z } else { least };
        let worth = error + least <= self.ball;
        let without = [!y_before_x & !z_first, y_before_x & !z_first, z_first];
        [0, 1, 2].map(|axis| if worth & without[axis] { 0.0 } else { steps[axis] })
    }
}

/// Chooses for all rows of a level. Each slice is one of its own, so that it is known to overlap with no other.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "a slice in an array may be any")]
pub(super) fn choose<const FINEST: bool>(
    rule: Rule,
    [tx, ty, tz]: [&[f32]; 3],
    x: &mut [f32],
    y: &mut [f32],
    z: &mut [f32],
    steps_x: &mut [i32],
    steps_y: &mut [i32],
    steps_z: &mut [i32],
    symbols: &mut [u8],
    sums: &mut [u8],
) -> bool {
    let n = sums.len();
    let (tx, ty, tz) = (&tx[..n], &ty[..n], &tz[..n]);
    let (x, y, z) = (&mut x[..n], &mut y[..n], &mut z[..n]);
    let (steps_x, steps_y, steps_z) = (&mut steps_x[..n], &mut steps_y[..n], &mut steps_z[..n]);
    let symbols = &mut symbols[..n];
    let mut out_of_reach = false;
    for i in 0..n {
        let chosen = rule.row::<FINEST>([tx[i], ty[i], tz[i]], [x[i], y[i], z[i]]);
        [x[i], y[i], z[i]] = chosen.point;
        [steps_x[i], steps_y[i], steps_z[i]] = chosen.steps;
        symbols[i] = chosen.symbol;
        sums[i] = chosen.sum;
        out_of_reach |= chosen.out_of_reach;
    }
    out_of_reach
}

/// The largest square of a distance between rows, as bits: what is not a number is largest of all.
#[inline(always)]
pub(super) fn worst(targets: [&[f32]; 3], points: [&[f32]; 3]) -> u64 {
    let n = targets[0].len();
    let ([a, b, c], [x, y, z]) =
        (targets.map(|plane| &plane[..n]), points.map(|plane| &plane[..n]));
    let mut worst = 0;
    for i in 0..n {
        worst = worst.max(square([a[i], b[i], c[i]], [x[i], y[i], z[i]]).to_bits() as i64);
    }
    worst as u64
}

/// In float64, as errors are stated.
#[inline(always)]
pub(super) fn square(target: [f32; 3], point: [f32; 3]) -> f64 {
    let [x, y, z] = [0, 1, 2].map(|axis| f64::from(target[axis]) - f64::from(point[axis]));
    // Without the sign that what is not a number may have.
    (x * x + y * y + z * z).abs()
}
