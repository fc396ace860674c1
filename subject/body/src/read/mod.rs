//! Readers of mesh files: OBJ, PLY (text and binary of both byte orders), STL (text and binary) and OFF.
//!
//! The content determines the format; the file name's extension counts only if the content leaves it open. Counts in a
//! file are never trusted for allocation: every vertex and face comes from bytes that exist. `Surface`
//! collects them within limits, and checks them at the end.

mod obj_off_stl;
mod ply;
#[cfg(test)]
mod tests;

use std::fmt;

use crate::{
    Mesh, Note, Unit,
    mesh::{self, Point, unit},
};

/// Largest file: five million triangles as text need less.
pub const BYTES_MAX: usize = 1 << 30;
/// Maximum number of triangles. A body scanner gives 0.1 to 2 million.
pub const FACES_MAX: usize = 5_000_000;
/// Maximum number of vertices: three per face, as if none were shared.
pub const VERTICES_MAX: usize = 3 * FACES_MAX;

/// A mesh as read: polygons are triangulated, every position is finite, every index valid. Whether it is one clean
/// surface is up to [`repair`](super::repair).
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// The surface, in the file's unit.
    pub mesh: Mesh,
    /// Format of the file.
    pub format: Format,
    /// The unit, if a comment in the file states it.
    pub unit: Option<Unit>,
    /// Remarks on the file.
    pub notes: Vec<Note>,
}

/// Reads a mesh file. Only the extension of `name` is used, as a hint.
///
/// # Errors
/// [`ReadError`], with what to do about it.
pub fn read(bytes: &[u8], name: &str) -> Result<Scan, ReadError> {
    if bytes.is_empty() {
        return Err(ReadError::Empty);
    }
    if bytes.len() > BYTES_MAX {
        return Err(ReadError::TooLarge { what: "bytes", found: bytes.len(), limit: BYTES_MAX });
    }
    let format = format(bytes, name)?;
    let surface = match format {
        Format::Obj => obj_off_stl::read_obj(bytes)?,
        Format::Ply => ply::read(bytes)?,
        Format::Stl => obj_off_stl::read_stl(bytes)?,
        Format::Off => obj_off_stl::read_off(bytes)?,
    };
    let mut scan = surface.finish()?;
    if let Some(ending) = Format::from_name(name)
        && ending != format
    {
        let text = format!("read as {format} by its content, though its name ends as {ending}");
        scan.notes.push(Note::new("other-ending", text));
    }
    Ok(scan)
}

/// A mesh file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Wavefront OBJ, text.
    Obj,
    /// Stanford PLY, text or binary.
    Ply,
    /// STL (stereolithography), text or binary.
    Stl,
    /// Geomview OFF, text.
    Off,
}

impl Format {
    /// Recognises the extension of a file name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let (_, ending) = name.rsplit_once('.')?;
        match ending.to_ascii_lowercase().as_str() {
            "obj" => Some(Self::Obj),
            "ply" => Some(Self::Ply),
            "stl" => Some(Self::Stl),
            "off" => Some(Self::Off),
            _ => None,
        }
    }

    /// A [`ReadError::Malformed`] at a place, with a reason.
    fn malformed(self, place: impl Into<String>, reason: impl Into<String>) -> ReadError {
        ReadError::Malformed { format: self, place: place.into(), reason: reason.into() }
    }

    fn malformed_line(self, number: usize, reason: impl Into<String>) -> ReadError {
        self.malformed(format!("line {number}"), reason)
    }

    fn unexpected(self, number: usize, expected: &str, found: &[u8]) -> ReadError {
        self.malformed_line(
            number,
            format!("expected {expected}, found {}", obj_off_stl::quote(found)),
        )
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Obj => "OBJ",
            Self::Ply => "PLY",
            Self::Stl => "STL",
            Self::Off => "OFF",
        })
    }
}

/// Keywords of OBJ lines.
const OBJ_KEYWORDS: [&[u8]; 11] =
    [b"v", b"vt", b"vn", b"vp", b"f", b"o", b"g", b"s", b"l", b"mtllib", b"usemtl"];
