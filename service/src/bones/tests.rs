use mocapd_simulator::generator::{BONES, SITES};
use mocapd_take::record::Subject;

use super::{bones, live_limbs, with_limbs};

fn labels(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

/// The lines as pairs of names, each pair and all pairs in alphabetical order.
fn names(labels: &[String]) -> Vec<[&str; 2]> {
    let mut lines: Vec<[&str; 2]> = bones(labels)
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
fn the_generators_sites_get_the_generators_bones() {
    let sites = labels(&SITES);
    let mut expected: Vec<[&str; 2]> = BONES
        .iter()
        .map(|&(a, b)| {
            let mut pair = [SITES[a], SITES[b]];
            pair.sort_unstable();
            pair
        })
        .collect();
    expected.sort_unstable();
    assert_eq!(names(&sites), expected);
}

#[test]
fn markers_on_segments_get_no_lines() {
    let mut with_clusters = labels(&SITES);
    with_clusters.extend(labels(&["trunk_1", "l_thigh_1", "r_upper_arm_2", "head_1"]));
    assert_eq!(bones(&with_clusters), bones(&labels(&SITES)));
}

#[test]
fn ways_of_writing_a_side_are_one() {
    for wrist in
        ["l_wrist", "L.Wrist", "LeftWrist", "Wrist_L", "LWRIST", "wrist left", "Left Wrist"]
    {
        assert_eq!(bones(&labels(&["L_Elbow", wrist])), [[0, 1]], "{wrist}");
        assert!(bones(&labels(&["R_Elbow", wrist])).is_empty(), "{wrist} is not the right one");
    }
}

#[test]
fn joints_of_another_name_or_order_get_the_same_body() {
    let shuffled = labels(&[
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
    assert_eq!(bones(&shuffled).len(), 14);
    assert!(names(&shuffled).contains(&["neck", "pelvis"]));
    assert!(names(&shuffled).contains(&["l_hip", "pelvis"]));
}

#[test]
fn a_body_without_middle_is_joined_across() {
    let body = labels(&["l_shoulder", "r_shoulder", "l_hip", "r_hip"]);
    assert_eq!(names(&body), [["l_hip", "r_hip"], ["l_shoulder", "r_shoulder"]]);
}

#[test]
fn plug_in_gait_is_joined_from_head_to_toe() {
    let set = labels(&[
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
    let full = labels(&[
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
    let short = labels(&[
        "THEA", "FHEA", "RHEA", "RSHO", "RELB", "RWRI", "LSHO", "LELB", "LWRI", "RASI", "LASI",
        "VSAC", "RKNE", "RANK", "RHEE", "RTOE", "LKNE", "LANK", "LHEE", "LTOE",
    ]);
    assert_eq!(bones(&full), bones(&short));
    assert_eq!(bones(&full).len(), 23);
}

#[test]
fn skeletons_of_asf_and_bvh_are_chains() {
    let asf = labels(&["root", "lhipjoint", "lfemur", "ltibia", "lfoot", "ltoes"]);
    assert_eq!(bones(&asf), [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5]]);
    let bvh = labels(&["Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase"]);
    assert_eq!(bones(&bvh), [[0, 1], [1, 2], [2, 3], [3, 4]]);
}

#[test]
fn subjects_are_not_joined_with_each_other() {
    let two = labels(&[
        "Ann:LSHO", "Bob:LELB", "Bob:LSHO", "Ann:LELB", "Ann:LASI", "Ann:RASI", "Bob:CLAV",
    ]);
    let lines = names(&two);
    assert!(lines.contains(&["Ann:LELB", "Ann:LSHO"]));
    assert!(lines.contains(&["Bob:LELB", "Bob:LSHO"]));
    assert!(lines.iter().all(|[a, b]| a[..3] == b[..3]), "{lines:?}");
}

#[test]
fn labels_that_nobody_knows_get_no_lines() {
    assert!(bones(&[]).is_empty());
    assert!(bones(&labels(&["u001", "", ":", "left", "_", "marker 7", "LÄNGS"])).is_empty());
}

#[test]
fn of_a_label_that_comes_twice_the_first_is_meant() {
    assert_eq!(bones(&labels(&["l_knee", "l_knee", "l_hip"])), [[2, 0]]);
}

#[test]
fn slots_beyond_what_a_line_can_name_are_passed_over() {
    let mut many = vec!["u001".to_owned(); 65_535];
    many.extend(labels(&["l_hip", "l_knee"]));
    assert!(bones(&many).is_empty());
}

#[test]
fn limbs_of_the_subjects_skeleton_come_with_their_lengths() {
    let mut subject = Subject { name: "Ann".to_owned(), documents: Vec::new() };
    let skeleton = r#"{"format":"mocapd-skeleton","version":1,"joints":[{"name":"l_hip"},{"name":"l_knee"},{"name":"l_ankle"}],
"bones":[{"name":"l_thigh","parent":"l_hip","child":"l_knee","length_mm":400,"uncertainty_mm":9},
{"name":"l_shank","parent":"l_knee","child":"l_ankle","length_mm":300,"uncertainty_mm":50}]}"#;
    subject.set(Subject::SKELETON, skeleton.as_bytes().to_vec());
    let two = labels(&["Bob:LHIP", "Bob:LKNE", "Ann:LANK", "Ann:LKNE", "Ann:LHJC"]);
    let limbs = live_limbs(Some(&subject), &two);
    let told: Vec<_> = limbs.iter().map(|limb| (limb.ends, limb.length_mm, limb.off_mm)).collect();
    assert_eq!(told, [([4, 3], 400.0, 40.0), ([3, 2], 300.0, 50.0)]);
    // No line is drawn twice, whichever way it goes.
    assert_eq!(with_limbs(vec![[2, 3], [0, 1]], &limbs), [[2, 3], [0, 1], [4, 3]]);
    assert!(live_limbs(None, &two).is_empty());
    subject.set(Subject::SKELETON, b"{}".to_vec());
    assert!(live_limbs(Some(&subject), &two).is_empty());
}
