//! The header: which elements, how many, and what each has.

use super::malformed;
use crate::Unit;
use crate::read::{ReadError, text};

/// Elements of a file, and properties of an element, that are read at most; scanners write fewer than twenty.
const PARTS_MAX: usize = 256;
/// Bytes in which the header must end.
const LEN_MAX: usize = 1 << 20;

/// How the values are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

/// A type of numbers, all of which a float64 holds exactly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }
}

/// One number, or a count and as many.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

#[derive(Debug)]
pub(super) struct Element {
    pub(super) name: String,
    /// As announced.
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    pub(super) unit: Option<Unit>,
    /// Its bytes, with the end of its last line.
    pub(super) len: usize,
    /// Its lines.
    pub(super) n_lines: usize,
}

impl Header {
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, ReadError> {
        let (mut encoding, mut elements, mut unit) = (None, Vec::<Element>::new(), None);
        let mut rest = bytes.get(..LEN_MAX).unwrap_or(bytes);
        let whole = rest.len();
        for number in 1.. {
            let Some((line, after)) = split_line(rest) else { break };
            rest = after;
            let mut words = text::words(line);
            let wrong = |expected: &str| {
                let reason = format!("expected {expected}, found {}", text::quote(line));
                malformed(&format!("line {number}"), &reason)
            };
            match words.next() {
                Some(b"format") => {
                    encoding = match words.next() {
                        Some(b"ascii") => Some(Encoding::Text),
                        Some(b"binary_little_endian") => Some(Encoding::LittleEndian),
                        Some(b"binary_big_endian") => Some(Encoding::BigEndian),
                        _ => return Err(wrong("`format` and ascii or binary_..._endian")),
                    };
                }
                Some(b"comment" | b"obj_info") => unit = unit.or_else(|| Unit::from_comment(line)),
                Some(b"element") => {
                    let name = words.next().map(|name| String::from_utf8_lossy(name).into_owned());
                    let count = words.next().and_then(text::whole);
                    let count = count.and_then(|count| u64::try_from(count).ok());
                    let (name, count) =
                        name.zip(count).ok_or_else(|| wrong("a name and a count"))?;
                    elements.push(Element { name, count, properties: Vec::new() });
                    if elements.len() > PARTS_MAX {
                        return Err(wrong("fewer elements"));
                    }
                }
                Some(b"property") => {
                    let property =
                        property(&mut words).ok_or_else(|| wrong("a type and a name"))?;
                    let element = elements.last_mut().ok_or_else(|| wrong("an element first"))?;
                    element.properties.push(property);
                    if element.properties.len() > PARTS_MAX {
                        return Err(wrong("fewer properties"));
                    }
                }
                Some(b"end_header") => {
                    let encoding = encoding.ok_or_else(|| wrong("a line with `format` before"))?;
                    let len = whole - rest.len();
                    return Ok(Self { encoding, elements, unit, len, n_lines: number });
                }
                _ => {}
            }
        }
        Err(malformed("end of file", "expected `end_header`: cut off, export the scan again"))
    }
}

fn property(words: &mut dyn Iterator<Item = &[u8]>) -> Option<Property> {
    let kind = match words.next()? {
        b"list" => {
            let count = Scalar::from_name(words.next()?)?;
            Kind::List { count, item: Scalar::from_name(words.next()?)? }
        }
        scalar => Kind::Scalar(Scalar::from_name(scalar)?),
    };
    Some(Property { name: String::from_utf8_lossy(words.next()?).into_owned(), kind })
}

/// The first line, and what follows its end: LF, CR LF or CR. A CR is the whole end only where no LF follows.
fn split_line(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let end = bytes.iter().position(|&b| b == b'\n' || b == b'\r')?;
    let (line, rest) = bytes.split_at(end);
    let rest = rest.strip_prefix(b"\r\n").or_else(|| rest.get(1..))?;
    Some((line, rest))
}
