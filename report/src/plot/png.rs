//! Pictures as PNG, and the fonts of their texts.
//!
//! `DejaVu Sans` is compiled in, so that no machine needs a font for labels in Latin, Greek, Cyrillic, Armenian, Georgian,
//! Hebrew and Arabic letters. Characters that it lacks, such as those of Chinese, Japanese and Korean, whose fonts have
//! megabytes, are drawn with the fonts of the system. A character that no font has is drawn as a box, and reported.

use std::{collections::BTreeSet, sync::Arc};

use fontdb::{Database, FaceInfo, Source, Stretch, Style, Weight};
use resvg::{
    tiny_skia::{Pixmap, Transform},
    usvg::{Options, Tree},
};
use skrifa::{FontRef, MetadataProvider, Tag, raw::TableProvider};

use super::FONT;
use crate::ReportError;

/// Pixels of a PNG per unit of the SVG: sharp in print and on high-density screens.
const SCALE: f32 = 2.0;

/// Maximum number of pixels of a PNG: 400 MB.
const PIXELS_MAX: f32 = 1e8;

/// Families for texts in scripts that [`FONT`] lacks: what Debian, Windows and macOS have.
const JAPANESE: &str =
    "Noto Sans CJK JP, Noto Sans JP, Hiragino Sans, Yu Gothic, Meiryo, IPAGothic";
const KOREAN: &str =
    "Noto Sans CJK KR, Noto Sans KR, Apple SD Gothic Neo, Malgun Gothic, NanumGothic";
const CHINESE: &str = "Noto Sans CJK SC, Noto Sans SC, PingFang SC, Microsoft YaHei, WenQuanYi Zen Hei, Droid Sans Fallback";
const OTHER_SCRIPTS: &str = "Noto Sans";

/// A picture as PNG.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PngPicture {
    /// The file.
    pub bytes: Vec<u8>,
    /// Characters that no font has, each drawn as a box; in the order of their code points.
    pub missing: Vec<char>,
}

/// Renders an SVG to PNG. `installed` returns the fonts of the system; it is called if the picture has characters that
/// `DejaVu Sans` lacks.
///
/// # Errors
/// `Drawing` if the SVG is malformed or too large.
pub fn png(
    svg: &str,
    installed: impl FnOnce() -> Arc<Database>,
) -> Result<PngPicture, ReportError> {
    let bad = |error: &dyn std::fmt::Display| ReportError::Drawing(error.to_string());
    let mut fonts = Database::new();
    for font in [dejavu::sans::regular(), dejavu::sans::bold()] {
        fonts.load_font_data(font.to_vec());
    }
    fonts.set_sans_serif_family("DejaVu Sans");
    let mut missing: BTreeSet<char> = svg.chars().filter(|&c| is_visible(c)).collect();
    let included = characters(dejavu::sans::regular(), 0, &missing);
    missing.retain(|c| !included.contains(c));
    if !missing.is_empty() {
        add_installed(&mut fonts, &mut missing, &installed(), &families(svg));
    }
    let options = Options { fontdb: Arc::new(fonts), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|error| bad(&error))?;
    let size = tree.size();
    let (width, height) = (size.width() * SCALE, size.height() * SCALE);
    if width * height > PIXELS_MAX {
        return Err(bad(&"the picture is too large for a PNG: use .svg"));
    }
    let mut pixels = Pixmap::new(width.ceil() as u32, height.ceil() as u32)
        .ok_or_else(|| bad(&"the picture is empty"))?;
    resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    let bytes = pixels.encode_png().map_err(|error| bad(&error))?;
    Ok(PngPicture { bytes, missing: missing.into_iter().collect() })
}

