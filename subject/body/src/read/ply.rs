//! Stanford PLY: a text header that describes elements and their properties, then their values.

use super::{
    Format, ReadError, Surface,
    obj_off_stl::{integer, lines, number, quote, tokens},
    put_corner,
};
use crate::Unit;

type Result<T = ()> = std::result::Result<T, ReadError>;

/// Reads a PLY file: `x`, `y` and `z` of the vertices in any type, `vertex_indices` or `vertex_index` of faces and of
/// `tristrips`. Everything else is ignored.
pub(super) fn read(bytes: &[u8]) -> Result<Surface> {
    let header = Header::parse(bytes)?;
    let mut surface = Surface::new(Format::Ply);
    surface.unit = header.unit;
    let body = bytes.get(header.len..).unwrap_or_default();
    match header.encoding {
        Encoding::Text => elements(&header, &mut Text::new(body, header.n_lines), &mut surface)?,
        Encoding::Binary { big_endian } => {
            elements(&header, &mut Binary::new(body, header.len, big_endian), &mut surface)?;
        }
    }
    Ok(surface)
}

/// What the values of an element are used for.
enum Role {
    /// Indices of x, y and z among the properties.
    Vertices([usize; 3]),
    /// Index of the list of corners.
    Faces(usize),
    /// Index of the list of a strip's corners; -1 begins a new strip.
    Strips(usize),
    Passed,
}

impl Role {
    fn of(element: &Element) -> Result<Self> {
        let find = |name: &str| element.properties.iter().position(|p| p.name == name);
        let list = || find("vertex_indices").or_else(|| find("vertex_index"));
        let is_list = |at: usize| {
            element.properties.get(at).is_some_and(|p| matches!(p.kind, PropertyType::List { .. }))
        };
        match element.name.as_str() {
            "vertex" => match [find("x"), find("y"), find("z")] {
                [Some(x), Some(y), Some(z)] if ![x, y, z].into_iter().any(is_list) => {
                    Ok(Self::Vertices([x, y, z]))
                }
                _ => Err(malformed("header", "expected a vertex with the properties x, y and z")),
            },
            "face" | "tristrips" => {
                let Some(at) = list().filter(|&at| is_list(at)) else {
                    let expected = "expected faces with a list of vertex_indices";
                    return Err(malformed("header", expected));
                };
                Ok(if element.name == "face" { Self::Faces(at) } else { Self::Strips(at) })
            }
            _ => Ok(Self::Passed),
        }
    }
}

fn elements(header: &Header, source: &mut impl ValueSource, surface: &mut Surface) -> Result {
    let mut row = Row::default();
    for element in &header.elements {
        let role = Role::of(element)?;
        // An element without properties occupies no bytes.
        if element.properties.is_empty() {
            continue;
        }
        for _ in 0..element.count {
            source.begin_row()?;
            row.read(element, &role, source, surface)?;
        }
    }
    Ok(())
}

/// Buffers for one row, reused for all.
#[derive(Default)]
struct Row {
    /// One per property; zero in place of a list.
    scalars: Vec<f64>,
    corners: Vec<u32>,
}

impl Row {
    fn read(
        &mut self,
        element: &Element,
        role: &Role,
        source: &mut impl ValueSource,
        surface: &mut Surface,
    ) -> Result {
        self.scalars.clear();
        for (at, property) in element.properties.iter().enumerate() {
            let (count, item) = match property.kind {
                PropertyType::Scalar(scalar) => {
                    self.scalars.push(source.value(scalar)?);
                    continue;
                }
                PropertyType::List { count, item } => (source.value(count)?, item),
            };
            self.scalars.push(0.0);
            if count < 0.0 || count.fract() != 0.0 {
                return Err(malformed(source.place(), "a list length that is not an integer"));
            }
            self.corners.clear();
            // The length is not trusted: every item is read, and the bytes end.
            let mut left = count;
            while left > 0.0 {
                let value = source.value(item)?;
                match role {
                    Role::Faces(faces) if *faces == at => {
                        put_corner(&mut self.corners, index(value, source)?)?;
                    }
                    Role::Strips(strips) if *strips == at => self.strip(value, source, surface)?,
                    _ => {}
                }
                left -= 1.0;
            }
            if matches!(role, Role::Faces(faces) if *faces == at) {
                surface.face(&self.corners)?;
            }
        }
        if let Role::Vertices(at) = role {
            surface.vertex(at.map(|at| self.scalars.get(at).copied().unwrap_or(f64::NAN)))?;
        }
        Ok(())
    }