/// Maximum number of lines before the first keyword of an OBJ: exporters' comments are shorter.
const OBJ_LINES: usize = 1000;

fn format(bytes: &[u8], name: &str) -> Result<Format, ReadError> {
    let bytes = obj_off_stl::without_bom(bytes);
    if matches!(bytes, [b'p', b'l', b'y', b'\r' | b'\n', ..]) {
        return Ok(Format::Ply);
    }
    // Before the other formats: a binary STL may begin with any text.
    if obj_off_stl::fits_binary_stl(bytes) {
        return Ok(Format::Stl);
    }
    let mut lines = obj_off_stl::lines(bytes)
        .take(OBJ_LINES)
        .filter_map(|(_, line)| obj_off_stl::tokens(obj_off_stl::before_comment(line)).next());
    let first = lines.next().unwrap_or_default();
    if first.ends_with(b"OFF") && first.len() <= 9 && first.iter().all(u8::is_ascii_alphanumeric) {
        return Ok(Format::Off);
    }
    if first.eq_ignore_ascii_case(b"solid") {
        return Ok(Format::Stl);
    }
    if OBJ_KEYWORDS.contains(&first) || lines.any(|token| OBJ_KEYWORDS.contains(&token)) {
        return Ok(Format::Obj);
    }
    Format::from_name(name).ok_or_else(|| ReadError::Unknown { found: describe(bytes).to_owned() })
}

/// Describes files that people try instead.
fn describe(bytes: &[u8]) -> &'static str {
    match bytes {
        [0x1f, 0x8b, ..] => "a gzip file: unpack it first",
        [b'P', b'K', 3, 4, ..] => "a ZIP archive, perhaps 3MF: unpack it first",
        [b'g', b'l', b'T', b'F', ..] => "a binary glTF",
        [b'K', b'a', b'y', b'd', b'a', b'r', b'a', ..] => "an FBX",
        [b'#', b'V', b'R', b'M', b'L', ..] => "a VRML world",
        [b'<', ..] => "an XML document",
        [b'{', ..] => "a JSON document",
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => "a text in UTF-16: save it as UTF-8",
        _ => "it begins like no known format",
    }
}

/// Why a file could not be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The file is empty.
    #[error("the file is empty: export the scan again")]
    Empty,
    /// Not one of the formats.
    #[error("not a supported mesh format ({found}): export it as OBJ, PLY, STL or OFF")]
    Unknown {
        /// What it seems to be.
        found: String,
    },
    /// The file violates its format, or is cut off.
    #[error("{format}, {place}: {reason}")]
    Malformed {
        /// The format.
        format: Format,
        /// Such as `line 12`, `byte 4096` or `face 7`.
        place: String,
        /// What was expected, and what was found.
        reason: String,
    },
    /// A variant of the format that is not supported.
    #[error("{format}: {what} is not supported: export it as plain text or binary triangles")]
    Unsupported {
        /// The format.
        format: Format,
        /// The variant.
        what: String,
    },
    /// Too many vertices or faces.
    #[error("{found} {what}, the limit is {limit}: decimate the mesh in the scanner's software")]
    TooLarge {
        /// What exceeds the limit, such as `faces`.
        what: &'static str,
        /// Number found, a lower bound if reading stopped early.
        found: usize,
        /// The limit.
        limit: usize,
    },
    /// Vertices without faces.
    #[error("{format}: {vertices} vertices and no face: export a mesh, not a point cloud")]
    NoSurface {
        /// The format.
        format: Format,
        /// Number of vertices.
        vertices: usize,
    },
    /// Too many coordinates are not numbers.
    #[error(
        "{found} of {vertices} vertices have no finite position (NaN, infinite, or beyond 1e9): export the scan again"
    )]
    NotFinite {
        /// Number of such vertices.
        found: usize,
        /// Number of all vertices.
        vertices: usize,
    },
}

