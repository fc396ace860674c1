//! Seeded motion that is identical on every machine: computed with integers, without sine or logarithm.

use mocapd_codec::{Position, Rows};

/// The markers of [`markers`].
pub(crate) const MARKERS: usize = 20;

/// This marker has a sample in one of five rows.
const SINGLES: usize = 4;

/// This marker appears late and ends with a spike.
const LATE: usize = 5;

/// From this marker on, pairs of markers are on limbs, with gaps.
const LIMBS: usize = 6;

/// One marker, row by row.
#[derive(Debug, Clone)]
pub(crate) struct Column {
    pub(crate) positions: Vec<Position>,
    pub(crate) present: Vec<bool>,
}

impl Column {
    pub(crate) fn part(&self, rows: std::ops::Range<usize>) -> Rows<'_> {
        Rows::new(&self.positions[rows.clone()], &self.present[rows]).unwrap()
    }

    pub(crate) fn drop_front(&mut self, rows: usize) {
        self.positions.drain(..rows);
        self.present.drain(..rows);
    }

    fn sample(&mut self, position: Position, present: bool) {
        self.positions.push(position);
        self.present.push(present);
    }
}

/// A small generator (Knuth's MMIX constants).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, n: u64) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    /// From `-most` to `most`.
    fn within(&mut self, most: i64) -> i64 {
        self.below(2 * most as u64 + 1) as i64 - most
    }
}

/// A point on an approximate circle, in micrometres / 2^16.
struct Circle {
    x: i64,
    y: i64,
    /// Radians per row * 2^16.
    speed: i64,
}

impl Circle {
    fn new(random: &mut Random, radius_mm: i64) -> Self {
        // 0.4 to 2.5 Hz at 120 Hz.
        let speed = 1_400 + random.below(7_200) as i64;
        Self { x: (random.within(radius_mm) * 1000) << 16, y: (radius_mm * 1000) << 16, speed }
    }

    fn next_um(&mut self) -> i64 {
        self.x -= (self.y * self.speed) >> 16;
        self.y += (self.x * self.speed) >> 16;
        self.x >> 16
    }
}

/// [`MARKERS`] markers: one at rest, one 10 km away, one that jumps, one on a line, one visible in single rows, one
/// that appears late, and pairs on limbs of a swaying body.
pub(crate) fn markers(n_rows: usize) -> Vec<Column> {
    let mut random = Random(20_120);
    let column = Column { positions: Vec::new(), present: Vec::new() };
    let mut columns = vec![column; MARKERS];
    let mut circles = |n: usize, radius_mm: i64| -> Vec<[Circle; 3]> {
        (0..n).map(|_| [(); 3].map(|()| Circle::new(&mut random, radius_mm))).collect()
    };
    let mut body = circles(1, 400);
    let mut limbs = circles((MARKERS - LIMBS) / 2, 150);
    let mut seen = [true; MARKERS];
    let mut jumped = [1_000_000, 0, 2_000_000];
    for row in 0..n_rows as i64 {
        let [sway] = &mut body[..] else { unreachable!("one body") };
        let sway = sway.each_mut().map(Circle::next_um);
        for (i, seen) in seen.iter_mut().enumerate() {
            *seen ^= random.below(if *seen { 70 } else { 9 }) == 0;
            columns[i].sample([0.0; 3], i < SINGLES && i != 2 || *seen);
        }
        if random.below(35) == 0 {
            jumped = [(); 3].map(|()| random.within(3_000_000));
        }
        let near = |at: [i64; 3], by: [i64; 3]| mm([at[0] + by[0], at[1] + by[1], at[2] + by[2]]);
        let mut noise = |um: i64| [(); 3].map(|()| random.within(um));
        let mut set = |i: usize, position| columns[i].positions[row as usize] = position;
        set(0, mm([123_456, -789_012, 1_000_001]));
        set(1, near([10_000_000_000, -4_000_000, 900_000], sway));
        set(2, near(jumped, noise(60)));
        set(3, mm([2_500 * row - 400_000, 700_000 - 333 * row, 10 * row]));
        // Values near the limits of float32.
        let tiny = f32::from_bits(7 + row as u32);
        set(SINGLES, [if row % 2 == 0 { -0.0 } else { 0.0 }, tiny, row as f32]);
        set(LATE, mm([row * row * 4, -row * row, 1_500_000]));
        for (limb, circles) in limbs.iter_mut().enumerate() {
            let by = circles.each_mut().map(Circle::next_um);
            let at = |part: i64| [part * 70_000, limb as i64 * 200_000, 1_000_000 + part * 31_000];
            // From no noise to more than the smallest tolerance.
            let um = [0, 15, 60, 250][limb % 4];
            for part in 0..2 {
                let swaying = std::array::from_fn(|axis| at(part as i64)[axis] + sway[axis]);
                let jitter = noise(um);
                let moved = std::array::from_fn(|axis| by[axis] + jitter[axis]);
                set(LIMBS + 2 * limb + part, near(swaying, moved));
            }
        }
    }
    for row in 0..n_rows {
        columns[SINGLES].present[row] = row % 5 == 2;
        columns[LATE].present[row] &= row > n_rows * 2 / 3;
    }
    let spike = n_rows * 8 / 9;
    columns[LATE].positions[spike] = [f32::MAX, -f32::MAX, f32::MIN_POSITIVE];
    columns[LATE].present[spike] = true;
    columns
}

fn mm(um: [i64; 3]) -> Position {
    um.map(|um| (um as f64 / 1000.0) as f32)
}
