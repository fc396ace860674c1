//! An SVG document, written element by element.

use std::fmt::Write as _;

pub(super) const INK: &str = "#282828";
pub(super) const DIM: &str = "#6e6e6e";
pub(super) const GRID: &str = "#e1e1e1";
const FONT: &str = "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif";
/// Maximum number of characters of foreign text.
const TEXT_MAX: usize = 160;

/// Alignment of a text at its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Left,
    Middle,
    Right,
}

/// A document under construction. Coordinates have one decimal; elements with non-finite ones are dropped.
pub(super) struct Sheet(String);

impl Sheet {
    pub(super) fn new(width: f64, height: f64) -> Self {
        let mut sheet = Self(String::new());
        sheet.put(format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"{FONT}\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
        ));
        sheet
    }

    pub(super) fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    /// Writing to a `String` cannot fail.
    fn put(&mut self, what: std::fmt::Arguments<'_>) {
        self.0.write_fmt(what).ok();
    }

    /// Text, vertically centred at the point.
    pub(super) fn text(
        &mut self,
        x: f64,
        y: f64,
        text: &str,
        size: f64,
        colour: &str,
        anchor: Anchor,
    ) {
        let value = match anchor {
            Anchor::Left => "start",
            Anchor::Middle => "middle",
            Anchor::Right => "end",
        };
        let baseline = y + 0.36 * size;
        self.put(format_args!(
            "<text x=\"{x:.1}\" y=\"{baseline:.1}\" font-size=\"{size}\" fill=\"{colour}\" text-anchor=\"{value}\">{}</text>\n",
            escaped(text)
        ));
    }

    /// Text that runs upwards along the left edge of a chart.
    pub(super) fn vertical_text(&mut self, x: f64, y: f64, text: &str, size: f64) {
        self.put(format_args!(
            "<text transform=\"translate({x:.1} {y:.1}) rotate(-90)\" font-size=\"{size}\" fill=\"{DIM}\" text-anchor=\"middle\">{}</text>\n",
            escaped(text)
        ));
    }

    pub(super) fn line(&mut self, from: [f64; 2], to: [f64; 2], style: &str) {
        self.path(&[vec![from, to]], false, style);
    }

    pub(super) fn circle(&mut self, at: [f64; 2], radius: f64, style: &str) {
        if at.iter().all(|c| c.is_finite()) && radius.is_finite() {
            let [x, y] = at;
            self.put(format_args!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" {style}/>\n"
            ));
        }
    }

    /// Polylines as one element.
    pub(super) fn path(&mut self, lines: &[Vec<[f64; 2]>], closed: bool, style: &str) {
        let finite = |line: &&Vec<[f64; 2]>| {
            line.len() > 1 && line.iter().all(|p| p.iter().all(|c| c.is_finite()))
        };
        let mut lines = lines.iter().filter(finite).peekable();
        if lines.peek().is_none() {
            return;
        }
        self.0.push_str("<path d=\"");
        for line in lines {
            for (i, [x, y]) in line.iter().enumerate() {
                let step = if i == 0 { 'M' } else { 'L' };
                self.put(format_args!("{step}{x:.1} {y:.1}"));
            }
            if closed {
                self.0.push('Z');
            }
        }
        self.put(format_args!("\" {style}/>\n"));
    }
}

/// Text escaped for XML, of bounded length.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars().take(TEXT_MAX) {
        match c {
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push(' '),
            c => out.push(c),
        }
    }
    out
}
