//! Motion that no body performs but rigs report: the bound holds, block after block, with keys in between.

use mocapd_codec::Position;

use super::{Channel, cut, decode_and_check, encode, motions::Random, settings};

/// All resamplers; the exhaustive variants write the same format.
pub(crate) const KINDS: [&str; 6] =
    ["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"];

/// From below the resolution of float32 at room scale to coarser than the motion of a joint.
pub(crate) const TOLERANCES_MM: [f64; 3] = [0.003, 0.5, 20.0];

/// Numbers of rows of the stretches of a stream, some of one to three rows; every third stretch is a key.
const LENGTHS: [usize; 8] = [31, 1, 20, 40, 2, 26, 17, 3];
const KEYS: u32 = 0b0100_1001;
const ROWS: usize = 140;

/// Checks that all blocks keep the bound, that encoding again gives the same bytes, and that decoding may start at
/// keys.
pub(crate) fn stream(
    kind: &str,
    tolerance_mm: f64,
    channels: &[Channel],
    lengths: &[usize],
    keys: u32,
) {
    let settings = settings(kind, tolerance_mm);
    let stretches = cut(channels, lengths, keys);
    let blocks = encode(settings, &stretches);
    assert_eq!(blocks, encode(settings, &stretches), "{kind}: the same samples gave other bytes");
    decode_and_check(settings, &stretches, &blocks);
    for at in (1..stretches.len()).filter(|&at| stretches[at].key) {
        decode_and_check(settings, &stretches[at..], &blocks[at..]);
    }
}

fn streams(group: impl Fn(&mut Random) -> Vec<Channel>) {
    for kind in KINDS {
        for tolerance_mm in TOLERANCES_MM {
            for seed in 0..3 {
                stream(kind, tolerance_mm, &group(&mut Random(seed)), &LENGTHS, KEYS);
            }
        }
    }
}

/// A channel without gaps.
fn seen(position: impl FnMut(usize) -> Position) -> Channel {
    Channel { positions: (0..ROWS).map(position).collect(), present: vec![true; ROWS] }
}

pub(crate) fn seen_where(mut channel: Channel, present: impl FnMut(usize) -> bool) -> Channel {
    channel.present = (0..channel.present.len()).map(present).collect();
    channel
}

pub(crate) fn swing(row: usize) -> Position {
    let t = row as f32 / 60.0;
    [400.0 * (3.0 * t).sin(), 900.0 + 250.0 * t, 80.0 * (11.0 * t).cos()]
}

pub(crate) fn moved(by: Position, position: Position) -> Position {
    std::array::from_fn(|axis| position[axis] + by[axis])
}

/// Lasting jumps of metres, as from swapped labels; some at the first row of a stretch.
#[test]
fn steps() {
    streams(|random| {
        let mut at = [0.0; 3];
        let anywhere = seen(|_| {
            if random.below(9) == 0 {
                at = random.vector(9000.0);
            }
            at
        });
        let swap = |row: usize| [31, 32, 52, 94, 120].iter().filter(|&&at| row >= at).count();
        let (left, right) = ([-300.0, 0.0, 0.0], [2500.0, 10.0, -40.0]);
        let side = |is_left: bool| if is_left { left } else { right };
        let swapped =
            |first| seen(move |row| moved(side((swap(row) % 2 == 0) == first), swing(row)));
        vec![anywhere, swapped(true), swapped(false)]
    });
}

/// Single rows that are metres off, as from reflections; in two channels at the borders of stretches only.
#[test]
fn spikes_of_metres() {
    streams(|random| {
        let mut spiky = |border: bool| {
            seen(|row| {
                let spike = if border {
                    [31, 32, 51, 52, 139].contains(&row)
                } else {
                    random.below(8) == 0
                };
                if spike { moved(random.vector(8000.0), swing(row)) } else { swing(row) }
            })
        };
        vec![spiky(false), spiky(true), spiky(true), seen(swing)]
    });
}

/// Markers at rest, near and far from the origin, with gaps, and next to moving ones.
#[test]
fn constant_markers() {
    streams(|random| {
        let (near, far) = (random.vector(2000.0), random.vector(3e5));
        let flicker = seen_where(seen(|_| near), |row| row % 7 != 3);
        let then_moves = seen(|row| if row < 70 { near } else { swing(row) });
        vec![seen(|_| near), seen(|_| far), seen(|_| [0.0; 3]), flicker, then_moves]
    });
}

/// Runs of one sample each, which leave nothing to interpolate.
#[test]
fn runs_of_one_sample() {
    streams(|random| {
        let lonely = |every: usize, first: usize, random: &mut Random| {
            let channel = seen(|row| moved(random.vector(3.0), swing(row)));
            seen_where(channel, |row| row % every == first)
        };
        let mut channels: Vec<_> =
            [(2, 0), (3, 2), (5, 1), (139, 0)].map(|(n, at)| lonely(n, at, random)).into();
        // Alone in its stretch, at the first and the last row of others.
        let rows = [0, 30, 31, 32, 51, 92, 93, 94, 137, 139];
        channels.push(seen_where(seen(swing), |row| rows.contains(&row)));
        channels
    });
}

/// Channels present in alternate rows, as from a device that sends half of its markers in each frame.
#[test]
fn alternate_presence() {
    streams(|random| {
        let mut turn = |of: usize, turn: usize| {
            let noise = random.vector(40.0);
            let channel = seen(|row| moved(moved(noise, random.vector(0.2)), swing(row)));
            seen_where(channel, |row| row % of == turn)
        };
        vec![turn(2, 0), turn(2, 1), turn(2, 0), turn(4, 3)]
    });
}

/// 10 km from the origin, where neighbouring float32 are a millimetre apart.
#[test]
fn coordinates_of_10_km() {
    streams(|random| {
        let mut corner = |x: f32, y: f32, z: f32| {
            let origin = [x * 1e7, y * 1e7, z * 1e7];
            seen(|row| moved(moved(origin, random.vector(0.5)), swing(row)))
        };
        let mut channels =
            vec![corner(1.0, 1.0, 1.0), corner(-1.0, 1.0, 0.0), corner(0.0, 0.0, -1.0)];
        // From one end to the other within a stretch.
        channels.push(seen(|row| [1e7 - 2e5 * row as f32, 0.0, 3.0]));
        channels
    });
}

/// Denormal numbers and zeros of both signs, on all axes and next to normal coordinates.
#[test]
fn denormals() {
    streams(|random| {
        let mut tiny =
            || f32::from_bits(random.below(1 << 23) as u32 | (random.below(2) as u32) << 31);
        let all = seen(|_| [tiny(), tiny(), tiny()]);
        let beside = seen(|row| [swing(row)[0], tiny(), -0.0]);
        let least = [f32::from_bits(1), -f32::from_bits(1), 0.0, -0.0, f32::MIN_POSITIVE];
        let edges = seen(|row| [0, 1, 2].map(|axis| least[(row + 2 * axis) % least.len()]));
        vec![all, beside, edges]
    });
}
