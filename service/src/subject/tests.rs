use std::{collections::HashSet, fs};

use mocapd_report::labels::marker_lines;
use mocapd_simulator::generator::{BONES, SITES};

use super::*;

const SKELETON: &str = r#"{"format":"mocapd-skeleton","version":1,"method":"default","sources":[{"name":"a.obj",
"sha256":"00ff","unit":"m","unit_inferred":true}],"stature_mm":1750.5,"sides_told":true,"joints":[
{"name":"l_shoulder","position_mm":[1,2,3],"uncertainty_mm":8},{"name":"l_elbow","position_mm":[1,2,3],"uncertainty_mm":7}],
"bones":[{"name":"l_upper_arm","parent":"l_shoulder","child":"l_elbow","length_mm":300,"uncertainty_mm":6,"spread_mm":null,
"scans":1}],"notes":[]}"#;
const FACE: &str = r#"{"format":"mocapd-face","version":1,"vertices_mm":[[0,0,0],[1,2,3]],"lines":[[0,1]],"features":{}}"#;

const MARKERS: &str =
    r#"{"format":"mocapd-face-mapping","version":1,"markers":[{"label":"a","at":1}]}"#;

#[test]
fn files_become_a_subject_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        Some(path)
    };
    let files = SubjectFiles {
        name: Some("Anna".to_owned()),
        skeleton: path("s.json", SKELETON),
        face: path("f.json", FACE),
        face_markers: path("m.json", MARKERS),
    };
    let subject = files.load().unwrap().unwrap();
    assert_eq!(subject.name, "Anna");
    assert_eq!(subject.document(Subject::SKELETON), Some(SKELETON.as_bytes()));
    assert_eq!(subject.document(Subject::FACE), Some(FACE.as_bytes()));
    assert_eq!(subject.document(Subject::FACE_MARKERS), Some(MARKERS.as_bytes()));
    assert_eq!(mapping(Some(&subject)).unwrap().unwrap().markers.len(), 1);
    let bones = skeleton(Some(&subject)).unwrap().unwrap().bones;
    assert_eq!((bones.len(), bones[0].length_mm, bones[0].uncertainty_mm), (1, 300.0, Some(6.0)));
    assert_eq!(face(Some(&subject)).unwrap().unwrap().vertices_mm.len(), 2);
    assert_eq!(SubjectFiles::default().load().unwrap(), None);
    assert_eq!(skeleton(None).unwrap(), None);

    let refused = |files: SubjectFiles| format!("{:#}", files.load().unwrap_err());
    let missing = Some(folder.path().join("none.json"));
    let why = refused(SubjectFiles { skeleton: missing, ..Default::default() });
    assert!(why.contains("none.json") && !why.contains("mocapd subject"), "{why}");
    let why = refused(SubjectFiles { face: path("s.json", SKELETON), ..Default::default() });
    assert!(why.contains("s.json") && why.contains("`mocapd subject face -o`"), "{why}");
    let why = refused(SubjectFiles { face_markers: path("m.json", MARKERS), ..Default::default() });
    assert!(why.contains("m.json"), "its face is not given: {why}");
    let why = refused(SubjectFiles {
        face: path("f.json", FACE),
        face_markers: path("n.json", &MARKERS.replace("\"at\":1", "\"at\":2")),
        ..Default::default()
    });
    for fact in ["n.json", "a at 2", "0 to 1"] {
        assert!(why.contains(fact), "{fact}: {why}");
    }
    let why = refused(SubjectFiles {
        face: path("f.json", FACE),
        face_markers: path("n.json", &MARKERS.replace("\"at\":1", "\"at\":\"nose\"")),
        ..Default::default()
    });
    assert!(why.contains("a at \"nose\""), "{why}");
    let why = refused(SubjectFiles {
        face: path("f.json", FACE),
        face_markers: path("s.json", SKELETON),
        ..Default::default()
    });
    assert!(why.contains("s.json") && why.contains("singing-face-mapping.json"), "{why}");
    let why = refused(SubjectFiles { face: path("l", &" ".repeat(1 << 21)), ..Default::default() });
    assert!(why.contains("1048576"), "{why}");
}

