//! A recorded motion without its noise, evaluated at any time.

use anyhow::ensure;
use mocapd_take::motion::{Motion, Position, is_gap};

use crate::low_pass::{HALF_WIDTH_S, STOP_HZ, weight};

/// The markers of a take that are present in every frame.
#[derive(Debug)]
pub(crate) struct Smooth {
    pub(crate) rate_hz: f64,
    /// Frame-major, in millimetres.
    positions_mm: Vec<[f64; 3]>,
    pub(crate) n_markers: usize,
    n_frames: usize,
}

impl Smooth {
    /// # Errors
    /// When the rate of the take leaves no band for the measurement of the noise, the take is too short, or every
    /// marker has gaps.
    pub(crate) fn new(motion: &Motion) -> anyhow::Result<Self> {
        let rate_hz = motion.info.rate_hz;
        let n_frames = motion.n_frames();
        // At 3 times the stop band edge, the upper third of the band up to half the rate contains noise alone.
        ensure!(
            rate_hz >= 3.0 * STOP_HZ,
            "{rate_hz} Hz are too few to separate noise from motion: at least {} Hz are needed",
            3.0 * STOP_HZ
        );
        ensure!(
            n_frames as f64 / rate_hz >= 1.0 + 2.0 * HALF_WIDTH_S,
            "the take is too short: at least {:.1} s are needed",
            1.0 + 2.0 * HALF_WIDTH_S
        );
        let is_whole = |&marker: &usize| (0..n_frames).all(|f| !is_gap(motion.frame(f)[marker]));
        let whole: Vec<usize> = (0..motion.info.markers.len()).filter(is_whole).collect();
        ensure!(!whole.is_empty(), "every marker has gaps: at least one must be complete");
        let rows = (0..n_frames).flat_map(|frame| whole.iter().map(move |&m| (frame, m)));
        let positions_mm = rows.map(|(frame, m)| motion.frame(frame)[m].map(f64::from)).collect();
        Ok(Self { rate_hz, positions_mm, n_markers: whole.len(), n_frames })
    }

    /// The recorded positions of a frame, one per marker.
    pub(crate) fn frame(&self, index: usize) -> &[[f64; 3]] {
        &self.positions_mm[index * self.n_markers..(index + 1) * self.n_markers]
    }

    /// The frames with the full half width of the filter on both sides.
    pub(crate) fn inner_frames(&self) -> std::ops::Range<usize> {
        let edge = (HALF_WIDTH_S * self.rate_hz).ceil() as usize;
        edge..self.n_frames - edge
    }

    /// Duration of the inner frames in seconds.
    pub(crate) fn seconds(&self) -> f64 {
        self.inner_frames().len() as f64 / self.rate_hz
    }

    /// Replaces `row` with the smoothed positions at a frame number, which need not be whole.
    pub(crate) fn at(&self, frame: f64, row: &mut Vec<[f64; 3]>) {
        let reach = HALF_WIDTH_S * self.rate_hz;
        let first = (frame - reach).ceil().max(0.0) as usize;
        let last = ((frame + reach).floor() as usize).min(self.n_frames - 1);
        row.clear();
        row.resize(self.n_markers, [0.0; 3]);
        let mut weights = 0.0;
        for n in first..=last {
            let weight = weight((frame - n as f64) / self.rate_hz);
            weights += weight;
            for (sum, position) in row.iter_mut().zip(self.frame(n)) {
                for (sum, value) in sum.iter_mut().zip(position) {
                    *sum += weight * value;
                }
            }
        }
        for sum in row.iter_mut().flatten() {
            *sum /= weights;
        }
    }

    /// The inner frames resampled at `rate_hz`, one column per marker.
    pub(crate) fn sampled(&self, rate_hz: f64) -> Vec<Vec<Position>> {
        let n_rows = (self.seconds() * rate_hz).floor() as usize;
        let mut columns = vec![Vec::with_capacity(n_rows); self.n_markers];
        let mut row = Vec::new();
        for index in 0..n_rows {
            let frame = self.inner_frames().start as f64 + index as f64 / rate_hz * self.rate_hz;
            self.at(frame, &mut row);
            for (column, position) in columns.iter_mut().zip(&row) {
                column.push(position.map(|v| v as f32));
            }
        }
        columns
    }
}
