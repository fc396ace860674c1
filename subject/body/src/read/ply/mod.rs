//! The polygon format of Stanford: a header in text that describes elements and their properties, then their values.

mod header;
mod values;

use self::header::{Element, Encoding, Header, Kind};
use self::values::{Binary, Source, Text};
use super::surface::{Surface, put_corner};
use super::{Format, ReadError};

/// Reads a whole file. Of the vertices, `x`, `y` and `z` are read, of any type; of the faces, `vertex_indices` or
/// `vertex_index`; of `tristrips`, the same. All else is passed over.
pub(super) fn read(bytes: &[u8]) -> Result<Surface, ReadError> {
    let header = Header::parse(bytes)?;
    let mut surface = Surface::new(Format::Ply);
    surface.unit = header.unit;
    let body = bytes.get(header.len..).unwrap_or_default();
    match header.encoding {
        Encoding::Text => elements(&header, &mut Text::new(body, header.n_lines), &mut surface)?,
        Encoding::LittleEndian => {
            elements(&header, &mut Binary::new(body, header.len, false), &mut surface)?;
        }
        Encoding::BigEndian => {
            elements(&header, &mut Binary::new(body, header.len, true), &mut surface)?;
        }
    }
    Ok(surface)
}

/// What is done with the values of an element.
enum Role {
    /// Where x, y and z stand among the properties.
    Vertices([usize; 3]),
    /// Where the list of corners stands.
    Faces(usize),
    /// Where the list of a strip's corners stands; -1 begins a new strip.
    Strips(usize),
    Passed,
}

impl Role {
    fn of(element: &Element) -> Result<Self, ReadError> {
        let find = |name: &str| element.properties.iter().position(|p| p.name == name);
        let list = || find("vertex_indices").or_else(|| find("vertex_index"));
        let is_list = |at: usize| {
            element.properties.get(at).is_some_and(|p| matches!(p.kind, Kind::List { .. }))
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
                    return Err(malformed(
                        "header",
                        "expected faces with a list of vertex_indices",
                    ));
                };
                Ok(if element.name == "face" { Self::Faces(at) } else { Self::Strips(at) })
            }
            _ => Ok(Self::Passed),
        }
    }
}

fn elements(
    header: &Header,
    source: &mut impl Source,
    surface: &mut Surface,
) -> Result<(), ReadError> {
    let mut row = Row::default();
    for element in &header.elements {
        let role = Role::of(element)?;
        // Nothing stands for it, however many are announced.
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

/// What one row holds; kept, so that rows need no memory of their own.
#[derive(Default)]
struct Row {
    /// One a property; zero in the place of a list.
    scalars: Vec<f64>,
    corners: Vec<u32>,
}

impl Row {
    fn read(
        &mut self,
        element: &Element,
        role: &Role,
        source: &mut impl Source,
        surface: &mut Surface,
    ) -> Result<(), ReadError> {
        self.scalars.clear();
        for (at, property) in element.properties.iter().enumerate() {
            let (count, item) = match property.kind {
                Kind::Scalar(scalar) => {
                    self.scalars.push(source.value(scalar)?);
                    continue;
                }
                Kind::List { count, item } => (source.value(count)?, item),
            };
            self.scalars.push(0.0);
            if count < 0.0 || count.fract() != 0.0 {
                return Err(malformed(&source.place(), "a list whose length is no whole number"));
            }
            self.corners.clear();
            // The length is a claim: every item is asked for, and there is an end of bytes.
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

    /// Every vertex makes a triangle with the two before it; every second one is turned.
    fn strip(
        &mut self,
        value: f64,
        source: &impl Source,
        surface: &mut Surface,
    ) -> Result<(), ReadError> {
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

fn index(value: f64, source: &impl Source) -> Result<u32, ReadError> {
    if value.fract() == 0.0 && (0.0..f64::from(u32::MAX)).contains(&value) {
        return Ok(value as u32);
    }
    Err(malformed(&source.place(), &format!("expected the index of a vertex, found {value}")))
}

fn malformed(place: &str, reason: &str) -> ReadError {
    ReadError::malformed(Format::Ply, place, reason)
}