/// Largest coordinate in any unit; squares of distances cannot overflow within it.
const COORDINATE_MAX: f64 = 1e9;
/// Maximum number of corners of a face: those of the largest mesh.
const CORNERS_MAX: usize = FACES_MAX + 2;
/// Largest fraction of vertices that are not numbers; scanners leave single ones, a damaged file many.
const NOT_FINITE_SHARE_MAX: f64 = 0.01;

/// Adds a corner to a face, within the limit.
fn put_corner(corners: &mut Vec<u32>, index: u32) -> Result<(), ReadError> {
    if corners.len() >= CORNERS_MAX {
        let found = corners.len() + 1;
        return Err(ReadError::TooLarge { what: "corners of a face", found, limit: CORNERS_MAX });
    }
    corners.push(index);
    Ok(())
}

/// A mesh under construction.
#[derive(Debug)]
struct Surface {
    format: Format,
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Triangulated once all vertices are known.
    polygons: Polygons,
    /// Number of triangles, polygons included.
    n_faces: usize,
    /// Unit from a comment.
    unit: Option<Unit>,
    notes: Vec<Note>,
}

/// Faces with more than three corners.
#[derive(Debug, Default)]
struct Polygons {
    /// Corners of all polygons in sequence.
    corners: Vec<u32>,
    /// Number of corners of each.
    sizes: Vec<u32>,
}

impl Surface {
    fn new(format: Format) -> Self {
        Self {
            format,
            positions: Vec::new(),
            triangles: Vec::new(),
            polygons: Polygons::default(),
            n_faces: 0,
            unit: None,
            notes: Vec::new(),
        }
    }

    fn n_vertices(&self) -> usize {
        self.positions.len()
    }

    fn vertex(&mut self, position: [f64; 3]) -> Result<(), ReadError> {
        if self.positions.len() >= VERTICES_MAX {
            let found = VERTICES_MAX + 1;
            return Err(ReadError::TooLarge { what: "vertices", found, limit: VERTICES_MAX });
        }
        self.positions.push(position);
        Ok(())
    }

    /// Adds a face; its vertices may follow later. Faces of fewer than three corners are ignored.
    fn face(&mut self, corners: &[u32]) -> Result<(), ReadError> {
        self.n_faces += corners.len().saturating_sub(2);
        if self.n_faces > FACES_MAX {
            let found = self.n_faces;
            return Err(ReadError::TooLarge { what: "faces", found, limit: FACES_MAX });
        }
        match *corners {
            [] | [_] | [_, _] => {}
            [a, b, c] => self.triangles.push([a, b, c]),
            _ => {
                self.polygons.corners.extend_from_slice(corners);
                self.polygons.sizes.push(corners.len() as u32);
            }
        }
        Ok(())
    }

    /// Checks that every index is valid and every position finite, and triangulates polygons.
    fn finish(mut self) -> Result<Scan, ReadError> {
        let n = self.positions.len();
        let corners = self.triangles.as_flattened().iter().chain(&self.polygons.corners);
        if let Some(index) = corners.copied().find(|&index| index as usize >= n) {
            let reason = format!(
                "uses vertex {} of {n}: cut off or damaged, export the scan again",
                u64::from(index) + 1
            );
            return Err(self.format.malformed("a face", reason));
        }
        self.cut_polygons();
        if self.triangles.is_empty() {
            return Err(ReadError::NoSurface { format: self.format, vertices: n });
        }
        self.drop_not_finite()?;
        let Self { format, positions, triangles, unit, notes, .. } = self;
        Ok(Scan { mesh: Mesh { positions, triangles }, format, unit, notes })
    }

    fn cut_polygons(&mut self) {
        let Polygons { corners, sizes } = std::mem::take(&mut self.polygons);
        let mut rest = &corners[..];
        let positions = &self.positions;
        for &size in &sizes {
            let (polygon, after) = rest.split_at((size as usize).min(rest.len()));
            triangulate(polygon, |corner| positions[corner as usize].into(), &mut self.triangles);
            rest = after;
        }
        if !sizes.is_empty() {
            let text = format!("triangulated faces with more than three corners: {}", sizes.len());
            self.notes.push(Note::new("polygons", text));
        }
        let large = sizes.iter().filter(|&&size| size as usize > EARS_MAX).count();
        if large > 0 {
            let text =
                format!("faces with more than {EARS_MAX} corners, triangulated as fans: {large}");
            self.notes.push(Note::new("fans", text));
        }
    }