/// The families of a picture's texts: those of every picture, and with characters of other scripts, those that have them.
pub(super) fn families(svg: &str) -> String {
    let is_any_in = |ranges: &[std::ops::RangeInclusive<char>]| {
        svg.chars().any(|c| ranges.iter().any(|range| range.contains(&c)))
    };
    // What viewers have for Latin, Greek, Cyrillic, Hebrew, Arabic, punctuation and symbols is in the list already.
    if !is_any_in(&[
        '\u{700}'..='\u{1dff}',
        '\u{2e80}'..='\u{f8ff}',
        '\u{f900}'..='\u{faff}',
        '\u{fe30}'..='\u{fe4f}',
        '\u{ff00}'..='\u{ffef}',
        '\u{10000}'..='\u{10ffff}',
    ]) {
        return FONT.to_owned();
    }
    // Han characters have other forms in Japanese and Korean: kana and hangul tell which language it is.
    let cjk = if is_any_in(&['\u{3040}'..='\u{30ff}', '\u{ff66}'..='\u{ff9f}']) {
        [JAPANESE, CHINESE, KOREAN]
    } else if is_any_in(&[
        '\u{1100}'..='\u{11ff}',
        '\u{3130}'..='\u{318f}',
        '\u{ac00}'..='\u{d7af}',
    ]) {
        [KOREAN, JAPANESE, CHINESE]
    } else {
        [CHINESE, JAPANESE, KOREAN]
    };
    let generic = "sans-serif";
    let named = FONT.strip_suffix(generic).unwrap_or(FONT);
    format!("{named}{}, {OTHER_SCRIPTS}, {generic}", cjk.join(", "))
}

/// Adds the installed faces that have missing characters, until none is missing: upright ones of the listed families
/// first, and of a family the one of normal weight.
fn add_installed(
    fonts: &mut Database,
    missing: &mut BTreeSet<char>,
    installed: &Database,
    families: &str,
) {
    let listed: Vec<&str> = families.split(", ").collect();
    let place = |face: &FaceInfo| {
        let is_of = |name: &&str| face.families.iter().any(|(family, _)| family == name);
        listed.iter().position(is_of).unwrap_or(listed.len())
    };
    let mut faces: Vec<&FaceInfo> = installed.faces().collect();
    // The name last, since the order of files in a folder is that of the disk.
    faces.sort_by_cached_key(|face| {
        let is_unusual = face.style != Style::Normal || face.stretch != Stretch::Normal;
        let weight = face.weight.0.abs_diff(Weight::NORMAL.0);
        (is_unusual, place(face), weight, face.post_script_name.clone())
    });
    for face in faces {
        if missing.is_empty() {
            return;
        }
        let found = installed.with_face_data(face.id, |data, index| {
            let has = characters(data, index, missing);
            (!has.is_empty()).then(|| (has, data.to_vec()))
        });
        let Some((has, data)) = found.flatten() else { continue };
        missing.retain(|c| !has.contains(c));
        fonts.push_face_info(FaceInfo {
            source: Source::Binary(Arc::new(data)),
            // Otherwise a bold italic would not do for a text that is neither.
            style: Style::Normal,
            weight: Weight::NORMAL,
            stretch: Stretch::Normal,
            ..face.clone()
        });
    }
}

/// Which of these characters a face has, as outlines: pictures in fonts are not drawn.
fn characters(data: &[u8], index: u32, wanted: &BTreeSet<char>) -> BTreeSet<char> {
    let Ok(font) = FontRef::from_index(data, index) else { return BTreeSet::new() };
    let outlines = [b"glyf", b"CFF ", b"CFF2"];
    if !outlines.iter().any(|tag| font.data_for_tag(Tag::new(tag)).is_some()) {
        return BTreeSet::new();
    }
    let map = font.charmap();
    let has = |c: &char| map.map(*c).is_some_and(|glyph| glyph.to_u32() != 0);
    wanted.iter().copied().filter(has).collect()
}

