//! The skeleton that a take is compared with, and the limbs between its markers, for `plot pose` and `verify`.

use std::path::Path;

use mocapd_body::skeleton::Skeleton;
use mocapd_report::limbs::{Limb, limbs};
use mocapd_service::subject;
use mocapd_take::motion::Motion;

/// A skeleton, and those of its bones whose ends are markers of a take.
#[derive(Debug)]
pub(super) struct TakeLimbs {
    pub(super) skeleton: Skeleton,
    pub(super) limbs: Vec<Limb>,
    /// The columns of all markers of the subject.
    pub(super) columns: Vec<usize>,
}

/// The limbs by the skeleton in `file`, else by the take's own; `None` if there is no skeleton.
///
/// # Errors
/// If the skeleton cannot be read.
pub(super) fn of(motion: &Motion, file: Option<&Path>) -> anyhow::Result<Option<TakeLimbs>> {
    let own = motion.info.subject.as_ref();
    let skeleton = match file {
        Some(path) => Some(subject::read(path, Skeleton::from_json)?.1),
        None => subject::skeleton(own)?,
    };
    let Some(skeleton) = skeleton else { return Ok(None) };
    let labels: Vec<&str> =
        motion.info.markers.iter().map(|marker| marker.label.as_str()).collect();
    let name = own.map_or("", |subject| subject.name.as_str());
    let (limbs, columns) = limbs(&skeleton.bones, &labels, name);
    Ok(Some(TakeLimbs { skeleton, limbs, columns }))
}
