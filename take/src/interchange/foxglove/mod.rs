//! Foxglove's messages, with their schemas: what the export to MCAP writes and a live stream sends.
//!
//! Positions are in metres in the frame `mocap`, whose parent `world` has its z axis up.

mod messages;
mod protobuf;
mod scene;
mod schema;

pub use self::{
    messages::{LogLevel, PlacedBody, child_frames, cloud, log, sampled, transforms, up_transform},
    protobuf::Message,
    scene::{ForceArrow, face_scene, force_scene, label_scene, line_scene, marker_scene},
    schema::{descriptor_set, field_names, sampled_descriptor},
};
