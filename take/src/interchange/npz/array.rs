//! A `.npy`: a head that says type and shape, then the elements, little endian, last index fastest.

use crate::interchange::InterchangeError;

/// Bytes that the head's length is a multiple of, so that elements are aligned.
const ALIGNMENT: usize = 64;
/// Most bytes of an array of texts: every element has the room of the longest.
const TEXT_BYTES_MAX: u64 = 1 << 26;

/// Types of elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Bool,
    I64,
    F32,
    F64,
    /// UTF-32, so many characters each.
    Text(usize),
}

impl Kind {
    fn name(self) -> String {
        match self {
            Self::Bool => "|b1".to_owned(),
            Self::I64 => "<i8".to_owned(),
            Self::F32 => "<f4".to_owned(),
            Self::F64 => "<f8".to_owned(),
            Self::Text(characters) => format!("<U{characters}"),
        }
    }
}

/// The head of an array; no dimensions for a single element.
pub(super) fn header(kind: Kind, shape: &[u64]) -> Vec<u8> {
    let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
    // A tuple of one keeps its comma; Python reads one behind the last of several, too.
    let about = format!(
        "{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}",
        kind.name(),
        shape.trim_end()
    );
    let mut head = b"\x93NUMPY\x01\x00\0\0".to_vec();
    let padded = (head.len() + about.len() + 1).next_multiple_of(ALIGNMENT);
    let about_bytes = (padded - head.len()) as u16;
    if let Some(place) = head.get_mut(8..10) {
        place.copy_from_slice(&about_bytes.to_le_bytes());
    }
    head.extend(about.bytes());
    head.resize(padded - 1, b' ');
    head.push(b'\n');
    head
}

/// An array of texts.
pub(super) fn texts(texts: &[&str]) -> Result<Vec<u8>, InterchangeError> {
    let longest = texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
    let n = texts.len() as u64;
    if n.saturating_mul(4 * longest as u64) > TEXT_BYTES_MAX {
        return Err(InterchangeError::Unsupported(format!(
            "npz gives every text the room of the longest: {n} of {longest} characters are too many"
        )));
    }
    let mut array = header(Kind::Text(longest), &[n]);
    texts.iter().for_each(|text| push_text(text, longest, &mut array));
    Ok(array)
}

/// A single text.
pub(super) fn text(text: &str) -> Vec<u8> {
    let characters = text.chars().count().max(1);
    let mut array = header(Kind::Text(characters), &[]);
    push_text(text, characters, &mut array);
    array
}

fn push_text(text: &str, characters: usize, out: &mut Vec<u8>) {
    let end = out.len() + 4 * characters;
    out.extend(text.chars().flat_map(|c| u32::from(c).to_le_bytes()));
    out.resize(end, 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_as_numpy_writes_them() {
        for (shape, said) in [
            (&[][..], "'shape': (), }"),
            (&[7][..], "'shape': (7,), }"),
            (&[7, 2, 3], "'shape': (7, 2, 3,), }"),
        ] {
            let head = header(Kind::F32, shape);
            assert!(head.len().is_multiple_of(ALIGNMENT) && head.ends_with(b"\n"));
            assert_eq!(usize::from(u16::from_le_bytes([head[8], head[9]])), head.len() - 10);
            let text = String::from_utf8_lossy(&head[10..]).into_owned();
            assert!(text.starts_with("{'descr': '<f4', ") && text.contains(said), "{text}");
        }
    }

    #[test]
    fn texts_have_the_room_of_the_longest() {
        let array = texts(&["a", "", "\u{4e2d}b"]).unwrap();
        let head = header(Kind::Text(2), &[3]).len();
        let words: Vec<u32> =
            array[head..].as_chunks().0.iter().map(|&b| u32::from_le_bytes(b)).collect();
        assert_eq!(words, [0x61, 0, 0, 0, 0x4e2d, 0x62]);
        let long = "x".repeat(1 << 20);
        assert!(texts(&[long.as_str(); 1000]).is_err());
    }
}
