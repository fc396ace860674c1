//! Valid files of every format, and damaged ones.

mod damaged;
mod good;

use super::{Format, ReadError, Scan, read};

/// A tetrahedron, so that its files are short.
pub(super) const CORNERS: [[f32; 3]; 4] =
    [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 1.25, 0.0], [0.0, 0.0, 1.75]];
pub(super) const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

pub(super) fn obj() -> Vec<u8> {
    let mut text = "# File units = meters\nmtllib a.mtl\no body\n".to_owned();
    CORNERS.iter().for_each(|[x, y, z]| text += &format!("v {x} {y} {z}\n"));
    text += "vt 0 0\nvn 0 0 1\ns off\n";
    FACES
        .iter()
        .for_each(|[a, b, c]| text += &format!("f {}/1 {}/1/1 {}//1\n", a + 1, b + 1, c + 1));
    text.into()
}

pub(super) fn off() -> Vec<u8> {
    let mut text = "OFF # a comment\n4 4 0\n\n".to_owned();
    CORNERS.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
    FACES.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c} 255 0 0\n"));
    text.into()
}

pub(super) fn stl_text() -> Vec<u8> {
    let mut text = "solid body\n".to_owned();
    for face in FACES {
        text += "facet normal 0 0 0\nouter loop\n";
        for [x, y, z] in face.map(|corner| CORNERS[corner as usize]) {
            text += &format!("vertex {x} {y:e} {z}\n");
        }
        text += "endloop\nendfacet\n";
    }
    (text + "endsolid body\n").into()
}

pub(super) fn stl_binary() -> Vec<u8> {
    // Begins like the text format: some programs write such titles.
    let mut bytes = [b"solid body".as_slice(), &[b' '; 70], &4_u32.to_le_bytes()].concat();
    for face in FACES {
        bytes.extend([0; 12]);
        for corner in face {
            CORNERS[corner as usize].iter().for_each(|c| bytes.extend(c.to_le_bytes()));
        }
        bytes.extend([0; 2]);
    }
    bytes
}

/// Vertices with a confidence between the coordinates, as float64 and float32; faces with flags before the corners, and
/// another list after them.
pub(super) fn ply(encoding: &str, line_end: &str) -> Vec<u8> {
    let header = [
        "ply",
        &format!("format {encoding} 1.0"),
        "comment units: mm",
        "element vertex 4",
        "property double x",
        "property uchar confidence",
        "property float y",
        "property float32 z",
        "element face 4",
        "property uint16 flags",
        "property list uchar int vertex_indices",
        "property list int8 double texcoord",
        "element nothing 7",
        "end_header",
    ];
    let mut bytes = header.map(|line| format!("{line}{line_end}")).concat().into_bytes();
    if encoding == "ascii" {
        for [x, y, z] in CORNERS {
            bytes.extend(format!("{x} 200 {y} {z}{line_end}").bytes());
        }
        for [a, b, c] in FACES {
            bytes.extend(format!("9 3 {a} {b} {c} 1 0.5{line_end}").bytes());
        }
        return bytes;
    }
    let mut put = |value: &[u8]| {
        let mut value = value.to_vec();
        if encoding == "binary_big_endian" {
            value.reverse();
        }
        bytes.extend(value);
    };
    for [x, y, z] in CORNERS {
        put(&f64::from(x).to_le_bytes());
        put(&[200]);
        put(&y.to_le_bytes());
        put(&z.to_le_bytes());
    }
    for face in FACES {
        put(&9_u16.to_le_bytes());
        put(&[3]);
        face.iter().for_each(|corner| put(&corner.to_le_bytes()));
        put(&[1]);
        put(&0.5_f64.to_le_bytes());
    }
    bytes
}

/// One file of each format.
pub(super) fn files() -> Vec<(&'static str, Format, Vec<u8>)> {
    vec![
        ("obj", Format::Obj, obj()),
        ("off", Format::Off, off()),
        ("stl, text", Format::Stl, stl_text()),
        ("stl, binary", Format::Stl, stl_binary()),
        ("ply, text", Format::Ply, ply("ascii", "\r\n")),
        ("ply, old text", Format::Ply, ply("ascii", "\r")),
        ("ply, little", Format::Ply, ply("binary_little_endian", "\n")),
        ("ply, big", Format::Ply, ply("binary_big_endian", "\r\n")),
    ]
}

pub(super) fn read_text(text: &str) -> Result<Scan, ReadError> {
    read(text.as_bytes(), "")
}
