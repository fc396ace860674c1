//! What a simulated NDI system is told, and why it may refuse to be one.

use crate::device::DeviceError;

/// Tools that can be plugged in; the rest of the handles are for tools that a host loads.
pub const TOOLS_MAX: usize = 32;

/// Stray markers in one answer: `BX` counts them in a byte.
pub const STRAYS_MAX: usize = 255;

/// How the system plays its motion.
#[derive(Debug, Clone, PartialEq)]
pub struct NdiSettings {
    /// Serial number it gives.
    pub serial: String,
    /// Resample to this rate, Hz; `None` for the recorded one.
    pub rate_hz: Option<f64>,
    /// Times faster than it was recorded, 0.001 to 1000, to the nearest 0.001.
    pub speed: f64,
    /// Begin again after the last frame, and never end.
    pub looping: bool,
    /// Labels of the markers that are tools, plugged in in this order; all others are strays.
    pub tools: Vec<String>,
    /// Whether it knows `BX2`, as systems since the Vega do.
    pub bx2: bool,
    /// The highest speed that `COMM` may set, in baud.
    pub baud_max: u32,
}

impl Default for NdiSettings {
    fn default() -> Self {
        Self {
            serial: "SIM0001".to_owned(),
            rate_hz: None,
            speed: 1.0,
            looping: false,
            tools: Vec::new(),
            bx2: true,
            baud_max: 1_228_739,
        }
    }
}

/// Why a motion cannot be an NDI system.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NdiError {
    /// A tool that is not there.
    #[error("no marker is called '{label}': name one of {known}")]
    NoSuchTool {
        /// As it was given.
        label: String,
        /// What there is: the first labels, and how many more.
        known: String,
    },
    /// More than can be plugged in.
    #[error("{found} tools are more than the {TOOLS_MAX} that can be plugged in: name fewer")]
    TooManyTools {
        /// As given.
        found: usize,
    },
    /// More than an answer counts.
    #[error(
        "{found} stray markers are more than the {STRAYS_MAX} of an answer: choose a file with fewer"
    )]
    TooManyStrays {
        /// In the motion.
        found: usize,
    },
    /// The motion makes no device of any kind.
    #[error(transparent)]
    Device(#[from] DeviceError),
}
