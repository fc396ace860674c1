//! Plots of takes, as SVG and PNG.
//!
//! Colours are those of Okabe and Ito ("Color universal design", 2008), which colour-blind people can distinguish;
//! shapes or dashes always repeat what a colour means.

mod bodies;
mod png;
mod pose;
mod quality;
mod recorded;
mod sampled;
mod sizes;
mod trajectory;

use std::ops::Range;

use crate::ReportError;
use plotters::{
    chart::ChartContext,
    coord::{Shift, types::RangedCoordf64},
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

pub use self::{
    bodies::{BODIES_MAX, BodiesPlot, bodies, plot_bodies},
    png::{PngPicture, png},
    pose::{MOMENTS_MAX, PosePlot, pose},
    quality::{MarkerQuality, QualityPlot, quality},
    recorded::{PlotChannel, plot_channels},
    sampled::{AnalogPlot, CHANNELS_MAX, ForcesPlot, PLATES_MAX, analog, forces},
    sizes::{SizeLine, SizePanel, by_phase, sizes},
    trajectory::{TrajectoryPlot, trajectory},
};

const FONT: &str = "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif";

/// Font sizes in the unit of plotters, 1.24 per pixel.
const BODY: u32 = 15;
const TITLE: u32 = 20;
const SMALL: u32 = 13;

const INK: RGBColor = RGBColor(40, 40, 40);
const DIM: RGBColor = RGBColor(110, 110, 110);
const GRID: RGBColor = RGBColor(225, 225, 225);
const BLUE: RGBColor = RGBColor(0, 114, 178);
const VERMILION: RGBColor = RGBColor(213, 94, 0);
const GREEN: RGBColor = RGBColor(0, 148, 108);
const PURPLE: RGBColor = RGBColor(170, 80, 140);
const ORANGE: RGBColor = RGBColor(200, 140, 0);
const SKY: RGBColor = RGBColor(60, 150, 205);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type DrawResult = Result<(), Box<dyn std::error::Error>>;

/// An SVG of a white sheet of this size, in pixels, that `draw` has drawn on.
fn sheet(
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> DrawResult,
) -> Result<String, ReportError> {
    let mut text = String::new();
    let drawn = (|| {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        area.fill(&WHITE)?;
        draw(&area)?;
        area.present()?;
        Ok::<(), Box<dyn std::error::Error>>(())
    })();
    drawn.map_err(|error| ReportError::Drawing(error.to_string()))?;
    // Labels of a script that the usual fonts lack name those that have it.
    let families = png::families(&text);
    Ok(if families == FONT { text } else { text.replace(FONT, &families) })
}

/// The size, colour and horizontal alignment of text.
#[derive(Clone, Copy)]
struct LabelStyle {
    size: u32,
    colour: RGBColor,
    anchor: HPos,
}

/// Text that begins at its point.
fn left_aligned(size: u32, colour: RGBColor) -> LabelStyle {
    LabelStyle { size, colour, anchor: HPos::Left }
}

/// Text centred on its point.
fn centred(size: u32, colour: RGBColor) -> LabelStyle {
    LabelStyle { size, colour, anchor: HPos::Center }
}

/// Text that ends at its point.
fn right_aligned(size: u32, colour: RGBColor) -> LabelStyle {
    LabelStyle { size, colour, anchor: HPos::Right }
}

/// Draws text, vertically centred on its point `at` in the area.
fn text(area: &Area<'_>, text: &str, at: (i32, i32), style: LabelStyle) -> DrawResult {
    let style = TextStyle {
        font: (FONT, style.size).into_font(),
        color: style.colour.to_backend_color(),
        pos: Pos::new(style.anchor, VPos::Center),
    };
    Ok(area.draw(&Text::new(plain(text), at, style))?)
}

/// Text from a file, with characters that XML does not allow replaced.
fn plain(text: &str) -> String {
    let is_bad = |c: char| c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}');
    text.chars().map(|c| if is_bad(c) { '\u{fffd}' } else { c }).collect()
}

/// A name shortened to `max` characters by leaving out its middle.
fn shortened(text: &str, max: usize) -> String {
    let n = text.chars().count();
    if n <= max {
        return text.to_owned();
    }
    let half = max.saturating_sub(1) / 2;
    let head: String = text.chars().take(half).collect();
    let tail: String = text.chars().skip(n - (max - 1 - half)).collect();
    format!("{head}…{tail}")
}

