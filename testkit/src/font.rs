//! A TrueType font with a single character, for tests of what is drawn with the fonts of a system.

/// Font units of an em.
const EM: i16 = 1000;

/// A font of this family whose only character is a filled square. Its glyph for characters that it lacks is empty.
#[must_use]
pub fn font_with(family: &str, character: char) -> Vec<u8> {
    let glyph = square();
    let tables: [(&[u8; 4], Vec<u8>); 8] = [
        (b"cmap", cmap(character)),
        (b"glyf", glyph.clone()),
        (b"head", head()),
        (
            b"hhea",
            words(&[1, 0, EM as u16, 0, 0, EM as u16, 0, 0, EM as u16, 1, 0, 0, 0, 0, 0, 0, 0, 2]),
        ),
        // An advance and a left side bearing for each of the two glyphs.
        (b"hmtx", words(&[EM as u16, 0, EM as u16, 0])),
        // Where glyphs begin and end, as 32-bit offsets.
        (b"loca", words(&[0, 0, 0, 0, 0, glyph.len() as u16])),
        (b"maxp", words(&[1, 0, 2, 4, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0])),
        (b"name", name(family)),
    ];
    let n = tables.len() as u16;
    let mut file = words(&[1, 0, n, 128, 3, n * 16 - 128]);
    let mut at = file.len() + 16 * tables.len();
    for (tag, table) in &tables {
        file.extend_from_slice(*tag);
        // No reader refuses a font for its checksums.
        file.extend([0; 4]);
        file.extend((at as u32).to_be_bytes());
        file.extend((table.len() as u32).to_be_bytes());
        at += table.len().next_multiple_of(4);
    }
    for (_, table) in &tables {
        file.extend(table);
        file.resize(file.len().next_multiple_of(4), 0);
    }
    file
}

/// Numbers of 16 bits, big endian.
fn words(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

/// One group of one character, in the format for all of Unicode.
fn cmap(character: char) -> Vec<u8> {
    let c = u32::from(character);
    let (high, low) = ((c >> 16) as u16, c as u16);
    words(&[0, 1, 3, 10, 0, 12, 12, 0, 0, 28, 0, 0, 0, 1, high, low, high, low, 0, 1])
}

/// One contour of four points on the curve.
fn square() -> Vec<u8> {
    let size = EM as u16;
    let mut glyph = words(&[1, 0, 0, size, size, 3, 0]);
    glyph.extend([1; 4]);
    let back = size.wrapping_neg();
    glyph.extend(words(&[0, size, 0, back, 0, 0, size, 0]));
    glyph
}

fn head() -> Vec<u8> {
    let em = EM as u16;
    words(&[
        1, 0, 1, 0, 0, 0, 0x5f0f, 0x3cf5, 0, em, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, em, em, 0, 8, 2, 1,
        0,
    ])
}

/// The family and the PostScript name, in English for Windows.
fn name(family: &str) -> Vec<u8> {
    let utf_16: Vec<u16> = family.encode_utf16().collect();
    let len = 2 * utf_16.len() as u16;
    let records = [[3, 1, 0x409, 1, len, 0], [3, 1, 0x409, 6, len, 0]].concat();
    [words(&[0, 2, 30]), words(&records), words(&utf_16)].concat()
}
