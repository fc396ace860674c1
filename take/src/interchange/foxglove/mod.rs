//! Foxglove's messages, with their schemas: what the export to MCAP writes and a live stream sends. Points, transforms,
//! samples and log entries; scenes of markers, labels, lines, faces and forces, each an entity of a `foxglove.SceneUpdate`
//! that replaces the one before it; and a minimal Protocol Buffers encoder (protobuf.dev, "Encoding").
//!
//! Positions are in metres in the frame `mocap`, whose parent `world` has its z axis up.

mod schema;

pub use self::schema::{descriptor_set, field_names, sampled_descriptor};
use super::text::unique_names;
use crate::{
    motion::{Position, UpAxis, is_gap},
    varint,
};

/// The frame of reference of the positions, and its parent, whose z points up.
const FRAME: &str = "mocap";
const ROOT: &str = "world";

/// Foxglove's schemas have metres.
const MM_PER_METRE: f64 = 1000.0;

/// Bytes of a point: x, y and z as float32, the column as uint16, two bytes of padding.
const STRIDE: usize = 16;

/// Values of `PackedElementField.NumericType`.
const UINT16: u64 = 3;
const FLOAT32: u64 = 7;

/// The level of a log entry: `foxglove.Log.Level`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    /// What happens as intended.
    Info,
    /// What a person should look at.
    Warning,
    /// What has failed.
    Error,
}

/// `google.protobuf.Timestamp`.
fn timestamp(time_ns: u64) -> Message {
    Message::default().int(1, time_ns / 1_000_000_000).int(2, time_ns % 1_000_000_000)
}

/// The start of a message with a time and a frame of reference in its first two fields.
fn stamped(time_ns: u64, frame: &str) -> Message {
    Message::default().message(1, &timestamp(time_ns)).text(2, frame)
}

/// A message of doubles in fields 1, 2, 3...: a vector, a quaternion or a colour.
fn doubles<const N: usize>(values: [f64; N]) -> Message {
    (1..).zip(values).fold(Message::default(), |out, (field, value)| out.double(field, value))
}

/// A pose of this orientation.
fn pose(at_m: [f64; 3], xyzw: [f64; 4]) -> Message {
    Message::default().message(1, &doubles(at_m)).message(2, &doubles(xyzw))
}

const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn metres(position: Position) -> [f64; 3] {
    position.map(|mm| f64::from(mm) / MM_PER_METRE)
}

fn metres_f64(position_mm: [f64; 3]) -> [f64; 3] {
    position_mm.map(|mm| mm / MM_PER_METRE)
}

/// Numbers of the fields of a sample's values, after that of its time. Protocol Buffers reserve 19000 to 19999.
fn value_fields() -> impl Iterator<Item = u32> {
    (2..19_000).chain(20_000..)
}

/// A sample of all channels of a table, for the schema of [`sampled_descriptor`].
#[must_use]
pub fn sampled(row: &[f32], time_ns: u64) -> Message {
    let message = Message::default().message(1, &timestamp(time_ns));
    value_fields().zip(row).fold(message, |message, (field, value)| message.float(field, *value))
}

/// The `foxglove.PointCloud` of the visible markers.
#[must_use]
pub fn cloud(row: &[Position], time_ns: u64) -> Message {
    let mut data = Vec::with_capacity(row.len() * STRIDE);
    for (column, position) in row.iter().enumerate().filter(|(_, position)| !is_gap(**position)) {
        for axis in metres(*position) {
            data.extend((axis as f32).to_le_bytes());
        }
        data.extend((column as u16).to_le_bytes());
        data.extend([0; 2]);
    }
    let header = stamped(time_ns, FRAME).message(3, &pose([0.0; 3], UPRIGHT));
    let header = header.fixed32(4, STRIDE as u32);
    [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("marker", 12, UINT16)]
        .map(|(name, offset, kind)| {
            Message::default().text(1, name).fixed32(2, offset).int(3, kind)
        })
        .iter()
        .fold(header, |cloud, field| cloud.message(5, field))
        .bytes(6, &data)
}

