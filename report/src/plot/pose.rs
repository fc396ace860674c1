//! Stick figures of several moments: original above, rebuilt below (figure 3 of Shi et al. 2012).

use mocapd_take::motion::Motion;
use plotters::prelude::*;

use super::canvas::{
    Area, BLUE, DIM, Drawn, GRID, INK, SMALL, TITLE, VERMILION, WORDS, centred, left_aligned,
    sheet, shortened, words,
};
use crate::{
    ReportError,
    coded::Coded,
    column::{Vector, distance, median, sample},
    limbs::Limb,
    up::Up,
};

/// Most moments that have room beside each other.
const MOMENTS_MAX: usize = 12;

/// Most markers that are drawn of a moment: more are a cloud, and megabytes.
const MARKERS_MAX: usize = 500;

const WIDTH: u32 = 1280;
const HEAD: i32 = 72;
const ROW: i32 = 330;
const FOOT: i32 = 56;

/// What to draw.
#[derive(Debug, Clone, Copy)]
pub struct Pose<'a> {
    /// The take's name, for the title.
    pub name: &'a str,
    /// The take.
    pub coded: &'a Coded,
    /// What it was made of, where that is there.
    pub original: Option<&'a Motion>,
    /// The moments: rows, from 0.
    pub rows: &'a [usize],
    /// Columns between which a line is drawn, where there are no limbs.
    pub bones: &'a [[u16; 2]],
    /// Limbs of a scanned skeleton: drawn instead, and their lengths told.
    pub limbs: &'a [Limb],
    /// Lines of the subject's face where it lies under the markers, mm, for each moment; none where it has no face.
    pub faces: &'a [Vec<[Vector; 2]>],
    /// Where the face's own left and top are: it is looked at from in front.
    pub front: Option<[Vector; 2]>,
    /// Which way is up.
    pub up: Up,
}

/// Draws it as SVG.
///
/// # Errors
/// `Nothing` when no moment has a sample, `InvalidArgument` when there are none, too many, or one beyond the end.
pub fn pose(wanted: &Pose<'_>) -> Result<String, ReportError> {
    let motion = &wanted.coded.motion;
    let n_frames = motion.n_frames();
    if wanted.rows.is_empty() || wanted.rows.len() > MOMENTS_MAX {
        return Err(ReportError::InvalidArgument(format!(
            "{} moments were asked for: 1 to {MOMENTS_MAX} have room",
            wanted.rows.len()
        )));
    }
    if let Some(row) = wanted.rows.iter().find(|&&row| row >= n_frames) {
        return Err(ReportError::InvalidArgument(format!(
            "there is no frame {row}: the take has {n_frames}, from 0"
        )));
    }
    let view = View::of(wanted).ok_or_else(|| {
        ReportError::Nothing("no marker was seen at any of these moments: choose others".to_owned())
    })?;
    let n_rows = if wanted.original.is_some() { 2 } else { 1 };
    let table = limbs_height(wanted.limbs.len());
    let height = (HEAD + n_rows * ROW + FOOT + table) as u32;
    sheet((WIDTH, height), |area| {
        let title = format!("Moments of {}", shortened(wanted.name, 80));
        words(area, &title, (24, 26), left_aligned(TITLE, INK))?;
        words(area, &caption(wanted), (24, 52), left_aligned(WORDS, DIM))?;
        let mut base = HEAD;
        if let Some(original) = wanted.original {
            let strip = Strip { name: "original", motion: original, colour: INK };
            draw_strip(area, base, strip, wanted, &view)?;
            base += ROW;
        }
        let strip = Strip { name: "rebuilt", motion, colour: BLUE };
        draw_strip(area, base, strip, wanted, &view)?;
        times(area, base + ROW, wanted)?;
        limbs_table(area, base + ROW + FOOT, wanted)
    })
}

/// The markers that a frame has.
fn seen(motion: &Motion, row: usize) -> impl Iterator<Item = (usize, Vector)> + '_ {
    let frame = motion.frame(row).iter().enumerate().take(MARKERS_MAX);
    frame.filter_map(|(marker, &position)| Some((marker, sample(position)?)))
}

