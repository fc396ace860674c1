//! Round trips: the samples are identical to the bit.

use mocapd_take::interchange::{Format, InterchangeError};
use mocapd_take::motion::{
    GAP, Marker, Motion, MotionFrames, MotionInfo, Position, Source, UpAxis, is_gap,
};
use proptest::prelude::*;

use crate::{assert_same_samples, labels};

fn motion(names: &[String], positions_mm: Vec<Position>, rate_hz: f64, first_frame: u64) -> Motion {
    Motion {
        info: MotionInfo {
            rate_hz,
            n_frames: (positions_mm.len() / names.len()) as u64,
            markers: names
                .iter()
                .map(|label| Marker { label: label.clone(), labelled: true })
                .collect(),
            up: UpAxis::Y,
            source: Source { factor: 1.0, first_frame, ..Source::default() },
            ..MotionInfo::default()
        },
        positions_mm,
    }
}

fn through(format: Format, motion: &Motion) -> Motion {
    let mut bytes = Vec::new();
    format.write(&mut MotionFrames::new(motion), &mut bytes).expect("memory");
    format.read(&bytes).expect("what was written")
}

/// Any finite position, or a gap.
fn position() -> impl Strategy<Value = Position> {
    let coordinate = any::<u32>().prop_map(f32::from_bits).prop_filter("finite", |v| v.is_finite());
    prop_oneof![4 => [coordinate.clone(), coordinate.clone(), coordinate], 1 => Just(GAP)]
}

