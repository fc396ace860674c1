//! Marker sets: the subject and the joint that a marker label names, and the lines to draw between markers.
//!
//! All interpretation of labels is in this module.

use std::collections::HashMap;

/// A marker set: each joint, and the labels for it in order of preference, separated by `/`. `*` matches `l` and
/// `r`. Labels are in the form of [`site_key`].
type Names = [(&'static str, &'static str)];

/// Labels that name the joint itself, as in joint files and by the generator, and the markers or computed joint centres
/// nearest to it in Vicon's Plug-in Gait and the Helen Hayes sets.
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

/// Joints of BVH files by their most common names, those of the segments that begin there.
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

/// All sets; if two match equally many joints, the earlier one is taken.
const SETS: [&Names; 3] = [BY_JOINT, ASF, BVH];

/// The lines to draw for a marker set, as pairs of sites; nothing is measured along them. `/` separates labels of one
/// site in order of preference, and `*` matches `l` and `r`.
type Lines = [(&'static str, &'static str)];

/// The 15 sites of Shi et al. 2012 (doi 10.3969/j.issn.0372-2112.2012.01.021), as labelled by
/// `simulator/src/generator/body.rs` and in joint files made from CMU's motion capture database (mocap.cs.cmu.edu),
/// plus toes and hands. Without a throat or a pelvis, the shoulders or hips are joined directly.
const JOINT_LINES: &Lines = &[
    ("throat/neck", "head"),
    ("throat/neck/rshoulder", "lshoulder"),
    ("throat/neck", "rshoulder"),
    ("pelvis/hips/root/sacrum", "throat/neck"),
    ("pelvis/hips/root/sacrum/rhip", "lhip"),
    ("pelvis/hips/root/sacrum", "rhip"),
    ("*shoulder", "*elbow"),
    ("*elbow", "*wrist"),
    ("*wrist", "*hand/*finger"),
    ("*hip", "*knee"),
    ("*knee", "*ankle"),
    ("*ankle", "*toe/*foot"),
    ("*ankle", "*heel"),
    ("*heel", "*toe/*foot"),
];

/// Plug-in Gait, full body, after Vicon's "Plug-in Gait Reference Guide". Wand markers and the offset marker (`LUPA`,
/// `LFRM`, `LTHI`, `LTIB`, `RBAK`) get no line.
const PLUG_IN_GAIT_LINES: &Lines = &[
    ("lfhd", "rfhd"),
    ("lbhd", "rbhd"),
    ("*fhd", "*bhd"),
    ("c7", "clav"),
    ("c7", "t10"),
    ("clav", "strn"),
    ("strn", "t10"),
    ("*sho", "clav"),
    ("*sho", "c7"),
    ("*sho", "*elb"),
    ("*elb", "*wra"),
    ("*elb", "*wrb"),
    ("*wra", "*wrb"),
    ("*wra", "*fin"),
    ("*wrb", "*fin"),
    ("lasi", "rasi"),
    ("lpsi", "rpsi"),
    ("*asi", "*psi/sacr"),
    ("t10", "*psi/sacr"),
    ("*asi", "*kne"),
    ("*kne", "*ank"),
    ("*ank", "*hee"),
    ("*ank", "*toe"),
    ("*hee", "*toe"),
];

/// The Helen Hayes set (Kadaba, Ramakrishnan and Wootten 1990, doi 10.1002/jor.1100080310), with head and arms as
/// labelled by Motion Analysis's programs, in full and in four letters.
const HELEN_HAYES_LINES: &Lines = &[
    ("fronthead/fhea", "rearhead/rhea"),
    ("fronthead/fhea", "tophead/thea"),
    ("rearhead/rhea", "tophead/thea"),
    ("lshoulder/lsho", "rshoulder/rsho"),
    ("*shoulder/*sho", "*elbow/*elb"),
    ("*elbow/*elb", "*wrist/*wri"),
    ("*shoulder/*sho", "*asis/*asi"),
    ("lasis/lasi", "rasis/rasi"),
    ("*asis/*asi", "*psis/vsacral/vsac/sacral/sacrum/s2"),
    ("*asis/*asi", "*knee/*kne"),
    ("*knee/*kne", "*ankle/*ank"),
    ("*ankle/*ank", "*heel/*hee"),
    ("*ankle/*ank", "*toe/*mt1"),
    ("*heel/*hee", "*toe/*mt1"),
];

