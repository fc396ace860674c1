//! Error-bounded compression of marker trajectories: samples in, blocks out, and back.
//!
//! A *channel* is one marker's trajectory: a position per frame, or none where the marker was not seen.
//! Up to [`GROUP_CHANNELS`] channels are coded together in *blocks*, each over one stretch of frames. The
//! encoder rebuilds every block as a decoder does and measures it: the float32 reconstruction of every
//! sample lies within the tolerance, a Euclidean distance in 3D, and the block states the error bound
//! it reached.
//!
//! Five resamplers implement one contract ([`ResamplerKind`]): `dense` makes the smallest blocks, `fast`
//! codes in the shortest time, `lossless` keeps every bit, and `spline` and `sync` are the methods of
//! (Shi et al. 2012), for study. The bytes depend on the samples and the [`Settings`] only, never on the
//! machine.
//!
//! The crate does no I/O, reads no clock and starts no thread. Encoders and decoders are [`Send`] and
//! share no state. Decoders accept arbitrary bytes: they return an error or samples, never panic, and
//! allocate no more than the caller's number of rows times the channels of a group needs. `docs/codec.md`
//! specifies the format byte by byte; the README gives memory and speed, and what is stable.
//!
//! ```
//! use mocapd_codec::{BlockReport, ResamplerKind, Rows, Settings, Tolerance};
//!
//! let settings =
//!     Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(0.5)? };
//! // Two markers for one second at 120 Hz; both are hidden for ten frames.
//! let path = |side_mm: f32| -> Vec<[f32; 3]> {
//!     let times_s = (0..120).map(|frame| frame as f32 / 120.0);
//!     times_s.map(|t| [side_mm + 300.0 * (3.0 * t).sin(), 1000.0 * t, 900.0]).collect()
//! };
//! let (left, right) = (path(-200.0), path(200.0));
//! let present: Vec<bool> = (0..120).map(|frame| !(50..60).contains(&frame)).collect();
//! let channels = [Rows::new(&left, &present)?, Rows::new(&right, &present)?];
//!
//! let mut block = Vec::new();
//! let mut reports = [BlockReport::default(); 2];
//! settings.encoder().encode(&channels, &[], true, &mut block, &mut reports)?;
//! assert!(reports.iter().all(|report| report.samples == 110 && report.max_error_mm <= 0.5));
//! assert!(block.len() * 10 < 220 * 12, "less than a tenth of the raw float32");
//!
//! let mut decoded = Vec::new();
//! settings.decoder().decode(&block, &[], 120, true, &mut decoded)?;
//! assert_eq!(decoded[1].present, present);
//! assert!((decoded[1].positions[7][1] - right[7][1]).abs() <= 0.5);
//! # Ok::<(), mocapd_codec::CodecError>(())
//! ```
mod block;
mod coding;
mod dense;
mod fast;
mod frame;
mod lossless;
pub mod poses;
pub mod sampled;
mod settings;
mod spline;

pub use crate::block::Tolerance;
pub use block::{
    BlockDecoder, BlockEncoder, BlockReport, CodecError, DecodedRows, GROUP_CHANNELS, Rows,
};
pub(crate) use block::{Result, ensure};
pub use coding::range;
pub use dense::Effort;
#[cfg(feature = "training")]
pub use dense::training;
pub use frame::{stated_channels, stated_error_step};
pub use settings::{ResamplerKind, Settings};
pub use spline::SplineVariant;

/// The version of the block format: the one that this crate writes, and the only one it reads.
///
/// Blocks do not carry it: a container stores it with them and refuses every other version. A new version
/// is a breaking change of the crate. Versions 1 to 5 existed during development only.
pub const BLOCK_VERSION: u16 = 6;

/// A position in millimetres, x y z, right-handed, in the device's own axes.
pub type Position = [f32; 3];

/// Runs the README's example as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
