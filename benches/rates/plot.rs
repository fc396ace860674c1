//! Bytes per second against the sampling rate, both axes logarithmic, one panel per take.

use anyhow::{Context, anyhow};
use mocapd_codec::ResamplerKind;
use plotters::{
    coord::Shift,
    coord::combinators::{BindKeyPoints, IntoLogRange},
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use crate::{RATES_HZ, RESAMPLERS, TOLERANCES_MM, report::Study};

/// Width and height of a panel in pixels.
const SIZE: (u32, u32) = (600, 600);
/// Width of the margin for the labels to the right of the lines.
const NAMES: u32 = 130;
/// Minimum vertical distance between two labels.
const NAME_GAP: i32 = 17;
const FONT: &str = "Helvetica, Arial, sans-serif";
/// Font sizes in the unit of the drawing library, 1.24 per pixel.
const BODY: u32 = 17;
const TITLE: u32 = 19;

const INK: RGBColor = RGBColor(51, 51, 51);
const GRID: RGBColor = RGBColor(225, 225, 225);
/// One colour per tolerance, distinguishable with red-green colour blindness (Okabe and Ito, "Color universal design",
/// 2008).
const COLOURS: [RGBColor; TOLERANCES_MM.len()] =
    [RGBColor(213, 94, 0), RGBColor(0, 114, 178), RGBColor(0, 148, 108)];

/// One line of a panel.
struct Line {
    name: String,
    points: Vec<(f64, f64)>,
    colour: RGBColor,
    is_dashed: bool,
}

/// # Errors
/// When the drawing library fails.
pub(crate) fn svg(studies: &[Study]) -> anyhow::Result<String> {
    let mut text = String::new();
    let panels: Vec<Vec<Line>> = studies.iter().map(lines).collect();
    let all = || panels.iter().flatten().flat_map(|line| line.points.iter().map(|p| p.1));
    // All panels share one scale, with a margin above and below.
    let low = 0.7 * all().fold(f64::MAX, f64::min);
    let high = 1.4 * all().fold(1.0, f64::max);
    {
        let n = studies.len().max(1);
        let root = SVGBackend::with_string(&mut text, (SIZE.0 * n as u32, SIZE.1));
        let root = root.into_drawing_area();
        root.fill(&WHITE)?;
        let areas = root.split_evenly((1, n));
        for ((area, study), lines) in areas.iter().zip(studies).zip(&panels) {
            panel(area, study, lines, low..high)
                .map_err(|e| anyhow!("{e}"))
                .with_context(|| format!("cannot draw {}", study.name))?;
        }
        root.present()?;
    }
    Ok(text)
}

fn lines(study: &Study) -> Vec<Line> {
    let raw = RATES_HZ.iter().map(|&hz| (hz, study.raw_bytes_per_s(hz))).collect();
    let mut lines =
        vec![Line { name: "float32".to_owned(), points: raw, colour: INK, is_dashed: false }];
    for kind in RESAMPLERS {
        for (tolerance_mm, colour) in TOLERANCES_MM.into_iter().zip(COLOURS) {
            lines.push(Line {
                name: format!("{kind} {tolerance_mm} mm"),
                points: study.line(kind, tolerance_mm, true),
                colour,
                is_dashed: kind != ResamplerKind::Dense,
            });
        }
    }
    lines
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn panel(
    area: &Area<'_>,
    study: &Study,
    lines: &[Line],
    bytes: std::ops::Range<f64>,
) -> Result<(), Box<dyn std::error::Error>> {
    let title =
        format!("{} ({} markers, noise {:.2} mm)", study.name, study.n_markers, study.sigma_mm());
    area.draw(&Text::new(title, (84, 22), text_style(TITLE, INK)))?;
    let ticks = (0..12).flat_map(|i| [1.0, 2.0, 5.0].map(|digit| digit * 10_f64.powi(i)));
    let ticks: Vec<f64> = ticks.filter(|tick| bytes.contains(tick)).collect();
    let (first, last) = (RATES_HZ[0], RATES_HZ[RATES_HZ.len() - 1]);
    let mut chart = ChartBuilder::on(area)
        .margin_top(40)
        .margin_right(NAMES)
        .margin_bottom(8)
        .margin_left(8)
        .x_label_area_size(46)
        .y_label_area_size(76)
        .build_cartesian_2d(
            (first..last).log_scale().with_key_points(RATES_HZ.to_vec()),
            bytes.log_scale().with_key_points(ticks),
        )?;
    chart
        .configure_mesh()
        .axis_style(GRID)
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .x_desc("rate (Hz)")
        .y_desc("bytes per second of motion")
        .x_label_formatter(&|hz| format!("{hz}"))
        .y_label_formatter(&|bytes| with_unit(*bytes))
        .label_style((FONT, BODY).into_font().color(&INK))
        .axis_desc_style((FONT, BODY).into_font().color(&INK))
        .draw()?;
    for line in lines {
        let style = line.colour.stroke_width(if line.is_dashed { 1 } else { 2 });
        let points = line.points.iter().copied();
        if line.is_dashed {
            chart.draw_series(DashedLineSeries::new(points.clone(), 6, 4, style))?;
        } else {
            chart.draw_series(LineSeries::new(points.clone(), style))?;
        }
        chart.draw_series(points.map(|point| Circle::new(point, 3, line.colour.filled())))?;
    }
    let ends = lines.iter().filter_map(|line| line.points.last());
    let ends: Vec<(i32, i32)> = ends.map(|end| chart.plotting_area().map_coordinate(end)).collect();
    let origin = area.get_base_pixel();
    for ((line, end), y) in lines.iter().zip(&ends).zip(spread(&ends)) {
        let (x, end_y) = (end.0 - origin.0, end.1 - origin.1);
        let y = y - origin.1;
        area.draw(&PathElement::new(vec![(x + 5, end_y), (x + 14, y)], GRID))?;
        area.draw(&Text::new(line.name.clone(), (x + 17, y), text_style(BODY, line.colour)))?;
    }
    Ok(())
}

/// Text anchored at its left end, vertically centred.
fn text_style(size: u32, colour: RGBColor) -> TextStyle<'static> {
    let pos = Pos::new(HPos::Left, VPos::Center);
    TextStyle { font: (FONT, size).into_font(), color: colour.to_backend_color(), pos }
}

/// Vertical positions of the labels: close to the ends of their lines, without overlap.
fn spread(ends: &[(i32, i32)]) -> Vec<i32> {
    let mut order: Vec<usize> = (0..ends.len()).collect();
    order.sort_by_key(|&i| ends[i].1);
    let mut heights: Vec<i32> = ends.iter().map(|end| end.1).collect();
    // Two labels that are too close each move by half the missing distance; their neighbours follow in the next round.
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
