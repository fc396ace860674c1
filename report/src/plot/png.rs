//! Pictures as PNG, and the fonts of their texts.
//!
//! `DejaVu Sans` is compiled in, so that no machine needs a font for labels in Latin, Greek, Cyrillic, Armenian, Georgian,
//! Hebrew and Arabic letters. Characters that it lacks, such as those of Chinese, Japanese and Korean, whose fonts have
//! megabytes, are drawn with the fonts of the system. A character that no font has is drawn as a box, and reported.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::{Range, RangeInclusive},
    sync::{Arc, Mutex, PoisonError},
};

use fontdb::{Database, FaceInfo, ID, Language, Source, Stretch, Style, Weight};
use resvg::{
    tiny_skia::{Pixmap, Transform},
    usvg::{self, Node, Options, Tree, roxmltree},
};
use skrifa::{FontRef, MetadataProvider, Tag, raw::TableProvider};

use super::FONT;
use crate::ReportError;

/// Pixels of a PNG per unit of the SVG: sharp in print and on high-density screens.
const SCALE: f32 = 2.0;

/// Maximum number of pixels of a PNG: 400 MB.
const PIXELS_MAX: f32 = 1e8;

/// Families for texts in scripts that [`FONT`] lacks: what Debian, Windows and macOS have.
const SCRIPTS: [(RangeInclusive<char>, &str); 21] = [
    ('\u{700}'..='\u{74f}', "Noto Sans Syriac, Segoe UI Historic"),
    ('\u{780}'..='\u{7bf}', "Noto Sans Thaana, MV Boli"),
    ('\u{900}'..='\u{97f}', "Noto Sans Devanagari, Nirmala UI, Kohinoor Devanagari"),
    ('\u{980}'..='\u{9ff}', "Noto Sans Bengali, Nirmala UI, Kohinoor Bangla"),
    ('\u{a00}'..='\u{a7f}', "Noto Sans Gurmukhi, Nirmala UI, Gurmukhi MN"),
    ('\u{a80}'..='\u{aff}', "Noto Sans Gujarati, Nirmala UI, Kohinoor Gujarati"),
    ('\u{b00}'..='\u{b7f}', "Noto Sans Oriya, Nirmala UI, Oriya MN"),
    ('\u{b80}'..='\u{bff}', "Noto Sans Tamil, Nirmala UI, Tamil MN"),
    ('\u{c00}'..='\u{c7f}', "Noto Sans Telugu, Nirmala UI, Kohinoor Telugu"),
    ('\u{c80}'..='\u{cff}', "Noto Sans Kannada, Nirmala UI, Kannada MN"),
    ('\u{d00}'..='\u{d7f}', "Noto Sans Malayalam, Nirmala UI, Malayalam MN"),
    ('\u{d80}'..='\u{dff}', "Noto Sans Sinhala, Nirmala UI, Sinhala MN"),
    ('\u{e00}'..='\u{e7f}', "Noto Sans Thai, Leelawadee UI, Thonburi"),
    ('\u{e80}'..='\u{eff}', "Noto Sans Lao, Leelawadee UI, Lao MN"),
    ('\u{f00}'..='\u{fff}', "Noto Serif Tibetan, Microsoft Himalaya, Kailasa"),
    ('\u{1000}'..='\u{109f}', "Noto Sans Myanmar, Myanmar Text, Myanmar MN"),
    ('\u{1200}'..='\u{139f}', "Noto Sans Ethiopic, Ebrima, Kefa"),
    ('\u{13a0}'..='\u{13ff}', "Noto Sans Cherokee, Gadugi, Plantagenet Cherokee"),
    ('\u{1400}'..='\u{167f}', "Noto Sans Canadian Aboriginal, Gadugi, Euphemia UCAS"),
    ('\u{1780}'..='\u{17ff}', "Noto Sans Khmer, Leelawadee UI, Khmer MN"),
    ('\u{1800}'..='\u{18af}', "Noto Sans Mongolian, Mongolian Baiti"),
];
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
    let mut faces = BTreeMap::new();
    if !missing.is_empty() {
        faces = faces_of(&mut fonts, &missing, installed(), &families(svg));
        missing.retain(|c| !faces.contains_key(c));
    }
    let options = Options { fontdb: Arc::new(fonts), ..Options::default() };
    let tree = tree_of(svg, &options, &faces).map_err(|error| bad(&error))?;
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
    let is_any_in = |ranges: &[RangeInclusive<char>]| {
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
    let scripts = SCRIPTS.iter().filter(|(range, _)| is_any_in(std::slice::from_ref(range)));
    let listed: Vec<&str> = scripts.map(|(_, families)| *families).chain(cjk).collect();
    format!("{named}{}, {OTHER_SCRIPTS}, {generic}", listed.join(", "))
}