/// The `foxglove.FrameTransform` that rotates the take's up axis to z.
#[must_use]
pub fn up_transform(up: UpAxis, time_ns: u64) -> Message {
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = match up {
        UpAxis::Z | UpAxis::Unknown => UPRIGHT,
        // 90° about x takes y to z; -90° about y takes x to z.
        UpAxis::Y => [HALF, 0.0, 0.0, HALF],
        UpAxis::X => [0.0, -HALF, 0.0, HALF],
    };
    transform(time_ns, [ROOT, FRAME], [0.0; 3], rotation)
}

fn transform(
    time_ns: u64,
    [parent, child]: [&str; 2],
    translation_m: [f64; 3],
    xyzw: [f64; 4],
) -> Message {
    let transform = stamped(time_ns, parent).text(3, child);
    transform.message(4, &doubles(translation_m)).message(5, &doubles(xyzw))
}

/// A rigid body in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedBody<'a> {
    /// Its name, which is that of its frame of reference.
    pub name: &'a str,
    /// The position of its origin in millimetres.
    pub position_mm: [f32; 3],
    /// The rotation from its axes: w, x, y, z.
    pub quaternion: [f32; 4],
}

/// The `foxglove.FrameTransforms` of a frame: that of [`up_transform`] if an axis is given, and one for each rigid body, whose
/// rotation gets a length of 1.
#[must_use]
pub fn transforms(up: Option<UpAxis>, bodies: &[PlacedBody<'_>], time_ns: u64) -> Message {
    let up = up.map(|up| up_transform(up, time_ns));
    let all = up.iter().fold(Message::default(), |all, up| all.message(1, up));
    bodies.iter().fold(all, |all, body| {
        let [w, x, y, z] = body.quaternion.map(f64::from);
        let length = (w * w + x * x + y * y + z * z).sqrt();
        let [w, x, y, z] = [w, x, y, z].map(|number| number / length);
        let at_m = metres(body.position_mm);
        all.message(1, &transform(time_ns, [FRAME, body.name], at_m, [x, y, z, w]))
    })
}

/// The names of the bodies' frames of reference: none is that of the positions or of the world.
#[must_use]
pub fn child_frames(names: Vec<String>) -> Vec<String> {
    let all = [FRAME, ROOT].map(str::to_owned).into_iter().chain(names);
    unique_names(all).into_iter().skip(2).collect()
}

/// A `foxglove.Log` entry.
#[must_use]
pub fn log(level: LogLevel, name: &str, text: &str, time_ns: u64) -> Message {
    let level = match level {
        LogLevel::Info => 2,
        LogLevel::Warning => 3,
        LogLevel::Error => 4,
    };
    Message::default().message(1, &timestamp(time_ns)).int(2, level).text(3, text).text(4, name)
}

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

/// An encoded message, built field by field.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Message(Vec<u8>);

impl Message {
    /// The encoded message.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Adds an integer, a bool or an enum value.
    fn int(mut self, field: u32, value: u64) -> Self {
        self.tag(field, 0);
        varint::put(&mut self.0, value);
        self
    }

    fn float(self, field: u32, value: f32) -> Self {
        self.fixed32(field, value.to_bits())
    }

    fn double(mut self, field: u32, value: f64) -> Self {
        self.tag(field, 1);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn fixed32(mut self, field: u32, value: u32) -> Self {
        self.tag(field, 5);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn bytes(mut self, field: u32, value: &[u8]) -> Self {
        self.tag(field, 2);
        varint::put(&mut self.0, value.len() as u64);
        self.0.extend_from_slice(value);
        self
    }

    fn text(self, field: u32, value: &str) -> Self {
        self.bytes(field, value.as_bytes())
    }

    fn message(self, field: u32, value: &Self) -> Self {
        self.bytes(field, &value.0)
    }

    fn tag(&mut self, field: u32, wire_type: u32) {
        varint::put(&mut self.0, u64::from(field << 3 | wire_type));
    }
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

    /// The examples of protobuf.dev, "Encoding".
    #[test]
    fn fields_are_encoded_as_specified() {
        let inner = Message::default().int(1, 150);
        assert_eq!(inner.0, [0x08, 0x96, 0x01]);
        let outer = Message::default().message(3, &inner).text(2, "testing");
        assert_eq!(outer.0[..5], [0x1a, 0x03, 0x08, 0x96, 0x01]);
        assert_eq!(outer.0[5..], [0x12, 7, b't', b'e', b's', b't', b'i', b'n', b'g']);
    }
}
