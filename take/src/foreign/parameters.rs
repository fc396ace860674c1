//! The parameters of a take that was imported from a C3D file, as plain values: an inventory for analyses. Programs that
//! need samples in physical units use [`analog`](super::analog) and [`force_plates`](super::force_plates), which know
//! what the parameters mean.

use crate::{TakeError, foreign::analog, interchange::c3d, motion::MotionInfo};

/// A parameter of a C3D file.
#[derive(Debug, Clone, PartialEq)]
pub struct C3dParameter {
    /// Its group, as written; empty if the file does not define the group.
    pub group: String,
    /// Its name, as written.
    pub name: String,
    /// Free text; may be empty.
    pub description: String,
    /// Its dimensions as the file has them, the fastest first; of texts, the first is their length. None for a scalar.
    pub dimensions: Vec<u8>,
    /// Its values in the order of the file.
    pub values: C3dValues,
}

/// The values of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub enum C3dValues {
    /// Texts, without the spaces that fill them up.
    Texts(Vec<String>),
    /// Bytes.
    Bytes(Vec<u8>),
    /// 16-bit integers. Counts, frame numbers and the offsets of unsigned samples are unsigned, others signed.
    Integers(Vec<i32>),
    /// Floats.
    Floats(Vec<f32>),
}

impl C3dParameter {
    /// Whether it has this group and name, ignoring case.
    #[must_use]
    pub fn is(&self, group: &str, name: &str) -> bool {
        self.group.eq_ignore_ascii_case(group) && self.name.eq_ignore_ascii_case(name)
    }
}

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