/// Adds the installed faces that have these characters, and returns by which of them each is drawn.
fn faces_of(
    fonts: &mut Database,
    wanted: &BTreeSet<char>,
    installed: Arc<Database>,
    families: &str,
) -> BTreeMap<char, usize> {
    // To find out that no font has a character takes reading all of them: not again for each picture of a folder.
    static INSTALLED: Mutex<Option<Installed>> = Mutex::new(None);
    let mut remembered = INSTALLED.lock().unwrap_or_else(PoisonError::into_inner);
    let of_these = remembered.take().filter(|known| Arc::ptr_eq(&known.fonts, &installed));
    let known = remembered.insert(of_these.unwrap_or_else(|| Installed::new(installed)));
    let found = known.find(wanted, families);
    for index in found.values().collect::<BTreeSet<_>>() {
        if let Some((_, face)) = known.faces.get(*index) {
            fonts.push_face_info(face.clone());
        }
    }
    found
}

/// The fonts of the system, and what was found in them.
struct Installed {
    fonts: Arc<Database>,
    /// The faces that have been needed, with their data.
    faces: Vec<(ID, FaceInfo)>,
    /// By the families of a picture, which decide on the forms of Han characters: the face of each character, by its index.
    found: BTreeMap<String, BTreeMap<char, usize>>,
    /// Characters that no font has.
    absent: BTreeSet<char>,
}

impl Installed {
    fn new(fonts: Arc<Database>) -> Self {
        Self { fonts, faces: Vec::new(), found: BTreeMap::new(), absent: BTreeSet::new() }
    }

    /// The face of each of these characters that a font has: the first one in the order of [`preferred`].
    fn find(&mut self, wanted: &BTreeSet<char>, families: &str) -> BTreeMap<char, usize> {
        let found = self.found.entry(families.to_owned()).or_default();
        let is_new = |c: &char| !found.contains_key(c) && !self.absent.contains(c);
        let mut missing: BTreeSet<char> = wanted.iter().copied().filter(is_new).collect();
        if !missing.is_empty() {
            for face in preferred(&self.fonts, families) {
                let read = self.fonts.with_face_data(face.id, |data, index| {
                    let has = characters(data, index, &missing);
                    (!has.is_empty()).then(|| (has, data.to_vec()))
                });
                let Some((has, data)) = read.flatten() else { continue };
                let index = self.faces.iter().position(|(id, _)| *id == face.id);
                let index = index.unwrap_or_else(|| {
                    self.faces.push((face.id, usable(face, data, self.faces.len())));
                    self.faces.len() - 1
                });
                missing.retain(|c| !has.contains(c));
                found.extend(has.into_iter().map(|c| (c, index)));
                if missing.is_empty() {
                    break;
                }
            }
            self.absent.append(&mut missing);
        }
        wanted.iter().filter_map(|c| Some((*c, *found.get(c)?))).collect()
    }
}

/// The installed faces, the best one first: upright ones of the listed families, and of a family the one of normal weight.
fn preferred<'a>(installed: &'a Database, families: &str) -> Vec<&'a FaceInfo> {
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
    faces
}

/// A face for texts of any weight and style, with a family that no other has.
fn usable(face: &FaceInfo, data: Vec<u8>, index: usize) -> FaceInfo {
    let mut families = face.families.clone();
    families.push((face_family(index), Language::English_UnitedStates));
    FaceInfo {
        source: Source::Binary(Arc::new(data)),
        families,
        // Otherwise a bold italic would not do for a text that is neither.
        style: Style::Normal,
        weight: Weight::NORMAL,
        stretch: Stretch::Normal,
        ..face.clone()
    }
}

/// The family by which a text names a face of the system.
fn face_family(index: usize) -> String {
    format!("mocapd-face-{index}")
}

/// The id of a group around a text whose runs are drawn apart.
fn text_id(number: usize) -> String {
    format!("mocapd-text-{number}")
}

