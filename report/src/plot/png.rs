//! A picture as pixels: with a font of our own, so that it is the same on every machine.

use std::sync::Arc;

use resvg::{
    tiny_skia::{Pixmap, Transform},
    usvg::{Options, Tree, fontdb},
};

use crate::ReportError;

/// Pixels to a unit of the SVG: sharp on paper and on dense screens.
const SCALE: f32 = 2.0;

/// Most pixels of a picture: 400 MB.
const PIXELS_MAX: f32 = 1e8;

/// Turns an SVG into a PNG.
///
/// # Errors
/// `Drawing` when the SVG cannot be read, or is too large.
pub fn png(svg: &str) -> Result<Vec<u8>, ReportError> {
    let bad = |error: &dyn std::fmt::Display| ReportError::Drawing(error.to_string());
    let mut fonts = fontdb::Database::new();
    for font in [dejavu::sans::regular(), dejavu::sans::bold()] {
        fonts.load_font_data(font.to_vec());
    }
    fonts.set_sans_serif_family("DejaVu Sans");
    let options = Options { fontdb: Arc::new(fonts), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|error| bad(&error))?;
    let size = tree.size();
    let (width, height) = (size.width() * SCALE, size.height() * SCALE);
    if width * height > PIXELS_MAX {
        return Err(bad(&"the picture is too large for pixels: use .svg"));
    }
    let mut pixels = Pixmap::new(width.ceil() as u32, height.ceil() as u32)
        .ok_or_else(|| bad(&"the picture has no size"))?;
    resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| bad(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many pixels of a PNG are not white, by its decoded bytes.
    fn inked(svg: &str) -> usize {
        let pixels = Pixmap::decode_png(&png(svg).unwrap()).unwrap();
        pixels.pixels().iter().filter(|pixel| pixel.red() < 128 && pixel.alpha() > 0).count()
    }

    #[test]
    fn words_are_drawn_without_a_font_on_the_machine() {
        let svg = |text: &str| {
            format!(
                "<svg width='200' height='40' xmlns='http://www.w3.org/2000/svg'>\
                 <rect width='200' height='40' fill='white'/>\
                 <text x='5' y='25' font-family='Nowhere, sans-serif' font-size='20'>{text}</text></svg>"
            )
        };
        assert_eq!(inked(&svg("")), 0);
        assert!(inked(&svg("mm/s")) > 200);
        // Also what is not Latin.
        assert!(inked(&svg("λ° ж")) > 200);
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        assert!(png("<svg").is_err());
        let large = "<svg width='99999' height='99999' xmlns='http://www.w3.org/2000/svg'></svg>";
        assert!(png(large).unwrap_err().to_string().contains("use .svg"));
    }
}
