//! The fuzz targets, one function each, so that seeds can be run without a fuzzer.
//!
//! They share the conversion of a fuzzer's bytes to motion, and the checks of the results.

mod blocks;
mod check;
mod config;
mod face;
mod file;
mod input;
mod link;
mod lsl;
mod mesh;
mod motion;
mod natnet;
mod qtm;
mod range;
mod samples;
pub mod seeds;
mod take;
mod trips;

pub use self::{
    blocks::decode_block, config::config, face::read_face, face::read_face_model,
    face::read_mapping, face::read_photo, file::read_file, input::Input, link::hear, lsl::read_lsl,
    mesh::read_mesh, mesh::read_skeleton, natnet::read_natnet, qtm::read_qtm, range::range_coder,
    samples::decode_samples, take::read_take, take::recover_take, trips::round_trip,
};