/// Parses an SVG. usvg shapes a whole text with one font after the other, and draws boxes if they differ in the number of
/// glyphs, as at a ligature. So each run of characters that one font draws becomes a `tspan` with a position of its own,
/// which is shaped apart.
fn tree_of(
    svg: &str,
    options: &Options<'_>,
    faces: &BTreeMap<char, usize>,
) -> Result<Tree, usvg::Error> {
    if faces.is_empty() {
        return Tree::from_str(svg, options);
    }
    let allowed = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let document = roxmltree::Document::parse_with_options(svg, allowed)?;
    let texts = document.descendants().filter_map(|node| MixedText::of(svg, node, faces));
    let mut texts: Vec<MixedText<'_>> = texts.collect();
    let tree = Tree::from_str(&with_runs_apart(svg, &texts), options)?;
    if texts.iter().all(|text| text.before <= 0.0) {
        return Ok(tree);
    }
    // Runs follow each other from the left. Where the others begin depends on their widths, which are known now.
    for (number, text) in texts.iter_mut().enumerate() {
        text.x -= text.before * tree.node_by_id(&text_id(number)).map_or(0.0, text_width);
    }
    Tree::from_str(&with_runs_apart(svg, &texts), options)
}

/// A text with characters that a font of the system draws.
struct MixedText<'a> {
    /// Where the element and its content begin, and where the element ends.
    begins: usize,
    content: usize,
    ends: usize,
    x: f32,
    y: f32,
    dy: &'a str,
    /// The share of its width that is left of its point: its anchor.
    before: f32,
    runs: Vec<(Option<usize>, String)>,
}

impl<'a> MixedText<'a> {
    /// The text of an element; `None` if usvg has to draw it as it is.
    fn of(svg: &str, node: roxmltree::Node<'a, '_>, faces: &BTreeMap<char, usize>) -> Option<Self> {
        let Range { start: begins, end: ends } = node.range();
        let is_plain = |name: &str| node.attribute(name).is_none();
        // A prefix of its namespace would have to be in the end tag, too.
        if node.tag_name().name() != "text"
            || !svg[begins..].starts_with("<text")
            || !["dx", "rotate", "textLength", "style"].into_iter().all(is_plain)
        {
            return None;
        }
        let content = node.first_child().filter(roxmltree::Node::is_text)?;
        if content.next_sibling().is_some() {
            return None;
        }
        let words = content.text()?.split([' ', '\t', '\r', '\n']).filter(|word| !word.is_empty());
        let text = words.collect::<Vec<_>>().join(" ");
        let runs = runs(&text, faces);
        if !runs.iter().any(|(face, _)| face.is_some()) || !keeps_order(&text, &runs) {
            return None;
        }
        let number =
            |name: &str| node.attribute(name).map_or(Some(0.0), |value| value.parse().ok());
        let before = match node.ancestors().find_map(|node| node.attribute("text-anchor")) {
            Some("middle") => 0.5,
            Some("end") => 1.0,
            _ => 0.0,
        };
        Some(Self {
            begins,
            content: content.range().start,
            ends,
            x: number("x")?,
            y: number("y")?,
            dy: node.attribute("dy").unwrap_or("0"),
            before,
            runs: runs.into_iter().map(|(face, run)| (face, run.to_owned())).collect(),
        })
    }
}

/// The runs of a text that one font draws, with the face if it is one of the system.
fn runs<'a>(text: &'a str, faces: &BTreeMap<char, usize>) -> Vec<(Option<usize>, &'a str)> {
    let mut ends: Vec<(Option<usize>, usize)> = Vec::new();
    for (at, c) in text.char_indices() {
        let face = faces.get(&c).copied();
        let end = at + c.len_utf8();
        match ends.last_mut() {
            Some((last, run_end)) if *last == face || is_part(c) => *run_end = end,
            _ => ends.push((face, end)),
        }
    }
    let mut at = 0;
    let run = |(face, end): (Option<usize>, usize)| {
        let run = &text[at..end];
        at = end;
        (face, run)
    };
    ends.into_iter().map(run).collect()
}

/// Whether a character changes the one before it, and so has to be of the same font.
fn is_part(c: char) -> bool {
    let is_mark = matches!(c, '\u{300}'..='\u{36f}' | '\u{1ab0}'..='\u{1aff}' | '\u{1dc0}'..='\u{1dff}' | '\u{20d0}'..='\u{20ff}' | '\u{fe20}'..='\u{fe2f}');
    is_mark || !(is_visible(c) || c.is_whitespace())
}

