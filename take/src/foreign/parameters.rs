//! The parameters of a take that was imported from a C3D file, as plain values: an inventory for analyses. Programs that
//! need samples in physical units use [the analog channels](super::analog) and [the force plates](super::force_plates),
//! which know what the parameters mean.

use super::analog;
use crate::{TakeError, interchange::c3d, motion::MotionInfo};

pub use crate::interchange::c3d::{C3dParameter, C3dValues};

/// Whether [`read`] needs the content of foreign parts of a kind. Pass this to
/// [`TakeFrames::open_with`](crate::TakeFrames::open_with).
#[must_use]
pub fn is_needed(kind: &str) -> bool {
    kind == c3d::PARAMETERS
}

/// The parameters, in the order of the file; `None` if the take has none.
///
/// # Errors
/// `InvalidArgument` if the content of the part was not read, or has another layout; `Io` if its scratch file cannot be
/// read.
pub fn read(info: &MotionInfo) -> Result<Option<Vec<C3dParameter>>, TakeError> {
    Ok(analog::parameters(info)?.map(|parameters| c3d::parameter_values(&parameters)))
}
