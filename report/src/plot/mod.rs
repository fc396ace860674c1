//! Plots of takes, as SVG, and rendering to PNG.
//!
//! Colours are those of Okabe and Ito ("Color universal design", 2008), which colour-blind people can distinguish;
//! shapes or dashes always repeat what a colour means.

mod canvas;
mod pose;
mod quality;
mod sampled;
mod sizes;
mod study;
mod trace;
mod trajectory;

pub use self::{
    canvas::png,
    pose::{MOMENTS_MAX, PosePlot, pose},
    quality::{MarkerQuality, QualityPlot, quality},
    sampled::{AnalogPlot, CHANNELS_MAX, ForcesPlot, PLATES_MAX, analog, forces},
    sizes::{SizeLine, SizePanel, sizes},
    study::by_phase,
    trajectory::{TrajectoryPlot, trajectory},
};
