//! Stick figures at several times: original above, reconstruction below (figure 3 of Shi et al. 2012).

use mocapd_take::motion::Motion;
use plotters::prelude::*;

use super::{
    Area, BLUE, BODY, DIM, DrawResult, GRID, INK, SMALL, TITLE, VERMILION, centred, left_aligned,
    sheet, shortened, text,
};
use crate::{
    ReportError,
    column::{Vector, distance, median, sample},
    decoded::DecodedTake,
    limbs::Limb,
    up::Up,
};

/// Maximum number of stick figures side by side.
pub const MOMENTS_MAX: usize = 12;

/// Maximum number of markers drawn per stick figure: more are an unreadable cloud, and make a large file.
const MARKERS_MAX: usize = 500;

const WIDTH: u32 = 1280;
const HEAD: i32 = 72;
const ROW: i32 = 330;
const FOOT: i32 = 56;

/// The contents of a plot of stick figures.
#[derive(Debug, Clone, Copy)]
pub struct PosePlot<'a> {
    /// The take's name, for the title.
    pub name: &'a str,
    /// The take.
    pub take: &'a DecodedTake,
    /// Its original, if available.
    pub original: Option<&'a Motion>,
    /// The row of each stick figure, from 0.
    pub rows: &'a [usize],
    /// Pairs of columns to join by lines if there are no limbs.
    pub bones: &'a [[u16; 2]],
    /// Limbs of a scanned skeleton: drawn instead of `bones`, with a table of their lengths.
    pub limbs: &'a [Limb],
    /// The lines of the subject's face under its markers, mm, for each stick figure; empty if it has none.
    pub faces: &'a [Vec<[Vector; 2]>],
    /// Vectors to the face's left and top; if given, the view is from the front of the face.
    pub front: Option<[Vector; 2]>,
    /// The up direction.
    pub up: Up,
}

/// Draws the stick figures as SVG.
///
/// # Errors
/// `Nothing` if there is no sample at these times; `InvalidArgument` if there are no rows, too many, or one beyond the
/// end.
pub fn pose(plot: &PosePlot<'_>) -> Result<String, ReportError> {
    let motion = &plot.take.motion;
    let n_frames = motion.n_frames();
    if plot.rows.is_empty() || plot.rows.len() > MOMENTS_MAX {
        return Err(ReportError::InvalidArgument(format!(
            "cannot draw {} stick figures: give 1 to {MOMENTS_MAX} times",
            plot.rows.len()
        )));
    }
    if let Some(row) = plot.rows.iter().find(|&&row| row >= n_frames) {
        return Err(ReportError::InvalidArgument(format!(
            "no frame {row}: the take has {n_frames} frames, numbered from 0"
        )));
    }
    let view = View::of(plot).ok_or_else(|| {
        ReportError::Nothing("no marker is visible at these times: choose others".to_owned())
    })?;
    let n_rows = if plot.original.is_some() { 2 } else { 1 };
    let table = limbs_height(plot.limbs.len());
    let height = (HEAD + n_rows * ROW + FOOT + table) as u32;
    sheet((WIDTH, height), |area| {
        let title = format!("Poses of {}", shortened(plot.name, 80));
        text(area, &title, (24, 26), left_aligned(TITLE, INK))?;
        text(area, &caption(plot), (24, 52), left_aligned(BODY, DIM))?;
        let mut base = HEAD;
        if let Some(original) = plot.original {
            let strip = Strip { name: "original", motion: original, colour: INK };
            draw_strip(area, base, strip, plot, &view)?;
            base += ROW;
        }
        // A file of another program is drawn as it is.
        let is_reconstructed = plot.take.settings.is_some() || plot.original.is_some();
        let name = if is_reconstructed { "reconstruction" } else { "as in the file" };
        let strip = Strip { name, motion, colour: BLUE };
        draw_strip(area, base, strip, plot, &view)?;
        times(area, base + ROW, plot)?;
        limbs_table(area, base + ROW + FOOT, plot)
    })
}

/// The markers visible in a frame: columns and positions.
fn visible(motion: &Motion, row: usize) -> impl Iterator<Item = (usize, Vector)> + '_ {
    let frame = motion.frame(row).iter().enumerate().take(MARKERS_MAX);
    frame.filter_map(|(marker, &position)| Some((marker, sample(position)?)))
}

/// A row of stick figures of one motion.
#[derive(Clone, Copy)]
struct Strip<'a> {
    name: &'a str,
    motion: &'a Motion,
    colour: RGBColor,
}

