//! The rigid bodies of a recording against time: position and rotation of each, under the trajectory of a marker.

use mocapd_take::{
    interchange::output_names,
    motion::{Motion, MotionInfo},
    poses::Pose,
    sampled::Recording,
};
use plotters::style::RGBColor;

use super::{
    BODY, DIM, INK, TITLE, left_aligned,
    recorded::Trace,
    sampled::{Dash, HEAD, Panels, STYLES, TIME_AXIS, WIDTH, legend, span_s, start_s},
    sheet, shortened, text,
};
use crate::{
    ReportError,
    column::{Column, Vector},
};

/// Maximum number of rigid bodies on a sheet, each with two panels.
pub const BODIES_MAX: usize = 6;
/// Bodies on a sheet if none is chosen.
const BODIES_SHOWN: usize = 4;

/// Height of a panel: three curves share it.
const PANEL: u32 = 160;

/// Change of a rotation vector between two frames from which on the curve is interrupted, in degrees: behind a whole turn
/// the vector begins anew.
const ANEW_DEGREES: f64 = 90.0;

/// The contents of a plot of rigid bodies.
#[derive(Debug, Clone, Copy)]
pub struct BodiesPlot<'a> {
    /// The take's name, for the title.
    pub name: &'a str,
    /// The take with its recording.
    pub info: &'a MotionInfo,
    /// Its samples.
    pub motion: &'a Motion,
    /// Indices of the bodies, at most [`BODIES_MAX`]; empty for the first ones.
    pub bodies: &'a [usize],
    /// The column of the marker whose trajectory is drawn; `None` for a take without markers.
    pub marker: Option<usize>,
    /// The first frame and one past the last, from 0.
    pub rows: (u64, u64),
}

/// The names of a take's rigid bodies, as in exports: each is unique.
#[must_use]
pub fn plot_bodies(info: &MotionInfo) -> Vec<String> {
    let bodies = info.recording.as_ref().map_or(&[][..], Recording::bodies);
    output_names(bodies.iter().map(|body| (body.number, &body.name)))
}

/// The curves of a body.
struct BodyTraces {
    name: String,
    position_mm: [Trace; 3],
    rotation: [Trace; 3],
    /// The last rotation vector, in degrees.
    last: Option<Vector>,
    n_tracked: u64,
}

/// Draws rigid bodies as SVG: below the trajectory of a marker, the position of each and its rotation vector, whose
/// direction is the axis and whose length is the angle, in degrees.
///
/// # Errors
/// `Nothing` for a take without rigid bodies, `InvalidArgument` for too many of them; those of reading the take.
pub fn bodies(plot: &BodiesPlot<'_>) -> Result<String, ReportError> {
    let names = plot_bodies(plot.info);
    let n_bodies = names.len();
    let traces = body_traces(plot, &names)?;
    let marker = plot.marker.map(|marker| marker_traces(plot, marker));
    let n_panels = 2 * traces.len() + usize::from(marker.is_some());
    let height = HEAD as u32 + PANEL * n_panels as u32 + TIME_AXIS;
    sheet((WIDTH, height), |area| {
        let title = format!("Rigid bodies of {}", shortened(plot.name, 60));
        text(area, &title, (24, 26), left_aligned(TITLE, INK))?;
        let of = format!(
            "{} of {n_bodies} bodies, {} Hz; rotation: axis times angle",
            traces.len(),
            (plot.info.rate_hz * 100.0).round() / 100.0
        );
        text(area, &of, (24, 52), left_aligned(BODY, DIM))?;
        let (head, body) = area.split_vertically(HEAD);
        legend(&head)?;
        let all = traces.iter().flat_map(|of| &of.position_mm);
        let all: Vec<Trace> = all.chain(marker.iter().flatten()).cloned().collect();
        let panels = Panels::new(&body, (n_panels, PANEL), span_s(&all));
        let mut index = 0;
        let mut draw = |title: String, curves: &[Trace; 3]| {
            let styled: Vec<(&Trace, RGBColor, Dash)> =
                curves.iter().zip(STYLES).map(|(t, (colour, dash))| (t, colour, dash)).collect();
            index += 1;
            panels.draw(index - 1, &title, &styled)
        };
        if let Some((index, curves)) = plot.marker.zip(marker.as_ref()) {
            let label = plot.motion.info.markers.get(index).map(|marker| marker.label.as_str());
            draw(format!("marker {} (mm)", shortened(label.unwrap_or_default(), 40)), curves)?;
        }
        let n_frames = plot.rows.1.saturating_sub(plot.rows.0).max(1);
        for of in &traces {
            let name = shortened(&of.name, 40);
            let share = 100.0 * of.n_tracked as f64 / n_frames as f64;
            let share = if share < 100.0 { share.min(99.9) } else { share };
            let tracked = format!("tracked in {share:.1} % of the frames");
            draw(format!("position of {name} (mm), {tracked}"), &of.position_mm)?;
            draw(format!("rotation of {name} (degrees)"), &of.rotation)?;
        }
        Ok(())
    })
}

