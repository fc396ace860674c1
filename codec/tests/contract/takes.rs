//! Real takes, where the folder in `MOCAPD_TAKES` has them.

use mocapd_codec::{DecodedRows, Rows};

use super::{Stretch, check, encode, settings};

/// The CSV takes: `time` and then x, y, z of each marker in millimetres, all present.
fn csv_channels(text: &str) -> Vec<Vec<[f32; 3]>> {
    let rows: Vec<Vec<f32>> = text
        .lines()
        .filter(|line| line.starts_with(|c: char| c.is_ascii_digit()))
        .map(|line| line.split(',').map(|cell| cell.trim().parse().unwrap()).collect())
        .collect();
    let markers = (rows[0].len() - 1) / 3;
    (0..markers)
        .map(|m| rows.iter().map(|r| [r[1 + 3 * m], r[2 + 3 * m], r[3 + 3 * m]]).collect())
        .collect()
}

#[test]
fn real_jumps_keep_the_bound_and_compress() {
    let Some(folder) = std::env::var_os("MOCAPD_TAKES") else {
        eprintln!("skipped: MOCAPD_TAKES is not set");
        return;
    };
    let path = std::path::Path::new(&folder).join("cmu_13_32_forward_jump_15joints_120hz.csv");
    let channels = csv_channels(&std::fs::read_to_string(&path).unwrap());
    assert_eq!(channels.len(), 15);
    // Well below what each reaches: a broken predictor or model shows, small changes do not.
    for (kind, tolerance, least) in [
        ("dense", 1.0, 14.0),
        ("dense", 0.1, 5.0),
        ("fast", 1.0, 8.0),
        ("lossless", 1.0, 1.5),
        ("spline", 1.0, 3.0),
    ] {
        let settings = settings(kind, tolerance);
        let (mut raw, mut coded) = (0, 0);
        for positions in &channels {
            let stretches: Vec<Stretch> = positions
                .chunks(if settings.kind.is_live() { 60 } else { usize::MAX })
                .enumerate()
                .map(|(i, part)| Stretch {
                    positions: part.to_vec(),
                    present: vec![true; part.len()],
                    key: i == 0,
                })
                .collect();
            let mut decoder = settings.decoder();
            let mut decoded = DecodedRows::default();
            for (stretch, block) in stretches.iter().zip(encode(settings, &stretches)) {
                let n = stretch.present.len();
                decoder.decode(&block.bytes, &block.shared, n, stretch.key, &mut decoded).unwrap();
                check(settings, stretch, &block, &decoded);
                raw += 12 * n;
                coded += block.bytes.len();
            }
        }
        let ratio = raw as f64 / coded as f64;
        assert!(ratio >= least, "{kind} at {tolerance} mm reaches {ratio:.2}, less than {least}");
    }
}

/// Equation 8 of (Shi et al. 2012) on a real forward jump at 60 Hz; falls only where knots are wasted.
#[test]
fn the_published_measure_on_a_real_jump() {
    let Some(folder) = std::env::var_os("MOCAPD_TAKES") else {
        eprintln!("skipped: MOCAPD_TAKES is not set");
        return;
    };
    let path = std::path::Path::new(&folder).join("cmu_13_32_forward_jump_15joints_60hz.csv");
    let channels = csv_channels(&std::fs::read_to_string(&path).unwrap());
    for (tolerance, expected) in [(0.5, 0.75), (1.0, 1.2), (5.0, 3.1), (10.0, 4.8), (20.0, 5.8)] {
        let settings = settings("spline", tolerance);
        let kept: u32 = channels
            .iter()
            .map(|positions| {
                let present = vec![true; positions.len()];
                let rows = Rows::new(positions, &present).unwrap();
                settings.encoder().encode(rows, &[], true, &mut Vec::new()).unwrap().kept
            })
            .sum();
        let sr2 = 16.0 * channels[0].len() as f64 / (2.0 * f64::from(kept));
        assert!((sr2 / expected - 1.0).abs() < 0.05, "SR2 {sr2:.2} at {tolerance} mm");
    }
}
