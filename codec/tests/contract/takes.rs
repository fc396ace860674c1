//! Recorded takes from the folder in `MOCAPD_TAKES`, where it is set.

use mocapd_testkit::recorded::RecordedData;

use super::{Channel, cut, decode_and_check, encode, settings};

/// The channels of a CSV take: `time`, then x, y, z of each marker in millimetres, all present.
fn csv_channels(text: &str) -> Vec<Channel> {
    let rows: Vec<Vec<f32>> = text
        .lines()
        .filter(|line| line.starts_with(|c: char| c.is_ascii_digit()))
        .map(|line| line.split(',').map(|cell| cell.trim().parse().unwrap()).collect())
        .collect();
    let markers = (rows[0].len() - 1) / 3;
    (0..markers)
        .map(|m| Channel {
            positions: rows.iter().map(|r| [r[1 + 3 * m], r[2 + 3 * m], r[3 + 3 * m]]).collect(),
            present: vec![true; rows.len()],
        })
        .collect()
}

#[test]
fn real_jumps_keep_the_bound_and_compress() {
    let Some(folder) = RecordedData::Takes.folder() else { return };
    let path = folder.join("cmu_13_32_forward_jump_15joints_120hz.csv");
    let channels = csv_channels(&std::fs::read_to_string(&path).unwrap());
    assert_eq!(channels.len(), 15);
    let n_rows = channels[0].present.len();
    // Well below the ratios reached, so that only a broken predictor or model fails.
    for (kind, tolerance, least) in [
        ("dense", 1.0, 14.0),
        ("dense", 0.1, 5.0),
        ("fast", 1.0, 12.0),
        ("lossless", 1.0, 1.5),
        ("lossless:predictive", 1.0, 1.8),
        ("spline", 1.0, 3.0),
    ] {
        let settings = settings(kind, tolerance);
        let mut lengths = vec![n_rows];
        if settings.kind.is_live() {
            lengths = vec![60; n_rows / 60];
            lengths.push(n_rows % 60);
        }
        let stretches = cut(&channels, &lengths, 0);
        let blocks = encode(settings, &stretches);
        decode_and_check(settings, &stretches, &blocks);
        let coded: usize = blocks.iter().map(|block| block.bytes.len()).sum();
        let ratio = (12 * 15 * n_rows) as f64 / coded as f64;
        assert!(ratio >= least, "{kind} at {tolerance} mm reaches {ratio:.2}, less than {least}");
    }
}

/// SR2, equation 8 of (Shi et al. 2012), on a recorded forward jump at 60 Hz; it falls when knots are wasted.
#[test]
fn the_published_measure_on_a_real_jump() {
    let Some(folder) = RecordedData::Takes.folder() else { return };
    let path = folder.join("cmu_13_32_forward_jump_15joints_60hz.csv");
    let channels = csv_channels(&std::fs::read_to_string(&path).unwrap());
    let n_rows = channels[0].present.len();
    for (tolerance, expected) in [(0.5, 0.75), (1.0, 1.2), (5.0, 3.1), (10.0, 4.8), (20.0, 5.8)] {
        let blocks = encode(settings("spline", tolerance), &cut(&channels, &[n_rows], 0));
        let kept: u32 = blocks[0].reports.iter().map(|report| report.kept).sum();
        let sr2 = 16.0 * n_rows as f64 / (2.0 * f64::from(kept));
        assert!((sr2 / expected - 1.0).abs() < 0.05, "SR2 {sr2:.2} at {tolerance} mm");
    }
}