/// Whether the runs of a text are drawn from left to right. Beside letters of scripts that are written from right to left,
/// characters without a direction, such as symbols, may go to the other side.
fn keeps_order(text: &str, runs: &[(Option<usize>, &str)]) -> bool {
    let is_private = |c: char| matches!(c, '\u{e000}'..='\u{f8ff}' | '\u{f0000}'..='\u{10ffff}');
    let begins_to_right = |run: &str| run.starts_with(|c: char| c.is_alphabetic() || is_private(c));
    let mut others = runs.iter().filter(|(face, _)| face.is_some());
    !text.contains(is_right_to_left)
        || others.all(|(_, run)| begins_to_right(run) && !run.contains(is_right_to_left))
}

/// Letters that are written from right to left, and characters that give others a direction.
fn is_right_to_left(c: char) -> bool {
    let is_letter = matches!(c, '\u{590}'..='\u{8ff}' | '\u{fb1d}'..='\u{fdff}' | '\u{fe70}'..='\u{fefc}' | '\u{10800}'..='\u{10fff}' | '\u{1e800}'..='\u{1efff}');
    is_letter
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// An SVG with the runs of these texts as elements of their own.
fn with_runs_apart(svg: &str, texts: &[MixedText<'_>]) -> String {
    let mut changed = String::with_capacity(svg.len() + 512 * texts.len());
    let mut at = 0;
    for (number, text) in texts.iter().enumerate() {
        changed.push_str(&svg[at..text.begins]);
        changed.push_str(&format!("<g id=\"{}\">", text_id(number)));
        changed.push_str(&svg[text.begins..text.content]);
        // A run with a `y` of its own is shaped apart, and begins where the one before it ends.
        let (mut x, y, dy) = (format!(" x=\"{}\"", text.x), text.y, escaped(text.dy));
        for (face, run) in &text.runs {
            let family = face.map_or_else(String::new, |index| {
                format!(" font-family=\"{}\"", face_family(index))
            });
            let run = escaped(run);
            changed.push_str(&format!(
                "<tspan text-anchor=\"start\"{x} y=\"{y}\" dy=\"{dy}\"{family}>{run}</tspan>"
            ));
            x.clear();
        }
        changed.push_str("</text></g>");
        at = text.ends;
    }
    changed.push_str(&svg[at..]);
    changed
}

/// Text as the content or the value of XML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The width of a text in a group.
fn text_width(node: &Node) -> f32 {
    match node {
        Node::Text(text) => text.bounding_box().width(),
        Node::Group(group) => group.children().iter().map(text_width).fold(0.0, f32::max),
        Node::Path(_) | Node::Image(_) => 0.0,
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
    use std::sync::atomic::{AtomicUsize, Ordering};

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
        for (text, name) in [("เข่า", "Noto Sans Thai"), ("முழங்கால்", "Nirmala UI"), ("ጉልበት", "Kefa")]
        {
            assert!(place(text, name) < place(text, "CJK SC"), "{text}");
            assert!(!families("左手").contains(name), "only families of its scripts are named");
        }
        // Of two faces with a character that of the listed family is used.
        let listed = [font_with("Other", PRIVATE), font_with("Noto Sans", PRIVATE)];
        let mut used = Database::new();
        let wanted = BTreeSet::from([PRIVATE]);
        let found = faces_of(&mut used, &wanted, fonts(&listed), &families(&PRIVATE.to_string()));
        let names: Vec<_> = used.faces().map(|face| face.families[0].0.clone()).collect();
        assert_eq!((names, found), (vec!["Noto Sans".to_owned()], BTreeMap::from([(PRIVATE, 0)])));
    }

    /// The first and the last column with ink, and the first and the last row.
    fn extent(png: &PngPicture) -> [usize; 4] {
        let pixels = Pixmap::decode_png(&png.bytes).unwrap();
        let width = pixels.width() as usize;
        let mut found = [usize::MAX, 0, usize::MAX, 0];
        for (at, pixel) in pixels.pixels().iter().enumerate() {
            if pixel.red() < 128 {
                let (x, y) = (at % width, at / width);
                let [left, right, top, bottom] = found;
                found = [left.min(x), right.max(x), top.min(y), bottom.max(y)];
            }
        }
        found
    }

    /// Ligatures are one glyph in one font, and two in the other.
    #[test]
    fn a_character_of_another_font_is_drawn_beside_a_ligature() {
        let others = fonts(&[font_with("Own", PRIVATE)]);
        let draw = |text: &str| png(text, || Arc::clone(&others)).unwrap();
        for word in ["fi", "knee fi ", "لا", "كلا 12 ", "a&amp;fi&lt;"] {
            let text = svg(word);
            let plain = inked(&draw(&text));
            for mixed in [format!("{word}{PRIVATE}"), format!("\n{PRIVATE} {word}\n")] {
                let drawn = draw(&svg(&mixed));
                let square = inked(&drawn) - plain;
                assert!((1500..=1700).contains(&square), "{mixed}: {square}");
                assert_eq!(drawn.missing, []);
            }
        }
    }

    #[test]
    fn texts_with_several_fonts_stay_where_they_are() {
        let others = fonts(&[font_with("Own", PRIVATE)]);
        let draw = |attributes: &str, text: &str| {
            let text = svg(text).replace("x='5'", attributes);
            extent(&png(&text, || Arc::clone(&others)).unwrap())
        };
        let near = |a: usize, b: usize| a.abs_diff(b) <= 1;
        let both = format!("{PRIVATE}fi{PRIVATE}");
        let [first, _, top, bottom] = draw("x='5'", &both);
        assert_eq!([first, top, bottom], [10, 10, 49]);
        let [_, last, ..] = draw("x='150' text-anchor='end'", &both);
        assert!(near(last, 299), "{last}");
        let [first, last, ..] = draw("x='100' text-anchor='middle'", &both);
        assert!(near(first + last, 399) && last - first > 90, "{first} {last}");
        let [first, last, top, bottom] = draw("x='150' dy='0.5ex' text-anchor='end'", &both);
        assert!(near(last, 299) && last - first > 90, "{first} {last}");
        assert_eq!([top, bottom], [20, 59]);
        let turned = "x='100' text-anchor='middle' transform='rotate(180, 100, 20)'";
        let [first, last, ..] = draw(turned, &both);
        assert!(near(first + last, 399) && last - first > 90, "{first} {last}");
    }

    #[test]
    fn runs_follow_the_fonts_unless_they_change_places() {
        let faces = BTreeMap::from([('左', 0), ('手', 0), ('ひ', 1), ('☺', 1)]);
        let of = |text: &'static str| {
            let found = runs(text, &faces);
            (keeps_order(text, &found), found)
        };
        let expected = [(None, "knee "), (Some(0), "左手\u{301}"), (Some(1), "ひ"), (None, " 1")];
        assert_eq!(of("knee 左手\u{301}ひ 1"), (true, expected.to_vec()));
        for (text, is_kept) in
            [("knee ☺", true), ("ירך 左手 ירך", true), ("ירך ☺ ירך", false), ("\u{202e}a☺", false)]
        {
            assert_eq!(of(text).0, is_kept, "{text}");
        }
    }

    #[test]
    fn fonts_are_read_once_for_each_character() {
        struct Counted(Vec<u8>, AtomicUsize);

        impl AsRef<[u8]> for Counted {
            fn as_ref(&self) -> &[u8] {
                self.1.fetch_add(1, Ordering::Relaxed);
                &self.0
            }
        }

        let font = Arc::new(Counted(font_with("Own", PRIVATE), AtomicUsize::new(0)));
        let mut database = Database::new();
        database.load_font_source(Source::Binary(Arc::clone(&font) as _));
        let mut installed = Installed::new(Arc::new(database));
        let reads = || font.1.swap(0, Ordering::Relaxed);
        reads();
        let wanted = BTreeSet::from([PRIVATE, '\u{10fffb}']);
        let found = BTreeMap::from([(PRIVATE, 0)]);
        assert_eq!(installed.find(&wanted, "Nowhere"), found);
        assert!(reads() > 0);
        assert_eq!(installed.find(&wanted, "Nowhere"), found);
        assert_eq!(reads(), 0);
        // Which face is best depends on the families, but not that none has a character.
        assert_eq!(installed.find(&BTreeSet::from(['\u{10fffb}']), "Own"), BTreeMap::new());
        assert_eq!(reads(), 0);
        assert_eq!(installed.find(&wanted, "Own"), found);
        assert!(reads() > 0 && installed.faces.len() == 1);
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