fn draw_strip(
    area: &Area<'_>,
    top: i32,
    strip: Strip<'_>,
    plot: &PosePlot<'_>,
    view: &View,
) -> DrawResult {
    let Strip { name, motion, colour } = strip;
    let floor = top + ROW - 24;
    let line = vec![(24, floor), (WIDTH as i32 - 24, floor)];
    area.draw(&PathElement::new(line, GRID.stroke_width(2)))?;
    text(area, name, (24, top + 20), left_aligned(BODY, INK))?;
    for (i, &row) in plot.rows.iter().enumerate() {
        // Both strips are centred on the reconstruction, so that they can be compared by eye.
        let rebuilt: Vec<Vector> = visible(&plot.take.motion, row).map(|(_, at)| at).collect();
        let Some(middle) = middle(&rebuilt, view.across) else { continue };
        let x0 = column_x(i, plot.rows.len());
        let place = |at: Vector| {
            let x = x0 + (view.across.of(at) - middle) * view.scale;
            let y = f64::from(floor) - (view.up.height(at) - view.floor_mm) * view.scale;
            (x.round() as i32, y.round() as i32)
        };
        for line in plot.faces.get(i).into_iter().flatten() {
            area.draw(&PathElement::new(line.map(place).to_vec(), DIM.mix(0.5).stroke_width(1)))?;
        }
        let points: std::collections::BTreeMap<usize, Vector> = visible(motion, row).collect();
        for ([a, b], limb) in lines(plot) {
            if let (Some(&a), Some(&b)) = (points.get(&a), points.get(&b)) {
                let is_off = limb.is_some_and(|limb| limb.is_off(distance(a, b)));
                let colour = if is_off { VERMILION } else { colour };
                let line = vec![place(a), place(b)];
                area.draw(&PathElement::new(line, colour.stroke_width(2)))?;
            }
        }
        for &at in points.values() {
            area.draw(&Circle::new(place(at), 2, colour.filled()))?;
        }
    }
    Ok(())
}

/// The pairs of columns to join, each with its limb if there are limbs.
fn lines<'a>(plot: &PosePlot<'a>) -> impl Iterator<Item = ([usize; 2], Option<&'a Limb>)> {
    let by_label = if plot.limbs.is_empty() { plot.bones } else { &[] };
    let by_label = by_label.iter().map(|bone| (bone.map(usize::from), None));
    by_label.chain(plot.limbs.iter().map(|limb| (limb.ends, Some(limb))))
}

fn column_x(i: usize, n: usize) -> f64 {
    60.0 + f64::from(WIDTH - 120) * (i as f64 + 0.5) / n as f64
}

/// Draws the time and the largest marker error below each stick figure.
fn times(area: &Area<'_>, top: i32, plot: &PosePlot<'_>) -> DrawResult {
    let motion = &plot.take.motion;
    for (i, &row) in plot.rows.iter().enumerate() {
        let x = column_x(i, plot.rows.len()).round() as i32;
        let time_s = row as f64 / motion.info.rate_hz.max(f64::MIN_POSITIVE);
        text(area, &format!("{time_s:.2} s"), (x, top + 2), centred(BODY, INK))?;
        let none = visible(motion, row).next().is_none();
        let line = match plot.original {
            _ if none => "no marker visible".to_owned(),
            None => continue,
            Some(original) => {
                let pairs = motion.frame(row).iter().zip(original.frame(row));
                let errors_mm = pairs.filter_map(|(&a, &b)| Some(distance(sample(a)?, sample(b)?)));
                errors_mm.reduce(f64::max).map_or_else(String::new, |mm| format!("{mm:.2} mm"))
            }
        };
        text(area, &line, (x, top + 24), centred(SMALL, VERMILION))?;
    }
    Ok(())
}

fn caption(plot: &PosePlot<'_>) -> String {
    let mut parts = Vec::new();
    if plot.take.settings.is_some() {
        parts.push(plot.take.coding());
    }
    if plot.original.is_some() {
        parts.push("below each: the largest distance of a marker from the original".to_owned());
    }
    if plot.faces.iter().any(|lines| !lines.is_empty()) {
        parts.push("the subject's face under its markers".to_owned());
    } else if plot.bones.is_empty() && plot.limbs.is_empty() {
        parts.push("no marker set matches the labels (see --skeleton)".to_owned());
    }
    let n = plot.take.motion.info.markers.len();
    if n > MARKERS_MAX {
        parts.push(format!("the first {MARKERS_MAX} of {n} markers"));
    }
    parts.join("; ")
}

/// Columns of the table of limbs, and its maximum number of lines.
const ACROSS: usize = 4;
const LINES_MAX: usize = 8;
const LINE: i32 = 22;
const LIMBS_HEAD: i32 = 34;

/// The height of the table of limbs.
fn limbs_height(n_limbs: usize) -> i32 {
    match n_limbs.div_ceil(ACROSS).min(LINES_MAX) {
        0 => 0,
        n => LIMBS_HEAD + n as i32 * LINE + 14,
    }
}

