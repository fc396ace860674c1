//! The Foxglove message types that the export uses, from the published schemas (`foxglove-sdk`, `schemas/proto`), and
//! their encoding as a `FileDescriptorSet` with all dependencies, which an MCAP file stores as the schema.

use std::collections::BTreeSet;

use super::messages::{Message, value_fields};

/// A field: name, number and type.
type Field = (&'static str, u32, FieldType);

/// The type of a field; [`field_descriptor`] has its number in `descriptor.proto`.
#[derive(Clone, Copy)]
enum FieldType {
    Double,
    Fixed32,
    Bool,
    Text,
    Bytes,
    Int64,
    Int32,
    /// A message, by its full name.
    Nested(&'static str),
    /// A repeated message, by its full name.
    Repeated(&'static str),
    /// The enum `PackedElementField.NumericType`.
    NumericType,
}

use FieldType::{Bool, Bytes, Double, Fixed32, Int32, Int64, Nested, NumericType, Repeated, Text};

const TIMESTAMP: FieldType = Nested("google.protobuf.Timestamp");
const DURATION: FieldType = Nested("google.protobuf.Duration");

/// A message type: full name and fields. Each has a proto file of its own.
type MessageType = (&'static str, &'static [Field]);

/// All message types, each after those that it uses.
const MESSAGES: &[MessageType] = &[
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
        &[
            ("position", 1, Nested("foxglove.Vector3")),
            ("orientation", 2, Nested("foxglove.Quaternion")),
        ],
    ),
    (
        "foxglove.PackedElementField",
        &[("name", 1, Text), ("offset", 2, Fixed32), ("type", 3, NumericType)],
    ),
    (
        "foxglove.TextPrimitive",
        &[
            ("pose", 1, Nested("foxglove.Pose")),
            ("billboard", 2, Bool),
            ("font_size", 3, Double),
            ("scale_invariant", 4, Bool),
            ("color", 5, Nested("foxglove.Color")),
            ("text", 6, Text),
        ],
    ),
    // Only the primitives that the export uses.
    (
        "foxglove.SceneEntity",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Text),
            ("id", 3, Text),
            ("lifetime", 4, DURATION),
            ("frame_locked", 5, Bool),
            ("texts", 13, Repeated("foxglove.TextPrimitive")),
        ],
    ),
    ("foxglove.SceneUpdate", &[("entities", 2, Repeated("foxglove.SceneEntity"))]),
    (
        "foxglove.FrameTransform",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("parent_frame_id", 2, Text),
            ("child_frame_id", 3, Text),
            ("translation", 4, Nested("foxglove.Vector3")),
            ("rotation", 5, Nested("foxglove.Quaternion")),
        ],
    ),
    ("foxglove.FrameTransforms", &[("transforms", 1, Repeated("foxglove.FrameTransform"))]),
    (
        "foxglove.PointCloud",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Text),
            ("pose", 3, Nested("foxglove.Pose")),
            ("point_stride", 4, Fixed32),
            ("fields", 5, Repeated("foxglove.PackedElementField")),
            ("data", 6, Bytes),
        ],
    ),
];

/// Names of the enum `PackedElementField.NumericType`; the index is the value.
const NUMERIC_TYPES: [&str; 9] =
    ["UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"];

/// The `FileDescriptorSet` of a message type and all types that it uses.
pub(super) fn descriptor_set(name: &'static str) -> Vec<u8> {
    let mut names = BTreeSet::from([name]);
    let mut files = Vec::new();
    for message in MESSAGES.iter().rev() {
        if names.contains(message.0) {
            names.extend(used(message));
            files.push(file_descriptor(message));
        }
    }
    files.iter().rev().fold(Message::default(), |set, file| set.message(1, file)).0
}

/// The `FileDescriptorSet` of the samples of a table: a time, and a float for each of these fields.
pub(super) fn sampled_descriptor(full_name: &str, fields: &[String]) -> Vec<u8> {
    const TIMESTAMP_TYPE: &str = "google.protobuf.Timestamp";
    let (package, name) = full_name.rsplit_once('.').unwrap_or(("", full_name));
    let field = field_descriptor(&("timestamp", 1, TIMESTAMP));
    let mut message = Message::default().text(1, name).message(2, &field);
    for (number, field) in value_fields().zip(fields) {
        // Optional, of the type float.
        let field = Message::default().text(1, field).int(3, number.into()).int(4, 1).int(5, 2);
        message = message.message(2, &field);
    }
    let file = Message::default()
        .text(1, &path(full_name))
        .text(2, package)
        .text(3, &path(TIMESTAMP_TYPE))
        .message(4, &message)
        .text(12, "proto3");
    [descriptor_set(TIMESTAMP_TYPE), Message::default().message(1, &file).0].concat()
}

/// The message types of a message's fields.
fn used((_, fields): &MessageType) -> impl Iterator<Item = &'static str> {
    fields.iter().filter_map(|(.., of)| match of {
        Nested(message) | Repeated(message) => Some(*message),
        _ => None,
    })
}

/// The path of the proto file of a message type.
fn path(full_name: &str) -> String {
    match full_name.strip_prefix("google.protobuf.") {
        Some(name) => format!("google/protobuf/{}.proto", name.to_lowercase()),
        None => format!("{}.proto", full_name.replace('.', "/")),
    }
}

fn file_descriptor(message_type: &MessageType) -> Message {
    let (full_name, fields) = message_type;
    let (package, name) = full_name.rsplit_once('.').unwrap_or(("", full_name));
    let uses: BTreeSet<String> = used(message_type).map(path).collect();
    let file = Message::default().text(1, &path(full_name)).text(2, package);
    let file = uses.iter().fold(file, |file, path| file.text(3, path));
    let mut message = Message::default().text(1, name);
    for field in *fields {
        message = message.message(2, &field_descriptor(field));
    }
    if fields.iter().any(|(.., of)| matches!(of, NumericType)) {
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
        Nested(message) => (OPTIONAL, 11, Some(message)),
        Repeated(message) => (REPEATED, 11, Some(message)),
        Bytes => (OPTIONAL, 12, None),
        NumericType => (OPTIONAL, 14, Some("foxglove.PackedElementField.NumericType")),
    };
    let field = Message::default().text(1, name).int(3, number.into()).int(4, label).int(5, kind);
    match type_name {
        Some(type_name) => field.text(6, &format!(".{type_name}")),
        None => field,
    }
}
