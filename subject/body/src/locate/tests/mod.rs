//! Tests on shapes whose centre lines and joints are known.

mod body;
mod girth;
mod lengths;
mod parts;
mod touching;
mod tube;
mod voxels;
