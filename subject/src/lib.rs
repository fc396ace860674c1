//! The subject of a capture: joint centres out of a body scan ([`body`]), and a wireframe fitted to a photograph of the
//! face ([`face`]).
//!
//! Both are made before a capture, once a subject, and know nothing of takes: a take carries what they give as plain
//! data. There is no network in it. Joints rest on weights learned from two drawn bodies; faces are found by linear weights and
//! trees learned from a few photographs and many drawn heads. The scripts are in `benches/subject`.

pub mod body;
pub mod face;
