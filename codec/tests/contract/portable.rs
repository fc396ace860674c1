//! Encoders write the same bytes on every machine: blocks of seeded motion, of which the digests are stored here.
//!
//! The motion is made by additions and multiplications alone, because sines differ from machine to machine.
//! CONTRIBUTING.md names the command that runs these tests as another processor.

use mocapd_codec::{
    Effort,
    sampled::{ChannelProfile, SampleBound, SampledEncoder},
};

use super::{
    Channel, KINDS, cut, encode_with,
    motions::{self, PRESENCES, Random},
    settings,
};

/// FNV-1a, 64 bits.
struct Digest(u64);

impl Digest {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

/// An oscillation of almost constant amplitude.
struct Oscillator {
    now: f64,
    before: f64,
    /// Twice the cosine of the angle from sample to sample.
    twice_cosine: f64,
}

impl Oscillator {
    fn new(random: &mut Random, scale: f64) -> Self {
        let mut number = || f64::from(random.signed());
        let before = scale * number();
        let slow = 1.0 - number().abs();
        Self { now: before + 0.02 * scale * number(), before, twice_cosine: 2.0 - 0.02 * slow }
    }

    fn next(&mut self) -> f64 {
        let next = self.twice_cosine * self.now - self.before;
        self.before = std::mem::replace(&mut self.now, next);
        next
    }
}

/// Markers on one body, with noise; the last one has motion of another kind.
fn group(random: &mut Random, n_markers: usize, n_rows: usize) -> Vec<Channel> {
    let scale = f64::from(1_u32 << random.below(12));
    let noise = scale * f64::from(random.signed()) * 0.01;
    let mut body: [_; 3] = std::array::from_fn(|_| Oscillator::new(random, scale));
    let path: Vec<[f64; 3]> =
        (0..n_rows).map(|_| std::array::from_fn(|axis| body[axis].next())).collect();
    let gaps = PRESENCES[random.below(PRESENCES.len() as u64) as usize];
    let mut channels: Vec<_> = (1..n_markers)
        .map(|marker| {
            let offset = random.vector(500.0).map(f64::from);
            let mut own = Oscillator::new(random, 0.2 * scale);
            let positions = path.iter().map(|body| {
                let swing = own.next();
                std::array::from_fn(|axis| {
                    let shaken = noise * f64::from(random.signed());
                    (body[axis] + offset[axis] + swing + shaken) as f32
                })
            });
            let positions = positions.collect();
            Channel { positions, present: motions::presence(gaps, marker as u64, n_rows) }
        })
        .collect();
    let kind = ["constant", "walk", "steps", "line", "zeros", "denormal"][random.below(6) as usize];
    channels.push(Channel::new(kind, "random", random.below(99), n_rows));
    channels
}

/// The digest of the blocks of many groups.
fn of_kind(kind: &str, effort: Effort, n_groups: u64) -> u64 {
    let mut digest = Digest::new();
    for seed in 0..n_groups {
        let mut random = Random(seed);
        let n_markers = 1 + random.below(9) as usize;
        let lengths = [40, 25, 1].map(|most| 1 + random.below(most) as usize);
        let channels = group(&mut random, n_markers, lengths.iter().sum());
        let tolerance_mm = [0.05, 0.3, 1.0, 7.5][random.below(4) as usize];
        let stretches = cut(&channels, &lengths, 1 << random.below(4));
        for block in encode_with(settings(kind, tolerance_mm), effort, &stretches) {
            digest.add(&block.shared);
            digest.add(&block.bytes);
        }
    }
    digest.0
}

#[test]
fn resamplers_write_the_same_bytes_on_every_machine() {
    let found = KINDS.map(|kind| (kind, of_kind(kind, Effort::MIN, 150)));
    assert_eq!(found, RESAMPLERS);
}

#[test]
fn every_effort_writes_the_same_bytes_on_every_machine() {
    let found = [2, 3, 5, 9].map(|level| {
        let n_groups = if level > 3 { 12 } else { 40 };
        (level, of_kind("dense", Effort::new(level).unwrap(), n_groups))
    });
    assert_eq!(found, EFFORTS);
}

/// Integers times a scale, text of three decimals, floats, or a level with repeats.
fn sampled_channel(random: &mut Random, n_rows: usize) -> Vec<f32> {
    let form = random.below(4);
    let scale = [1.0, 0.25, 0.1, 0.000_3][random.below(4) as usize];
    let reach = f64::from(1_u32 << random.below(14));
    let mut path = Oscillator::new(random, reach);
    let mut held = 0.0;
    (0..n_rows)
        .map(|_| {
            let value = path.next() + 3.0 * f64::from(random.signed());
            match form {
                0 => (value.round_ties_even() * scale) as f32,
                1 => ((value * 1000.0).round_ties_even() / 1000.0) as f32,
                2 => (value * scale) as f32,
                _ => {
                    held = if random.below(6) == 0 { value.round_ties_even() as f32 } else { held };
                    held
                }
            }
        })
        .collect()
}

#[test]
fn sampled_channels_have_the_same_bytes_on_every_machine() {
    let mut digest = Digest::new();
    for seed in 0..60 {
        let mut random = Random(seed);
        let n_rows = 20 + random.below(400) as usize;
        let mut channels: Vec<_> =
            (0..=random.below(5)).map(|_| sampled_channel(&mut random, n_rows)).collect();
        // Every second group has a bound in place of every bit.
        if seed % 2 == 1 {
            for samples in &mut channels {
                let mut profile = ChannelProfile::default();
                profile.add(samples);
                if let Some(bound) = SampleBound::new(&profile, 0.01 * profile.range()) {
                    digest.add(&bound.apply(samples).to_bits().to_le_bytes());
                }
            }
        }
        let mut encoder = SampledEncoder::new();
        let mut bytes = Vec::new();
        let middle = n_rows / 2;
        for (key, rows) in [(true, 0..middle), (seed % 4 == 0, middle..n_rows)] {
            let part: Vec<_> = channels.iter().map(|samples| &samples[rows.clone()]).collect();
            encoder.encode(&part, key, &mut bytes).unwrap();
        }
        digest.add(&bytes);
    }
    assert_eq!(digest.0, SAMPLED);
}

const RESAMPLERS: [(&str, u64); 8] = [
    ("dense", 0x90e3_7fbe_2cf5_6d6c),
    ("fast", 0x4ad0_f2af_5a9d_375c),
    ("lossless", 0xfbf4_1896_2e17_38fd),
    ("lossless:predictive", 0xc744_73c7_19ea_cb97),
    ("spline:worst-sample", 0x5c26_b9c2_f22e_ed6d),
    ("spline:exhaustive", 0x12f3_e30d_9487_aa4a),
    ("sync:worst-sample", 0x4925_55d6_d2a9_86b2),
    ("sync:exhaustive", 0x5f61_891e_3a4f_8f6a),
];

const EFFORTS: [(u8, u64); 4] = [
    (2, 0x1861_d724_9328_8277),
    (3, 0x4c63_d2db_46c0_06ef),
    (5, 0xd303_1e32_d425_37e8),
    (9, 0xc233_15dd_a895_90d8),
];

const SAMPLED: u64 = 0x858d_16da_0509_d7af;
