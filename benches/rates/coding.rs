//! Encodes columns of samples in the stretches of a recording, then decodes the blocks and checks the tolerance.

use anyhow::ensure;
use mocapd_codec::{BlockReport, GROUP_CHANNELS, Position, Rows, Settings};

/// Length of a stretch and interval of key stretches in seconds, the defaults of a recording.
const STRETCH_S: f64 = 0.5;
const KEY_S: f64 = 10.0;

#[derive(Debug, Clone, Copy)]
pub(crate) struct EncodedSize {
    /// The sum over all blocks.
    pub(crate) bytes: usize,
    pub(crate) seconds: f64,
    /// Largest distance between a sample and its decoded position.
    pub(crate) max_error_mm: f64,
}

impl EncodedSize {
    pub(crate) fn bytes_per_s(&self) -> f64 {
        self.bytes as f64 / self.seconds
    }
}

/// Encodes and decodes `columns`, one per marker, sampled at `rate_hz` and equally long.
///
/// # Errors
/// When the codec refuses the samples, or an error exceeds the tolerance.
pub(crate) fn encode(
    settings: &Settings,
    columns: &[Vec<Position>],
    rate_hz: f64,
) -> anyhow::Result<EncodedSize> {
    let n_rows = columns.first().map_or(0, Vec::len);
    let stretch_rows = (STRETCH_S * rate_hz).floor().max(1.0) as usize;
    let key_rows = (KEY_S * rate_hz).floor() as usize;
    let present = vec![true; stretch_rows];
    let (mut bytes, mut max_error_mm) = (0, 0.0_f64);
    for group in columns.chunks(GROUP_CHANNELS) {
        let (mut encoder, mut decoder) = (settings.encoder(), settings.decoder());
        let mut reports = vec![BlockReport::default(); group.len()];
        let (mut block, mut decoded) = (Vec::new(), Vec::new());
        let mut since_key = key_rows;
        for first in (0..n_rows).step_by(stretch_rows) {
            let n = stretch_rows.min(n_rows - first);
            let rows =
                group.iter().map(|column| Rows::new(&column[first..first + n], &present[..n]));
            let rows = rows.collect::<Result<Vec<_>, _>>()?;
            let key = since_key >= key_rows;
            since_key = if key { n } else { since_key + n };
            block.clear();
            encoder.encode(&rows, &[], key, &mut block, &mut reports)?;
            bytes += block.len();
            decoder.decode(&block, &[], n, key, &mut decoded)?;
            let (n, n_decoded) = (group.len(), decoded.len());
            ensure!(n_decoded == n, "decoded {n_decoded} channels, expected {n}");
            for (rows, decoded) in rows.iter().zip(&decoded) {
                for (a, b) in rows.positions().iter().zip(&decoded.positions) {
                    max_error_mm = max_error_mm.max(distance_mm(*a, *b));
                }
            }
        }
    }
    let tolerance_mm = settings.tolerance.mm();
    ensure!(
        max_error_mm <= tolerance_mm,
        "an error of {max_error_mm} mm exceeds the tolerance of {tolerance_mm} mm"
    );
    Ok(EncodedSize { bytes, seconds: n_rows as f64 / rate_hz, max_error_mm })
}

fn distance_mm(a: Position, b: Position) -> f64 {
    a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2)).sum::<f64>().sqrt()
}
