//! The subject of a capture: joint centres out of a body scan ([`body`]), and a wireframe fitted to a photograph of the
//! face ([`face`]).
//!
//! Both are made before a capture, once a subject, and know nothing of takes: a take carries what they give as plain
//! data. Nothing here is trained on people: what was learned is a handful of ratios, beside the script that learned them.

pub mod body;
pub mod face;
