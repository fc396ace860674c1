//! Why a scan gives no body.

use crate::UnitError;

/// A scan that was not repaired, by what to do about it.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RepairError {
    /// Every triangle was needless.
    #[error("no triangle has an area: export the scan again")]
    NoSurface,
    /// No piece is most of the surface.
    #[error(
        "{pieces} pieces that do not hang together, the largest with {share:.0} % of the surface: join them, or export the subject alone"
    )]
    Pieces {
        /// How many.
        pieces: usize,
        /// The area of the largest, in per cent of all.
        share: f64,
    },
    /// A hole is so large that it is not known what was there.
    #[error(
        "a hole of {around:.0} % of the extent around, and {area:.0} % of the surface: part of the body is missing, scan it again"
    )]
    Hole {
        /// Its length in per cent of the largest extent.
        around: f64,
        /// The area of what would close it, in per cent of the surface.
        area: f64,
    },
    /// The surface runs into itself in a way that no cut undoes.
    #[error("the surface is tangled beyond repair: make it manifold in the scanner's program")]
    Tangled,
    /// A sheet, and not a solid.
    #[error("the surface encloses nothing: export a closed mesh")]
    Flat,
    /// Of no body's size.
    #[error(transparent)]
    Unit(#[from] UnitError),
}
