//! Small meshes in every format, and skeletons.

use mocapd_body::{
    Joints, Mesh, Repaired, Unit,
    skeleton::{Method, ScanJoints, Skeleton, Source},
};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

/// An octahedron, small enough for a fuzzer to change much with few bytes, also with a hole, a duplicate vertex and
/// a stray triangle; and a small body.
fn meshes() -> Vec<Mesh> {
    let tip = |axis: usize, sign: f64| std::array::from_fn(|k| if k == axis { sign } else { 0.0 });
    let positions: Vec<[f64; 3]> = (0..6).map(|i| tip(i / 2, [0.9, -0.9][i % 2])).collect();
    let triangles = vec![
        [0, 2, 4],
        [2, 1, 4],
        [1, 3, 4],
        [3, 0, 4],
        [2, 0, 5],
        [1, 2, 5],
        [3, 1, 5],
        [0, 3, 5],
    ];
    let whole = Mesh { positions, triangles };
    let mut hole = whole.clone();
    hole.triangles.pop();
    let mut double = whole.clone();
    double.positions.push(whole.positions[0]);
    double.triangles[3] = [3, 6, 4];
    let mut stray = whole.clone();
    stray.triangles.push([0, 2, 3]);
    let figure = body(1, Pose::A, BodyOptions { n_faces: 500, turned: false }).0;
    vec![whole, hole, double, stray, figure]
}

/// The meshes in every format, each after the byte that selects it.
pub(crate) fn files() -> Vec<Vec<u8>> {
    meshes()
        .iter()
        .flat_map(|mesh| {
            [
                obj(mesh),
                off(mesh),
                stl(mesh),
                text_stl(mesh),
                ply(mesh, false),
                ply(mesh, true),
                text_ply(mesh),
            ]
        })
        .collect()
}

fn obj(mesh: &Mesh) -> Vec<u8> {
    let mut text = "\0# units: m\n".to_owned();
    mesh.positions.iter().for_each(|[x, y, z]| text += &format!("v {x} {y} {z}\n"));
    let faces = mesh.triangles.iter().map(|t| t.map(|corner| corner + 1));
    faces.for_each(|[a, b, c]| text += &format!("f {a} {b}/1 {c}//2\n"));
    text.into_bytes()
}

fn off(mesh: &Mesh) -> Vec<u8> {
    let mut text = format!("\u{3}OFF\n{} {} 0\n", mesh.positions.len(), mesh.triangles.len());
    mesh.positions.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
    mesh.triangles.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
    text.into_bytes()
}

fn corners(mesh: &Mesh) -> impl Iterator<Item = [[f64; 3]; 3]> {
    mesh.triangles.iter().map(|t| t.map(|corner| mesh.positions[corner as usize]))
}

fn stl(mesh: &Mesh) -> Vec<u8> {
    let mut bytes = vec![2];
    bytes.extend([b' '; 80]);
    bytes.extend((mesh.triangles.len() as u32).to_le_bytes());
    for triangle in corners(mesh) {
        bytes.extend([0; 12]);
        triangle.as_flattened().iter().for_each(|&c| bytes.extend((c as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn text_stl(mesh: &Mesh) -> Vec<u8> {
    let mut text = "\u{2}solid a\n".to_owned();
    for triangle in corners(mesh) {
        text += "facet normal 0 0 0\nouter loop\n";
        triangle.iter().for_each(|[x, y, z]| text += &format!("vertex {x} {y} {z}\n"));
        text += "endloop\nendfacet\n";
    }
    (text + "endsolid\n").into_bytes()
}

fn ply_header(mesh: &Mesh, encoding: &str) -> String {
    let (v, f) = (mesh.positions.len(), mesh.triangles.len());
    format!(
        "\u{1}ply\nformat {encoding} 1.0\nelement vertex {v}\nproperty float x\nproperty float y\nproperty double z\n\
         element face {f}\nproperty list uchar ushort vertex_indices\nend_header\n"
    )
}

fn ply(mesh: &Mesh, big: bool) -> Vec<u8> {
    let encoding = if big { "binary_big_endian" } else { "binary_little_endian" };
    let mut bytes = ply_header(mesh, encoding).into_bytes();
    let mut put = |value: &[u8]| {
        let mut value = value.to_vec();
        if big {
            value.reverse();
        }
        bytes.extend(value);
    };
    for &[x, y, z] in &mesh.positions {
        put(&(x as f32).to_le_bytes());
        put(&(y as f32).to_le_bytes());
        put(&z.to_le_bytes());
    }
    for triangle in &mesh.triangles {
        put(&[3]);
        triangle.iter().for_each(|&corner| put(&(corner as u16).to_le_bytes()));
    }
    bytes
}

fn text_ply(mesh: &Mesh) -> Vec<u8> {
    let mut text = ply_header(mesh, "ascii");
    mesh.positions.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
    mesh.triangles.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
    text.into_bytes()
}

/// Skeletons of one scan, of several, and without joints.
pub(crate) fn skeletons() -> Vec<Vec<u8>> {
    let repaired = Repaired {
        mesh: Mesh::default(),
        unit: Unit::Metre,
        unit_inferred: true,
        genus: 0,
        notes: Vec::new(),
    };
    let scan = |pose: Pose, joints: Joints| ScanJoints {
        source: Source::new(&format!("{pose:?}.obj"), b"", &repaired),
        joints,
        unit: Unit::Metre,
        notes: vec!["a note".to_owned()],
    };
    let options = BodyOptions { n_faces: 500, turned: true };
    let posed = |pose: &Pose| scan(*pose, body(1, *pose, options).1);
    let all: Vec<ScanJoints> = Pose::ALL.iter().map(posed).collect();
    let lists = [&all[..1], &all[..], &[scan(Pose::A, Joints::default())]];
    let skeleton = |scans| Skeleton::new(Method::Default, scans);
    lists.into_iter().filter_map(skeleton).map(|s| s.to_json().into_bytes()).collect()
}
