//! The trajectory of one marker: original samples, kept samples and the reconstruction, in space and against time
//! (figure 2 of Shi et al. 2012).

use std::ops::Range;

use mocapd_take::motion::Motion;
use plotters::prelude::*;

use super::{
    Area, Axes, BLUE, BODY, DIM, DrawResult, INK, SMALL, TITLE, VERMILION, centred, left_aligned,
    panel, range, sheet, shortened, text,
};
use crate::{
    ReportError,
    column::{Column, Vector, distance, runs},
    decoded::DecodedTake,
    up::Up,
};

/// Maximum number of rows with a circle for each sample; with more, only the curve is drawn.
const MARKED_ROWS_MAX: usize = 1500;

/// Maximum number of rows: more are unreadable on a page, and make a file of megabytes.
const ROWS_MAX: usize = 20_000;

const SIZE: (u32, u32) = (1280, 860);
const HEAD: i32 = 74;
const LEFT: i32 = 560;

/// The contents of a plot of a trajectory.
#[derive(Debug, Clone, Copy)]
pub struct TrajectoryPlot<'a> {
    /// The take's name, for the title.
    pub name: &'a str,
    /// The take.
    pub take: &'a DecodedTake,
    /// Its original, if available.
    pub original: Option<&'a Motion>,
    /// The column of the marker.
    pub marker: usize,
    /// The first row and one past the last, from 0.
    pub rows: (usize, usize),
    /// The up direction.
    pub up: Up,
}

/// The rows to draw.
struct Path {
    rows: Range<usize>,
    rate_hz: f64,
    rebuilt: Column,
    original: Option<Column>,
    kept: Vec<bool>,
    is_marked: bool,
}

/// Draws the trajectory as SVG.
///
/// # Errors
/// `Nothing` if there is no sample in these rows, `InvalidArgument` for too many rows or an unknown marker.
pub fn trajectory(plot: &TrajectoryPlot<'_>) -> Result<String, ReportError> {
    let path = Path::of(plot)?;
    let label = &plot.take.motion.info.markers[plot.marker].label;
    sheet(SIZE, |area| {
        let title = format!("{} of {}", shortened(label, 40), shortened(plot.name, 60));
        text(area, &title, (24, 26), left_aligned(TITLE, INK))?;
        text(area, &path.caption(plot), (24, 52), left_aligned(BODY, DIM))?;
        let (head, body) = area.split_vertically(HEAD);
        legend(&head, &path, plot.take.settings.is_some() || plot.original.is_some())?;
        let (left, right) = body.split_horizontally(LEFT);
        in_space(&left, &path, plot.up)?;
        against_time(&right, &path, plot)
    })
}

impl Path {
    fn of(plot: &TrajectoryPlot<'_>) -> Result<Self, ReportError> {
        let motion = &plot.take.motion;
        let marker = plot.marker;
        if marker >= motion.info.markers.len() {
            return Err(ReportError::InvalidArgument(format!("the take has no column {marker}")));
        }
        let rows = plot.rows.0..plot.rows.1.min(motion.n_frames());
        if rows.len() > ROWS_MAX {
            return Err(ReportError::InvalidArgument(format!(
                "{} frames are too many to plot (at most {ROWS_MAX}): give --from and --to",
                rows.len()
            )));
        }
        let cut = |column: Column| Column(column.0.get(rows.clone()).unwrap_or_default().to_vec());
        let rebuilt = cut(Column::of(motion, marker));
        if rebuilt.n_samples() == 0 {
            return Err(ReportError::Nothing(format!(
                "{} has no samples in these frames: nothing to draw",
                motion.info.markers[marker].label
            )));
        }
        let kept = plot.take.kept.get(marker).and_then(|kept| kept.get(rows.clone()));
        Ok(Self {
            rate_hz: motion.info.rate_hz.max(f64::MIN_POSITIVE),
            original: plot.original.map(|original| cut(Column::of(original, marker))),
            kept: kept.unwrap_or_default().to_vec(),
            is_marked: rows.len() <= MARKED_ROWS_MAX,
            rebuilt,
            rows,
        })
    }

    fn time_s(&self, row: usize) -> f64 {
        (self.rows.start + row) as f64 / self.rate_hz
    }

