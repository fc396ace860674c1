//! The messages of Foxglove that are written, as its published schemas have them (`foxglove-sdk`,
//! `schemas/proto`), and as an MCAP file carries them: a `FileDescriptorSet`, complete with what they use.

use super::proto::Message;

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

struct File {
    /// Package and path are `foxglove` or `google.protobuf`.
    package: &'static str,
    name: &'static str,
    /// Files that it uses.
    uses: &'static [&'static str],
    fields: &'static [Field],
}

use Type::{Bool, Bytes, Double, Fixed32, Int32, Int64, Many, Number, One, Text};

const TIMESTAMP: Type = One(".google.protobuf.Timestamp");
const DURATION: Type = One(".google.protobuf.Duration");

/// In an order in which each stands behind those that it uses.
const FILES: &[File] = &[
    File {
        package: "google.protobuf",
        name: "Timestamp",
        uses: &[],
        fields: &[("seconds", 1, Int64), ("nanos", 2, Int32)],
    },
    File {
        package: "google.protobuf",
        name: "Duration",
        uses: &[],
        fields: &[("seconds", 1, Int64), ("nanos", 2, Int32)],
    },
    File {
        package: "foxglove",
        name: "Vector3",
        uses: &[],
        fields: &[("x", 1, Double), ("y", 2, Double), ("z", 3, Double)],
    },
    File {
        package: "foxglove",
        name: "Quaternion",
        uses: &[],
        fields: &[("x", 1, Double), ("y", 2, Double), ("z", 3, Double), ("w", 4, Double)],
    },
    File {
        package: "foxglove",
        name: "Color",
        uses: &[],
        fields: &[("r", 1, Double), ("g", 2, Double), ("b", 3, Double), ("a", 4, Double)],
    },
    File {
        package: "foxglove",
        name: "Pose",
        uses: &["foxglove/Quaternion.proto", "foxglove/Vector3.proto"],
        fields: &[
            ("position", 1, One(".foxglove.Vector3")),
            ("orientation", 2, One(".foxglove.Quaternion")),
        ],
    },
    File {
        package: "foxglove",
        name: "PackedElementField",
        uses: &[],
        fields: &[("name", 1, Text), ("offset", 2, Fixed32), ("type", 3, Number)],
    },
    File {
        package: "foxglove",
        name: "TextPrimitive",
        uses: &["foxglove/Color.proto", "foxglove/Pose.proto"],
        fields: &[
            ("pose", 1, One(".foxglove.Pose")),
            ("billboard", 2, Bool),
            ("font_size", 3, Double),
            ("scale_invariant", 4, Bool),
            ("color", 5, One(".foxglove.Color")),
            ("text", 6, Text),
        ],
    },
    File {
        package: "foxglove",
        name: "SceneEntity",
        uses: &[
            "foxglove/TextPrimitive.proto",
            "google/protobuf/duration.proto",
            "google/protobuf/timestamp.proto",
        ],
        // Of the primitives, those that are written.
        fields: &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Text),
            ("id", 3, Text),
            ("lifetime", 4, DURATION),
            ("frame_locked", 5, Bool),
            ("texts", 13, Many(".foxglove.TextPrimitive")),
        ],
    },
    File {
        package: "foxglove",
        name: "SceneUpdate",
        uses: &["foxglove/SceneEntity.proto"],
        fields: &[("entities", 2, Many(".foxglove.SceneEntity"))],
    },
    File {
        package: "foxglove",
        name: "FrameTransform",
        uses: &[
            "foxglove/Quaternion.proto",
            "foxglove/Vector3.proto",
            "google/protobuf/timestamp.proto",
        ],
        fields: &[
            ("timestamp", 1, TIMESTAMP),
            ("parent_frame_id", 2, Text),
            ("child_frame_id", 3, Text),
            ("translation", 4, One(".foxglove.Vector3")),
            ("rotation", 5, One(".foxglove.Quaternion")),
        ],
    },
    File {
        package: "foxglove",
        name: "PointCloud",
        uses: &[
            "foxglove/PackedElementField.proto",
            "foxglove/Pose.proto",
            "google/protobuf/timestamp.proto",
        ],
        fields: &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Text),
            ("pose", 3, One(".foxglove.Pose")),
            ("point_stride", 4, Fixed32),
            ("fields", 5, Many(".foxglove.PackedElementField")),
            ("data", 6, Bytes),
        ],
    },
];

/// Of [`PackedElementField`](FILES); a place is the number.
const NUMERIC_TYPES: [&str; 9] =
    ["UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"];

/// The `FileDescriptorSet` of a message and all that it uses.
pub(super) fn descriptor_set(name: &str) -> Vec<u8> {
    let mut wanted = vec![format!("foxglove/{name}.proto")];
    let mut files = Vec::new();
    for file in FILES.iter().rev() {
        if wanted.contains(&file.path()) {
            wanted.extend(file.uses.iter().map(|&path| path.to_owned()));
            files.push(file);
        }
    }
    let mut set = Message::default();
    files.iter().rev().for_each(|file| set.message(1, &file.descriptor()));
    set.0
}

impl File {
    fn path(&self) -> String {
        let folder = self.package.replace('.', "/");
        match self.package {
            "foxglove" => format!("{folder}/{}.proto", self.name),
            _ => format!("{folder}/{}.proto", self.name.to_lowercase()),
        }
    }

    fn descriptor(&self) -> Message {
        let mut file = Message::default();
        file.text(1, &self.path());
        file.text(2, self.package);
        self.uses.iter().for_each(|path| file.text(3, path));
        let mut message = Message::default();
        message.text(1, self.name);
        self.fields.iter().for_each(|field| message.message(2, &descriptor(field)));
        if self.fields.iter().any(|(.., of)| matches!(of, Number)) {
            let mut numbers = Message::default();
            numbers.text(1, "NumericType");
            for (number, name) in (0..).zip(NUMERIC_TYPES) {
                let mut value = Message::default();
                value.text(1, name);
                value.int(2, number);
                numbers.message(2, &value);
            }
            message.message(4, &numbers);
        }
        file.message(4, &message);
        file.text(12, "proto3");
        file
    }
}

fn descriptor(&(name, number, of): &Field) -> Message {
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
        Number => (OPTIONAL, 14, Some(".foxglove.PackedElementField.NumericType")),
    };
    let mut field = Message::default();
    field.text(1, name);
    field.int(3, number.into());
    field.int(4, label);
    field.int(5, kind);
    if let Some(type_name) = type_name {
        field.text(6, type_name);
    }
    field
}
