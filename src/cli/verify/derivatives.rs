//! `verify --cutoff`: errors of velocities and accelerations, as JSON (docs/json.md) and as text.

use std::path::Path;

use mocapd::outcome::UsageError;
use mocapd_report::{
    ReportError,
    derivative::{DerivativeError, by_marker},
};
use serde::Serialize;

use crate::cli::{
    motion_files::{read_original, read_take},
    output::plain,
};

#[derive(Debug, Serialize)]
pub(super) struct DerivativesReport {
    cutoff_hz: f64,
    samples_left_out: u64,
    all: Errors,
    markers: Vec<MarkerErrors>,
}

#[derive(Debug, Serialize)]
struct MarkerErrors {
    label: String,
    #[serde(flatten)]
    errors: Errors,
}

#[derive(Debug, Serialize)]
struct Errors {
    velocity_rms_mm_s: f64,
    velocity_max_mm_s: f64,
    acceleration_rms_mm_s2: f64,
    acceleration_max_mm_s2: f64,
    original_velocity_rms_mm_s: f64,
    original_velocity_max_mm_s: f64,
    original_acceleration_rms_mm_s2: f64,
    original_acceleration_max_mm_s2: f64,
}

impl From<&DerivativeError> for Errors {
    fn from(found: &DerivativeError) -> Self {
        Self {
            velocity_rms_mm_s: found.velocity_mm_s.rms(),
            velocity_max_mm_s: found.velocity_mm_s.max(),
            acceleration_rms_mm_s2: found.acceleration_mm_s2.rms(),
            acceleration_max_mm_s2: found.acceleration_mm_s2.max(),
            original_velocity_rms_mm_s: found.original_velocity_mm_s.rms(),
            original_velocity_max_mm_s: found.original_velocity_mm_s.max(),
            original_acceleration_rms_mm_s2: found.original_acceleration_mm_s2.rms(),
            original_acceleration_max_mm_s2: found.original_acceleration_mm_s2.max(),
        }
    }
}

/// Compares the derivatives of a take with those of its original.
///
/// # Errors
/// If one cannot be read; a usage error for a cutoff that the frame rate does not allow.
pub(super) fn derivatives(
    take: &Path,
    original: &Path,
    cutoff_hz: f64,
) -> anyhow::Result<DerivativesReport> {
    let decoded = read_take(take)?;
    let (original, _) = read_original(take, original)?;
    let found = by_marker(&decoded.motion, &original, cutoff_hz).map_err(|error| match error {
        ReportError::InvalidArgument(why) => UsageError(why).into(),
        other => anyhow::Error::from(other),
    })?;
    let mut all = DerivativeError::default();
    found.iter().for_each(|marker| all.add_all(marker));
    let markers = original.info.markers.iter().zip(&found).map(|(marker, found)| MarkerErrors {
        label: marker.label.clone(),
        errors: Errors::from(found),
    });
    Ok(DerivativesReport {
        cutoff_hz,
        samples_left_out: all.samples_left_out,
        all: Errors::from(&all),
        markers: markers.collect(),
    })
}

impl DerivativesReport {
    /// A table of the markers, with all of them together in the last line.
    pub(super) fn text(&self) -> String {
        let mut out = format!(
            "errors of the take's derivatives, low-passed at {} Hz (fourth-order zero-lag Butterworth):\n\
             {:<20} {:>22} {:>26}\n{:<20} {:>10} {:>11} {:>13} {:>12}\n",
            self.cutoff_hz,
            "",
            "velocity (mm/s)",
            "acceleration (mm/s^2)",
            "marker",
            "rms",
            "largest",
            "rms",
            "largest"
        );
        let line = |label: &str, errors: &Errors| {
            format!(
                "{:<20} {:>10.3} {:>11.3} {:>13.2} {:>12.2}\n",
                plain(label),
                errors.velocity_rms_mm_s,
                errors.velocity_max_mm_s,
                errors.acceleration_rms_mm_s2,
                errors.acceleration_max_mm_s2
            )
        };
        for marker in &self.markers {
            out += &line(&marker.label, &marker.errors);
        }
        out += &line("all", &self.all);
        let own = &self.all;
        out += &format!(
            "the original motion: velocity {:.0} mm/s rms, {:.0} at most; acceleration {:.0} mm/s^2 rms, {:.0} at most\n",
            own.original_velocity_rms_mm_s,
            own.original_velocity_max_mm_s,
            own.original_acceleration_rms_mm_s2,
            own.original_acceleration_max_mm_s2
        );
        if self.samples_left_out > 0 {
            out += &format!(
                "left out: {} samples, in runs without a gap that are shorter than a period of the cutoff\n",
                self.samples_left_out
            );
        }
        out
    }
}
