//! Round trips: for any motion, also motion that no body performs but rigs report, for any gaps, tolerance, rate and
//! blocks, the bound holds and all counts agree.

use mocapd_codec::{BlockReport, CodecError, Position, Rows};
use proptest::prelude::*;

use super::{
    Channel, Stretch, cut, decode_and_check, encode,
    motions::{MOTIONS, PRESENCES, Random},
    settings,
};

fn round_trip(kind: &str, tolerance_mm: f64, stretches: &[Stretch]) {
    let settings = settings(kind, tolerance_mm);
    let blocks = encode(settings, stretches);
    assert_eq!(blocks, encode(settings, stretches), "the same samples gave other bytes");
    decode_and_check(settings, stretches, &blocks);
}

#[test]
fn every_motion_presence_and_kind() {
    for kind in KINDS {
        let (lengths, tolerances): (&[usize], &[f64]) = if kind.ends_with("exhaustive") {
            (&[40, 1, 9], &[0.5])
        } else {
            (&[60, 1, 30, 7, 130, 2], &[1e-4, 0.03, 1.0, 1e3])
        };
        let n = lengths.iter().sum();
        for motion in MOTIONS {
            for gaps in PRESENCES {
                for &tolerance in tolerances {
                    let channels = [
                        Channel::new(motion, gaps, 7, n),
                        Channel::new("smooth", "late", 8, n),
                        Channel::new(motion, gaps, 9, n),
                    ];
                    round_trip(kind, tolerance, &cut(&channels, lengths, 0b01_0000));
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn any_group(
        kind in proptest::sample::select(vec!["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"]),
        channels in proptest::collection::vec(
            (
                proptest::sample::select(MOTIONS.to_vec()),
                proptest::sample::select(PRESENCES.to_vec()),
                any::<u64>(),
            ),
            1..6,
        ),
        lengths in proptest::collection::vec(0_usize..140, 1..6),
        keys in any::<u32>(),
        exponent in -4.0..3.0_f64,
    ) {
        let n = lengths.iter().sum();
        let channels: Vec<_> = channels
            .into_iter()
            .map(|(motion, gaps, seed)| Channel::new(motion, gaps, seed, n))
            .collect();
        round_trip(kind, 10_f64.powf(exponent), &cut(&channels, &lengths, keys));
    }

    /// Arbitrary bit patterns: finite samples keep the bound; the others are absent.
    #[test]
    fn any_bits(
        kind in proptest::sample::select(vec!["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"]),
        bits in proptest::collection::vec(any::<[[u32; 3]; 2]>(), 1..50),
    ) {
        let channels = (0..2).map(|i| {
            let positions: Vec<Position> = bits.iter().map(|p| p[i].map(f32::from_bits)).collect();
            let present = positions.iter().map(|p| p.iter().all(|v| v.is_finite())).collect();
            Channel { positions, present }
        });
        round_trip(kind, 0.5, &[Stretch { channels: channels.collect(), key: true }]);
    }
}

#[test]
fn a_sample_that_is_not_finite_is_refused_and_changes_nothing() {
    for kind in KINDS {
        let settings = settings(kind, 0.5);
        let channels: Vec<_> = (0..3).map(|i| Channel::new("smooth", "all", i, 60)).collect();
        let good = cut(&channels, &[30, 30], 0);
        let mut bad = good[1].clone();
        bad.channels[2].positions[17][1] = f32::NAN;
        let mut encoder = settings.encoder();
        let mut out = vec![1, 2, 3];
        let mut reports = [BlockReport::default(); 3];
        let shared: Vec<Vec<u8>> = good.iter().map(|s| settings.plan(&s.rows()).unwrap()).collect();
        encoder.encode(&good[0].rows(), &shared[0], true, &mut out, &mut reports).unwrap();
        let before = out.clone();
        let error =
            encoder.encode(&bad.rows(), &shared[1], true, &mut out, &mut reports).unwrap_err();
        assert!(
            matches!(&error, CodecError::InvalidArgument(m) if m.contains("row 17")),
            "{error}"
        );
        assert_eq!(out, before);
        encoder.encode(&good[1].rows(), &shared[1], false, &mut out, &mut reports).unwrap();
        let expected: Vec<u8> =
            encode(settings, &good).into_iter().flat_map(|block| block.bytes).collect();
        assert_eq!(out[3..], expected, "{kind}: the refused block changed the state");
        // The bits of an absent sample do not matter.
        bad.channels[2].present[17] = false;
        round_trip(kind, 0.5, &[Stretch { key: true, ..bad }]);
    }
}

#[test]
fn one_plan_serves_channels_with_different_motion() {
    let settings = settings("sync", 0.2);
    let channels: Vec<Channel> = ["smooth", "walk", "steps", "constant", "line"]
        .iter()
        .zip(["all", "gaps", "late", "singles", "none"])
        .map(|(motion, gaps)| Channel::new(motion, gaps, 11, 300))
        .collect();
    let stretches = cut(&channels, &[300], 0);
    let blocks = encode(settings, &stretches);
    decode_and_check(settings, &stretches, &blocks);
    // A raw channel would have no error at all.
    assert!(blocks[0].reports[1].max_error_mm > 0.0, "the plan holds for every channel");
    let rows = stretches[0].rows();
    let odd = Rows::new(&rows[0].positions()[..9], &[true; 9]).unwrap();
    assert!(matches!(settings.plan(&[rows[0], odd]), Err(CodecError::InvalidArgument(_))));
}

#[test]
fn a_plan_of_other_samples_keeps_the_bound() {
    let settings = settings("sync", 0.2);
    let walk = Channel::new("walk", "all", 5, 80);
    let (mut out, mut reports) = (Vec::new(), [BlockReport::default()]);
    settings.encoder().encode(&[walk.rows()], &[], true, &mut out, &mut reports).unwrap();
    assert_eq!((reports[0].kept, reports[0].max_error_mm), (80, 0.0));
    let mut decoded = Vec::new();
    settings.decoder().decode(&out, &[], 80, true, &mut decoded).unwrap();
    assert_eq!(decoded[0].positions, walk.positions);
}

#[test]
fn the_exhaustive_search_refuses_long_runs() {
    let settings = settings("spline:exhaustive", 1.0);
    let long = Channel::new("line", "all", 1, 1025);
    let (mut out, mut reports) = (Vec::new(), [BlockReport::default()]);
    let mut encoder = settings.encoder();
    let error = encoder.encode(&[long.rows()], &[], true, &mut out, &mut reports).unwrap_err();
    assert!(matches!(&error, CodecError::InvalidArgument(m) if m.contains("1024")), "{error}");
    assert!(out.is_empty());
    let fits = long.part(0..1024);
    // After this error the encoder needs a key block.
    let next = encoder.encode(&[fits.rows()], &[], false, &mut out, &mut reports);
    assert_eq!(next, Err(CodecError::OutOfStep));
    assert!(encoder.encode(&[fits.rows()], &[], true, &mut out, &mut reports).is_ok());
}

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

/// A part of a channel: kind of motion, whether it has gaps, seed, and number of rows.
fn part() -> impl Strategy<Value = (u8, bool, u64, usize)> {
    (0..8_u8, any::<bool>(), any::<u64>(), 1..40_usize)
}

fn anything(parts: &[(u8, bool, u64, usize)]) -> Channel {
    let mut channel = Channel { positions: Vec::new(), present: Vec::new() };
    let mut origin = [0.0, 1000.0, 0.0];
    for &(what, gaps, seed, len) in parts {
        let mut random = Random(seed);
        for _ in 0..len {
            let row = channel.positions.len();
            channel.positions.push(match what {
                0 => origin,
                1 => moved(origin, swing(row)),
                2 if random.below(5) == 0 => moved(random.vector(8000.0), origin),
                2 => origin,
                3 => random.vector(1e7),
                4 => moved([1e7; 3], swing(row)),
                5 => [0; 3].map(|_| f32::from_bits(random.below(1 << 23) as u32)),
                6 => [0; 3].map(|_| f32::from_bits(random.below(0x7f80_0000) as u32)),
                _ => {
                    origin = moved(origin, random.vector(4.0));
                    origin
                }
            });
            channel.present.push(!gaps || random.below(3) > 0);
        }
    }
    channel
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Any sequence of parts, at any tolerance, with any stretches and keys.
    #[test]
    fn anything_after_anything(
        kind in proptest::sample::select(KINDS.to_vec()),
        channels in proptest::collection::vec(proptest::collection::vec(part(), 1..6), 1..7),
        mut lengths in proptest::collection::vec(0..50_usize, 1..8),
        keys in any::<u32>(),
        exponent in -4.0..6.0_f64,
    ) {
        let mut channels: Vec<_> = channels.iter().map(|parts| anything(parts)).collect();
        let n_rows = channels.iter().map(|channel| channel.present.len()).max().unwrap();
        for channel in &mut channels {
            channel.positions.resize(n_rows, [f32::NAN; 3]);
            channel.present.resize(n_rows, false);
        }
        let mut left = n_rows;
        for len in &mut lengths {
            *len = left.min(*len);
            left -= *len;
        }
        lengths.push(left);
        stream(kind, 10_f64.powf(exponent), &channels, &lengths, keys);
    }
}

/// `n_rows` rows of one motion at a rate; the third channel has many gaps.
fn at_rate(rate_hz: u32, n_rows: usize) -> Vec<Channel> {
    let path = |phase: f64| -> Vec<Position> {
        let at = |row: usize| {
            let t = row as f64 / f64::from(rate_hz) + phase;
            [350.0 * (4.0 * t).sin(), 1100.0 + 60.0 * (23.0 * t).cos(), 700.0 * t].map(|v| v as f32)
        };
        (0..n_rows).map(at).collect()
    };
    let seen = |phase| Channel { positions: path(phase), present: vec![true; n_rows] };
    let flicker = |row: usize| (row as u64 * 7 / u64::from(rate_hz)) % 3 != 1 && row % 11 != 5;
    vec![seen(0.0), seen(0.3), seen_where(seen(1.1), flicker)]
}

/// All rates, with few rows each: prediction alone depends on the rate.
#[test]
fn every_rate_from_1_to_10000_hz() {
    for rate_hz in 1..=10_000 {
        let kind = KINDS[rate_hz as usize % KINDS.len()];
        let tolerance_mm = TOLERANCES_MM[rate_hz as usize / KINDS.len() % TOLERANCES_MM.len()];
        stream(kind, tolerance_mm, &at_rate(rate_hz, 16), &[9, 1, 6], 0b100);
    }
}

/// The rates of devices, in the half-second stretches of a recording.
#[test]
fn usual_rates_in_whole_stretches() {
    for rate_hz in [1, 2, 15, 24, 25, 30, 50, 60, 100, 120, 200, 240, 333, 500, 1000, 2000, 10_000]
    {
        for kind in KINDS {
            let half_a_second = (rate_hz as usize).div_ceil(2);
            let lengths = [half_a_second.div_ceil(5), half_a_second, half_a_second];
            stream(kind, 0.5, &at_rate(rate_hz, lengths.iter().sum()), &lengths, 0b100);
        }
    }
}
