//! MCAP, written: messages of Foxglove's schemas, so that its viewer and others show a take as it is.
//!
//! A point cloud a frame, in metres, with the column of each point's marker; the markers' names beside it as a
//! scene; the way up as a transform at the start; and what a take says of itself as metadata.

mod messages;
mod proto;
mod schema;
mod write;

pub(crate) use self::write::write;
