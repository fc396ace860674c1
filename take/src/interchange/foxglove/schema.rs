//! The Foxglove message types that are used, from the published schemas (`foxglove-sdk`, `schemas/proto`), and their
//! encoding as a `FileDescriptorSet` with all dependencies, which MCAP files and live streams have as the schema.

use std::collections::{BTreeSet, HashSet};

use FieldType::{Bool, Bytes, Double, Enum, Fixed32, Int32, Int64, Nested, Repeated, Text};

use super::{Message, value_fields};

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
    /// An enum of the message itself.
    Enum(&'static EnumType),
}

/// An enum: its name in its message, that in other messages, and the names of its values from 0 on.
#[derive(Debug)]
struct EnumType {
    name: &'static str,
    full_name: &'static str,
    values: &'static [&'static str],
}

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
        &[("name", 1, Text), ("offset", 2, Fixed32), ("type", 3, Enum(&NUMERIC_TYPE))],
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
    (
        "foxglove.SpherePrimitive",
        &[
            ("pose", 1, Nested("foxglove.Pose")),
            ("size", 2, Nested("foxglove.Vector3")),
            ("color", 3, Nested("foxglove.Color")),
        ],
    ),
    ("foxglove.Point3", &[("x", 1, Double), ("y", 2, Double), ("z", 3, Double)]),
    (
        "foxglove.LinePrimitive",
        &[
            ("type", 1, Enum(&LINE_TYPE)),
            ("pose", 2, Nested("foxglove.Pose")),
            ("thickness", 3, Double),
            ("scale_invariant", 4, Bool),
            ("points", 5, Repeated("foxglove.Point3")),
            ("color", 6, Nested("foxglove.Color")),
        ],
    ),
    (
        "foxglove.ArrowPrimitive",
        &[
            ("pose", 1, Nested("foxglove.Pose")),
            ("shaft_length", 2, Double),
            ("shaft_diameter", 3, Double),
            ("head_length", 4, Double),
            ("head_diameter", 5, Double),
            ("color", 6, Nested("foxglove.Color")),
        ],
    ),
    ("foxglove.KeyValuePair", &[("key", 1, Text), ("value", 2, Text)]),
    // Only the primitives that are used.
    (
        "foxglove.SceneEntity",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Text),
            ("id", 3, Text),
            ("lifetime", 4, DURATION),
            ("frame_locked", 5, Bool),
            ("metadata", 6, Repeated("foxglove.KeyValuePair")),
            ("arrows", 7, Repeated("foxglove.ArrowPrimitive")),
            ("spheres", 9, Repeated("foxglove.SpherePrimitive")),
            ("lines", 11, Repeated("foxglove.LinePrimitive")),
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
        "foxglove.Log",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("level", 2, Enum(&LOG_LEVEL)),
            ("message", 3, Text),
            ("name", 4, Text),
        ],
    ),
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

const NUMERIC_TYPE: EnumType = EnumType {
    name: "NumericType",
    full_name: "foxglove.PackedElementField.NumericType",
    values: &[
        "UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64",
    ],
};

const LINE_TYPE: EnumType = EnumType {
    name: "Type",
    full_name: "foxglove.LinePrimitive.Type",
    values: &["LINE_STRIP", "LINE_LOOP", "LINE_LIST"],
};

const LOG_LEVEL: EnumType = EnumType {
    name: "Level",
    full_name: "foxglove.Log.Level",
    values: &["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"],
};

/// The `FileDescriptorSet` of a message type and all types that it uses.
#[must_use]
pub fn descriptor_set(name: &'static str) -> Vec<u8> {
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
#[must_use]
pub fn sampled_descriptor(full_name: &str, fields: &[String]) -> Vec<u8> {
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
    for (.., of) in *fields {
        if let Enum(of) = of {
            let mut numbers = Message::default().text(1, of.name);
            for (number, name) in (0..).zip(of.values) {
                numbers = numbers.message(2, &Message::default().text(1, name).int(2, number));
            }
            message = message.message(4, &numbers);
        }
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
        Enum(of) => (OPTIONAL, 14, Some(of.full_name)),
    };
    let field = Message::default().text(1, name).int(3, number.into()).int(4, label).int(5, kind);
    match type_name {
        Some(type_name) => field.text(6, &format!(".{type_name}")),
        None => field,
    }
}

/// Names for the Protocol Buffers fields of columns with these names: ASCII letters, digits and underscores, which also differ in
/// their JSON form, without underscores and case.
#[must_use]
pub fn field_names(names: &[&str]) -> Vec<String> {
    let key = |name: &str| name.replace('_', "").to_ascii_lowercase();
    let mut taken = HashSet::from([key("timestamp")]);
    let unique = |name: &str| {
        let letter = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        let mut name: String = name.chars().map(letter).collect();
        if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
            name.insert_str(0, "channel_");
        }
        let (given, mut number) = (name.clone(), 2);
        while !taken.insert(key(&name)) {
            name = format!("{given}_{number}");
            number += 1;
        }
        name
    };
    names.iter().copied().map(unique).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn field_names_are_unique_identifiers() {
        let names = ["Fz1", "fz_1", "EMG left", "1", "", "\u{e9}", "timestamp", "fz_1_2", "a.x"];
        let expected = [
            "Fz1",
            "fz_1_2",
            "EMG_left",
            "channel_1",
            "channel_",
            "channel___2",
            "timestamp_2",
            "fz_1_2_2",
            "a_x",
        ];
        assert_eq!(field_names(&names), expected);
    }
}