/// Poses of one motion beside each other.
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
    wanted: &Pose<'_>,
    view: &View,
) -> Drawn {
    let Strip { name, motion, colour } = strip;
    let floor = top + ROW - 24;
    area.draw(&PathElement::new(
        vec![(24, floor), (WIDTH as i32 - 24, floor)],
        GRID.stroke_width(2),
    ))?;
    words(area, name, (24, top + 20), left_aligned(WORDS, INK))?;
    for (i, &row) in wanted.rows.iter().enumerate() {
        // Both strips are laid about the rebuilt body, so that they can be compared by eye.
        let rebuilt: Vec<Vector> = seen(&wanted.coded.motion, row).map(|(_, at)| at).collect();
        let Some(middle) = middle(&rebuilt, view.across) else { continue };
        let x0 = column_x(i, wanted.rows.len());
        let place = |at: Vector| {
            let x = x0 + (view.across.of(at) - middle) * view.scale;
            let y = f64::from(floor) - (view.up.height(at) - view.floor_mm) * view.scale;
            (x.round() as i32, y.round() as i32)
        };
        for line in wanted.faces.get(i).into_iter().flatten() {
            area.draw(&PathElement::new(line.map(place).to_vec(), DIM.mix(0.5).stroke_width(1)))?;
        }
        let points: std::collections::BTreeMap<usize, Vector> = seen(motion, row).collect();
        for ([a, b], limb) in lines(wanted) {
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

/// The columns that are joined, and the limb that this is.
fn lines<'a>(wanted: &Pose<'a>) -> impl Iterator<Item = ([usize; 2], Option<&'a Limb>)> {
    let by_label = if wanted.limbs.is_empty() { wanted.bones } else { &[] };
    let by_label = by_label.iter().map(|bone| (bone.map(usize::from), None));
    by_label.chain(wanted.limbs.iter().map(|limb| (limb.ends, Some(limb))))
}

fn column_x(i: usize, n: usize) -> f64 {
    60.0 + f64::from(WIDTH - 120) * (i as f64 + 0.5) / n as f64
}

/// Below each moment its time, and how far apart the two bodies are.
fn times(area: &Area<'_>, top: i32, wanted: &Pose<'_>) -> Drawn {
    let motion = &wanted.coded.motion;
    for (i, &row) in wanted.rows.iter().enumerate() {
        let x = column_x(i, wanted.rows.len()).round() as i32;
        let time_s = row as f64 / motion.info.rate_hz.max(f64::MIN_POSITIVE);
        words(area, &format!("{time_s:.2} s"), (x, top + 2), centred(WORDS, INK))?;
        let none = seen(motion, row).next().is_none();
        let line = match wanted.original {
            _ if none => "no marker seen".to_owned(),
            None => continue,
            Some(original) => {
                let pairs = motion.frame(row).iter().zip(original.frame(row));
                let apart = pairs.filter_map(|(&a, &b)| Some(distance(sample(a)?, sample(b)?)));
                apart.reduce(f64::max).map_or_else(String::new, |mm| format!("{mm:.2} mm"))
            }
        };
        words(area, &line, (x, top + 24), centred(SMALL, VERMILION))?;
    }
    Ok(())
}

fn caption(wanted: &Pose<'_>) -> String {
    let mut words = wanted.coded.how();
    if wanted.original.is_some() {
        words += "; below each moment: the largest distance of a marker, original to rebuilt";
    }
    if wanted.faces.iter().any(|lines| !lines.is_empty()) {
        words += "; the subject's face as it lies under the markers";
    } else if wanted.bones.is_empty() && wanted.limbs.is_empty() {
        words += "; no lines are known between these labels (--skeleton)";
    }
    let n = wanted.coded.motion.info.markers.len();
    if n > MARKERS_MAX {
        words += &format!("; the first {MARKERS_MAX} of {n} markers");
    }
    words
}

/// Limbs in a line, and the lines that have room.
const ACROSS: usize = 4;
const LINES_MAX: usize = 8;
const LINE: i32 = 22;
const LIMBS_HEAD: i32 = 34;

/// How much of the sheet so many limbs need.
fn limbs_height(n_limbs: usize) -> i32 {
    match n_limbs.div_ceil(ACROSS).min(LINES_MAX) {
        0 => 0,
        n => LIMBS_HEAD + n as i32 * LINE + 14,
    }
}

fn limbs_table(area: &Area<'_>, top: i32, wanted: &Pose<'_>) -> Drawn {
    if wanted.limbs.is_empty() {
        return Ok(());
    }
    let title = "limbs, median of the take / scan (mm); red: off by more than a tenth and than the scan's uncertainty";
    words(area, title, (24, top + 14), left_aligned(SMALL, DIM))?;
    let cell = (WIDTH as i32 - 48) / ACROSS as i32;
    for (i, limb) in wanted.limbs.iter().take(ACROSS * LINES_MAX).enumerate() {
        let at = (24 + (i % ACROSS) as i32 * cell, top + LIMBS_HEAD + (i / ACROSS) as i32 * LINE);
        let bone = &limb.bone;
        let give_mm = bone.uncertainty_mm.unwrap_or_default();
        let scan = format!("{:.0} ± {give_mm:.0}", bone.length_mm);
        let (length, colour) = match median_mm(limb, wanted) {
            Some(mm) => (format!("{mm:.0}"), if limb.is_off(mm) { VERMILION } else { INK }),
            None => ("not seen".to_owned(), DIM),
        };
        let line = format!("{}  {length} / {scan}", shortened(&bone.name, 22));
        words(area, &line, at, left_aligned(WORDS, colour))?;
    }
    Ok(())
}

/// Over the whole take.
fn median_mm(limb: &Limb, wanted: &Pose<'_>) -> Option<f64> {
    let motion = &wanted.coded.motion;
    let length = |row: usize| {
        let ends = limb.ends.map(|end| motion.frame(row).get(end).copied().and_then(sample));
        Some(distance(ends[0]?, ends[1]?))
    };
    let mut all: Vec<f64> = (0..motion.n_frames()).filter_map(length).collect();
    median(&mut all)
}

/// How a body becomes lines on the sheet.
struct View {
    across: Direction,
    up: Up,
    /// Units of the sheet to a millimetre.
    scale: f64,
    /// Lowest height of all, mm.
    floor_mm: f64,
}

/// An axis, or the other way along it.
#[derive(Clone, Copy)]
struct Direction {
    axis: usize,
    sign: f64,
}

impl Direction {
    /// The axis that a direction is nearest to, but for one.
    fn nearest(direction: Vector, but: Option<usize>) -> Option<Self> {
        let axes = (0..3).filter(|&axis| Some(axis) != but);
        let axis = axes.max_by(|&a, &b| direction[a].abs().total_cmp(&direction[b].abs()))?;
        Some(Self { axis, sign: direction[axis].signum() })
    }

    fn of(self, at: Vector) -> f64 {
        self.sign * at[self.axis]
    }
}

impl View {
    fn of(wanted: &Pose<'_>) -> Option<Self> {
        let motion = &wanted.coded.motion;
        let axis = |axis: usize| Direction { axis, sign: 1.0 };
        let up = wanted.up;
        let face =
            |moment: usize| wanted.faces.get(moment).into_iter().flatten().flatten().copied();
        let of_moment = |(moment, &row): (usize, &usize)| {
            let markers = seen(motion, row).map(|(_, at)| at);
            markers.chain(face(moment)).collect()
        };
        let moments: Vec<Vec<Vector>> = wanted.rows.iter().enumerate().map(of_moment).collect();
        // From the side on which the body is seen best: where it goes, or else where it is wide.
        let spread = |axis: usize| {
            let values = moments.iter().flatten().map(|at| at[axis]);
            let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
            high - low
        };
        let across = match wanted.front {
            Some([left, _]) => Direction::nearest(left, Some(up.axis))?,
            None => axis(
                (0..3)
                    .filter(|&axis| axis != up.axis)
                    .max_by(|&a, &b| spread(a).total_cmp(&spread(b)))?,
            ),
        };
        let floor_mm = moments.iter().flatten().map(|&at| up.height(at)).reduce(f64::min)?;
        let high_mm = moments.iter().flatten().map(|&at| up.height(at)).reduce(f64::max)?;
        let wide_mm = moments
            .iter()
            .filter_map(|points| {
                let middle = middle(points, across)?;
                points.iter().map(|&at| 2.0 * (across.of(at) - middle).abs()).reduce(f64::max)
            })
            .fold(1.0, f64::max);
        let cell = f64::from(WIDTH - 120) / wanted.rows.len() as f64;
        let scale =
            ((f64::from(ROW) - 60.0) / (high_mm - floor_mm).max(1.0)).min(0.94 * cell / wide_mm);
        Some(Self { across, up, scale, floor_mm })
    }
}

fn middle(points: &[Vector], along: Direction) -> Option<f64> {
    let values = || points.iter().map(|&at| along.of(at));
    Some(0.5 * (values().reduce(f64::min)? + values().reduce(f64::max)?))
}
