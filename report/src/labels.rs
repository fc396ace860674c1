//! What labels of markers mean: whose they are, and which joint of the body they name. Everything that reads a label
//! for its meaning reads it here.

use std::collections::HashMap;

/// What labels call a joint, set by set; what stands between `/` are names of one joint, of which the first that is
/// there is taken. `*` is either side. Names are as [`plain`] writes them.
type Names = [(&'static str, &'static str)];

/// By the joint itself, as the generator and files of joints do, and as Vicon's Plug-in Gait and the sets after Helen
/// Hayes call the marker or the computed centre that is nearest to it.
const BY_JOINT: &Names = &[
    ("head", "head"),
    ("throat", "throat/neck"),
    ("pelvis", "pelvis/hips/root/midhip/sacrum/sacr/vsacral/vsac"),
    ("*_shoulder", "*sjc/*shoulder/*sho"),
    ("*_elbow", "*ejc/*elbow/*elb"),
    ("*_wrist", "*wjc/*wrist/*wri"),
    ("*_hip", "*hjc/*hip"),
    ("*_knee", "*kjc/*knee/*kne"),
    ("*_ankle", "*ajc/*ankle/*ank"),
];

/// Bones of CMU's ASF skeletons (mocap.cs.cmu.edu), each a point at its far end.
const ASF: &Names = &[
    ("head", "head"),
    ("throat", "thorax"),
    ("pelvis", "root"),
    ("*_shoulder", "*clavicle"),
    ("*_elbow", "*humerus"),
    ("*_wrist", "*wrist/*radius"),
    ("*_hip", "*hipjoint"),
    ("*_knee", "*femur"),
    ("*_ankle", "*tibia"),
];

/// Joints of BVH files as most programs name them, after the segment that begins there.
const BVH: &Names = &[
    ("head", "head"),
    ("throat", "neck"),
    ("pelvis", "hips"),
    ("*_shoulder", "*arm"),
    ("*_elbow", "*forearm"),
    ("*_wrist", "*hand"),
    ("*_hip", "*upleg"),
    ("*_knee", "*leg"),
    ("*_ankle", "*foot"),
];

/// In the order in which they are preferred where two explain as much.
const SETS: [&Names; 3] = [BY_JOINT, ASF, BVH];

/// Whose marker it is, and what it is called there: several subjects are told apart by what stands before the last `:`.
#[must_use]
pub fn split(label: &str) -> (&str, &str) {
    label.rsplit_once(':').unwrap_or(("", label))
}

/// A site in small letters without what separates its words, and its side as one letter before it: `L.Shoulder`,
/// `l_shoulder`, `LeftShoulder` and `Shoulder_L` are one.
#[must_use]
pub fn plain(site: &str) -> String {
    let small = site.to_lowercase();
    let words: Vec<&str> =
        small.split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty()).collect();
    let (side, words) = match words.as_slice() {
        [rest @ .., last @ ("l" | "left" | "r" | "right")] if !rest.is_empty() => {
            (&last[..1], rest)
        }
        all => ("", all),
    };
    let name = words.concat();
    let name = match (name.strip_prefix("left"), name.strip_prefix("right")) {
        (Some(rest), _) if !rest.is_empty() => format!("l{rest}"),
        (_, Some(rest)) if !rest.is_empty() => format!("r{rest}"),
        _ => name,
    };
    format!("{side}{name}")
}

/// Markers of one subject.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SubjectMarkers<'a> {
    /// What stands before the `:` of its labels; empty where nothing does.
    pub name: &'a str,
    /// The column of each [`plain`] site: of one that comes twice, the first.
    pub sites: HashMap<String, usize>,
}

/// The markers by subject, in the order in which these appear.
#[must_use]
pub fn subjects<'a>(labels: impl IntoIterator<Item = &'a str>) -> Vec<SubjectMarkers<'a>> {
    let mut subjects: Vec<SubjectMarkers<'a>> = Vec::new();
    let mut places: HashMap<&str, usize> = HashMap::new();
    for (column, label) in labels.into_iter().enumerate() {
        let (name, site) = split(label);
        let place = *places.entry(name).or_insert(subjects.len());
        if place == subjects.len() {
            subjects.push(SubjectMarkers { name, sites: HashMap::new() });
        }
        subjects[place].sites.entry(plain(site)).or_insert(column);
    }
    subjects
}

impl SubjectMarkers<'_> {
    /// The column of the first of these names that is there.
    #[must_use]
    pub fn first(&self, names: &[&str]) -> Option<usize> {
        names.iter().find_map(|name| self.sites.get(*name).copied())
    }

    /// The columns of the joints that its labels name, by the set that names most of them: `l_shoulder` and so on.
    #[must_use]
    pub fn joints(&self) -> HashMap<String, usize> {
        let mut best = HashMap::new();
        for set in SETS {
            let found = self.by(set);
            if found.len() > best.len() {
                best = found;
            }
        }
        best
    }

    fn by(&self, set: &Names) -> HashMap<String, usize> {
        let mut found = HashMap::new();
        for (joint, names) in set {
            let sides: &[&str] = if joint.contains('*') { &["l", "r"] } else { &[""] };
            for side in sides {
                let mut columns = names.split('/').map(|name| name.replace('*', side));
                if let Some(column) = columns.find_map(|name| self.sites.get(&name).copied()) {
                    found.insert(joint.replace('*', side), column);
                }
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints(labels: &[&str]) -> Vec<(String, usize)> {
        let subjects = subjects(labels.iter().copied());
        let mut found: Vec<_> = subjects[0].joints().into_iter().collect();
        found.sort();
        found
    }

    #[test]
    fn ways_of_writing_a_side_are_one() {
        for label in
            ["l_wrist", "L.Wrist", "LeftWrist", "Wrist_L", "LWRIST", "wrist left", "Left Wrist"]
        {
            assert_eq!(joints(&[label]), [("l_wrist".to_owned(), 0)], "{label}");
        }
    }

    #[test]
    fn sets_do_not_mix() {
        // In a BVH file the joint at the shoulder is called after the arm that begins there.
        let bvh = ["Hips", "Neck", "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"];
        let found = joints(&bvh);
        assert!(found.contains(&("l_shoulder".to_owned(), 3)), "{found:?}");
        assert!(found.contains(&("l_elbow".to_owned(), 4)), "{found:?}");
        let asf = ["root", "lhipjoint", "lfemur", "ltibia", "lfoot"];
        assert_eq!(joints(&asf).len(), 4);
        let gait = ["S1:LASI", "S1:LKNE", "S1:LANK", "S1:LHJC", "S1:LHIP"];
        assert_eq!(joints(&gait)[1], ("l_hip".to_owned(), 3), "a computed centre comes first");
    }

    #[test]
    fn subjects_are_told_apart_and_what_nobody_knows_is_no_joint() {
        let two = ["Ann:LKNE", "Bob:LKNE", "Ann:LANK", "u001", "Ann:LKNE"];
        let subjects = subjects(two);
        assert_eq!(subjects.iter().map(|s| s.name).collect::<Vec<_>>(), ["Ann", "Bob", ""]);
        assert_eq!(subjects[0].joints()["l_knee"], 0, "of two the first");
        assert!(subjects[2].joints().is_empty());
        assert!(super::subjects([]).is_empty() && joints(&["_", "left", ":"]).is_empty());
    }
}
