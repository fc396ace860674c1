//! Axes with figures that people read.

use std::ops::Range;

use plotters::{chart::ChartContext, coord::types::RangedCoordf64, prelude::*};

use super::canvas::{Area, FONT, GRID, INK, WORDS};

pub(super) type Chart<'a, 'b> =
    ChartContext<'b, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// What the axes of a panel say.
#[derive(Debug, Clone)]
pub(super) struct Axes<'a> {
    pub(super) x: Range<f64>,
    pub(super) y: Range<f64>,
    /// With its unit; empty for an axis whose figures stand below another panel.
    pub(super) x_words: &'a str,
    pub(super) y_words: &'a str,
    pub(super) margins: [u32; 4],
}

/// Axes, their grid and figures. Margins: top, right, bottom, left.
pub(super) fn panel<'a, 'b>(
    area: &'b Area<'a>,
    axes: &Axes<'_>,
) -> Result<Chart<'a, 'b>, Box<dyn std::error::Error>> {
    let [top, right, bottom, left] = axes.margins;
    let has_x = !axes.x_words.is_empty();
    let mut chart = ChartBuilder::on(area)
        .margin_top(top)
        .margin_right(right)
        .margin_bottom(bottom)
        .margin_left(left)
        .x_label_area_size(if has_x { 42 } else { 6 })
        .y_label_area_size(66)
        .build_cartesian_2d(axes.x.clone(), axes.y.clone())?;
    let (height, width) =
        (chart.plotting_area().dim_in_pixel().1, chart.plotting_area().dim_in_pixel().0);
    let (x_span, y_span) = (axes.x.end - axes.x.start, axes.y.end - axes.y.start);
    chart
        .configure_mesh()
        .axis_style(GRID)
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .x_labels((width / 70).clamp(2, 12) as usize)
        .y_labels((height / 32).clamp(2, 10) as usize)
        .x_desc(axes.x_words)
        .y_desc(axes.y_words)
        .x_label_formatter(&|value| if has_x { tick(*value, x_span) } else { String::new() })
        .y_label_formatter(&|value| tick(*value, y_span))
        .label_style((FONT, WORDS).into_font().color(&INK))
        .axis_desc_style((FONT, WORDS).into_font().color(&INK))
        .draw()?;
    Ok(chart)
}

/// A figure with as many digits as tell the marks of an axis apart.
pub(super) fn tick(value: f64, span: f64) -> String {
    let digits = (1.0 - span.abs().max(1e-12).log10()).ceil().clamp(0.0, 9.0) as usize;
    let text = format!("{value:.digits$}");
    let zero = text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.');
    if zero { text.trim_start_matches('-').to_owned() } else { text }
}

/// From the smallest to the largest finite value, with a little air; 0 to 1 where there is none.
pub(super) fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values.filter(|value| value.is_finite()) {
        (low, high) = (low.min(value), high.max(value));
    }
    if low > high {
        return 0.0..1.0;
    }
    let air = (0.06 * (high - low)).max(1e-6 * high.abs().max(low.abs())).max(1e-3);
    low - air..high + air
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_the_digits_that_matter() {
        assert_eq!(tick(0.30000000000000004, 1.0), "0.3");
        assert_eq!(tick(1250.0, 3000.0), "1250");
        assert_eq!(tick(-0.0, 0.5), "0.00");
        assert_eq!(tick(0.004, 0.01), "0.004");
    }

    #[test]
    fn a_range_has_a_length_whatever_is_in_it() {
        for values in
            [&[][..], &[5.0], &[5.0, 5.0], &[f64::NAN, f64::INFINITY], &[1e9, 1e9], &[-2.0, 3.0]]
        {
            let range = range(values.iter().copied());
            assert!(range.end > range.start && range.start.is_finite() && range.end.is_finite());
        }
    }
}
