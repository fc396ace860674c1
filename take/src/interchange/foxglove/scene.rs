//! Scenes: markers, labels, lines, faces and forces, each an entity of a `foxglove.SceneUpdate` that replaces the one before it.

use super::{
    messages::{FRAME, doubles, metres, metres_f64, pose, stamped},
    protobuf::Message,
};
use crate::motion::{Position, is_gap};

/// Font size of labels, in metres.
const LABEL_HEIGHT_M: f64 = 0.03;

/// Diameter of a sphere, in metres: the common markers of a body have 14 mm.
const SPHERE_M: f64 = 0.014;

/// Colours of labelled and of unlabelled markers, of lines, faces and forces.
const LABELLED: [f64; 4] = [0.35, 0.75, 1.0, 1.0];
const UNLABELLED: [f64; 4] = [0.65, 0.65, 0.65, 1.0];
const LINES: [f64; 4] = [0.8, 0.8, 0.8, 1.0];
const FACE: [f64; 4] = [1.0, 0.8, 0.6, 1.0];
const PLATES: [f64; 4] = [0.6, 0.6, 0.6, 1.0];
const FORCES: [f64; 4] = [1.0, 0.35, 0.3, 1.0];

/// Thickness of lines in pixels.
const THICKNESS_PX: f64 = 2.0;

/// Length of a force's arrow: a metre for a kilonewton, about the weight of a person.
const METRES_PER_N: f64 = 0.001;

/// The head of that arrow, in metres; the arrow of a small force is all head.
const HEAD_M: f64 = 0.06;

/// How long an entity is shown that is not replaced, so that nothing stands still as if it were seen when the device is gone.
const LIFETIME_S: u64 = 1;

/// Values of `LinePrimitive.Type`.
const LINE_LOOP: u64 = 1;
const LINE_LIST: u64 = 2;

/// Where the three coordinates of a sphere are in its encoding: behind the tags and lengths of the pose and its position, and
/// each behind a tag.
const COORDINATES_AT: [usize; 3] = [5, 14, 23];

/// A force plate and its load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceArrow {
    /// Its corners in millimetres.
    pub corners_mm: [[f64; 3]; 4],
    /// What the plate does to the subject, in N; not drawn if a component is NaN.
    pub force_n: [f64; 3],
    /// Where, in millimetres; NaN if the plate is not loaded.
    pub cop_mm: [f64; 3],
}

/// A scene of one entity; the one before it with this name is replaced.
fn scene(name: &str, time_ns: u64, fill: impl FnOnce(Message) -> Message) -> Message {
    let lifetime = Message::default().int(1, LIFETIME_S);
    let entity = fill(stamped(time_ns, FRAME).text(3, name).message(4, &lifetime));
    Message::default().message(2, &entity)
}

/// A rotation by nothing, in the fewest bytes.
fn upright() -> Message {
    Message::default().double(4, 1.0)
}

fn sphere(at_m: [f64; 3], colour: [f64; 4]) -> Message {
    let pose = Message::default().message(1, &doubles(at_m)).message(2, &upright());
    let size = doubles([SPHERE_M; 3]);
    Message::default().message(1, &pose).message(2, &size).message(3, &doubles(colour))
}

/// The visible markers as spheres, in the order of their columns. A column without a value in `is_labelled` is unlabelled.
#[must_use]
pub fn marker_scene(row: &[Position], is_labelled: &[bool], time_ns: u64) -> Message {
    // Two hundred markers at 1000 Hz are too many to build each from its parts.
    let mut spheres = [UNLABELLED, LABELLED].map(|colour| sphere([0.0; 3], colour));
    scene("markers", time_ns, |mut entity| {
        for (column, position) in row.iter().enumerate().filter(|(_, at)| !is_gap(**at)) {
            let labelled = is_labelled.get(column).is_some_and(|labelled| *labelled);
            let [other, ours] = &mut spheres;
            let sphere = if labelled { ours } else { other };
            for (at, value) in COORDINATES_AT.into_iter().zip(metres(*position)) {
                if let Some(bytes) = sphere.0.get_mut(at..at + 8) {
                    bytes.copy_from_slice(&value.to_le_bytes());
                }
            }
            entity = entity.message(9, sphere);
        }
        entity
    })
}

/// The labels at the visible markers. The metadata of the entity have the label of each column, also of hidden ones.
#[must_use]
pub fn label_scene(row: &[Position], labels: &[String], time_ns: u64) -> Message {
    scene("names", time_ns, |mut entity| {
        for (column, label) in labels.iter().enumerate() {
            let pair = Message::default().text(1, &column.to_string()).text(2, label);
            entity = entity.message(6, &pair);
        }
        for (position, label) in row.iter().zip(labels).filter(|(at, _)| !is_gap(**at)) {
            let pose = Message::default().message(1, &doubles(metres(*position)));
            let text = Message::default()
                .message(1, &pose.message(2, &upright()))
                .int(2, 1)
                .double(3, LABEL_HEIGHT_M)
                .message(5, &doubles([1.0; 4]))
                .text(6, label);
            entity = entity.message(13, &text);
        }
        entity
    })
}