/// Whether a character has a shape of its own: neither spaces, nor what directs the drawing of others, nor XML's line ends.
fn is_visible(c: char) -> bool {
    let is_direction = matches!(c, '\u{ad}' | '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{206f}');
    let is_variant = matches!(c, '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{e0000}'..='\u{e0fff}');
    !(c.is_control() || c.is_whitespace() || is_direction || is_variant)
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::font::font_with;

    use super::*;

    /// In Unicode's private use: no font has a meaning for it.
    const PRIVATE: char = '\u{10fffd}';

    fn svg(text: &str) -> String {
        format!(
            "<svg width='200' height='40' xmlns='http://www.w3.org/2000/svg'>\
             <rect width='200' height='40' fill='white'/>\
             <text x='5' y='25' font-family='Nowhere, sans-serif' font-size='20'>{text}</text></svg>"
        )
    }

    fn fonts(fonts: &[Vec<u8>]) -> Arc<Database> {
        let mut database = Database::new();
        fonts.iter().for_each(|font| database.load_font_data(font.clone()));
        assert_eq!(database.len(), fonts.len());
        Arc::new(database)
    }

    /// How many pixels of a PNG are not white, by its decoded bytes.
    fn inked(png: &PngPicture) -> usize {
        let pixels = Pixmap::decode_png(&png.bytes).unwrap();
        pixels.pixels().iter().filter(|pixel| pixel.red() < 128 && pixel.alpha() > 0).count()
    }

    #[test]
    fn text_is_drawn_without_an_installed_font() {
        let none = || -> Arc<Database> { panic!("no font of the system is needed") };
        assert_eq!(inked(&png(&svg(""), none).unwrap()), 0);
        for text in ["mm/s", "λ° ж", "ירך", "ركبة", "№ → ⊘ €", "a\u{ad}b\u{200b}\u{feff}\u{3000}"]
        {
            let png = png(&svg(text), none).unwrap();
            assert!(inked(&png) > 100 && png.missing.is_empty(), "{text}: {:?}", png.missing);
        }
    }

    #[test]
    fn characters_that_the_own_font_lacks_are_drawn_with_one_of_the_system() {
        let text = svg(&format!("a{PRIVATE}"));
        let boxed = png(&text, Default::default).unwrap();
        assert_eq!(boxed.missing, [PRIVATE]);
        let plain = inked(&png(&svg("a"), Default::default).unwrap());
        assert!(inked(&boxed) > plain + 50, "a box is visible");
        // The square of the font is 20 units wide, which are 40 pixels.
        let others = [font_with("Other", '\u{10fffc}'), font_with("Own", PRIVATE)];
        let drawn = png(&text, || fonts(&others)).unwrap();
        assert_eq!(drawn.missing, []);
        assert!((1500..=1700).contains(&(inked(&drawn) - plain)), "{} {plain}", inked(&drawn));
        // What one font lacks another one draws, and both leave the rest.
        let both = png(&svg("\u{10fffc}\u{10fffd}\u{10fffb}"), || fonts(&others)).unwrap();
        assert_eq!(both.missing, ['\u{10fffb}']);
        assert!(inked(&both) > 3000, "{}", inked(&both));
    }

    #[test]
    fn families_follow_the_language_of_the_labels() {
        assert_eq!(families("Knie: λ°, ж, ركبة, 1 → 2 …"), FONT);
        let place = |text: &str, name: &str| families(text).find(name).unwrap();
        for (text, first) in
            [("左手", "CJK SC"), ("左ひざ", "CJK JP"), ("무릎", "CJK KR"), ("घुटना", "CJK SC")]
        {
            for other in ["CJK SC", "CJK JP", "CJK KR"] {
                assert!(place(text, first) <= place(text, other), "{text}");
            }
            assert!(families(text).starts_with("DejaVu Sans, "), "{text}");
            assert!(families(text).ends_with(", Noto Sans, sans-serif"), "{text}");
        }
        // Of two faces with a character that of the listed family is used.
        let listed = [font_with("Other", PRIVATE), font_with("Noto Sans", PRIVATE)];
        let (mut used, mut missing) = (Database::new(), BTreeSet::from([PRIVATE]));
        add_installed(&mut used, &mut missing, &fonts(&listed), &families(&PRIVATE.to_string()));
        let names: Vec<_> = used.faces().map(|face| face.families[0].0.clone()).collect();
        assert_eq!((names, missing), (vec!["Noto Sans".to_owned()], BTreeSet::new()));
    }

    #[test]
    fn a_damaged_font_is_as_none() {
        let good = font_with("Own", PRIVATE);
        for cut in 0..good.len() {
            let mut database = Database::new();
            database.load_font_data(good[..cut].to_vec());
            png(&svg(&PRIVATE.to_string()), || Arc::new(database)).unwrap();
        }
    }

    #[test]
    fn malformed_and_too_large_pictures_are_refused() {
        assert!(png("<svg", Default::default).is_err());
        let large = "<svg width='99999' height='99999' xmlns='http://www.w3.org/2000/svg'></svg>";
        assert!(png(large, Default::default).unwrap_err().to_string().contains(".svg"));
    }
}
