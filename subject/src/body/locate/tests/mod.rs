//! Tests on shapes whose centre lines and joints are known.

mod body;
mod parts;
mod tube;
mod voxels;