#[test]
fn invalid_skeletons_are_explained() {
    let refused = |text: &str| format!("{:#}", Skeleton::from_json(text.as_bytes()).unwrap_err());
    let mut reasons = HashSet::new();
    let made_by = "`mocapd subject body -o`";
    for (from, to, fact) in [
        ("mocapd-skeleton", "mocapd-face", "mocapd-face"),
        ("\"version\":1", "\"version\":2", "version 2"),
        ("\"length_mm\":300", "\"length_mm\":-3", "`bones[0].length_mm` is -3"),
        ("\"child\":\"l_elbow\"", "\"child\":\"l_knee\"", "`bones[0].child` is l_knee"),
        ("\"name\":\"l_elbow\"", "\"name\":\"l_shoulder\"", "`joints[1].name` is l_shoulder"),
        ("\"length_mm\":300", "\"length_mm\":\"long\"", "length_mm"),
        ("{", "", made_by),
        ("{", "no {", made_by),
        ("\"mocapd-skeleton\"", "7", made_by),
        ("\"format\":\"mocapd-skeleton\",", "", made_by),
    ] {
        let found = refused(&SKELETON.replacen(from, to, 1));
        assert!(found.contains(fact) && found.contains("mocapd-skeleton"), "{found}");
        assert!(reasons.insert(found.clone()), "{from}: said before: {found}");
    }
    for cut in (0..SKELETON.len() - 1).step_by(7) {
        assert!(Skeleton::from_json(&SKELETON.as_bytes()[..cut]).is_err(), "{cut}");
    }
}

#[test]
fn invalid_faces_are_explained() {
    let refused = |text: &str| format!("{:#}", FittedFace::from_json(text.as_bytes()).unwrap_err());
    let nowhere = refused(&FACE.replace("[[0,1]]", "[[0,2]]"));
    let flat = refused(&FACE.replace("[1,2,3]", "[1,2]"));
    let (skeleton, list) = (refused(SKELETON), refused("[]"));
    assert!(skeleton.contains("mocapd-skeleton"), "{skeleton}");
    assert!(list.contains("`mocapd subject face -o`"), "{list}");
    // The parser's message comes after it.
    let cut = refused(&FACE[..40]);
    assert!(cut.contains("EOF while parsing"), "{cut}");
    let reasons = HashSet::from([nowhere, flat, skeleton, list, cut]);
    assert!(reasons.len() == 5 && reasons.iter().all(|why| why.contains("mocapd-face")));
    let binary = FittedFace::from_json(&[0xff; 9]).unwrap_err().to_string();
    assert_eq!(binary.matches("line 1 column 1").count(), 1, "the parser's words, once: {binary}");
    let binary = Mapping::from_json(&[0xff; 9]).unwrap_err().to_string();
    assert!(binary.contains("singing-face-mapping.json"), "{binary}");
}

fn labels(names: &[&str]) -> Vec<String> {
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
    assert_eq!(marker_lines(&with_clusters), marker_lines(&labels(&SITES)));
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
    let found: Vec<_> = limbs.iter().map(|limb| (limb.ends, limb.length_mm, limb.off_mm)).collect();
    assert_eq!(found, [([4, 3], 400.0, 40.0), ([3, 2], 300.0, 50.0)]);
    // No line is drawn twice, regardless of its direction.
    assert_eq!(with_limbs(vec![[2, 3], [0, 1]], &limbs), [[2, 3], [0, 1], [4, 3]]);
    assert!(live_limbs(None, &two).is_empty());
    subject.set(Subject::SKELETON, b"{}".to_vec());
    assert!(live_limbs(Some(&subject), &two).is_empty());
}
