//! The quality of each marker: gaps, noise, and the error of the take.

use mocapd_codec::Settings;
use mocapd_take::motion::Motion;
use plotters::prelude::*;

use super::{
    Area, BLUE, BODY, DIM, DrawResult, GRID, INK, ORANGE, SMALL, TITLE, VERMILION, centred,
    left_aligned, right_aligned, sheet, shortened, text, tick,
};
use crate::{
    ReportError,
    column::{Column, distance, runs},
    decoded::DecodedTake,
    noise::noise_mm,
};

/// Maximum number of markers on a sheet; if there are more, the worst are drawn.
const MARKERS_MAX: usize = 60;

/// The left and right edges of a column, in units of the sheet.
#[derive(Clone, Copy)]
struct Span {
    left: i32,
    right: i32,
}

const WIDTH: u32 = 1280;
const HEAD: i32 = 100;
const LINE: i32 = 19;
const FOOT: i32 = 66;
/// The columns of the gap strips and of the bars.
const GAPS: Span = Span { left: 190, right: 640 };
const BARS: [Span; 2] = [Span { left: 730, right: 940 }, Span { left: 1030, right: 1240 }];

/// The quality of one marker.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MarkerQuality {
    /// The marker's label.
    pub label: String,
    /// Number of samples.
    pub samples: usize,
    /// Number of gaps: runs of rows without a sample.
    pub gaps: usize,
    /// Length of the longest gap, rows.
    pub longest_gap: usize,
    /// Standard deviation of the noise on one axis, mm; `None` if it cannot be estimated ([`crate::noise`]), or the
    /// take's tolerance hides it.
    pub noise_mm: Option<f64>,
    /// The largest distance from the original, mm; `None` without one.
    pub max_error_mm: Option<f64>,
}

/// The contents of a plot of marker quality.
#[derive(Debug, Clone, Copy)]
pub struct QualityPlot<'a> {
    /// The take's name, for the title.
    pub name: &'a str,
    /// The take.
    pub take: &'a DecodedTake,
    /// Its original, if available; noise is then measured in the original.
    pub original: Option<&'a Motion>,
    /// The settings of an original that is itself a take.
    pub original_settings: Option<Settings>,
}

impl MarkerQuality {
    /// The quality of each marker of a take; noise is measured in the original if there is one.
    #[must_use]
    pub fn all(plot: &QualityPlot<'_>) -> Vec<Self> {
        let motion = &plot.take.motion;
        let of_marker = |marker: usize| {
            let ours = Column::of(motion, marker);
            let theirs = plot.original.map(|original| Column::of(original, marker));
            let max_error_mm = theirs.as_ref().and_then(|theirs| {
                let pairs = ours.0.iter().zip(&theirs.0);
                pairs.filter_map(|(a, b)| Some(distance((*a)?, (*b)?))).reduce(f64::max)
            });
            let gaps = runs(ours.0.iter().map(Option::is_none));
            let gaps: Vec<usize> = gaps.map(|gap| gap.len()).collect();
            Self {
                label: motion.info.markers[marker].label.clone(),
                samples: ours.n_samples(),
                gaps: gaps.len(),
                longest_gap: gaps.iter().copied().max().unwrap_or(0),
                noise_mm: noise_of(plot, theirs.as_ref().unwrap_or(&ours)),
                max_error_mm,
            }
        };
        (0..motion.info.markers.len()).map(of_marker).collect()
    }
}

/// Smallest ratio of noise to tolerance for an estimate from a reconstruction. The coding error on one axis then has a
/// standard deviation of at most `1 / (1.5 sqrt(3))` of the noise, which changes the estimate by 7 % at most.
const NOISE_OVER_TOLERANCE_MIN: f64 = 1.5;

/// The noise of one marker, mm; `None` if it cannot be estimated or the tolerance hides it.
fn noise_of(plot: &QualityPlot<'_>, column: &Column) -> Option<f64> {
    let noise_mm = noise_mm(column)?;
    (noise_mm >= NOISE_OVER_TOLERANCE_MIN * tolerance_mm(plot)).then_some(noise_mm)
}

/// The tolerance of the samples in which noise is measured, mm; 0 if they are lossless.
fn tolerance_mm(plot: &QualityPlot<'_>) -> f64 {
    let settings = match plot.original {
        Some(_) => plot.original_settings,
        None => plot.take.settings,
    };
    let lossy = settings.filter(|settings| !settings.kind.is_lossless());
    lossy.map_or(0.0, |settings| settings.tolerance.mm())
}

