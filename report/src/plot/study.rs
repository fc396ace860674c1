//! SR2 against the tolerance, one line per phase: the study and the paper.

use plotters::prelude::*;

use super::{
    Area, Axes, BLUE, BODY, DIM, DrawResult, GREEN, INK, ORANGE, PURPLE, SKY, TITLE, VERMILION,
    left_aligned, panel, sheet, sizes::names_at_ends, text,
};
use crate::{
    ReportError,
    phases::Phase,
    study::{self, Findings, Method, Piece},
};

const SIZE: (u32, u32) = (1280, 600);
const NAMES: u32 = 130;

/// The colours of the columns of table 1.
const COLOURS: [RGBColor; 7] = [BLUE, SKY, VERMILION, ORANGE, GREEN, PURPLE, INK];

/// Draws table 1 as SVG.
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
    sheet(SIZE, |area| {
        text(area, "SR2 by phase and tolerance", (24, 26), left_aligned(TITLE, INK))?;
        let caption = "Ratio of stored items (positions and times), original to asynchronous resampling (Shi et al. 2012, eq. 8)";
        text(area, caption, (24, 52), left_aligned(BODY, DIM))?;
        let (_, body) = area.split_vertically(66);
        let halves = [("these takes", &found), ("the paper", &published)];
        for (area, (title, lines)) in body.split_evenly((1, 2)).iter().zip(halves) {
            draw(area, title, lines, widest, most)?;
        }
        Ok(())
    })
}

type Line = (String, Vec<(f64, f64)>, RGBColor);

fn lines(tolerances_mm: &[f64], sr2: impl Fn(Piece, f64) -> Option<f64>) -> Vec<Line> {
    let line = |(&piece, &colour): (&Piece, &RGBColor)| {
        let points = tolerances_mm.iter().filter_map(|&mm| Some((mm, sr2(piece, mm)?)));
        let name =
            if piece == Piece::Phase(Phase::Flight) { "flight".to_owned() } else { piece.name() };
        (name, points.collect(), colour)
    };
    study::COLUMNS.iter().zip(&COLOURS).map(line).collect()
}

fn draw(area: &Area<'_>, title: &str, lines: &[Line], widest: f64, most: f64) -> DrawResult {
    text(area, title, (90, 14), left_aligned(BODY, INK))?;
    let axes = Axes {
        x: 0.0..widest * 1.02,
        y: 0.0..most * 1.05,
        x_title: "tolerance (mm)",
        y_title: "SR2",
        margins: [28, NAMES, 6, 6],
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
