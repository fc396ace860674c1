//! Sources of motion, and motion at other rates.

use mocapd_take::motion::{GAP, Marker, MotionInfo, is_gap};
use mocapd_testkit::recorded::RecordedData;
use proptest::prelude::*;

use super::*;
use crate::device::{Device, DeviceSettings};
use crate::generator::JumpSpec;

#[test]
fn the_extension_selects_the_format_and_errors_name_the_file() {
    let error = read(Path::new("/nowhere/jump.xyz")).unwrap_err().to_string();
    assert_eq!(
        error,
        "/nowhere/jump.xyz: unknown file extension: use .take, .c3d, .trc, .tsv or .csv"
    );
    for extension in ["take", "TAKE", "c3d", "trc", "tsv", "csv"] {
        let error = read(Path::new(&format!("/nowhere/jump.{extension}"))).unwrap_err();
        assert!(matches!(error, SourceError::Read { .. }), "{extension}: {error}");
    }
}

#[test]
fn recorded_motions_of_every_format_become_devices() {
    let Some(folder) = RecordedData::Takes.folder() else { return };
    let mut formats = std::collections::BTreeSet::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let Some(format) = Format::from_extension(&path) else { continue };
        let (motion, _) = read(&path).unwrap();
        let n_frames = motion.n_frames() as u64;
        let device = Device::new(motion, DeviceSettings::default());
        let device = device.unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert_eq!(device.hello().n_frames, n_frames, "{}", path.display());
        formats.insert(format!("{format:?}"));
    }
    assert_eq!(formats.len(), 4, "{formats:?}");
}

#[test]
fn generated_motions_are_named() {
    assert_eq!("jump".parse(), Ok(Generated { seed: 1 }));
    assert_eq!("jump:77".parse(), Ok(Generated { seed: 77 }));
    assert!("walk:1".parse::<Generated>().unwrap_err().contains("jump:"));
    assert!("jump:-1".parse::<Generated>().is_err());
}

#[test]
fn the_first_seconds_are_kept() {
    let mut motion = JumpSpec::new(1, 60.0).generate().unwrap().motion;
    let whole = motion.clone();
    keep_first(&mut motion, 1e9);
    assert_eq!(motion, whole);
    keep_first(&mut motion, 2.0);
    assert_eq!((motion.n_frames(), motion.info.n_frames), (120, 120));
    assert_eq!(motion.positions_mm, whole.positions_mm[..120 * 15]);
    keep_first(&mut motion, 0.0);
    assert_eq!(motion.n_frames(), 1);
}

/// All resampled frames as a motion of rate `rate_hz`.
fn to_motion(replay: &Replay, rate_hz: f64) -> Motion {
    let mut out = Motion { info: replay.motion.info.clone(), positions_mm: Vec::new() };
    let mut row = Vec::new();
    for index in 0..replay.n_frames() {
        replay.frame(index, &mut row);
        out.positions_mm.extend_from_slice(&row);
    }
    out.info.rate_hz = rate_hz;
    out.info.n_frames = replay.n_frames();
    out
}

fn line(samples: &[Position]) -> Arc<Motion> {
    let markers = vec![Marker { label: "m".to_owned(), labelled: true }];
    let n_frames = samples.len() as u64;
    let info = MotionInfo { rate_hz: 60.0, n_frames, markers, ..MotionInfo::default() };
    Arc::new(Motion { info, positions_mm: samples.to_vec() })
}

fn at(x: f32) -> Position {
    [x, 2.0 * x, -x]
}

#[test]
fn coinciding_frames_are_bit_equal() {
    let motion = Arc::new(JumpSpec::new(2, 60.0).generate().unwrap().motion);
    let replay = Replay::resampled(Arc::clone(&motion), 60_000, 240_000).unwrap();
    assert_eq!(replay.n_frames(), (motion.n_frames() as u64 - 1) * 4 + 1);
    let mut row = Vec::new();
    for k in 0..motion.n_frames() {
        replay.frame(4 * k as u64, &mut row);
        assert_eq!(row, motion.frame(k));
    }
    // Down again by the same factor gives the recording.
    let up = Arc::new(to_motion(&replay, 240.0));
    let down = to_motion(&Replay::resampled(up, 240_000, 60_000).unwrap(), 60.0);
    assert_eq!(down, *motion);
}

#[test]
fn interpolation_follows_smooth_motion() {
    let fine = Arc::new(JumpSpec::new(2, 480.0).clean().generate().unwrap().motion);
    let coarse = to_motion(&Replay::resampled(Arc::clone(&fine), 480, 120).unwrap(), 120.0);
    let again = Replay::resampled(Arc::new(coarse), 120, 480).unwrap();
    let mut row = Vec::new();
    let mut worst = 0.0f32;
    for k in 0..again.n_frames() {
        again.frame(k, &mut row);
        for (a, b) in row.iter().zip(fine.frame(k as usize)) {
            for axis in 0..3 {
                worst = worst.max((a[axis] - b[axis]).abs());
            }
        }
    }
    // Linear interpolation would miss by acceleration * dt^2 / 8 = 1 mm at 130 m/s^2.
    assert!(worst < 0.35, "{worst} mm");
}

#[test]
fn gaps_stay_gaps_and_do_not_grow() {
    let motion = line(&[at(0.0), at(1.0), at(2.0), GAP, at(4.0), at(5.0), at(6.0)]);
    let replay = Replay::resampled(motion, 1, 2).unwrap();
    let mut row = Vec::new();
    let mut seen = Vec::new();
    for k in 0..replay.n_frames() {
        replay.frame(k, &mut row);
        seen.push(if is_gap(row[0]) { None } else { Some(row[0][0]) });
    }
    // Only frames next to the missing sample are gaps, and a straight line stays straight up to the gap.
    let expected = [0.0, 0.5, 1.0, 1.5, 2.0, -1.0, -1.0, -1.0, 4.0, 4.5, 5.0, 5.5, 6.0];
    let expected: Vec<_> = expected.map(|x| (x >= 0.0).then_some(x)).to_vec();
    assert_eq!(seen, expected);
}

#[test]
fn motions_of_zero_frames_and_of_one() {
    let empty = Replay::native(line(&[]));
    assert_eq!(empty.n_frames(), 0);
    let one = Replay::resampled(line(&[at(3.0)]), 60, 999).unwrap();
    assert_eq!(one.n_frames(), 1);
    let mut row = Vec::new();
    one.frame(1, &mut row);
    assert!(row.is_empty());
    assert!(Replay::resampled(line(&[]), 0, 1).is_none());
}

proptest! {
    #[test]
    fn any_rate_ends_at_or_before_the_last_frame(n in 1u32..50, from in 1u64..20_000, to in 1u64..20_000) {
        let samples: Vec<_> = (0..n).map(|i| at(i as f32)).collect();
        let replay = Replay::resampled(line(&samples), from, to).unwrap();
        let mut row = Vec::new();
        replay.frame(replay.n_frames() - 1, &mut row);
        prop_assert_eq!(row.len(), 1);
        let x = (replay.n_frames() - 1) as f64 * from as f64 / to as f64;
        prop_assert!((f64::from(row[0][0]) - x).abs() < 1e-3);
        replay.frame(replay.n_frames(), &mut row);
        prop_assert!(row.is_empty());
    }
}
