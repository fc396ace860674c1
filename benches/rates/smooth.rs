//! A recorded motion without its noise, at any moment.

use anyhow::ensure;
use mocapd_take::motion::{Motion, Position, is_gap};

use crate::low_pass::{HALF_WIDTH_S, STOP_HZ, weight};

/// The markers of a take that no frame lacks.
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
    /// When the take's rate leaves no band to measure noise in, it is too short, or no marker is whole.
    pub(crate) fn new(motion: &Motion) -> anyhow::Result<Self> {
        let rate_hz = motion.info.rate_hz;
        let n_frames = motion.n_frames();
        // Half as much again as the filter's own end: a third of the band is noise alone.
        ensure!(
            rate_hz >= 3.0 * STOP_HZ,
            "{rate_hz} Hz are too few to tell noise from motion, {} at least are needed",
            3.0 * STOP_HZ
        );
        ensure!(
            n_frames as f64 / rate_hz >= 1.0 + 2.0 * HALF_WIDTH_S,
            "it is too short: it needs {:.1} s",
            1.0 + 2.0 * HALF_WIDTH_S
        );
        let is_whole = |&marker: &usize| (0..n_frames).all(|f| !is_gap(motion.frame(f)[marker]));
        let whole: Vec<usize> = (0..motion.info.markers.len()).filter(is_whole).collect();
        ensure!(!whole.is_empty(), "every marker has gaps");
        let rows = (0..n_frames).flat_map(|frame| whole.iter().map(move |&m| (frame, m)));
        let positions_mm = rows.map(|(frame, m)| motion.frame(frame)[m].map(f64::from)).collect();
        Ok(Self { rate_hz, positions_mm, n_markers: whole.len(), n_frames })
    }

    /// As recorded.
    pub(crate) fn frame(&self, index: usize) -> &[[f64; 3]] {
        &self.positions_mm[index * self.n_markers..(index + 1) * self.n_markers]
    }

    /// The frames that have the filter's whole width on both sides.
    pub(crate) fn inner_frames(&self) -> std::ops::Range<usize> {
        let edge = (HALF_WIDTH_S * self.rate_hz).ceil() as usize;
        edge..self.n_frames - edge
    }

    /// Seconds of the motion between the filter's ends.
    pub(crate) fn seconds(&self) -> f64 {
        self.inner_frames().len() as f64 / self.rate_hz
    }

    /// Replaces `row` by the markers so many frames, or parts of one, from the take's first.
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

    /// The whole inner motion at a rate, a column a marker.
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
