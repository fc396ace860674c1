//! What all pictures share: the sheet, its letters and its colours.

use plotters::{
    coord::Shift,
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use crate::ReportError;

pub(super) const FONT: &str = "DejaVu Sans, Verdana, Helvetica, Arial, sans-serif";

/// Heights of letters as the drawing library counts them, 1.24 to a pixel.
pub(super) const WORDS: u32 = 15;
pub(super) const TITLE: u32 = 20;
pub(super) const SMALL: u32 = 13;

pub(super) const INK: RGBColor = RGBColor(40, 40, 40);
pub(super) const DIM: RGBColor = RGBColor(110, 110, 110);
pub(super) const GRID: RGBColor = RGBColor(225, 225, 225);
pub(super) const BLUE: RGBColor = RGBColor(0, 114, 178);
pub(super) const VERMILION: RGBColor = RGBColor(213, 94, 0);
pub(super) const GREEN: RGBColor = RGBColor(0, 148, 108);
pub(super) const PURPLE: RGBColor = RGBColor(170, 80, 140);
pub(super) const ORANGE: RGBColor = RGBColor(200, 140, 0);
pub(super) const SKY: RGBColor = RGBColor(60, 150, 205);

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Drawn = Result<(), Box<dyn std::error::Error>>;

/// A white sheet of so many units, drawn on by `draw`.
pub(super) fn sheet(
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> Drawn,
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
    Ok(text)
}

/// Where words stand at their point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stand {
    Left,
    Middle,
    Right,
}

/// Words at half their height, `at` in units of the area.
pub(super) fn words(
    area: &Area<'_>,
    text: &str,
    at: (i32, i32),
    size: u32,
    colour: RGBColor,
    stand: Stand,
) -> Drawn {
    let horizontal = match stand {
        Stand::Left => HPos::Left,
        Stand::Middle => HPos::Center,
        Stand::Right => HPos::Right,
    };
    let style = TextStyle {
        font: (FONT, size).into_font(),
        color: colour.to_backend_color(),
        pos: Pos::new(horizontal, VPos::Center),
    };
    Ok(area.draw(&Text::new(plain(text), at, style))?)
}

/// A name out of a file, without what no XML can hold.
pub(super) fn plain(text: &str) -> String {
    let is_bad = |c: char| c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}');
    text.chars().map(|c| if is_bad(c) { '\u{fffd}' } else { c }).collect()
}

/// A name of at most so many letters, its middle left out.
pub(super) fn shortened(text: &str, letters: usize) -> String {
    let n = text.chars().count();
    if n <= letters {
        return text.to_owned();
    }
    let half = letters.saturating_sub(1) / 2;
    let head: String = text.chars().take(half).collect();
    let tail: String = text.chars().skip(n - (letters - 1 - half)).collect();
    format!("{head}…{tail}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hostile_names_are_drawn_all_the_same() {
        let svg = sheet((100, 40), |area| {
            words(area, "a<b>&\"\u{1}\n", (5, 20), WORDS, INK, Stand::Left)
        });
        let svg = svg.unwrap();
        assert!(!svg.contains("a<b>") && svg.contains("a&lt;b&gt;&amp;"), "{svg}");
        assert!(super::super::png(&svg).is_ok());
    }

    #[test]
    fn long_names_lose_their_middle() {
        assert_eq!(shortened("l_knee", 10), "l_knee");
        assert_eq!(shortened("a_very_long_name_indeed", 11), "a_ver…ndeed");
        assert_eq!(shortened("éèàùâêîôû", 5), "éè…ôû");
    }
}