    /// Removes vertices without a finite position and their faces; the holes can be closed later.
    fn drop_not_finite(&mut self) -> Result<(), ReadError> {
        let usable = |p: &[f64; 3]| p.iter().all(|c| c.abs() <= COORDINATE_MAX);
        let vertices = self.positions.len();
        let found = self.positions.iter().filter(|p| !usable(p)).count();
        if found == 0 {
            return Ok(());
        }
        if found as f64 > NOT_FINITE_SHARE_MAX * vertices as f64 {
            return Err(ReadError::NotFinite { found, vertices });
        }
        let mut kept = 0;
        let moved = self.positions.iter().map(|p| {
            let index = usable(p).then_some(kept);
            kept += u32::from(index.is_some());
            index
        });
        let moved: Vec<Option<u32>> = moved.collect();
        let of = |corner: u32| moved.get(corner as usize).copied().flatten();
        let before = self.triangles.len();
        self.triangles =
            self.triangles.iter().filter_map(|&[a, b, c]| Some([of(a)?, of(b)?, of(c)?])).collect();
        self.positions.retain(usable);
        let faces = before - self.triangles.len();
        let text =
            format!("left out {found} vertices without a finite position and their {faces} faces");
        self.notes.push(Note::new("not-finite", text));
        if self.triangles.is_empty() {
            return Err(ReadError::NotFinite { found, vertices });
        }
        Ok(())
    }
}

/// Maximum number of corners of a polygon that is cut by ears, which takes quadratic time or more; larger ones are cut
/// as fans.
const EARS_MAX: usize = 64;

/// Triangulates a polygon of three or more corners, keeping its orientation. `at` gives the position of a corner.
///
/// A polygon with a notch must be cut from its ears, and a quad that is not planar is best cut where its halves bend
/// least. So the ear whose triangle agrees most with the polygon's normal goes first.
fn triangulate(corners: &[u32], at: impl Fn(u32) -> Point, out: &mut Vec<[u32; 3]>) {
    let mut left = corners.to_vec();
    while left.len() > 3 && corners.len() <= EARS_MAX {
        let positions: Vec<Point> = left.iter().map(|&corner| at(corner)).collect();
        let normal = unit(area_vector(&positions));
        let n = left.len();
        let mut best = (0, f64::NEG_INFINITY);
        for i in 0..n {
            let value = ear(&positions, i, normal);
            if value > best.1 {
                best = (i, value);
            }
        }
        let i = best.0;
        out.push([left[(i + n - 1) % n], left[i], left[(i + 1) % n]]);
        left.remove(i);
    }
    if let [first, rest @ ..] = &left[..] {
        out.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    }
}

/// Quality of an ear: the minimum agreement with the polygon's normal of its triangle and of the two triangles
/// that remain next to it; the worst value if another corner lies within.
fn ear(positions: &[Point], i: usize, normal: Point) -> f64 {
    let n = positions.len();
    let at = |k: usize| positions[(i + n + k) % n];
    let (before, corner, after) = (at(n - 1), at(0), at(1));
    let facing = |a: Point, b: Point, c: Point| unit(mesh::normal([a, b, c])).dot(&normal);
    let own = facing(before, corner, after);
    let inside = |p: Point| {
        [(before, corner), (corner, after), (after, before)]
            .iter()
            .all(|&(a, b)| mesh::normal([a, b, p]).dot(&normal) > 0.0)
    };
    if own <= 0.0 || (2..n - 1).any(|k| inside(at(k))) {
        return -2.0 + own;
    }
    own.min(facing(before, after, at(2))).min(facing(at(n - 2), before, after)).max(-0.99)
}

/// The vector area, doubled.
fn area_vector(positions: &[Point]) -> Point {
    let Some(&origin) = positions.first() else { return Point::zeros() };
    positions.windows(2).map(|pair| mesh::normal([origin, pair[0], pair[1]])).sum()
}
