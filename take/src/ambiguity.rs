//! Where a file can be read in more than one way, and which way was taken.

use std::fmt;

/// How the data of a C3D file are cut into frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameLayout {
    /// Points a frame.
    pub points: u64,
    /// Analog samples a frame, all channels together.
    pub analog_per_frame: u64,
    /// Where the first frame begins in the file.
    pub data_offset: u64,
    /// Whether samples are 16-bit integers (else floats).
    pub integers: bool,
}

/// Something that a file leaves open, and what was decided. A comparison with the file that repeats the decision cannot
/// find it wrong.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Ambiguity {
    /// No unit of length is stated, or one that is not known: coordinates were taken as millimetres.
    Unit {
        /// As it stands in the file; empty where none does.
        stated: String,
        /// What the markers span, in whatever unit that is: one frame's in the median, or the path of a single marker.
        /// 0 where nothing can be measured.
        span: f64,
    },
    /// The unit of length that the file states makes of its markers something too small or too large to be captured.
    StatedUnit {
        /// As it stands in the file.
        stated: String,
        /// What the markers span in it, and how far they are from the origin, whichever is more: in millimetres.
        span_mm: f64,
    },
    /// Places in the file disagree about what a frame holds.
    FrameLayout {
        /// What they state.
        stated: String,
        /// What was taken.
        taken: FrameLayout,
    },
    /// Every fourth word says "missing", and coordinates are there: they were taken as samples.
    FourthWords {
        /// Samples taken so.
        samples: u64,
    },
    /// Fourth words say "missing" of samples that have coordinates: they are gaps.
    CoordinatesUnderGaps {
        /// Samples left out so.
        samples: u64,
    },
    /// Samples stand exactly at the origin, and nothing says that they are missing.
    Origin {
        /// How many.
        samples: u64,
        /// Whether they were taken as gaps (else as positions).
        gaps: bool,
    },
}

/// Markers that span more than this in whatever unit are measured in millimetres: 500 cm are more than a body with all
/// its reach, and so are 500 inches or feet; half a metre is the smallest set of markers that is larger than a head.
const SPAN_OF_MILLIMETRES: f64 = 500.0;
/// Markers that are all so near to each other and to the origin are not in the unit that is stated: metres that are called
/// millimetres are within 10, and a volume for fingers is calibrated with a wand of 50 mm and more.
const STATED_TOO_SMALL_MM: f64 = 25.0;
/// Neither are those that are so far: the largest outdoor volumes are some 100 m.
const STATED_TOO_LARGE_MM: f64 = 1e6;
/// A tolerance may be such a part of what markers span: of a body of 1.8 m that is 1.8 mm.
const TOLERANCE_OF_SPAN: f64 = 1e-3;

impl Ambiguity {
    /// Whether it is a unit that may well not be millimetres: the markers span too little for that.
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

    /// Whether samples that are kept within a tolerance would be destroyed, were the unit not millimetres.
    #[must_use]
    pub fn is_destroyed_by(&self, tolerance_mm: f64) -> bool {
        let (Self::Unit { span, .. } | Self::StatedUnit { span_mm: span, .. }) = self else {
            return false;
        };
        self.is_in_doubt() && tolerance_mm > TOLERANCE_OF_SPAN * span
    }

    /// A name for programs.
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
                    "" => f.write_str("No unit of length is stated")?,
                    unit => write!(f, "The unit of length `{unit}` is not known")?,
                }
                write!(
                    f,
                    "; positions were read as millimetres, in which the markers span {span:.4} mm."
                )
            }
            Self::StatedUnit { stated, span_mm } => write!(
                f,
                "The unit of length is `{stated}`, in which all markers are within {span_mm:.4} mm: hardly what was captured; \
                 if it is another, give it with --unit."
            ),
            Self::FrameLayout { stated, taken } => {
                let FrameLayout { points, analog_per_frame, data_offset, integers } = taken;
                let kind = if *integers { "integers" } else { "floats" };
                write!(
                    f,
                    "Places disagree about what a frame holds ({stated}): read as {points} points and {analog_per_frame} analog \
                     samples, {kind} from byte {data_offset} on, which suits the number of bytes and the motion best."
                )
            }
            Self::FourthWords { samples } => write!(
                f,
                "Every sample is marked as missing (fourth word negative), but {samples} have coordinates; those were read as \
                 samples."
            ),
            Self::CoordinatesUnderGaps { samples } => write!(
                f,
                "{samples} samples are marked as missing (fourth word negative) and have coordinates; they are gaps, and the \
                 coordinates were kept as c3d/gap-coordinates."
            ),
            Self::Origin { samples, gaps: true } => write!(
                f,
                "{samples} samples are exactly at the origin while other markers move; they were read as missing."
            ),
            Self::Origin { samples, gaps: false } => write!(
                f,
                "{samples} samples are exactly at the origin and not marked as missing; they were kept as positions."
            ),
        }
    }
}

/// What a reader found wrong or open, as it goes along.
#[derive(Debug, Default)]
pub(crate) struct Notes {
    /// One sentence each.
    pub(crate) warnings: Vec<String>,
    /// What can be read in another way; each stands among the warnings, too.
    pub(crate) ambiguities: Vec<Ambiguity>,
}

impl Notes {
    /// Adds a choice that was made.
    pub(crate) fn ambiguous(&mut self, ambiguity: Ambiguity) {
        self.warnings.push(ambiguity.to_string());
        self.ambiguities.push(ambiguity);
    }
}