/// Draws the quality of the markers as SVG.
///
/// # Errors
/// `Nothing` if the take has no markers or frames.
pub fn quality(plot: &QualityPlot<'_>) -> Result<String, ReportError> {
    let motion = &plot.take.motion;
    let n_rows = motion.n_frames();
    let all = MarkerQuality::all(plot);
    if all.is_empty() || n_rows == 0 {
        return Err(ReportError::Nothing(
            "the take has no markers or no frames: nothing to draw".to_owned(),
        ));
    }
    let shown = markers_to_draw(&all);
    let height = (HEAD + LINE * shown.len() as i32 + FOOT) as u32;
    sheet((WIDTH, height), |area| {
        let title = format!("Quality of {}", shortened(plot.name, 80));
        text(area, &title, (24, 26), left_aligned(TITLE, INK))?;
        text(area, &caption(plot, &all, shown.len()), (24, 52), left_aligned(BODY, DIM))?;
        let head_y = HEAD - 18;
        let title = "visible (blue), gaps (orange)";
        text(area, title, (GAPS.left, head_y), left_aligned(BODY, INK))?;
        for (i, &marker) in shown.iter().enumerate() {
            let y = HEAD + LINE * i as i32 + LINE / 2;
            let label = shortened(&all[marker].label, 20);
            text(area, &label, (GAPS.left - 12, y), right_aligned(SMALL, INK))?;
            presence(area, &Column::of(motion, marker), y)?;
        }
        let base = HEAD + LINE * shown.len() as i32;
        let seconds = n_rows as f64 / motion.info.rate_hz.max(f64::MIN_POSITIVE);
        scale(area, GAPS, base, seconds, "time (s)")?;
        let values = |of: fn(&MarkerQuality) -> Option<f64>| {
            shown.iter().map(|&marker| of(&all[marker])).collect::<Vec<_>>()
        };
        let noise = values(|marker| marker.noise_mm);
        let errors = values(|marker| marker.max_error_mm);
        let columns =
            [("noise, each axis (mm)", noise, BLUE), ("largest error (mm)", errors, VERMILION)];
        let known = columns.into_iter().filter(|(_, values, _)| values.iter().any(Option::is_some));
        for (place, (head, values, colour)) in BARS.into_iter().zip(known) {
            text(area, head, (place.left, head_y), left_aligned(BODY, INK))?;
            bars(area, place, base, values.into_iter(), colour, "mm")?;
        }
        Ok(())
    })
}

/// The markers to draw, in column order: all of them, or if they are too many those with fewest samples and most noise.
fn markers_to_draw(all: &[MarkerQuality]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..all.len()).collect();
    if all.len() > MARKERS_MAX {
        order.sort_by(|&a, &b| {
            let noise = |i: usize| all[i].noise_mm.unwrap_or(0.0);
            all[a].samples.cmp(&all[b].samples).then(noise(b).total_cmp(&noise(a)))
        });
        order.truncate(MARKERS_MAX);
        order.sort_unstable();
    }
    order
}

/// Draws the strip of a marker's gaps.
fn presence(area: &Area<'_>, column: &Column, y: i32) -> DrawResult {
    let n = column.0.len().max(1) as f64;
    let width = f64::from(GAPS.right - GAPS.left);
    let x = |row: usize| GAPS.left + (row as f64 / n * width).round() as i32;
    let bar = |from: i32, to: i32, half: i32, colour: RGBColor| {
        Rectangle::new([(from, y - half), (to.max(from + 1), y + half)], colour.filled())
    };
    area.draw(&bar(GAPS.left, GAPS.right, 5, BLUE))?;
    // A gap is at least one pixel wide; those that share a pixel are merged.
    let mut drawn_to = i32::MIN;
    for gap in runs(column.0.iter().map(Option::is_none)) {
        let (from, to) = (x(gap.start), x(gap.end).max(x(gap.start) + 1));
        if to > drawn_to {
            area.draw(&bar(from, to, 7, ORANGE))?;
            drawn_to = to;
        }
    }
    Ok(())
}

fn bars(
    area: &Area<'_>,
    place: Span,
    base: i32,
    values: impl Iterator<Item = Option<f64>> + Clone,
    colour: RGBColor,
    unit: &str,
) -> DrawResult {
    let most = values.clone().flatten().fold(0.0, f64::max);
    let most = if most > 0.0 { most } else { 1.0 };
    let width = f64::from(place.right - place.left);
    for (i, value) in values.enumerate() {
        let y = HEAD + LINE * i as i32 + LINE / 2;
        let Some(value) = value else {
            text(area, "-", (place.left + 4, y), left_aligned(SMALL, DIM))?;
            continue;
        };
        let to = place.left + (value / most * width).round() as i32;
        let corners = [(place.left, y - 5), (to.max(place.left + 1), y + 5)];
        area.draw(&Rectangle::new(corners, colour.filled()))?;
    }
    scale(area, place, base, most, unit)
}

/// Draws a scale with ticks at its beginning, middle and end.
fn scale(area: &Area<'_>, Span { left, right }: Span, y: i32, most: f64, unit: &str) -> DrawResult {
    let y = y + 6;
    area.draw(&PathElement::new(vec![(left, y), (right, y)], GRID.stroke_width(2)))?;
    for part in [0.0, 0.5, 1.0] {
        let x = left + (part * f64::from(right - left)).round() as i32;
        area.draw(&PathElement::new(vec![(x, y), (x, y + 5)], DIM.stroke_width(1)))?;
        text(area, &tick(part * most, 0.5 * most), (x, y + 16), centred(SMALL, INK))?;
    }
    text(area, unit, (left + (right - left) / 2, y + 36), centred(SMALL, DIM))
}

fn caption(plot: &QualityPlot<'_>, all: &[MarkerQuality], n_shown: usize) -> String {
    let motion = &plot.take.motion;
    let n_rows = motion.n_frames();
    let samples: usize = all.iter().map(|marker| marker.samples).sum();
    let part = 100.0 * samples as f64 / (n_rows * all.len()).max(1) as f64;
    let coding = plot.take.settings.map_or(String::new(), |_| format!("{}, ", plot.take.coding()));
    let n = all.len();
    let mut caption =
        format!("{coding}{n} markers, {n_rows} frames, {part:.1} % of the samples present");
    if n_shown < all.len() {
        caption += &format!("; shown: the {n_shown} with most gaps and noise");
    }
    if all.iter().any(|marker| marker.noise_mm.is_some()) {
        caption += "; noise from fourth differences";
    } else if tolerance_mm(plot) > 0.0 {
        caption += "; the tolerance hides the noise: give the original with --against";
    } else {
        caption += "; the noise cannot be separated from motion or rounding";
    }
    caption
}
