//! Tests on shapes whose centre lines and joints are known.

mod body;
mod lengths;
mod parts;
mod tube;
mod voxels;