fn limbs_table(area: &Area<'_>, top: i32, plot: &PosePlot<'_>) -> DrawResult {
    if plot.limbs.is_empty() {
        return Ok(());
    }
    let title = "limb lengths, median in the take / scan (mm); red: differ by more than a tenth and the scan's uncertainty";
    text(area, title, (24, top + 14), left_aligned(SMALL, DIM))?;
    let cell = (WIDTH as i32 - 48) / ACROSS as i32;
    for (i, limb) in plot.limbs.iter().take(ACROSS * LINES_MAX).enumerate() {
        let at = (24 + (i % ACROSS) as i32 * cell, top + LIMBS_HEAD + (i / ACROSS) as i32 * LINE);
        let bone = &limb.bone;
        let sigma_mm = bone.uncertainty_mm.unwrap_or_default();
        let scan = format!("{:.0} ± {sigma_mm:.0}", bone.length_mm);
        let (length, colour) = match median_mm(limb, plot) {
            Some(mm) => (format!("{mm:.0}"), if limb.is_off(mm) { VERMILION } else { INK }),
            None => ("not visible".to_owned(), DIM),
        };
        let line = format!("{}  {length} / {scan}", shortened(&bone.name, 22));
        text(area, &line, at, left_aligned(BODY, colour))?;
    }
    Ok(())
}

/// The median length of a limb over the whole take, mm.
fn median_mm(limb: &Limb, plot: &PosePlot<'_>) -> Option<f64> {
    let motion = &plot.take.motion;
    let length = |row: usize| {
        let ends = limb.ends.map(|end| motion.frame(row).get(end).copied().and_then(sample));
        Some(distance(ends[0]?, ends[1]?))
    };
    let mut all: Vec<f64> = (0..motion.n_frames()).filter_map(length).collect();
    median(&mut all)
}

/// The projection of the body to the sheet.
struct View {
    across: Direction,
    up: Up,
    /// Units of the sheet per millimetre.
    scale: f64,
    /// Lowest height of all stick figures, mm.
    floor_mm: f64,
}

/// An axis with a sign.
#[derive(Clone, Copy)]
struct Direction {
    axis: usize,
    sign: f64,
}

impl Direction {
    /// The axis nearest to a direction, other than `except`.
    fn nearest(direction: Vector, except: Option<usize>) -> Option<Self> {
        let axes = (0..3).filter(|&axis| Some(axis) != except);
        let axis = axes.max_by(|&a, &b| direction[a].abs().total_cmp(&direction[b].abs()))?;
        Some(Self { axis, sign: direction[axis].signum() })
    }

    fn of(self, at: Vector) -> f64 {
        self.sign * at[self.axis]
    }
}

impl View {
    fn of(plot: &PosePlot<'_>) -> Option<Self> {
        let motion = &plot.take.motion;
        let up = plot.up;
        let face = |moment: usize| plot.faces.get(moment).into_iter().flatten().flatten().copied();
        let of_moment = |(moment, &row): (usize, &usize)| {
            let markers = visible(motion, row).map(|(_, at)| at);
            markers.chain(face(moment)).collect()
        };
        let moments: Vec<Vec<Vector>> = plot.rows.iter().enumerate().map(of_moment).collect();
        // The view shows the horizontal axis along which the markers spread most: that of the path, or of the body's
        // width.
        let spread = |axis: usize| {
            let values = moments.iter().flatten().map(|at| at[axis]);
            let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
            high - low
        };
        let across = match plot.front {
            Some([left, _]) => Direction::nearest(left, Some(up.axis))?,
            None => {
                let axes = (0..3).filter(|&axis| axis != up.axis);
                let axis = axes.max_by(|&a, &b| spread(a).total_cmp(&spread(b)))?;
                Direction { axis, sign: 1.0 }
            }
        };
        let floor_mm = moments.iter().flatten().map(|&at| up.height(at)).reduce(f64::min)?;
        let high_mm = moments.iter().flatten().map(|&at| up.height(at)).reduce(f64::max)?;
        let width_mm = |points: &Vec<Vector>| {
            let middle = middle(points, across)?;
            points.iter().map(|&at| 2.0 * (across.of(at) - middle).abs()).reduce(f64::max)
        };
        let wide_mm = moments.iter().filter_map(width_mm).fold(1.0, f64::max);
        let cell = f64::from(WIDTH - 120) / plot.rows.len() as f64;
        let scale =
            ((f64::from(ROW) - 60.0) / (high_mm - floor_mm).max(1.0)).min(0.94 * cell / wide_mm);
        Some(Self { across, up, scale, floor_mm })
    }
}

/// The midpoint of the smallest and the largest coordinate along a direction.
fn middle(points: &[Vector], along: Direction) -> Option<f64> {
    let values = || points.iter().map(|&at| along.of(at));
    Some(0.5 * (values().reduce(f64::min)? + values().reduce(f64::max)?))
}