    /// Each vertex of a strip makes a triangle with the two before it; every second triangle is flipped.
    fn strip(&mut self, value: f64, source: &impl ValueSource, surface: &mut Surface) -> Result {
        if value == -1.0 {
            self.corners.clear();
            return Ok(());
        }
        put_corner(&mut self.corners, index(value, source)?)?;
        let turned = self.corners.len().is_multiple_of(2);
        match self.corners[..] {
            [.., a, b, c] if turned => surface.face(&[b, a, c]),
            [.., a, b, c] => surface.face(&[a, b, c]),
            _ => Ok(()),
        }
    }
}

fn index(value: f64, source: &impl ValueSource) -> Result<u32> {
    if value.fract() == 0.0 && (0.0..f64::from(u32::MAX)).contains(&value) {
        return Ok(value as u32);
    }
    Err(malformed(source.place(), format!("expected the index of a vertex, found {value}")))
}

fn malformed(place: impl Into<String>, reason: impl Into<String>) -> ReadError {
    Format::Ply.malformed(place, reason)
}

/// Maximum number of elements of a file and properties of an element; scanners write fewer than twenty.
const PARTS_MAX: usize = 256;
/// Largest header in bytes.
const LEN_MAX: usize = 1 << 20;

/// Encoding of the values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Text,
    Binary { big_endian: bool },
}

/// A scalar type; float64 holds all values of each exactly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scalar {
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

/// A scalar, or a list: a count and that many items.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PropertyType {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Debug)]
struct Property {
    name: String,
    kind: PropertyType,
}

#[derive(Debug)]
struct Element {
    name: String,
    /// Number of rows that the header declares.
    count: u64,
    properties: Vec<Property>,
}

