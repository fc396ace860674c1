//! Whether a subject's skeleton and face have anything to do with the markers of a take.

use mocapd_report::{labels::split, limbs::limbs};
use mocapd_take::record::Subject;

use super::{Skeleton, face};

/// Markers that a face is laid under, at least (Umeyama 1991 needs three, and one more tells a mirror image).
const FACE_MARKERS_MIN: usize = 4;

/// What of the subject will show nothing with these labels, in words. Documents were checked when they were read: here nothing is
/// said of them.
#[must_use]
pub fn strangers(subject: Option<&Subject>, labels: &[String]) -> Vec<String> {
    let mut words = Vec::new();
    if let Ok(Some(skeleton)) = Skeleton::of_take(subject) {
        let name = subject.map_or("", |subject| subject.name.as_str());
        if limbs(&skeleton.to_bones(), labels, name).0.is_empty() {
            words.push(
                "no bone of the skeleton has a marker at both its ends, by the labels: it is in the take and shows nothing".to_owned(),
            );
        }
    }
    if let Some(Ok(Some(mapping))) = subject.map(face::mapping_of) {
        let is_here =
            |wanted: &str| labels.iter().any(|label| label == wanted || split(label).1 == wanted);
        let n_here = mapping.markers.iter().filter(|marker| is_here(&marker.label)).count();
        if n_here < FACE_MARKERS_MIN {
            words.push(format!(
                "{n_here} of the {} markers of the face are in the take, {FACE_MARKERS_MIN} are needed: it shows no face",
                mapping.markers.len()
            ));
        } else if n_here < mapping.markers.len() {
            words.push(format!(
                "{n_here} of the {} markers of the face are in the take: they alone hold it",
                mapping.markers.len()
            ));
        }
    }
    words
}
