//! Tests on shapes whose centre lines and joints are known.

mod body;
mod joints;
mod limb;