/// A sentence shortened to `max` characters by leaving out its last words.
fn shortened_at_words(text: &str, max: usize) -> String {
    if text.chars().count() <= max {
        return text.to_owned();
    }
    let head: String = text.chars().take(max.saturating_sub(2)).collect();
    let whole = head.rsplit_once(' ').map_or(head.as_str(), |(words, _)| words);
    format!("{} …", whole.trim_end_matches([',', ';', ':']))
}

type Chart<'a, 'b> = ChartContext<'b, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The axes of a panel.
#[derive(Debug, Clone)]
struct Axes<'a> {
    x: Range<f64>,
    y: Range<f64>,
    /// Title with unit; empty for a panel that shares the x axis of the one below.
    x_title: &'a str,
    /// Title with unit.
    y_title: &'a str,
    /// Top, right, bottom and left.
    margins: [u32; 4],
}

/// Draws the axes of a panel with grid and tick labels.
fn panel<'a, 'b>(
    area: &'b Area<'a>,
    axes: &Axes<'_>,
) -> Result<Chart<'a, 'b>, Box<dyn std::error::Error>> {
    let [top, right, bottom, left] = axes.margins;
    let has_x = !axes.x_title.is_empty();
    let mut chart = ChartBuilder::on(area)
        .margin_top(top)
        .margin_right(right)
        .margin_bottom(bottom)
        .margin_left(left)
        .x_label_area_size(if has_x { 42 } else { 6 })
        .y_label_area_size(66)
        .build_cartesian_2d(axes.x.clone(), axes.y.clone())?;
    let (width, height) = chart.plotting_area().dim_in_pixel();
    let (x_span, y_span) = (axes.x.end - axes.x.start, axes.y.end - axes.y.start);
    chart
        .configure_mesh()
        .axis_style(GRID)
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .x_labels((width / 70).clamp(2, 12) as usize)
        .y_labels((height / 32).clamp(2, 10) as usize)
        .x_desc(axes.x_title)
        .y_desc(axes.y_title)
        .x_label_formatter(&|value| if has_x { tick(*value, x_span) } else { String::new() })
        .y_label_formatter(&|value| tick(*value, y_span))
        .label_style((FONT, BODY).into_font().color(&INK))
        .axis_desc_style((FONT, BODY).into_font().color(&INK))
        .draw()?;
    Ok(chart)
}

/// A tick label with as many digits as needed to distinguish the ticks of an axis.
fn tick(value: f64, span: f64) -> String {
    let digits = (1.0 - span.abs().max(1e-12).log10()).ceil().clamp(0.0, 9.0) as usize;
    let text = format!("{value:.digits$}");
    let zero = text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.');
    if zero { text.trim_start_matches('-').to_owned() } else { text }
}

/// The range of an axis: from the smallest to the largest finite value, with a margin; 0 to 1 without values.
fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values.filter(|value| value.is_finite()) {
        (low, high) = (low.min(value), high.max(value));
    }
    if low > high {
        return 0.0..1.0;
    }
    let margin = (0.06 * (high - low)).max(1e-6 * high.abs().max(low.abs())).max(1e-3);
    low - margin..high + margin
}

#[cfg(test)]
mod tests_of_chart {
    use super::*;

    #[test]
    fn tick_labels_have_as_many_digits_as_needed() {
        assert_eq!(tick(0.30000000000000004, 1.0), "0.3");
        assert_eq!(tick(1250.0, 3000.0), "1250");
        assert_eq!(tick(-0.0, 0.5), "0.00");
        assert_eq!(tick(0.004, 0.01), "0.004");
    }

    #[test]
    fn a_range_is_never_empty() {
        for values in
            [&[][..], &[5.0], &[5.0, 5.0], &[f64::NAN, f64::INFINITY], &[1e9, 1e9], &[-2.0, 3.0]]
        {
            let range = range(values.iter().copied());
            assert!(range.end > range.start && range.start.is_finite() && range.end.is_finite());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hostile_names_are_escaped() {
        let svg =
            sheet((100, 40), |area| text(area, "a<b>&\"\u{1}\n", (5, 20), left_aligned(BODY, INK)));
        let svg = svg.unwrap();
        assert!(!svg.contains("a<b>") && svg.contains("a&lt;b&gt;&amp;"), "{svg}");
        assert!(png(&svg, Default::default).is_ok());
    }

    #[test]
    fn long_names_lose_their_middle() {
        assert_eq!(shortened("l_knee", 10), "l_knee");
        assert_eq!(shortened("a_very_long_name_indeed", 11), "a_ver…ndeed");
        assert_eq!(shortened("éèàùâêîôû", 5), "éè…ôû");
        assert_eq!(shortened_at_words("two words, and more", 15), "two words …");
        assert_eq!(shortened_at_words("short", 5), "short");
    }
}