/// Bones of CMU's ASF skeletons (mocap.cs.cmu.edu), each a point at its far end.
const ASF_LINES: &Lines = &[
    ("root", "lowerback"),
    ("lowerback", "upperback"),
    ("upperback", "thorax"),
    ("thorax", "lowerneck"),
    ("lowerneck", "upperneck"),
    ("upperneck", "head"),
    ("thorax", "*clavicle"),
    ("*clavicle", "*humerus"),
    ("*humerus", "*radius"),
    ("*radius", "*wrist"),
    ("*wrist", "*hand"),
    ("root", "*hipjoint"),
    ("*hipjoint", "*femur"),
    ("*femur", "*tibia"),
    ("*tibia", "*foot"),
    ("*foot", "*toes"),
];

/// Joints of BVH files, by their most common names.
const BVH_LINES: &Lines = &[
    ("hips", "spine"),
    ("spine", "spine1/neck"),
    ("spine1", "neck"),
    ("neck", "head"),
    ("neck", "*shoulder/*arm"),
    ("*shoulder", "*arm"),
    ("*arm", "*forearm"),
    ("*forearm", "*hand"),
    ("hips", "*upleg"),
    ("*upleg", "*leg"),
    ("*leg", "*foot"),
    ("*foot", "*toebase"),
];

/// All sets of lines; if two draw equally many, the earlier one is taken.
const LINE_SETS: [&Lines; 5] =
    [JOINT_LINES, PLUG_IN_GAIT_LINES, HELEN_HAYES_LINES, ASF_LINES, BVH_LINES];

/// Splits a label into subject and site at the last `:`; without one the subject is empty.
#[must_use]
pub fn split(label: &str) -> (&str, &str) {
    label.rsplit_once(':').unwrap_or(("", label))
}

/// The normalised form of a site: lower case, without separators, with the side as one letter in front. `L.Shoulder`,
/// `l_shoulder`, `LeftShoulder` and `Shoulder_L` all become `lshoulder`.
#[must_use]
pub fn site_key(site: &str) -> String {
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

/// The markers of one subject.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SubjectMarkers<'a> {
    /// The subject's name in the labels; may be empty.
    pub name: &'a str,
    /// The column of each site in the form of [`site_key`]; the first one of a repeated site.
    pub sites: HashMap<String, usize>,
}

/// Groups markers by subject, in order of their first appearance.
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
        subjects[place].sites.entry(site_key(site)).or_insert(column);
    }
    subjects
}

impl SubjectMarkers<'_> {
    /// The column of the first of these sites that exists.
    #[must_use]
    pub fn first(&self, names: &[&str]) -> Option<usize> {
        names.iter().find_map(|name| self.sites.get(*name).copied())
    }

    /// The columns of the joints (`l_shoulder` and so on) that labels name, by the marker set that matches most of
    /// them.
    #[must_use]
    pub fn joints(&self) -> HashMap<String, usize> {
        // `max_by_key` returns the last of equal sets: reversed, the earlier one.
        let found = SETS.into_iter().rev().map(|set| self.by(set));
        found.max_by_key(HashMap::len).unwrap_or_default()
    }

    fn by(&self, set: &Names) -> HashMap<String, usize> {
        let mut found = HashMap::new();
        for (joint, names) in set {
            for side in sides(joint) {
                if let Some(column) = self.column(names, side) {
                    found.insert(joint.replace('*', side), column);
                }
            }
        }
        found
    }

    /// The column of the first site in a list separated by `/` that exists.
    fn column(&self, names: &str, side: &str) -> Option<usize> {
        names.split('/').find_map(|name| self.sites.get(&name.replace('*', side)).copied())
    }

    /// The lines of the set with most matches.
    fn lines(&self) -> Vec<[u16; 2]> {
        // As in `joints`, the earlier one of equal sets.
        let found = LINE_SETS.into_iter().rev().map(|set| self.lines_of(set));
        found.max_by_key(Vec::len).unwrap_or_default()
    }

    fn lines_of(&self, set: &Lines) -> Vec<[u16; 2]> {
        let ends = set.iter().flat_map(|(from, to)| {
            let sides = if from.contains('*') { sides(from) } else { sides(to) };
            sides.iter().map(move |side| [(*from, *side), (*to, *side)])
        });
        let slot = |(names, side)| u16::try_from(self.column(names, side)?).ok();
        let lines = ends.filter_map(|[from, to]| Some([slot(from)?, slot(to)?]));
        lines.filter(|[from, to]| from != to).collect()
    }
}

