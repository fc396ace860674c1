//! Plots against the tolerance: the size of a take, by resampler, and SR2, by phase.

use plotters::{
    coord::combinators::{BindKeyPoints, IntoLogRange},
    prelude::*,
};

use super::{
    Area, Axes, BLUE, BODY, DIM, DrawResult, FONT, GREEN, GRID, INK, ORANGE, PURPLE, SKY, TITLE,
    VERMILION, left_aligned, panel, sheet, shortened, shortened_at_words, text,
};
use crate::{
    ReportError,
    phases::Phase,
    study::{self, Findings, Method, Piece},
};

const PANEL: (u32, u32) = (640, 560);
/// Width of the column of line names, right of a panel.
const NAMES: u32 = 120;
/// Smallest vertical distance of two names.
const NAME_GAP: i32 = 18;
const COLOURS: [RGBColor; 5] = [VERMILION, BLUE, GREEN, PURPLE, INK];

/// The sizes with one resampler.
#[derive(Debug, Clone, PartialEq)]
pub struct SizeLine {
    /// The resampler's name.
    pub name: String,
    /// Tolerance (mm) and size of the take (bytes).
    pub points: Vec<(f64, u64)>,
    /// Whether the size does not depend on the tolerance; drawn as a thin dashed line.
    pub is_level: bool,
}

/// The sizes of one take.
#[derive(Debug, Clone, PartialEq)]
pub struct SizePanel {
    /// The take's name.
    pub name: String,
    /// A line about its contents.
    pub caption: String,
    /// The sizes by resampler.
    pub lines: Vec<SizeLine>,
}

/// Draws one panel per take as SVG, all with the same axes.
///
/// # Errors
/// `Nothing` without any size.
pub fn sizes(panels: &[SizePanel]) -> Result<String, ReportError> {
    let points = || panels.iter().flat_map(|panel| &panel.lines).flat_map(|line| &line.points);
    if points().next().is_none() {
        return Err(ReportError::Nothing("no sizes measured: nothing to draw".to_owned()));
    }
    let low = points().map(|point| point.1 as f64).fold(f64::MAX, f64::min) * 0.7;
    let high = points().map(|point| point.1 as f64).fold(1.0, f64::max) * 1.4;
    let from = points().map(|point| point.0).fold(f64::MAX, f64::min);
    let to = points().map(|point| point.0).fold(0.0, f64::max).max(from * 1.01);
    // About as many columns as rows, at most four: 2560 pixels.
    let n_across = ((panels.len() as f64).sqrt().ceil() as usize).clamp(1, 4);
    let n_down = panels.len().div_ceil(n_across);
    let size = (PANEL.0 * n_across as u32, PANEL.1 * n_down as u32);
    sheet(size, |area| {
        let areas = area.split_evenly((n_down, n_across));
        for (area, panel) in areas.iter().zip(panels) {
            draw(area, panel, from..to, low.max(1.0)..high)?;
        }
        Ok(())
    })
}

fn draw(
    area: &Area<'_>,
    panel: &SizePanel,
    tolerances_mm: std::ops::Range<f64>,
    bytes: std::ops::Range<f64>,
) -> DrawResult {
    text(area, &shortened(&panel.name, 56), (24, 26), left_aligned(TITLE, INK))?;
    text(area, &shortened_at_words(&panel.caption, 84), (24, 50), left_aligned(BODY, DIM))?;
    let decades = |range: &std::ops::Range<f64>| -> Vec<f64> {
        let ticks = (-5..12).flat_map(|i| [1.0, 2.0, 5.0].map(|digit| digit * 10_f64.powi(i)));
        ticks.filter(|tick| (0.999 * range.start..=1.001 * range.end).contains(tick)).collect()
    };
    let (x_ticks, y_ticks) = (decades(&tolerances_mm), decades(&bytes));
    let mut chart = ChartBuilder::on(area)
        .margin_top(70)
        .margin_right(NAMES)
        .margin_bottom(8)
        .margin_left(8)
        .x_label_area_size(44)
        .y_label_area_size(82)
        .build_cartesian_2d(
            tolerances_mm.log_scale().with_key_points(x_ticks),
            bytes.log_scale().with_key_points(y_ticks),
        )?;
    chart
        .configure_mesh()
        .axis_style(GRID)
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .x_desc("tolerance (mm)")
        .y_desc("size of the take")
        .x_label_formatter(&|mm| format!("{}", (mm * 1e6).round() / 1e6))
        .y_label_formatter(&|bytes| with_unit(*bytes))
        .label_style((FONT, BODY).into_font().color(&INK))
        .axis_desc_style((FONT, BODY).into_font().color(&INK))
        .draw()?;
    let mut ends = Vec::new();
    for (line, colour) in panel.lines.iter().zip(COLOURS.iter().cycle()) {
        let points = line.points.iter().map(|&(mm, bytes)| (mm, bytes as f64));
        let style = colour.stroke_width(if line.is_level { 1 } else { 2 });
        if line.is_level {
            chart.draw_series(DashedLineSeries::new(points.clone(), 6, 4, style))?;
        } else {
            chart.draw_series(LineSeries::new(points.clone(), style))?;
            chart.draw_series(points.clone().map(|at| Circle::new(at, 3, colour.filled())))?;
        }
        if let Some(end) = points.clone().next_back() {
            ends.push((chart.plotting_area().map_coordinate(&end), line.name.as_str(), *colour));
        }
    }
    names_at_ends(area, &ends)
}