    /// The reconstruction as runs between gaps.
    fn curves(&self) -> impl Iterator<Item = Vec<(usize, Vector)>> + '_ {
        let runs = runs(self.rebuilt.0.iter().map(Option::is_some));
        runs.map(|run| run.filter_map(|row| Some((row, self.rebuilt.0[row]?))).collect())
    }

    fn originals(&self) -> impl Iterator<Item = (usize, Vector)> + '_ {
        let column = self.original.as_ref().filter(|_| self.is_marked);
        column.into_iter().flat_map(|column| {
            column.0.iter().enumerate().filter_map(|(row, at)| Some((row, (*at)?)))
        })
    }

    fn kept(&self) -> impl Iterator<Item = (usize, Vector)> + '_ {
        let rows = self.kept.iter().enumerate().filter(|(_, kept)| **kept && self.is_marked);
        rows.filter_map(|(row, _)| Some((row, (*self.rebuilt.0.get(row)?)?)))
    }

    fn errors_mm(&self) -> Vec<(usize, f64)> {
        let Some(original) = &self.original else { return Vec::new() };
        let pairs = self.rebuilt.0.iter().zip(&original.0).enumerate();
        pairs.filter_map(|(row, (a, b))| Some((row, distance((*a)?, (*b)?)))).collect()
    }

    fn caption(&self, plot: &TrajectoryPlot<'_>) -> String {
        let kept = self.kept.iter().filter(|kept| **kept).count();
        let (n_samples, coding) = (self.rebuilt.n_samples(), plot.take.coding());
        let mut caption = match plot.take.settings {
            Some(_) => format!("{coding}: {kept} of {n_samples} samples kept"),
            None => format!("{n_samples} samples"),
        };
        caption += &format!(", {} Hz", (self.rate_hz * 100.0).round() / 100.0);
        if let Some(worst) = self.errors_mm().iter().map(|e| e.1).reduce(f64::max) {
            caption += &format!(", max error {worst:.3} mm");
        }
        if !self.is_marked {
            caption += "; too many samples to mark each";
        }
        caption
    }
}

fn legend(area: &Area<'_>, path: &Path, is_reconstructed: bool) -> DrawResult {
    // A file of another program has one line alone.
    if !is_reconstructed {
        return Ok(());
    }
    let y = 26;
    let mut x = SIZE.0 as i32 - 470;
    if path.original.is_some() && path.is_marked {
        area.draw(&Circle::new((x, y), 4, DIM.stroke_width(1)))?;
        text(area, "original samples", (x + 12, y), left_aligned(BODY, INK))?;
    }
    x += 170;
    if path.is_marked {
        area.draw(&Circle::new((x, y), 4, VERMILION.filled()))?;
        text(area, "kept samples", (x + 12, y), left_aligned(BODY, INK))?;
    }
    x += 142;
    area.draw(&PathElement::new(vec![(x - 8, y), (x + 12, y)], BLUE.stroke_width(2)))?;
    text(area, "reconstruction", (x + 20, y), left_aligned(BODY, INK))
}

/// Draws the trajectory in an oblique view from above, with all axes at the same scale.
fn in_space(area: &Area<'_>, path: &Path, up: Up) -> DrawResult {
    let project = projection(up);
    let all = path.rebuilt.0.iter().flatten().copied().chain(path.originals().map(|(_, at)| at));
    let points: Vec<(f64, f64)> = all.map(project).collect();
    let (xs, ys) = (range(points.iter().map(|p| p.0)), range(points.iter().map(|p| p.1)));
    let (width, height) = area.dim_in_pixel();
    let (left, top, right, bottom) = (40.0, 46.0, 30.0, 96.0);
    let (room_x, room_y) = (f64::from(width) - left - right, f64::from(height) - top - bottom);
    let scale = (room_x / (xs.end - xs.start)).min(room_y / (ys.end - ys.start));
    let (mid_x, mid_y) = (0.5 * (xs.start + xs.end), 0.5 * (ys.start + ys.end));
    let place = |at: Vector| {
        let (x, y) = project(at);
        let px = left + 0.5 * room_x + (x - mid_x) * scale;
        let py = top + 0.5 * room_y - (y - mid_y) * scale;
        (px.round() as i32, py.round() as i32)
    };
    text(area, "in space", (40, 18), left_aligned(BODY, INK))?;
    for (_, at) in path.originals() {
        area.draw(&Circle::new(place(at), 4, DIM.stroke_width(1)))?;
    }
    for curve in path.curves() {
        let points: Vec<(i32, i32)> = curve.iter().map(|&(_, at)| place(at)).collect();
        area.draw(&PathElement::new(points, BLUE.stroke_width(2)))?;
    }
    for (_, at) in path.kept() {
        area.draw(&Circle::new(place(at), 3, VERMILION.filled()))?;
    }
    // A scale bar and the directions of the axes.
    let bar_mm = round_length(0.25 * room_x / scale);
    let (bar, base) = ((bar_mm * scale).round() as i32, height as i32 - 36);
    area.draw(&PathElement::new(vec![(170, base), (170 + bar, base)], INK.stroke_width(3)))?;
    text(area, &format!("{bar_mm} mm"), (170, base + 18), left_aligned(BODY, INK))?;
    let corner = (74, base - 8);
    for (axis, name) in ["x", "y", "z"].iter().enumerate() {
        let mut unit = [0.0; 3];
        unit[axis] = 1.0;
        let ((x, y), (ox, oy)) = (project(unit), project([0.0; 3]));
        let end = |length: f64| {
            (corner.0 + ((x - ox) * length) as i32, corner.1 - ((y - oy) * length) as i32)
        };
        area.draw(&PathElement::new(vec![corner, end(34.0)], DIM.stroke_width(1)))?;
        text(area, name, end(46.0), centred(SMALL, DIM))?;
    }
    Ok(())
}

