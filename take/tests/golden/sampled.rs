//! The foreign parts of the golden take that has samples.

use mocapd_take::motion::Foreign;
use mocapd_testkit::random::Random;

/// Samples of an analog channel: a key block of ten seconds, and a shorter one.
const N_SAMPLES: usize = 4 * 1300;

/// The kinds of parts, in every form.
pub(crate) fn parts() -> Vec<Foreign> {
    let mut random = Random::new(41);
    let mut analog: Vec<Vec<u32>> = (0..3).map(|_| integers(&mut random, N_SAMPLES)).collect();
    // A channel that repeats its samples, and one that stands still.
    analog[1] = analog[1].iter().step_by(4).flat_map(|&word| [word; 4]).collect();
    analog.push(vec![7; N_SAMPLES]);
    let outputs: Vec<Vec<u32>> = (0..8).map(|i| floats(&mut random, i, 700)).collect();
    let residuals: Vec<Vec<u32>> = (0..66).map(|i| flags(&mut random, i, 60)).collect();
    vec![
        Foreign::exact("c3d/parameters", parameters()),
        block("c3d/analog", 2, 4, &[], &analog),
        block("c3d/residuals", 4, 1, &[], &residuals),
        block("c3d/model-outputs", 4, 1, &[5, 9], &outputs),
    ]
}

/// States error bounds; those of an import are counts.
pub(crate) fn bound(parts: &mut Vec<Foreign>) {
    parts.truncate(2);
    if let Some(analog) = parts.last_mut() {
        analog.bounds = vec![2.0, 0.0, 7.0, 1.0];
    }
}

/// A noisy signal of a converter.
fn integers(random: &mut Random, n: usize) -> Vec<u32> {
    let (mut at, mut speed) = (0.0, 0.0);
    let mut next = |_| {
        speed += random.between(-3.0, 3.0) - 0.1 * speed - 0.002 * at;
        at += speed;
        let sample = at + random.between(-2.0, 2.0);
        u32::from(sample.clamp(-30_000.0, 30_000.0) as i16 as u16)
    };
    (0..n).map(&mut next).collect()
}

/// Floats of any precision, some of them not finite.
fn floats(random: &mut Random, column: usize, n: usize) -> Vec<u32> {
    let mut at = 10.0;
    let mut next = |i: usize| {
        at += random.between(-0.3, 0.3);
        match i {
            40..44 => f32::from_bits(0x7fc0_0001 + i as u32),
            44 => f32::NEG_INFINITY,
            _ if column % 4 == 3 => 0.0,
            _ => (at * f64::from(1 + column as u32)) as f32,
        }
    };
    (0..n).map(&mut next).map(|sample| ordered(sample.to_bits())).collect()
}

/// Residuals that change occasionally.
fn flags(random: &mut Random, column: usize, n: usize) -> Vec<u32> {
    let mut word = 0.0_f32;
    let mut next = |_| {
        if random.one_in(9) {
            word = (column + random.below(5)) as f32;
        }
        ordered(word.to_bits())
    };
    (0..n).map(&mut next).collect()
}

fn ordered(bits: u32) -> u32 {
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// A block of columns as docs/foreign.md describes it, from frame 7 on.
fn block(kind: &str, width: usize, ratio: u32, points: &[u32], columns: &[Vec<u32>]) -> Foreign {
    let n_samples = columns[0].len();
    let n_signals = if points.is_empty() { columns.len() } else { points.len() };
    let mut data = vec![1, width as u8];
    data.extend((n_signals as u32).to_le_bytes());
    data.extend(ratio.to_le_bytes());
    data.extend(7_u64.to_le_bytes());
    data.extend((n_samples as u64 / u64::from(ratio)).to_le_bytes());
    data.extend(points.iter().flat_map(|point| point.to_le_bytes()));
    let unused_bits = 32 - 8 * width;
    for column in columns {
        let mut before = 0;
        let mut zigzag = |&word: &u32| {
            let difference = (word.wrapping_sub(before) << unused_bits) as i32 >> unused_bits;
            before = word;
            difference << 1 ^ difference >> 31
        };
        let differences: Vec<i32> = column.iter().map(&mut zigzag).collect();
        for plane in (0..width).rev() {
            data.extend(differences.iter().map(|difference| (difference >> (8 * plane)) as u8));
        }
    }
    Foreign::exact(kind, data)
}

/// Parameters that describe the channels and points.
fn parameters() -> Vec<u8> {
    let mut data = vec![1, 0, 0, 0];
    for (id, name) in [(1_u8, "POINT"), (2, "ANALOG")] {
        data.extend([name.len() as u8, id.wrapping_neg()]);
        data.extend(name.bytes());
        data.extend([3, 0, 0]);
    }
    let mut parameter = |id: u8, name: &str, kind: i8, dimensions: &[u8], values: &[u8]| {
        data.extend([name.len() as u8, id]);
        data.extend(name.bytes());
        data.extend(((5 + dimensions.len() + values.len()) as u16).to_le_bytes());
        data.extend([kind as u8, dimensions.len() as u8]);
        data.extend(dimensions);
        data.extend(values);
        data.push(0);
    };
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let scales: Vec<u8> = floats(&[0.25, -0.1, 1.5, 0.0]);
    parameter(1, "LABELS", -1, &[2, 10], b"abcdefghijklmnopqrst");
    parameter(1, "ANGLES", -1, &[2, 1], b"kl");
    parameter(1, "ANGLE_UNITS", -1, &[3], b"deg");
    parameter(2, "LABELS", -1, &[3, 4], b"Fx1Fy1EMGtrg");
    parameter(2, "UNITS", -1, &[2, 4], b"N N mVV ");
    parameter(2, "SCALE", 4, &[4], &scales);
    parameter(2, "GEN_SCALE", 4, &[], &0.5_f32.to_le_bytes());
    parameter(2, "OFFSET", 2, &[4], &[1, 0, 0, 8, 0xff, 0xff, 0, 0]);
    data.extend([0, 0]);
    data
}
