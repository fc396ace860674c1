//! Seeded motion and presence of every kind that rigs send, and of kinds that none has sent so far.

use mocapd_codec::Position;

/// The kinds of motion.
pub(crate) const MOTIONS: [&str; 10] = [
    "constant", "walk", "smooth", "steps", "spikes", "far", "denormal", "zeros", "line", "extreme",
];

/// The kinds of presence.
pub(crate) const PRESENCES: [&str; 7] =
    ["all", "none", "alternate", "singles", "gaps", "late", "random"];

/// A small random generator (Knuth's MMIX constants) that gives the same numbers on every machine.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, n: u64) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    /// From -1 to 1.
    pub(crate) fn signed(&mut self) -> f32 {
        self.below(1 << 24) as f32 / (1 << 23) as f32 - 1.0
    }

    pub(crate) fn vector(&mut self, scale: f32) -> Position {
        [0; 3].map(|_| self.signed() * scale)
    }
}

pub(crate) fn positions(motion: &str, seed: u64, n: usize) -> Vec<Position> {
    let mut random = Random(seed);
    let origin = random.vector(2000.0);
    let mut at = origin;
    (0..n)
        .map(|i| {
            let t = i as f32 / 100.0;
            let smooth: Position = [
                origin[0] + 300.0 * (5.0 * t).sin(),
                origin[1] + 100.0 * (11.0 * t).cos(),
                origin[2] + 50.0 * t,
            ];
            match motion {
                "constant" => origin,
                "walk" => {
                    at = add(at, random.vector(3.0));
                    at
                }
                "smooth" => add(smooth, random.vector(0.05)),
                "steps" => {
                    if random.below(12) == 0 {
                        at = random.vector(9000.0);
                    }
                    add(at, random.vector(0.1))
                }
                "spikes" if random.below(20) == 0 => random.vector(1e5),
                "spikes" => smooth,
                "far" => add(smooth, [1e7, -1e7, 1e7]),
                "denormal" => random.vector(1e-40),
                "zeros" => [if i % 2 == 0 { 0.0 } else { -0.0 }; 3],
                "line" => [i as f32, -2.0 * i as f32, 0.5 * i as f32],
                "extreme" => [f32::MAX, -f32::MAX, f32::MIN_POSITIVE]
                    .map(|v| if random.below(3) == 0 { v } else { random.signed() }),
                _ => unreachable!("unknown motion {motion}"),
            }
        })
        .collect()
}

pub(crate) fn presence(kind: &str, seed: u64, n: usize) -> Vec<bool> {
    let mut random = Random(seed ^ 0x5555);
    let mut state = true;
    (0..n)
        .map(|i| match kind {
            "all" => true,
            "none" => false,
            "alternate" => i % 2 == 1,
            "singles" => i % 5 == 2,
            "gaps" => {
                state ^= random.below(if state { 25 } else { 6 }) == 0;
                state
            }
            "late" => i > n / 2,
            "random" => random.below(2) == 0,
            _ => unreachable!("unknown presence {kind}"),
        })
        .collect()
}

fn add(a: Position, b: Position) -> Position {
    std::array::from_fn(|axis| a[axis] + b[axis])
}