/// The values of `*` in a list of sites.
fn sides(names: &str) -> &'static [&'static str] {
    if names.contains('*') { &["l", "r"] } else { &[""] }
}

/// The lines to draw between markers, as pairs of columns of `labels`. Each subject gets the lines of the marker set
/// that matches it best; of repeated labels the first is used.
#[must_use]
pub fn marker_lines(labels: &[String]) -> Vec<[u16; 2]> {
    // Columns in lines have 16 bits.
    let named = labels.iter().take(usize::from(u16::MAX) + 1).map(String::as_str);
    subjects(named).iter().flat_map(SubjectMarkers::lines).collect()
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
    fn spellings_of_a_side_are_equivalent() {
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
    fn subjects_are_distinguished_and_unknown_labels_name_no_joint() {
        let two = ["Ann:LKNE", "Bob:LKNE", "Ann:LANK", "u001", "Ann:LKNE"];
        let subjects = subjects(two);
        assert_eq!(subjects.iter().map(|s| s.name).collect::<Vec<_>>(), ["Ann", "Bob", ""]);
        assert_eq!(subjects[0].joints()["l_knee"], 0, "the first of two");
        assert!(subjects[2].joints().is_empty());
        assert!(super::subjects([]).is_empty() && joints(&["_", "left", ":"]).is_empty());
    }

    fn owned(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    /// The lines as pairs of names, each pair and all pairs in alphabetical order.
    fn names(labels: &[String]) -> Vec<[&str; 2]> {
        let mut lines: Vec<[&str; 2]> = marker_lines(labels)
            .iter()
            .map(|line| {
                let mut pair = line.map(|slot| labels[usize::from(slot)].as_str());
                pair.sort_unstable();
                pair
            })
            .collect();
        lines.sort_unstable();
        lines
    }

    #[test]
    fn lines_do_not_depend_on_the_spelling_of_a_side() {
        for wrist in
            ["l_wrist", "L.Wrist", "LeftWrist", "Wrist_L", "LWRIST", "wrist left", "Left Wrist"]
        {
            assert_eq!(marker_lines(&owned(&["L_Elbow", wrist])), [[0, 1]], "{wrist}");
            assert!(
                marker_lines(&owned(&["R_Elbow", wrist])).is_empty(),
                "{wrist} is not the right one"
            );
        }
    }

    #[test]
    fn joints_in_another_order_get_the_same_lines() {
        let shuffled = owned(&[
            "r_ankle",
            "r_knee",
            "r_hip",
            "l_ankle",
            "l_knee",
            "l_hip",
            "r_wrist",
            "r_elbow",
            "r_shoulder",
            "l_wrist",
            "l_elbow",
            "l_shoulder",
            "pelvis",
            "neck",
            "head",
        ]);
        assert_eq!(marker_lines(&shuffled).len(), 14);
        assert!(names(&shuffled).contains(&["neck", "pelvis"]));
        assert!(names(&shuffled).contains(&["l_hip", "pelvis"]));
    }

    #[test]
    fn a_body_without_throat_and_pelvis_gets_direct_lines() {
        let body = owned(&["l_shoulder", "r_shoulder", "l_hip", "r_hip"]);
        assert_eq!(names(&body), [["l_hip", "r_hip"], ["l_shoulder", "r_shoulder"]]);
    }

    #[test]
    fn plug_in_gait_is_joined_from_head_to_toe() {
        let set = owned(&[
            "LFHD", "RFHD", "LBHD", "RBHD", "C7", "T10", "CLAV", "STRN", "RBAK", "LSHO", "LUPA",
            "LELB", "LFRM", "LWRA", "LWRB", "LFIN", "RSHO", "RUPA", "RELB", "RFRM", "RWRA", "RWRB",
            "RFIN", "LASI", "RASI", "LPSI", "RPSI", "LTHI", "LKNE", "LTIB", "LANK", "LHEE", "LTOE",
            "RTHI", "RKNE", "RTIB", "RANK", "RHEE", "RTOE",
        ]);
        let lines = names(&set);
        for line in
            [["LELB", "LSHO"], ["RANK", "RTOE"], ["LASI", "RASI"], ["C7", "T10"], ["LFHD", "RFHD"]]
        {
            assert!(lines.contains(&line), "{line:?}");
        }
        assert_eq!(lines.len(), 40);
        let joined = |name: &str| lines.iter().any(|line| line.contains(&name));
        let alone: Vec<&String> = set.iter().filter(|name| !joined(name)).collect();
        assert_eq!(alone, ["RBAK", "LUPA", "LFRM", "RUPA", "RFRM", "LTHI", "LTIB", "RTHI", "RTIB"]);
    }

    #[test]
    fn helen_hayes_is_known_in_full_and_in_four_letters() {
        let full = owned(&[
            "Top.Head",
            "Front.Head",
            "Rear.Head",
            "R.Shoulder",
            "R.Elbow",
            "R.Wrist",
            "L.Shoulder",
            "L.Elbow",
            "L.Wrist",
            "R.ASIS",
            "L.ASIS",
            "V.Sacral",
            "R.Knee",
            "R.Ankle",
            "R.Heel",
            "R.Toe",
            "L.Knee",
            "L.Ankle",
            "L.Heel",
            "L.Toe",
        ]);
        let short = owned(&[
            "THEA", "FHEA", "RHEA", "RSHO", "RELB", "RWRI", "LSHO", "LELB", "LWRI", "RASI", "LASI",
            "VSAC", "RKNE", "RANK", "RHEE", "RTOE", "LKNE", "LANK", "LHEE", "LTOE",
        ]);
        assert_eq!(marker_lines(&full), marker_lines(&short));
        assert_eq!(marker_lines(&full).len(), 23);
    }

    #[test]
    fn skeletons_of_asf_and_bvh_are_chains() {
        let asf = owned(&["root", "lhipjoint", "lfemur", "ltibia", "lfoot", "ltoes"]);
        assert_eq!(marker_lines(&asf), [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5]]);
        let bvh = owned(&["Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase"]);
        assert_eq!(marker_lines(&bvh), [[0, 1], [1, 2], [2, 3], [3, 4]]);
    }

    #[test]
    fn subjects_are_not_joined_with_each_other() {
        let two = owned(&[
            "Ann:LSHO", "Bob:LELB", "Bob:LSHO", "Ann:LELB", "Ann:LASI", "Ann:RASI", "Bob:CLAV",
        ]);
        let lines = names(&two);
        assert!(lines.contains(&["Ann:LELB", "Ann:LSHO"]));
        assert!(lines.contains(&["Bob:LELB", "Bob:LSHO"]));
        assert!(lines.iter().all(|[a, b]| a[..3] == b[..3]), "{lines:?}");
    }

    #[test]
    fn unknown_labels_get_no_lines() {
        assert!(marker_lines(&[]).is_empty());
        assert!(
            marker_lines(&owned(&["u001", "", ":", "left", "_", "marker 7", "LÄNGS"])).is_empty()
        );
    }

    #[test]
    fn the_first_of_repeated_labels_is_used() {
        assert_eq!(marker_lines(&owned(&["l_knee", "l_knee", "l_hip"])), [[2, 0]]);
    }

    #[test]
    fn columns_beyond_16_bits_are_ignored() {
        let mut many = vec!["u001".to_owned(); 65_535];
        many.extend(owned(&["l_hip", "l_knee"]));
        assert!(marker_lines(&many).is_empty());
    }
}
