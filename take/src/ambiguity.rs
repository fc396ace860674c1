//! Ambiguities of imported files, and how they were resolved.

use std::fmt;

/// The layout of frames in the data section of a C3D file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameLayout {
    /// Points per frame.
    pub points: u64,
    /// Analog samples per frame, over all channels.
    pub analog_per_frame: u64,
    /// Byte offset of the first frame in the file.
    pub data_offset: u64,
    /// Whether samples are 16-bit integers (else floats).
    pub integers: bool,
}

/// An ambiguity of a file, and how it was resolved. Comparing the take with the file cannot reveal a wrong resolution,
/// because it resolves the ambiguity in the same way.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Ambiguity {
    /// No unit of length is stated, or an unknown one; coordinates were read as millimetres.
    Unit {
        /// The unit as written; empty if none is stated.
        stated: String,
        /// The extent of the markers, in the file's unit: the median over frames, or the path length of a single
        /// marker. 0 if it cannot be measured.
        span: f64,
    },
    /// The stated unit of length gives the markers an implausibly small or large extent.
    StatedUnit {
        /// The unit as written.
        stated: String,
        /// The larger of the markers' extent and their distance from the origin, in millimetres.
        span_mm: f64,
    },
    /// Places in the file disagree about the layout of a frame.
    FrameLayout {
        /// What they state.
        stated: String,
        /// The layout that was used.
        taken: FrameLayout,
    },
    /// Every fourth word says "missing" although coordinates exist; they were read as samples.
    FourthWords {
        /// Number of samples concerned.
        samples: u64,
    },
    /// Some fourth words say "missing" although coordinates exist; these are gaps.
    CoordinatesUnderGaps {
        /// Number of samples left out.
        samples: u64,
    },
    /// Samples lie exactly at the origin and are not marked as missing.
    Origin {
        /// Number of samples.
        samples: u64,
        /// Whether they were read as gaps (else as positions).
        gaps: bool,
    },
}

/// Markers with a larger extent, in an unknown unit, are in millimetres: 500 cm are more than a body with its reach,
/// and so are 500 inches or feet. Half a metre is also the smallest marker set larger than a head.
const SPAN_OF_MILLIMETRES: f64 = 500.0;
/// Markers that are all this close to each other and to the origin are not in the stated unit: metres labelled as
/// millimetres are within 10, and a volume for fingers is calibrated with a wand of 50 mm or more.
const STATED_TOO_SMALL_MM: f64 = 25.0;
/// Markers that are this far away are not in the stated unit either: the largest outdoor volumes are about 100 m.
const STATED_TOO_LARGE_MM: f64 = 1e6;
/// Largest tolerance as a fraction of the markers' extent: 1.8 mm for a body of 1.8 m.
const TOLERANCE_OF_SPAN: f64 = 1e-3;

impl Ambiguity {
    /// Whether the unit is doubtful: the extent of the markers is implausible in it.
    #[must_use]
    pub fn is_in_doubt(&self) -> bool {
        match self {
            Self::Unit { span, .. } => *span > 0.0 && *span < SPAN_OF_MILLIMETRES,
            Self::StatedUnit { span_mm, .. } => {
                *span_mm > STATED_TOO_LARGE_MM || (*span_mm > 0.0 && *span_mm < STATED_TOO_SMALL_MM)
            }
            _ => false,
        }
    }

    /// Whether encoding with this tolerance would destroy the samples if the unit were not millimetres.
    #[must_use]
    pub fn is_destroyed_by(&self, tolerance_mm: f64) -> bool {
        let (Self::Unit { span, .. } | Self::StatedUnit { span_mm: span, .. }) = self else {
            return false;
        };
        self.is_in_doubt() && tolerance_mm > TOLERANCE_OF_SPAN * span
    }

    /// The name in JSON documents.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Unit { .. } => "unit",
            Self::StatedUnit { .. } => "stated_unit",
            Self::FrameLayout { .. } => "frame_layout",
            Self::FourthWords { .. } => "fourth_words",
            Self::CoordinatesUnderGaps { .. } => "coordinates_under_gaps",
            Self::Origin { .. } => "origin",
        }
    }
}

impl fmt::Display for Ambiguity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unit { stated, span } => {
                match stated.as_str() {
                    "" => f.write_str("The file states no unit of length")?,
                    unit => write!(f, "The unit of length `{unit}` is unknown")?,
                }
                write!(
                    f,
                    "; positions were read as millimetres; the markers then span {span:.4} mm."
                )
            }
            Self::StatedUnit { stated, span_mm } => write!(
                f,
                "The stated unit of length, `{stated}`, places all markers within {span_mm:.4} mm, which is implausible; \
                 if the unit is another one, give it with --unit."
            ),
            Self::FrameLayout { stated, taken } => {
                let FrameLayout { points, analog_per_frame, data_offset, integers } = taken;
                let kind = if *integers { "integers" } else { "floats" };
                write!(
                    f,
                    "The file contradicts itself about the layout of frames ({stated}); {points} points and {analog_per_frame} \
                     analog samples, {kind} from byte {data_offset} on, fit its size and motion best and were read."
                )
            }
            Self::FourthWords { samples } => write!(
                f,
                "Every sample is marked as missing (negative fourth word), but {samples} have coordinates; those were read as \
                 samples."
            ),
            Self::CoordinatesUnderGaps { samples } => write!(
                f,
                "{} marked as missing (negative fourth word) in spite of coordinates; read as gaps, with the coordinates kept \
                 as c3d/gap-coordinates.",
                samples_are(*samples)
            ),
            Self::Origin { samples, gaps: true } => write!(
                f,
                "{} exactly at the origin while other markers move; read as missing.",
                samples_are(*samples)
            ),
            Self::Origin { samples, gaps: false } => write!(
                f,
                "{} exactly at the origin and not marked as missing; kept as positions.",
                samples_are(*samples)
            ),
        }
    }
}

fn samples_are(n: u64) -> String {
    if n == 1 { "1 sample is".to_owned() } else { format!("{n} samples are") }
}

/// Warnings that an importer collects.
#[derive(Debug, Default)]
pub(crate) struct Notes {
    /// One sentence each.
    pub(crate) warnings: Vec<String>,
    /// Ambiguities; each is also among the warnings.
    pub(crate) ambiguities: Vec<Ambiguity>,
}

impl Notes {
    /// Adds an ambiguity and its warning.
    pub(crate) fn ambiguous(&mut self, ambiguity: Ambiguity) {
        self.warnings.push(ambiguity.to_string());
        self.ambiguities.push(ambiguity);
    }
}
