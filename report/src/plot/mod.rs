//! Pictures of takes: SVG, and PNG out of it.
//!
//! Colours are those of Okabe and Ito ("Color universal design", 2008), which people tell apart who see no red or no
//! green; a shape or a dash always stands beside a colour.

mod canvas;
mod pose;
mod quality;
mod sizes;
mod study;
mod trajectory;

pub use self::{
    canvas::png,
    pose::{Pose, pose},
    quality::{MarkerQuality, Quality, quality},
    sizes::{SizeLine, SizePanel, sizes},
    study::by_phase,
    trajectory::{Trajectory, trajectory},
};
