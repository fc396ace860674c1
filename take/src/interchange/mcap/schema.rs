//! The messages of Foxglove that are written, as its published schemas have them (`foxglove-sdk`,
//! `schemas/proto`), and as an MCAP file carries them: a `FileDescriptorSet`, complete with what they use.

use std::collections::BTreeSet;

use super::messages::Message;

/// A field: its name, number, and type.
type Field = (&'static str, u32, Type);

/// What a field is of; `descriptor.proto` has the numbers.
#[derive(Clone, Copy)]
enum Type {
    Double,
    Fixed32,
    Bool,
    Text,
    Bytes,
    Int64,
    Int32,
    /// Of a message, by its full name.
    One(&'static str),
    /// Any number of them.
    Many(&'static str),
    /// The type of a packed number.
    Number,
}

use Type::{Bool, Bytes, Double, Fixed32, Int32, Int64, Many, Number, One, Text};

const TIMESTAMP: Type = One("google.protobuf.Timestamp");
const DURATION: Type = One("google.protobuf.Duration");

/// A message by its full name, with its fields; it stands in a file of its own.
type Declared = (&'static str, &'static [Field]);

/// In an order in which each stands behind those that it uses.
const MESSAGES: &[Declared] = &[
    ("google.protobuf.Timestamp", &[("seconds", 1, Int64), ("nanos", 2, Int32)]),
    ("google.protobuf.Duration", &[("seconds", 1, Int64), ("nanos", 2, Int32)]),
    ("foxglove.Vector3", &[("x", 1, Double), ("y", 2, Double), ("z", 3, Double)]),
    (
        "foxglove.Quaternion",
        &[("x", 1, Double), ("y", 2, Double), ("z", 3, Double), ("w", 4, Double)],
    ),
    ("foxglove.Color", &[("r", 1, Double), ("g", 2, Double), ("b", 3, Double), ("a", 4, Double)]),
    (
        "foxglove.Pose",
        &[("position", 1, One("foxglove.Vector3")), ("orientation", 2, One("foxglove.Quaternion"))],
    ),
    (
        "foxglove.PackedElementField",
        &[("name", 1, Text), ("offset", 2, Fixed32), ("type", 3, Number)],
    ),
    (
        "foxglove.TextPrimitive",
        &[
            ("pose", 1, One("foxglove.Pose")),
            ("billboard", 2, Bool),
            ("font_size", 3, Double),
            ("scale_invariant", 4, Bool),
            ("color", 5, One("foxglove.Color")),
            ("text", 6, Text),
        ],
    ),
    // Of the primitives, those that are written.
    (
        "foxglove.SceneEntity",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Text),
            ("id", 3, Text),
            ("lifetime", 4, DURATION),
            ("frame_locked", 5, Bool),
            ("texts", 13, Many("foxglove.TextPrimitive")),
        ],
    ),
    ("foxglove.SceneUpdate", &[("entities", 2, Many("foxglove.SceneEntity"))]),
    (
        "foxglove.FrameTransform",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("parent_frame_id", 2, Text),
            ("child_frame_id", 3, Text),
            ("translation", 4, One("foxglove.Vector3")),
            ("rotation", 5, One("foxglove.Quaternion")),
        ],
    ),
    (
        "foxglove.PointCloud",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Text),
            ("pose", 3, One("foxglove.Pose")),
            ("point_stride", 4, Fixed32),
            ("fields", 5, Many("foxglove.PackedElementField")),
            ("data", 6, Bytes),
        ],
    ),
];

/// Of [`PackedElementField`](MESSAGES); a place is the number.
const NUMERIC_TYPES: [&str; 9] =
    ["UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"];

/// The `FileDescriptorSet` of a message and all that it uses.
pub(super) fn descriptor_set(name: &'static str) -> Vec<u8> {
    let mut wanted = BTreeSet::from([name]);
    let mut files = Vec::new();
    for message in MESSAGES.iter().rev() {
        if wanted.contains(message.0) {
            wanted.extend(used(message));
            files.push(file_descriptor(message));
        }
    }
    files.iter().rev().fold(Message::default(), |set, file| set.message(1, file)).0
}

/// The messages that fields of one are of.
fn used((_, fields): &Declared) -> impl Iterator<Item = &'static str> {
    fields.iter().filter_map(|(.., of)| match of {
        One(message) | Many(message) => Some(*message),
        _ => None,
    })
}

/// The file that a message stands in.
fn path(full_name: &str) -> String {
    match full_name.strip_prefix("google.protobuf.") {
        Some(name) => format!("google/protobuf/{}.proto", name.to_lowercase()),
        None => format!("{}.proto", full_name.replace('.', "/")),
    }
}

fn file_descriptor(declared: &Declared) -> Message {
    let (full_name, fields) = declared;
    let (package, name) = full_name.rsplit_once('.').unwrap_or(("", full_name));
    let uses: BTreeSet<String> = used(declared).map(path).collect();
    let file = Message::default().text(1, &path(full_name)).text(2, package);
    let file = uses.iter().fold(file, |file, path| file.text(3, path));
    let mut message = Message::default().text(1, name);
    for field in *fields {
        message = message.message(2, &field_descriptor(field));
    }
    if fields.iter().any(|(.., of)| matches!(of, Number)) {
        let mut numbers = Message::default().text(1, "NumericType");
        for (number, name) in (0..).zip(NUMERIC_TYPES) {
            numbers = numbers.message(2, &Message::default().text(1, name).int(2, number));
        }
        message = message.message(4, &numbers);
    }
    file.message(4, &message).text(12, "proto3")
}

fn field_descriptor(&(name, number, of): &Field) -> Message {
    const OPTIONAL: u64 = 1;
    const REPEATED: u64 = 3;
    let (label, kind, type_name) = match of {
        Double => (OPTIONAL, 1, None),
        Int64 => (OPTIONAL, 3, None),
        Int32 => (OPTIONAL, 5, None),
        Fixed32 => (OPTIONAL, 7, None),
        Bool => (OPTIONAL, 8, None),
        Text => (OPTIONAL, 9, None),
        One(message) => (OPTIONAL, 11, Some(message)),
        Many(message) => (REPEATED, 11, Some(message)),
        Bytes => (OPTIONAL, 12, None),
        Number => (OPTIONAL, 14, Some("foxglove.PackedElementField.NumericType")),
    };
    let field = Message::default().text(1, name).int(3, number.into()).int(4, label).int(5, kind);
    match type_name {
        Some(type_name) => field.text(6, &format!(".{type_name}")),
        None => field,
    }
}