fn body_traces(plot: &BodiesPlot<'_>, names: &[String]) -> Result<Vec<BodyTraces>, ReportError> {
    let recording = plot.info.recording.as_ref().filter(|_| !names.is_empty());
    let recording = recording.ok_or_else(|| {
        ReportError::Nothing(
            "the take has no rigid bodies: only recordings of devices that send their poses have them"
                .to_owned(),
        )
    })?;
    if plot.bodies.len() > BODIES_MAX {
        return Err(ReportError::InvalidArgument(format!(
            "{} rigid bodies are too many to plot: give up to {BODIES_MAX} with --bodies",
            plot.bodies.len()
        )));
    }
    let chosen: Vec<usize> = match plot.bodies {
        [] => (0..names.len().min(BODIES_SHOWN)).collect(),
        given => given.to_vec(),
    };
    let mut part = plot.info.clone();
    part.cut(plot.rows.0, plot.rows.1.min(plot.info.n_frames));
    let (first_s, rate_hz) = (start_s(&part, plot.rows), part.rate_hz);
    let trace = || Trace::new(first_s, rate_hz, part.n_frames);
    let mut traces: Vec<(usize, BodyTraces)> = Vec::new();
    for index in chosen {
        let Some(name) = names.get(index) else {
            return Err(ReportError::InvalidArgument(format!("the take has no body {index}")));
        };
        let [position_mm, rotation] = [(); 2].map(|()| [(); 3].map(|()| trace()));
        let (name, last, n_tracked) = (name.clone(), None, 0);
        traces.push((index, BodyTraces { name, position_mm, rotation, last, n_tracked }));
    }
    let mut poses = recording.poses(part.rows());
    let (mut block, mut n_read) = (Vec::new(), 0_u64);
    while poses.next(&mut block).map_err(mocapd_take::TakeError::from)?.is_some() {
        for of_frame in block.chunks_exact(names.len()) {
            let time_s = first_s + n_read as f64 / rate_hz;
            for (index, body) in &mut traces {
                if let Some(pose) = of_frame.get(*index) {
                    body.push(time_s, pose);
                }
            }
            n_read += 1;
        }
    }
    for (_, body) in &mut traces {
        body.position_mm.iter_mut().chain(&mut body.rotation).for_each(Trace::end);
    }
    Ok(traces.into_iter().map(|(_, body)| body).collect())
}

impl BodyTraces {
    /// Adds the pose of the next frame.
    fn push(&mut self, time_s: f64, pose: &Pose) {
        self.n_tracked += u64::from(pose.is_tracked());
        let position_mm = pose.position_mm.map(f64::from);
        push_all(&mut self.position_mm, time_s, position_mm);
        if !pose.is_tracked() {
            push_all(&mut self.rotation, time_s, [f64::NAN; 3]);
            return;
        }
        let vector = rotation_vector(pose.quaternion, self.last);
        let moved = self.last.map_or(0.0, |last| length(difference(vector, last)));
        if moved > ANEW_DEGREES {
            push_all(&mut self.rotation, time_s, [f64::NAN; 3]);
        }
        push_all(&mut self.rotation, time_s, vector);
        self.last = Some(vector);
    }
}