/// The end point of a line on the sheet, its name and its colour.
type End<'a> = ((i32, i32), &'a str, RGBColor);

/// Draws the names of lines next to their ends.
fn names_at_ends(area: &Area<'_>, ends: &[End<'_>]) -> DrawResult {
    let origin = area.get_base_pixel();
    let heights = spread(&ends.iter().map(|(end, ..)| end.1).collect::<Vec<_>>());
    for (((x, end_y), name, colour), y) in ends.iter().zip(heights) {
        let (x, end_y, y) = (x - origin.0, end_y - origin.1, y - origin.1);
        area.draw(&PathElement::new(vec![(x + 5, end_y), (x + 14, y)], GRID))?;
        text(area, name, (x + 17, y), left_aligned(BODY, *colour))?;
    }
    Ok(())
}

/// The heights of names: near the ends of their lines, without overlap.
fn spread(ends: &[i32]) -> Vec<i32> {
    let mut order: Vec<usize> = (0..ends.len()).collect();
    order.sort_by_key(|&i| ends[i]);
    let mut heights = ends.to_vec();
    // Names that are too close are moved apart, each by half the missing distance; neighbours follow in the next round.
    for _ in 0..200 {
        for pair in order.windows(2) {
            let missing = NAME_GAP - (heights[pair[1]] - heights[pair[0]]);
            if missing > 0 {
                heights[pair[0]] -= missing / 2;
                heights[pair[1]] += missing - missing / 2;
            }
        }
    }
    heights
}

fn with_unit(bytes: f64) -> String {
    match bytes {
        b if b >= 1e6 => format!("{} MB", b / 1e6),
        b if b >= 1e3 => format!("{} kB", b / 1e3),
        b => format!("{b} B"),
    }
}

const PHASES_SIZE: (u32, u32) = (1280, 600);
/// Width of the column of their names.
const PHASE_NAMES: u32 = 130;

/// The colours of the columns of table 1.
const PHASE_COLOURS: [RGBColor; 7] = [BLUE, SKY, VERMILION, ORANGE, GREEN, PURPLE, INK];

/// Draws SR2 against the tolerance as SVG, one line per phase: the study (table 1) and the paper.
///
/// # Errors
/// `Nothing` if no phase was measured.
pub fn by_phase(findings: &Findings) -> Result<String, ReportError> {
    let here = |piece: Piece, mm: f64| findings.sum(piece, Method::WorstSample, mm)?.counts.sr2();
    let found = lines(&findings.tolerances_mm, here);
    if found.iter().all(|(_, points, _)| points.is_empty()) {
        return Err(ReportError::Nothing("no phase was measured: nothing to draw".to_owned()));
    }
    let published = lines(&study::TOLERANCES_MM, study::sr2);
    let all = || found.iter().chain(&published).flat_map(|line| &line.1);
    let most = all().map(|point| point.1).fold(1.0, f64::max);
    let widest = all().map(|point| point.0).fold(1.0, f64::max);
    sheet(PHASES_SIZE, |area| {
        text(area, "SR2 by phase and tolerance", (24, 26), left_aligned(TITLE, INK))?;
        let caption = "Ratio of stored items (positions and times), original to asynchronous resampling (Shi et al. 2012, eq. 8)";
        text(area, caption, (24, 52), left_aligned(BODY, DIM))?;
        let (_, body) = area.split_vertically(66);
        let halves = [("these takes", &found), ("the paper", &published)];
        for (area, (title, lines)) in body.split_evenly((1, 2)).iter().zip(halves) {
            draw_phases(area, title, lines, widest, most)?;
        }
        Ok(())
    })
}

type PhaseLine = (String, Vec<(f64, f64)>, RGBColor);

fn lines(tolerances_mm: &[f64], sr2: impl Fn(Piece, f64) -> Option<f64>) -> Vec<PhaseLine> {
    let line = |(&piece, &colour): (&Piece, &RGBColor)| {
        let points = tolerances_mm.iter().filter_map(|&mm| Some((mm, sr2(piece, mm)?)));
        let name =
            if piece == Piece::Phase(Phase::Flight) { "flight".to_owned() } else { piece.name() };
        (name, points.collect(), colour)
    };
    study::COLUMNS.iter().zip(&PHASE_COLOURS).map(line).collect()
}

fn draw_phases(
    area: &Area<'_>,
    title: &str,
    lines: &[PhaseLine],
    widest: f64,
    most: f64,
) -> DrawResult {
    text(area, title, (90, 14), left_aligned(BODY, INK))?;
    let axes = Axes {
        x: 0.0..widest * 1.02,
        y: 0.0..most * 1.05,
        x_title: "tolerance (mm)",
        y_title: "SR2",
        margins: [28, PHASE_NAMES, 6, 6],
    };
    let mut chart = panel(area, &axes)?;
    let mut ends = Vec::new();
    for (name, points, colour) in lines.iter().filter(|line| !line.1.is_empty()) {
        chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?;
        chart.draw_series(points.iter().map(|&at| Circle::new(at, 3, colour.filled())))?;
        if let Some(end) = points.last() {
            ends.push((chart.backend_coord(end), name.as_str(), *colour));
        }
    }
    names_at_ends(area, &ends)
}