/// The oblique projection of a position: up stays up, the other two axes point to the right at an angle.
fn projection(up: Up) -> impl Fn(Vector) -> (f64, f64) + Copy {
    let (right, depth) = ((up.axis + 1) % 3, (up.axis + 2) % 3);
    let ((turn_sin, turn_cos), (tilt_sin, tilt_cos)) =
        (35.0_f64.to_radians().sin_cos(), 25.0_f64.to_radians().sin_cos());
    move |at: Vector| {
        let (a, b, c) = (at[right], at[depth], up.height(at));
        let x = a * turn_cos + b * turn_sin;
        let depth = b * turn_cos - a * turn_sin;
        (x, c * tilt_cos + depth * tilt_sin)
    }
}

/// The largest of 1, 2, 5, 10 ... mm that does not exceed a length.
fn round_length(mm: f64) -> f64 {
    let power = 10.0_f64.powf(mm.max(1e-6).log10().floor());
    let digit = [5.0, 2.0, 1.0].into_iter().find(|digit| digit * power <= mm);
    digit.unwrap_or(1.0) * power
}

fn against_time(area: &Area<'_>, path: &Path, plot: &TrajectoryPlot<'_>) -> DrawResult {
    let errors = path.errors_mm();
    let n_panels = if errors.is_empty() { 3 } else { 4 };
    let areas = area.split_evenly((n_panels, 1));
    let times = path.time_s(0)..path.time_s(path.rows.len().max(2) - 1);
    let is_last = |i: usize| i + 1 == n_panels;
    let axes = |i: usize, y: Range<f64>, y_title: &'static str| Axes {
        x: times.clone(),
        y,
        x_title: if is_last(i) { "time (s)" } else { "" },
        y_title,
        margins: [10, 24, 4, 4],
    };
    for (axis, name) in ["x (mm)", "y (mm)", "z (mm)"].into_iter().enumerate() {
        let originals = path.original.iter().flat_map(|column| column.0.iter().flatten());
        let values = path.rebuilt.0.iter().flatten().chain(originals);
        let y = range(values.map(|at| at[axis]));
        let mut chart = panel(&areas[axis], &axes(axis, y, name))?;
        let point = |(row, at): (usize, Vector)| (path.time_s(row), at[axis]);
        chart
            .draw_series(path.originals().map(|s| Circle::new(point(s), 4, DIM.stroke_width(1))))?;
        for curve in path.curves() {
            chart
                .draw_series(LineSeries::new(curve.into_iter().map(point), BLUE.stroke_width(2)))?;
        }
        chart.draw_series(path.kept().map(|s| Circle::new(point(s), 3, VERMILION.filled())))?;
    }
    if errors.is_empty() {
        return Ok(());
    }
    let tolerance_mm =
        plot.take.settings.filter(|s| !s.kind.is_lossless()).map(|s| s.tolerance.mm());
    let worst = errors.iter().map(|e| e.1).chain(tolerance_mm).fold(1e-3, f64::max);
    let mut chart = panel(&areas[3], &axes(3, 0.0..1.2 * worst, "error (mm)"))?;
    let is_known = |row: usize| errors.binary_search_by_key(&row, |e| e.0).is_ok();
    for run in runs((0..path.rows.len()).map(is_known)) {
        let part = errors.iter().filter(|(row, _)| run.contains(row));
        let points = part.map(|&(row, mm)| (path.time_s(row), mm));
        chart.draw_series(LineSeries::new(points, INK.stroke_width(1)))?;
    }
    if let Some(mm) = tolerance_mm {
        let line = [(times.start, mm), (times.end, mm)];
        chart.draw_series(DashedLineSeries::new(line, 6, 4, VERMILION.stroke_width(1)))?;
        let (x, y) = chart.backend_coord(&(times.start, mm));
        let base = areas[3].get_base_pixel();
        let at = (x - base.0 + 8, y - base.1 - 9);
        text(&areas[3], &format!("tolerance {mm} mm"), at, left_aligned(SMALL, VERMILION))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_bars_have_round_lengths() {
        for (mm, round) in [(1.0, 1.0), (1.9, 1.0), (137.0, 100.0), (260.0, 200.0), (0.7, 0.5)] {
            assert!((round_length(mm) - round).abs() < 1e-9, "{mm}");
        }
    }

    #[test]
    fn up_is_up_for_every_axis() {
        for (axis, sign) in [(0, 1.0), (1, 1.0), (2, 1.0), (2, -1.0)] {
            let project = projection(Up { axis, sign });
            let mut unit = [0.0; 3];
            unit[axis] = sign;
            let (x, y) = project(unit);
            assert!(x.abs() < 1e-12 && y > 0.5, "{axis} {sign}");
        }
    }
}