fn lines(kind: u64, colour: [f64; 4], points_m: impl IntoIterator<Item = [f64; 3]>) -> Message {
    let lines = Message::default().int(1, kind);
    let lines = lines.message(2, &Message::default().message(2, &upright()));
    let lines = lines.double(3, THICKNESS_PX).int(4, 1);
    let lines = points_m.into_iter().fold(lines, |lines, at| lines.message(5, &doubles(at)));
    lines.message(6, &doubles(colour))
}

/// Lines between pairs of columns, where both markers are visible.
#[must_use]
pub fn line_scene(row: &[Position], pairs: &[[u16; 2]], time_ns: u64) -> Message {
    let ends = pairs.iter().filter_map(|pair| {
        let [a, b] = pair.map(|column| row.get(usize::from(column)).filter(|at| !is_gap(**at)));
        Some([metres(*a?), metres(*b?)])
    });
    scene("lines", time_ns, |entity| entity.message(11, &lines(LINE_LIST, LINES, ends.flatten())))
}

/// A wireframe: pairs of vertices in millimetres, in the frame of the markers; none if the face is not placed.
#[must_use]
pub fn face_scene(pairs_mm: impl IntoIterator<Item = [[f32; 3]; 2]>, time_ns: u64) -> Message {
    let ends = pairs_mm.into_iter().flat_map(|pair| pair.map(metres));
    scene("face", time_ns, |entity| entity.message(11, &lines(LINE_LIST, FACE, ends)))
}

/// Force plates: their outlines, and an arrow for the ground reaction of each that is loaded.
#[must_use]
pub fn force_scene(plates: &[ForceArrow], time_ns: u64) -> Message {
    scene("forces", time_ns, |mut entity| {
        for plate in plates {
            entity = arrow(plate).iter().fold(entity, |entity, arrow| entity.message(7, arrow));
        }
        for plate in plates {
            let outline = lines(LINE_LOOP, PLATES, plate.corners_mm.map(metres_f64));
            entity = entity.message(11, &outline);
        }
        entity
    })
}

fn arrow(plate: &ForceArrow) -> Option<Message> {
    let length_n = plate.force_n.iter().map(|value| value * value).sum::<f64>().sqrt();
    let is_finite = plate.force_n.iter().chain(&plate.cop_mm).all(|value| value.is_finite());
    if !is_finite || length_n == 0.0 {
        return None;
    }
    let length_m = length_n * METRES_PER_N;
    let head_m = HEAD_M.min(length_m);
    let rotation = from_x_to(plate.force_n.map(|value| value / length_n));
    let arrow = Message::default()
        .message(1, &pose(metres_f64(plate.cop_mm), rotation))
        .double(2, length_m - head_m)
        .double(3, HEAD_M / 4.0)
        .double(4, head_m)
        .double(5, HEAD_M / 2.0);
    Some(arrow.message(6, &doubles(FORCES)))
}

/// The rotation of the x axis, along which arrows point, to a unit vector: x, y, z, w.
fn from_x_to([x, y, z]: [f64; 3]) -> [f64; 4] {
    // Half of the angle between them, from 1 + cos and the cross product; opposite vectors turn about z.
    let norm = (2.0 * (1.0 + x)).sqrt();
    if norm < 1e-9 {
        return [0.0, 0.0, 1.0, 0.0];
    }
    [0.0, -z / norm, y / norm, norm / 2.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::GAP;

    #[test]
    fn spheres_are_those_that_are_built_from_their_parts() {
        let row = [[1.5, -2000.25, 3.0], GAP, [0.1, 0.2, 0.3]];
        let expected = scene("markers", 5, |entity| {
            let first = sphere(metres(row[0]), LABELLED);
            entity.message(9, &first).message(9, &sphere(metres(row[2]), UNLABELLED))
        });
        assert_eq!(marker_scene(&row, &[true], 5), expected);
    }

    #[test]
    fn metres_give_back_the_float_that_they_come_from() {
        let mut value = 1e-3_f32;
        while value < 1e5 {
            let [metres, ..] = metres([value; 3]);
            assert_eq!((metres * 1000.0) as f32, value);
            value *= 1.000_37;
        }
    }

    #[test]
    fn arrows_point_along_the_force() {
        for force in [[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 0.0, 800.0], [5.0, -7.0, 600.0]] {
            let length = f64::sqrt(force.iter().map(|v| v * v).sum());
            let unit = force.map(|v| v / length);
            let [x, y, z, w] = from_x_to(unit);
            // The x axis, rotated by the quaternion.
            let rotated =
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)];
            for (found, expected) in rotated.into_iter().zip(unit) {
                assert!((found - expected).abs() < 1e-12, "{rotated:?} {unit:?}");
            }
        }
    }
}
