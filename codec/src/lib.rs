//! Error-bounded compression of marker trajectories: samples in, blocks out, and back.
//!
//! A *channel* is one marker's trajectory: a position per frame, or none where the marker was not seen.
//! It is coded in *blocks*, each over one stretch of frames. The encoder rebuilds every block as a
//! decoder would and measures it: every sample present lies within the tolerance, as a Euclidean
//! distance in 3D, of its float32 reconstruction, and the block says how close it came.
//!
//! Five resamplers stand behind one contract ([`ResamplerKind`]): `dense` makes the smallest blocks,
//! `fast` the quickest, `lossless` keeps every bit, and `spline` and `sync` are the methods of
//! (Shi et al. 2012), for study. The bytes depend on the samples and the [`Settings`] only, never on the
//! machine.
//!
//! The crate does no I/O, reads no clock and starts no thread. Decoders take any bytes: they give an
//! error or samples, and never allocate more than the caller's number of rows asks for.
//! `docs/codec.md` describes the format byte by byte.
//!
//! ```
//! use mocapd_codec::{DecodedRows, ResamplerKind, Rows, Settings, Tolerance};
//!
//! let settings =
//!     Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(0.5)? };
//! // One second at 120 Hz; the marker is hidden for ten frames.
//! let positions: Vec<[f32; 3]> = (0..120)
//!     .map(|frame| frame as f32 / 120.0)
//!     .map(|time_s| [300.0 * (3.0 * time_s).sin(), 1000.0 * time_s, 900.0])
//!     .collect();
//! let present: Vec<bool> = (0..120).map(|frame| !(50..60).contains(&frame)).collect();
//!
//! let mut block = Vec::new();
//! let report =
//!     settings.encoder().encode(Rows::new(&positions, &present)?, &[], true, &mut block)?;
//! assert_eq!(report.samples, 110);
//! assert!(report.max_error_mm <= 0.5);
//! assert!(block.len() * 10 < 110 * 12, "less than a tenth of the raw float32");
//!
//! let mut rows = DecodedRows::default();
//! settings.decoder().decode(&block, &[], 120, true, &mut rows)?;
//! assert_eq!(rows.present, present);
//! assert!((rows.positions[7][1] - positions[7][1]).abs() <= 0.5);
//! # Ok::<(), mocapd_codec::CodecError>(())
//! ```
mod block;
mod bound;
mod coding;
mod dense;
mod error;
mod fast;
mod frame;
mod lossless;
mod presence;
mod settings;
mod spline;
mod sync;

pub use block::{BlockDecoder, BlockEncoder, BlockReport, DecodedRows, Rows};
pub use coding::range;
pub use error::CodecError;
pub use settings::{ResamplerKind, Settings, SplineVariant, Tolerance};

/// A position in millimetres, x y z, right-handed, in the device's own axes.
pub type Position = [f32; 3];