#[derive(Debug)]
struct Header {
    encoding: Encoding,
    elements: Vec<Element>,
    unit: Option<Unit>,
    /// Length in bytes, its last line end included.
    len: usize,
    /// Number of lines.
    n_lines: usize,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self> {
        let (mut encoding, mut elements, mut unit) = (None, Vec::<Element>::new(), None);
        let mut rest = bytes.get(..LEN_MAX).unwrap_or(bytes);
        let whole = rest.len();
        for number in 1.. {
            let Some((line, after)) = split_line(rest) else { break };
            rest = after;
            let mut tokens = tokens(line);
            let wrong = |expected: &str| Format::Ply.unexpected(number, expected, line);
            match tokens.next() {
                Some(b"format") => {
                    encoding = Some(match tokens.next() {
                        Some(b"ascii") => Encoding::Text,
                        Some(b"binary_little_endian") => Encoding::Binary { big_endian: false },
                        Some(b"binary_big_endian") => Encoding::Binary { big_endian: true },
                        _ => return Err(wrong("`format` and ascii or binary_..._endian")),
                    });
                }
                Some(b"comment" | b"obj_info") => unit = unit.or_else(|| Unit::from_comment(line)),
                Some(b"element") => {
                    let name = tokens.next().map(|name| String::from_utf8_lossy(name).into_owned());
                    let count = tokens.next().and_then(integer);
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
                        property(&mut tokens).ok_or_else(|| wrong("a type and a name"))?;
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

fn property(tokens: &mut dyn Iterator<Item = &[u8]>) -> Option<Property> {
    let kind = match tokens.next()? {
        b"list" => {
            let count = Scalar::from_name(tokens.next()?)?;
            PropertyType::List { count, item: Scalar::from_name(tokens.next()?)? }
        }
        scalar => PropertyType::Scalar(Scalar::from_name(scalar)?),
    };
    Some(Property { name: String::from_utf8_lossy(tokens.next()?).into_owned(), kind })
}

/// The first line, and what follows its end: LF, CR LF or CR.
fn split_line(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let end = bytes.iter().position(|&b| b == b'\n' || b == b'\r')?;
    let (line, rest) = bytes.split_at(end);
    let rest = rest.strip_prefix(b"\r\n").or_else(|| rest.get(1..))?;
    Some((line, rest))
}

/// A source of values.
trait ValueSource {
    /// Begins the next vertex, face or other element.
    fn begin_row(&mut self) -> Result;
    /// The next value, which takes at least one byte of the file.
    fn value(&mut self, scalar: Scalar) -> Result<f64>;
    /// Position of the last value, for messages.
    fn place(&self) -> String;
}

/// Text: one row per line, values separated by white space.
struct Text<'a> {
    lines: Box<dyn Iterator<Item = (usize, &'a [u8])> + 'a>,
    line: &'a [u8],
    number: usize,
}

impl<'a> Text<'a> {
    /// Starts after a header of `n_lines` lines.
    fn new(bytes: &'a [u8], n_lines: usize) -> Self {
        let lines = lines(bytes).map(move |(number, line)| (number + n_lines, line));
        Self { lines: Box::new(lines), line: &[], number: n_lines }
    }
}

impl ValueSource for Text<'_> {
    fn begin_row(&mut self) -> Result {
        let mut filled = self.lines.by_ref().filter(|(_, line)| !line.trim_ascii().is_empty());
        let Some((number, line)) = filled.next() else {
            return Err(malformed(
                "end of file",
                "fewer lines than announced: cut off, export the scan again",
            ));
        };
        (self.number, self.line) = (number, line);
        Ok(())
    }

    fn value(&mut self, _: Scalar) -> Result<f64> {
        let line = self.line.trim_ascii_start();
        let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
        let (token, rest) = line.split_at(end);
        self.line = rest;
        number(token).ok_or_else(|| {
            malformed(self.place(), format!("expected a number, found {}", quote(token)))
        })
    }

    fn place(&self) -> String {
        format!("line {}", self.number)
    }
}

/// Binary: values without separators.
struct Binary<'a> {
    rest: &'a [u8],
    /// Length of the whole file.
    len: usize,
    big_endian: bool,
}

impl<'a> Binary<'a> {
    /// Starts after a header of `header_len` bytes.
    fn new(rest: &'a [u8], header_len: usize, big_endian: bool) -> Self {
        Self { rest, len: rest.len() + header_len, big_endian }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let Some((&(mut bytes), rest)) = self.rest.split_first_chunk() else {
            return Err(malformed(
                self.place(),
                "fewer values than announced: cut off, export the scan again",
            ));
        };
        self.rest = rest;
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }
}

impl ValueSource for Binary<'_> {
    fn begin_row(&mut self) -> Result {
        Ok(())
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64> {
        Ok(match scalar {
            Scalar::I8 => i8::from_le_bytes(self.take()?).into(),
            Scalar::U8 => u8::from_le_bytes(self.take()?).into(),
            Scalar::I16 => i16::from_le_bytes(self.take()?).into(),
            Scalar::U16 => u16::from_le_bytes(self.take()?).into(),
            Scalar::I32 => i32::from_le_bytes(self.take()?).into(),
            Scalar::U32 => u32::from_le_bytes(self.take()?).into(),
            Scalar::F32 => f32::from_le_bytes(self.take()?).into(),
            Scalar::F64 => f64::from_le_bytes(self.take()?),
        })
    }

    fn place(&self) -> String {
        format!("byte {}", self.len - self.rest.len())
    }
}