fn motions() -> impl Strategy<Value = Motion> {
    let names = proptest::collection::vec("[A-Za-z][A-Za-z0-9.:_]{0,9}", 1..6);
    (names, 1usize..12).prop_flat_map(|(names, n_frames)| {
        let n = names.len() * n_frames;
        (Just(names), proptest::collection::vec(position(), n), 1u64..60_000)
            .prop_map(|(names, positions, first)| motion(&names, positions, 120.0, first))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn c3d(source in motions()) {
        let back = through(Format::C3d, &source);
        assert_same_samples(&back, &source);
        prop_assert_eq!(&back.info.markers, &source.info.markers);
        prop_assert_eq!(back.info.rate_hz, 120.0);
        prop_assert_eq!(back.info.source.first_frame, source.info.source.first_frame);
        prop_assert_eq!(back.info.up, UpAxis::Y);
    }

    #[test]
    fn csv(source in motions()) {
        let mut bytes = Vec::new();
        Format::Csv.write(&mut MotionFrames::new(&source), &mut bytes).expect("memory");
        // A single row has no interval, so the rate is given as a key.
        bytes.splice(..0, b"# rate=120\n".iter().copied());
        let back = Format::Csv.read(&bytes).expect("what was written");
        assert_same_samples(&back, &source);
        prop_assert_eq!(back.info.source.first_frame, source.info.source.first_frame);
    }

    #[test]
    fn trc(source in motions()) {
        // Labels identify columns, including empty ones.
        let back = through(Format::Trc, &source);
        assert_same_samples(&back, &source);
        prop_assert_eq!(labels(&back), unique(&source));
        prop_assert_eq!(back.info.source.first_frame, source.info.source.first_frame);
    }

    #[test]
    fn tsv(source in motions()) {
        let back = through(Format::Tsv, &source);
        assert_same_samples(&back, &source);
        prop_assert_eq!(labels(&back), unique(&source));
        prop_assert_eq!(back.info.source.first_frame, source.info.source.first_frame);
        prop_assert_eq!(back.info.rate_hz, 120.0);
    }

    #[test]
    fn csv_long(source in motions()) {
        let mut bytes = Vec::new();
        Format::CsvLong.write(&mut MotionFrames::new(&source), &mut bytes).expect("memory");
        let rows = source.positions_mm.iter().filter(|&&p| !is_gap(p)).count();
        prop_assert_eq!(bytes.split(|&b| b == b'\n').count(), rows + 2);
        // The rate needs at least two frames; markers without samples are absent, and so are frames before the first
        // and after the last sample.
        let seen = |frame: &usize| source.frame(*frame).iter().any(|&p| !is_gap(p));
        let (first, last) = ((0..source.n_frames()).find(seen), (0..source.n_frames()).rfind(seen));
        let (Some(first), Some(last)) = (first, last) else { return Ok(()) };
        prop_assume!(first < last);
        let back = Format::Csv.read(&bytes).expect("what was written");
        let expected = unique(&source);
        prop_assert_eq!(back.n_frames(), last - first + 1);
        prop_assert_eq!(back.info.source.first_frame, source.info.source.first_frame + first as u64);
        for (column, label) in expected.iter().enumerate() {
            let place = labels(&back).iter().position(|found| found == label);
            for frame in first..=last {
                let before = source.frame(frame)[column];
                let after = place.map_or(GAP, |place| back.frame(frame - first)[place]);
                prop_assert_eq!(is_gap(before), is_gap(after));
                prop_assert!(is_gap(before) || before.map(f32::to_bits) == after.map(f32::to_bits));
            }
        }
    }
}

/// The labels in formats whose columns need unique names.
fn unique(motion: &Motion) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for label in labels(motion) {
        let mut name = label.to_owned();
        for number in 2.. {
            if !names.contains(&name) {
                break;
            }
            name = format!("{label}#{number}");
        }
        names.push(name);
    }
    names
}

#[test]
fn a_position_at_the_origin_is_not_a_gap_in_tsv_and_trc() {
    let source = motion(&["a".to_owned()], vec![[0.0; 3], [1.0; 3], [-0.0; 3]], 100.0, 1);
    for format in [Format::Tsv, Format::Trc] {
        let back = through(format, &source);
        assert_eq!(back.positions_mm, [[1e-6, 0.0, 0.0], [1.0; 3], [1e-6, 0.0, 0.0]]);
    }
}

#[test]
fn labels_with_odd_characters_do_not_move_columns() {
    let names = ["a\tb", "c\nd", "\"e\",", "  ", "#f", "g\r", "\u{e9}\u{4e2d}", "frame", "X"];
    let names = names.map(str::to_owned);
    let source = motion(&names, vec![[1.0, 2.0, 3.0]; 18], 100.0, 1);
    for format in [Format::C3d, Format::Trc, Format::Tsv, Format::Csv, Format::CsvLong] {
        let back = through(format, &source);
        assert_same_samples(&back, &source);
        assert_eq!(labels(&back)[6..], ["\u{e9}\u{4e2d}", "frame", "X"], "{format:?}");
    }
}

#[test]
fn a_motion_without_markers_has_no_columns() {
    let mut source = motion(&["a".to_owned()], vec![[1.0; 3]; 5], 100.0, 1);
    source.info.markers.clear();
    source.positions_mm.clear();
    // Frames without a byte cannot be counted.
    assert_eq!(through(Format::C3d, &source).info.markers, []);
    for format in [Format::Trc, Format::Tsv, Format::Csv] {
        let back = through(format, &source);
        assert_eq!((labels(&back), back.info.n_frames), (Vec::new(), 5), "{format:?}");
    }
}

#[test]
fn rates_are_recovered_from_the_times_of_a_csv() {
    for rate_hz in [60.0, 60.0002, 119.88, 120.0, 1000.0 / 3.0, 1000.0] {
        let source = motion(&["a".to_owned()], vec![[100.0, 200.0, 300.0]; 500], rate_hz, 1);
        let back = through(Format::Csv, &source).info;
        assert!((back.rate_hz - rate_hz).abs() <= 1e-9 * rate_hz, "{} for {rate_hz}", back.rate_hz);
        assert_eq!(back.source.warnings, [""; 0]);
    }
}

#[test]
fn repeated_labels_are_distinguished_in_csv_and_kept_in_c3d() {
    let names = ["A", "A", "A#2", "b,\"c\"", "A", "u006"].map(str::to_owned);
    let source = motion(&names, vec![[1.0, 2.0, 3.0]; 12], 100.0, 1);
    assert_eq!(labels(&through(Format::C3d, &source)), names);
    assert_eq!(
        labels(&through(Format::Csv, &source)),
        ["A", "A#2", "A#2#2", "b,\"c\"", "A#3", "u006"]
    );
}

#[test]
fn many_points_and_many_frames_fit_in_c3d() {
    let names: Vec<String> =
        (0..700).map(|i| format!("a rather long label for marker {i}")).collect();
    let source = motion(&names, vec![[0.5, -0.25, 8.0]; 1400], 100.0, 1);
    assert_eq!(through(Format::C3d, &source).info.markers, source.info.markers);
    let positions = (0..66_000u32).map(|i| [i as f32, 0.5, -1.0]).collect();
    let source = motion(&["a".to_owned()], positions, 1000.0, 65_500);
    let back = through(Format::C3d, &source);
    assert_same_samples(&back, &source);
    assert_eq!(back.info.source.first_frame, 65_500);
    assert_eq!(back.info.source.warnings, [""; 0]);
}

#[test]
fn content_beyond_the_limits_of_c3d_is_refused_with_the_limit() {
    let source = motion(&["x".repeat(256)], vec![[0.0; 3]], 100.0, 1);
    let error = Format::C3d.write(&mut MotionFrames::new(&source), &mut Vec::new());
    assert!(
        matches!(&error, Err(InterchangeError::Unsupported(text)) if text.contains("255")),
        "{error:?}"
    );
    let names: Vec<String> = (0..2000).map(|i| format!("{i:0100}")).collect();
    let source = motion(&names, vec![[0.0; 3]; 2000], 100.0, 1);
    let error = Format::C3d.write(&mut MotionFrames::new(&source), &mut Vec::new());
    assert!(
        matches!(&error, Err(InterchangeError::Unsupported(text)) if text.contains(&(255 * 512).to_string())),
        "{error:?}"
    );
}
