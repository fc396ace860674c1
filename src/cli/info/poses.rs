//! The poses of rigid bodies in the report of `info`.

use mocapd_take::TakeMap;
use serde::Serialize;

use crate::cli::{
    output::plain,
    values::{bytes, count, rate},
};

/// The rigid bodies of a take, and their poses.
#[derive(Debug, Serialize)]
pub(super) struct PosesReport {
    bodies: Vec<BodyReport>,
    rate_hz: f64,
    /// Frames with poses, lost ones included.
    frames: u64,
    frames_lost: u64,
    /// The largest errors allowed; `None` if the poses are as the device sent them.
    tolerance_mm: Option<f64>,
    tolerance_degrees: Option<f64>,
    /// The largest errors that were measured; the tolerances where that is not known.
    max_error_mm: f64,
    max_error_degrees: f64,
    stored_bytes: u64,
}

/// A rigid body. Names may be empty, and may repeat.
#[derive(Debug, Serialize)]
struct BodyReport {
    name: String,
    number: u32,
}

impl PosesReport {
    /// `None` for a take without bodies.
    pub(super) fn new(take: &TakeMap) -> Option<Self> {
        let groups = || take.pose_groups();
        let first = groups().next()?;
        let tolerance = first.group.pose_bounds();
        let errors = groups().map(|group| group.pose_errors(take.sample_ledger.as_ref()));
        let errors = errors.map(|errors| errors.unwrap_or_default().errors());
        let lost = first.lost().iter().fold(0_u64, |sum, lost| sum.saturating_add(lost.n));
        let (mm, degrees) = errors.fold((0.0_f64, 0.0_f64), |(mm, degrees), of_group| {
            (mm.max(of_group.position_mm), degrees.max(of_group.angle_degrees))
        });
        Some(Self {
            bodies: groups()
                .flat_map(|group| group.group.numbered_bodies())
                .map(|(number, name)| BodyReport { name: name.to_owned(), number })
                .collect(),
            rate_hz: first.group.rate_hz,
            frames: first.n_samples(),
            frames_lost: lost,
            tolerance_mm: tolerance.map(|[mm, _]| mm),
            tolerance_degrees: tolerance.map(|[_, degrees]| degrees),
            max_error_mm: mm,
            max_error_degrees: degrees,
            stored_bytes: groups().map(|group| group.stored_bytes).sum(),
        })
    }

    /// A line of text.
    pub(super) fn text(&self) -> String {
        let names: Vec<String> =
            self.bodies.iter().map(|body| plain(&body.name).to_string()).collect();
        let lost = match self.frames_lost {
            0 => String::new(),
            n => format!(", {n} lost"),
        };
        let within = match (self.tolerance_mm, self.tolerance_degrees) {
            (Some(mm), Some(degrees)) => format!(
                "within {mm} mm and {degrees:.4} degrees (largest errors {:.4} mm and {:.4} degrees)",
                self.max_error_mm, self.max_error_degrees
            ),
            _ => "exact".to_owned(),
        };
        format!(
            "{} at {}, {}{lost}, {within}, {} in the take: {}",
            count(self.bodies.len() as u64, "body").replace("bodys", "bodies"),
            rate(self.rate_hz),
            count(self.frames, "frame"),
            bytes(self.stored_bytes),
            names.join(", ")
        )
    }
}