fn push_all(traces: &mut [Trace; 3], time_s: f64, values: Vector) {
    traces.iter_mut().zip(values).for_each(|(trace, value)| trace.push_at(time_s, value));
}

/// The rotation vector of a quaternion in degrees: the axis times the angle. Of all that are the same rotation, which are
/// whole turns apart, the one that is nearest to the vector before; without one, the shortest.
fn rotation_vector([w, x, y, z]: [f32; 4], before: Option<Vector>) -> Vector {
    let (w, along) = (f64::from(w), [x, y, z].map(f64::from));
    let sine = length(along);
    let before = before.unwrap_or_default();
    // Without a turn there is no axis, and that of before will do.
    let axis = if sine > 0.0 { along } else { before };
    let of_axis = length(axis);
    if of_axis == 0.0 {
        return [0.0; 3];
    }
    let axis = axis.map(|number| number / of_axis);
    let degrees = (2.0 * sine.atan2(w)).to_degrees();
    let on_axis: f64 = axis.iter().zip(before).map(|(a, b)| a * b).sum();
    let turns = ((on_axis - degrees) / 360.0).round();
    axis.map(|number| number * (degrees + 360.0 * turns))
}

fn length(vector: Vector) -> f64 {
    vector.iter().map(|number| number * number).sum::<f64>().sqrt()
}

fn difference(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

/// The trajectory of the marker in the frames of the plot.
fn marker_traces(plot: &BodiesPlot<'_>, marker: usize) -> [Trace; 3] {
    let (first, end) = plot.rows;
    let rate_hz = plot.motion.info.rate_hz.max(f64::MIN_POSITIVE);
    let n = end.saturating_sub(first);
    let mut traces = [(); 3].map(|()| Trace::new(first as f64 / rate_hz, rate_hz, n));
    let column = Column::of(plot.motion, marker);
    let row = |row: u64| usize::try_from(row).unwrap_or(usize::MAX).min(column.0.len());
    for at in column.0.get(row(first)..row(end)).unwrap_or_default() {
        let at = at.unwrap_or([f64::NAN; 3]);
        traces.iter_mut().zip(at).for_each(|(trace, value)| trace.push(value));
    }
    traces.iter_mut().for_each(Trace::end);
    traces
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The quaternion of a rotation about an axis of length 1.
    fn turned(axis: Vector, degrees: f64) -> [f32; 4] {
        let (sine, cosine) = (degrees.to_radians() / 2.0).sin_cos();
        let [x, y, z] = axis.map(|number| (number * sine) as f32);
        [cosine as f32, x, y, z]
    }

    #[test]
    fn rotation_vectors_continue_across_half_and_whole_turns_and_signs() {
        let axis = [0.48, -0.6, 0.64];
        let mut last = None;
        for step in 0..=140 {
            let degrees = f64::from(step) * 10.0 - 300.0;
            let mut quaternion = turned(axis, degrees);
            if step % 3 == 0 {
                quaternion = quaternion.map(|number| -number);
            }
            let vector = rotation_vector(quaternion, last);
            if let Some(last) = last {
                let moved = length(difference(vector, last));
                assert!((moved - 10.0).abs() < 1e-3, "{degrees}: {vector:?}");
            } else {
                // The shortest of the same rotation.
                assert!((length(vector) - 60.0).abs() < 1e-3, "{vector:?}");
            }
            last = Some(vector);
        }
    }

    #[test]
    fn rotations_without_an_axis_are_none_or_whole_turns() {
        assert_eq!(rotation_vector([1.0, 0.0, 0.0, 0.0], None), [0.0; 3]);
        assert_eq!(rotation_vector([-1.0, 0.0, 0.0, 0.0], None), [0.0; 3]);
        let before = Some([0.0, 0.0, 359.0]);
        assert_eq!(rotation_vector([-1.0, 0.0, 0.0, 0.0], before), [0.0, 0.0, 360.0]);
        let half = rotation_vector([0.0, 0.0, 0.0, 1.0], None);
        assert!((length(half) - 180.0).abs() < 1e-9);
    }
}
