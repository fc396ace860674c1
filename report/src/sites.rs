//! The markers that the detection of jumps needs, by their labels.

use mocapd_take::motion::Motion;

use crate::{
    column::Column,
    labels::{SubjectMarkers, subjects},
};

/// Labels of the pelvis, in the form of [`crate::labels::site_key`] and in order of preference.
const PELVIS: &[&str] = &["pelvis", "hips", "root", "sacrum", "sacr", "midhip", "vsacral", "vsac"];
/// Without a pelvis marker it is the mean of these: all markers of the first set that is complete.
const AROUND_PELVIS: &[&[&str]] =
    &[&["lasi", "rasi", "lpsi", "rpsi"], &["lasis", "rasis"], &["lasi", "rasi"], &["lhip", "rhip"]];
const LEFT_FOOT: &[&str] = &["lankle", "lank", "lfoot", "lheel", "lhee"];
const RIGHT_FOOT: &[&str] = &["rankle", "rank", "rfoot", "rheel", "rhee"];

/// The markers from which the phases of a jump are detected.
#[derive(Debug, Clone, PartialEq)]
pub struct Sites {
    /// Columns whose mean is the pelvis.
    pub pelvis: Vec<usize>,
    /// Columns of the left and the right foot.
    pub feet: [usize; 2],
}

impl Sites {
    /// The sites of the first subject (`name:site`) that has them all.
    ///
    /// # Errors
    /// A message that names the missing site.
    pub fn of(motion: &Motion) -> Result<Self, String> {
        let subjects = subjects(motion.info.markers.iter().map(|marker| marker.label.as_str()));
        let mut found = subjects.iter().map(Self::of_subject);
        let first = found.next().unwrap_or_else(|| Self::of_subject(&SubjectMarkers::default()));
        first.or_else(|missing| found.find_map(Result::ok).ok_or(missing))
    }

    fn of_subject(subject: &SubjectMarkers<'_>) -> Result<Self, String> {
        let all = |names: &&[&str]| names.iter().map(|name| subject.first(&[name])).collect();
        let pelvis = subject.first(PELVIS).map(|pelvis| vec![pelvis]);
        let pelvis = pelvis
            .or_else(|| AROUND_PELVIS.iter().find_map(all))
            .ok_or("no marker is labelled pelvis, hips, sacrum or l_hip and r_hip")?;
        let foot = |names: &[&str], side: &str| {
            let missing = format!("no marker is labelled {side}_ankle, {side}_foot or {side}_heel");
            subject.first(names).ok_or(missing)
        };
        Ok(Self { pelvis, feet: [foot(LEFT_FOOT, "l")?, foot(RIGHT_FOOT, "r")?] })
    }

    /// The position of the pelvis over the take.
    #[must_use]
    pub fn pelvis(&self, motion: &Motion) -> Column {
        let columns: Vec<Column> =
            self.pelvis.iter().map(|&column| Column::of(motion, column)).collect();
        Column::mean(&columns)
    }
}

#[cfg(test)]
mod tests {
    use mocapd_take::motion::{Marker, MotionInfo};

    use super::*;

    fn motion(labels: &[&str]) -> Motion {
        let marker = |label: &&str| Marker { label: (*label).to_owned(), labelled: true };
        let markers = labels.iter().map(marker).collect();
        Motion { info: MotionInfo { markers, ..Default::default() }, positions_mm: vec![] }
    }

    #[test]
    fn sites_of_several_marker_sets() {
        let ours = motion(&["head", "pelvis", "l_ankle", "r_ankle"]);
        assert_eq!(Sites::of(&ours), Ok(Sites { pelvis: vec![1], feet: [2, 3] }));
        let gait = motion(&["S1:LASI", "S1:RASI", "S1:LPSI", "S1:RPSI", "S1:LANK", "S1:RANK"]);
        assert_eq!(Sites::of(&gait), Ok(Sites { pelvis: vec![0, 1, 2, 3], feet: [4, 5] }));
        let two = ["A:pelvis", "A:l_ankle", "B:l_ankle", "B:r_ankle", "B:hips"];
        assert_eq!(Sites::of(&motion(&two)), Ok(Sites { pelvis: vec![4], feet: [2, 3] }));
        assert!(Sites::of(&motion(&["pelvis", "l_ankle"])).unwrap_err().contains("r_ankle"));
        assert!(Sites::of(&motion(&["u001"])).unwrap_err().contains("pelvis"));
    }
}
