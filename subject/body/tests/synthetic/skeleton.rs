//! Skeletons of generated bodies, and untrusted documents.

use std::collections::BTreeMap;

use mocapd_body::skeleton::{
    BONES, LEN_MAX, Method, ScanJoints, Skeleton, SkeletonError, Source, joint_name,
};
use mocapd_body::{Estimate, Joint, Joints, Mesh, Repaired, Side, Unit};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| a[axis] + b[axis])
}

fn source(name: &str) -> Source {
    let repaired = Repaired {
        mesh: Mesh::default(),
        unit: Unit::Metre,
        unit_inferred: true,
        genus: 0,
        notes: Vec::new(),
    };
    Source::new(name, name.as_bytes(), &repaired)
}

fn joints(seed: u64, pose: Pose) -> Joints {
    body(seed, pose, BodyOptions { n_faces: 500, turned: true }).1
}

fn scan(pose: Pose, joints: Joints) -> ScanJoints {
    let notes = vec!["seen from above".to_owned()];
    ScanJoints { source: source(&format!("scans/{pose:?}.obj")), joints, unit: Unit::Metre, notes }
}

fn one() -> Skeleton {
    Skeleton::new(Method::Default, &[scan(Pose::A, joints(3, Pose::A))]).unwrap()
}

#[test]
fn one_scan_gives_its_own_lengths() {
    let (skeleton, joints) = (one(), joints(3, Pose::A));
    assert_eq!(skeleton.joints.len(), 15);
    assert_eq!(skeleton.bones.len(), BONES.len());
    for (bone, ends) in skeleton.bones.iter().zip(BONES) {
        let [p, q] = [ends.parent, ends.child].map(|joint| joints.estimates[&joint].position);
        assert!((bone.length_mm - 1000.0 * distance(p, q)).abs() < 1e-3, "{bone:?}");
        assert_eq!((bone.spread_mm, bone.scans), (None, 1));
    }
    let [left, right] = ["l_thigh", "r_thigh"]
        .map(|name| skeleton.bones.iter().find(|bone| bone.name == name).unwrap().length_mm);
    assert!((left - right).abs() < 1e-3);
    assert_eq!(skeleton.sources[0].name, "A.obj");
    assert!(Skeleton::new(Method::Paper, &[]).is_none());
}

/// Every joint is displaced by its uncertainty, in a different direction each time.
fn shaken(mut joints: Joints, step_m: f64, round: usize) -> Joints {
    for (i, estimate) in joints.estimates.values_mut().enumerate() {
        let turn = (7 * i + 3 * round) as f64;
        let off = [turn.sin(), (1.7 * turn).cos(), (2.3 * turn).sin()].map(|c| c * step_m);
        (estimate.position, estimate.sigma) = (add(estimate.position, off), step_m);
    }
    joints
}

#[test]
fn several_scans_are_averaged_and_their_spread_stated() {
    let poses = [Pose::A, Pose::T, Pose::Walk, Pose::Squat, Pose::Sit, Pose::Up];
    let scans: Vec<ScanJoints> = (poses.iter().enumerate())
        .map(|(round, &pose)| scan(pose, shaken(joints(3, pose), 0.01, round)))
        .collect();
    let skeleton = Skeleton::new(Method::Default, &scans).unwrap();
    for (bone, truth) in skeleton.bones.iter().zip(one().bones) {
        let error = (bone.length_mm - truth.length_mm).abs();
        assert!(error < 3.0 * bone.uncertainty_mm.unwrap() + 2.0, "{bone:?} {truth:?}");
        assert_eq!(bone.scans, 6);
        assert!(bone.spread_mm.is_some_and(|mm| mm > 0.5 && mm < 20.0), "{bone:?}");
    }
    let noted = |text: &str| skeleton.notes.iter().any(|note| note.contains(text));
    assert!(noted("l_shoulder: centre of rotation of l_elbow"), "{:?}", skeleton.notes);
}

#[test]
fn moving_limbs_determine_their_centres_of_rotation() {
    // The shoulders of every scan have the same bias of 4 cm: outwards and down.
    let poses = [Pose::A, Pose::T, Pose::Walk, Pose::Squat, Pose::Sit, Pose::Up, Pose::Down];
    let biased = |pose: Pose| {
        let mut joints = joints(4, pose);
        let at = |joint: Joint| joints.estimates[&joint].position;
        let up = [0, 1, 2].map(|k| at(Joint::Throat)[k] - at(Joint::Pelvis)[k]);
        let length = up.iter().map(|c| c * c).sum::<f64>().sqrt();
        let shoulder = joints.estimates.get_mut(&Joint::Shoulder(Side::Left)).unwrap();
        shoulder.position = add(shoulder.position, up.map(|c| -0.04 * c / length));
        shoulder.sigma = 0.04;
        scan(pose, joints)
    };
    let scans: Vec<ScanJoints> = poses.into_iter().map(biased).collect();
    let skeleton = Skeleton::new(Method::Default, &scans).unwrap();
    let truth = joints(4, Pose::A).estimates[&Joint::Shoulder(Side::Left)].position;
    let found = skeleton.joints.iter().find(|joint| joint.name == "l_shoulder").unwrap();
    let error = distance(found.position_mm.unwrap(), truth.map(|c| 1000.0 * c));
    assert!(error < 8.0 && found.uncertainty_mm.unwrap() < 32.0, "{error} {found:?}");
    let bone = skeleton.bones.iter().find(|bone| bone.name == "l_upper_arm").unwrap();
    let other = skeleton.bones.iter().find(|bone| bone.name == "r_upper_arm").unwrap();
    assert!((bone.length_mm - other.length_mm).abs() < 8.0, "{bone:?} {other:?}");
    // With poses that hardly differ, a note explains why no centre was estimated.
    let skeleton =
        Skeleton::new(Method::Default, &[biased(Pose::A), biased(Pose::A), biased(Pose::A)]);
    let notes = skeleton.unwrap().notes;
    assert!(notes.iter().any(|note| note.contains("at least 40 are needed")), "{notes:?}");
}

#[test]
fn scans_of_two_people_get_a_note() {
    let of = |seed| scan(Pose::A, joints(seed, Pose::A));
    let noted = |scans: &[ScanJoints]| {
        let notes = Skeleton::new(Method::Default, scans).unwrap().notes;
        notes.iter().any(|note| note.contains("of several people"))
    };
    assert!(!noted(&[of(3), scan(Pose::T, joints(3, Pose::T))]));
    let mut tall = of(3);
    tall.joints.estimates.values_mut().for_each(|estimate| {
        estimate.position = estimate.position.map(|metres| 1.12 * metres);
    });
    assert!(noted(&[of(3), tall]));
}

#[test]
fn a_stature_is_no_more_certain_than_the_bones() {
    let mut joints = joints(3, Pose::A);
    let sure = Skeleton::new(Method::Default, &[scan(Pose::A, joints.clone())]).unwrap();
    for side in [Side::Left, Side::Right] {
        joints.estimates.get_mut(&Joint::Hip(side)).unwrap().sigma = 0.2;
    }
    let doubted = Skeleton::new(Method::Default, &[scan(Pose::A, joints)]).unwrap();
    assert_eq!(doubted.stature_mm, sure.stature_mm);
    let (sure, doubted) = (sure.stature_uncertainty_mm, doubted.stature_uncertainty_mm);
    assert!(doubted.unwrap() > 3.0 * sure.unwrap(), "{sure:?} {doubted:?}");
}

#[test]
fn undetermined_sides_are_averaged() {
    let mut scans = vec![scan(Pose::A, joints(3, Pose::A)), scan(Pose::T, joints(3, Pose::T))];
    let wrist = scans[1].joints.estimates.get_mut(&Joint::Wrist(Side::Left)).unwrap();
    wrist.position[0] += 0.02;
    scans[1].joints.sides_told = false;
    let skeleton = Skeleton::new(Method::Default, &scans).unwrap();
    let of = |name: &str| skeleton.bones.iter().find(|bone| bone.name == name).unwrap().length_mm;
    assert!(!skeleton.sides_told && of("l_forearm") == of("r_forearm"));
    assert!(of("pelvis_l_hip") == of("pelvis_r_hip"));
    assert!(skeleton.notes.iter().any(|note| note.contains("mean of both sides")));
}

#[test]
fn rewriting_a_document_keeps_it_identical() {
    let unknown = Skeleton { stature_mm: None, stature_uncertainty_mm: None, ..one() };
    for skeleton in [one(), Skeleton { stature_mm: Some(1712.5), ..one() }, unknown] {
        let text = skeleton.to_json();
        let again = Skeleton::from_json(text.as_bytes()).unwrap();
        assert_eq!(again, skeleton);
        assert_eq!(again.to_json(), text);
        assert!(text.starts_with("{\n  \"format\": \"mocapd-skeleton\",\n  \"version\": 1,"));
    }
    // Numbers from other programs are rounded once and stay the same afterwards.
    let text = one().to_json().replacen(
        "\"uncertainty_mm\": 0.0",
        "\"uncertainty_mm\": 0.30000000000000004441",
        1,
    );
    let read = Skeleton::from_json(text.as_bytes()).unwrap();
    assert!(
        read.to_json().contains("\"uncertainty_mm\": 0.3,")
            || read.to_json().contains("\"uncertainty_mm\": 0.3\n")
    );
    let mut named = BTreeMap::new();
    for ends in BONES {
        for joint in [ends.parent, ends.child] {
            assert_eq!(*named.entry(joint_name(joint)).or_insert(joint), joint, "{}", ends.name);
        }
    }
}

#[test]
fn stature_is_computed_in_any_pose_but_not_without_a_bone() {
    for pose in Pose::ALL {
        let (mesh, joints) = body(3, Pose::Down, BodyOptions { n_faces: 5000, turned: false });
        let height = |at: &[f64; 3]| at[1];
        let top = mesh.positions.iter().map(height).fold(f64::NEG_INFINITY, f64::max);
        let sole = mesh.positions.iter().map(height).fold(f64::INFINITY, f64::min);
        let of = |method, joints| Skeleton::new(method, &[scan(pose, joints)]).unwrap();
        let skeleton = of(Method::Default, self::joints(3, pose));
        let (mm, sigma_mm) =
            skeleton.stature_mm.zip(skeleton.stature_uncertainty_mm).expect("a stature");
        assert!((mm - 1000.0 * (top - sole)).abs() < 3.0 * sigma_mm, "{pose:?}: {mm}");
        assert_eq!(of(Method::Paper, joints.clone()).stature_mm, None);
        let mut legless = joints;
        // One leg is as good as both; without either there is no stature.
        legless.estimates.remove(&Joint::Knee(Side::Left));
        assert!(of(Method::Default, legless.clone()).stature_mm.is_some());
        legless.estimates.remove(&Joint::Knee(Side::Right));
        assert_eq!(of(Method::Default, legless).stature_mm, None);
    }
}

#[test]
fn any_joints_can_be_written_and_read_back() {
    let mut odd = joints(3, Pose::A);
    let mut put = |joint: Joint, position: [f64; 3], sigma: f64| {
        odd.estimates.insert(joint, Estimate { position, sigma });
    };
    put(Joint::Head, [f64::NAN, 0.0, 0.0], 0.0);
    put(Joint::Throat, [1e300, 0.0, 0.0], 0.0);
    put(Joint::Knee(Side::Left), [0.0; 3], f64::INFINITY);
    put(Joint::Ankle(Side::Left), [0.0; 3], f64::NAN);
    put(Joint::Hip(Side::Right), [0.0; 3], 1.0);
    put(Joint::Knee(Side::Right), [0.0; 3], 1.0);
    let skeleton = Skeleton::new(Method::Default, &[scan(Pose::A, odd)]).unwrap();
    assert_eq!(skeleton.joints.len(), 12);
    assert!(skeleton.bones.iter().all(|bone| bone.name != "r_thigh"));
    assert!(skeleton.notes.iter().any(|note| note.ends_with("finite position: 3")));
    assert_eq!(Skeleton::from_json(skeleton.to_json().as_bytes()), Ok(skeleton));
}

#[test]
fn an_invalid_document_is_refused_with_the_reason() {
    let text = one().to_json();
    let head = text.find("\"head\"").unwrap();
    for (from, to, expected) in [
        ("mocapd-skeleton", "other", "other"),
        ("\"version\": 1", "\"version\": 2", "version 2 of mocapd-skeleton"),
        (
            "\"version\": 1",
            "\"version\": 0",
            "no version 0 of mocapd-skeleton: write \"version\": 1",
        ),
        ("\"version\": 1,", "", "no version: write \"version\": 1"),
        ("\"default\"", "7", "method: "),
        ("\"sha256\"", "\"sha\"", "`sha256`"),
        ("\"name\": \"throat\"", "\"name\": \"head\"", "`joints[1].name` is head"),
        ("\"name\": \"throat\"", "\"name\": \"neck\"", "`bones[0].child` is throat"),
        ("\"uncertainty_mm\": 0.0", "\"uncertainty_mm\": -1", "`joints[0].uncertainty_mm` is -1"),
        ("\"parent\": \"pelvis\"", "\"parent\": \"throat\"", "`bones[0].child` is throat"),
        ("\"scans\": 1", "\"scans\": -1", "bones[0].scans: "),
        ("\"spread_mm\": null", "\"spread_mm\": -1", "`bones[0].spread_mm` is -1"),
        (
            "\"stature_uncertainty_mm\": ",
            "\"stature_uncertainty_mm\": -",
            "`stature_uncertainty_mm`",
        ),
        ("\"seen from above\"", "[]", "notes[0]: "),
    ] {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{from}");
        let error = Skeleton::from_json(changed.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{from}: {error}");
    }
    let far = text[head..].find('[').unwrap() + head + 1;
    let huge =
        format!("{}1e300,{}", &text[..far], &text[far + text[far..].find(',').unwrap() + 1..]);
    let error = Skeleton::from_json(huge.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("`joints[0].position_mm`"), "{error}");
    let long = vec![b' '; LEN_MAX + 1];
    assert_eq!(Skeleton::from_json(&long), Err(SkeletonError::TooLong(long.len())));
    let deep = "[".repeat(100_000);
    assert!(Skeleton::from_json(deep.as_bytes()).is_err());
}

#[test]
fn foreign_documents_may_have_other_names_and_lack_optional_keys() {
    let text = one().to_json();
    for (from, to) in [
        ("\"version\": 1", "\"version\": 1, \"more\": 2"),
        ("\"default\"", "\"magic\""),
        ("\"unit\": \"m\"", "\"unit\": \"M\""),
        ("\"unit\": \"m\"", "\"camera\": [7]"),
        ("A.obj", ""),
        ("\"l_upper_arm\"", "\"l_wing\""),
        ("\"parent\": \"pelvis\"", "\"parent\": \"head\""),
        ("\"scans\": 1", "\"scans\": 2"),
        ("seen from above", ""),
    ] {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{from}");
        let read = Skeleton::from_json(changed.as_bytes()).unwrap();
        assert_eq!(Skeleton::from_json(read.to_json().as_bytes()), Ok(read), "{to}");
    }
    let renamed = text.replace("\"throat\"", "\"neck\"");
    assert_eq!(Skeleton::from_json(renamed.as_bytes()).unwrap().joints[1].name, "neck");
    // A document as a person would write it by hand from a tape measure.
    let by_hand = r#"{"format":"mocapd-skeleton","version":1,"joints":[{"name":"l_hip"},{"name":"l_knee"}],
        "bones":[{"name":"l_thigh","parent":"l_hip","child":"l_knee","length_mm":412.123456}]}"#;
    let read = Skeleton::from_json(by_hand.as_bytes()).unwrap();
    let joint = &read.joints[0];
    assert_eq!((joint.position_mm, joint.uncertainty_mm, read.stature_mm), (None, None, None));
    let bone = &read.bones[0];
    assert_eq!((bone.length_mm, bone.uncertainty_mm, bone.scans), (412.123456, None, 0));
    assert!(read.method.is_empty() && read.sources.is_empty() && !read.sides_told);
    assert!(read.to_json().contains("\"length_mm\": 412.1235,"), "{}", read.to_json());
}

#[test]
fn any_damage_to_a_document_is_refused_or_harmless() {
    let text = one().to_json().into_bytes();
    for len in 0..text.len() - 1 {
        assert!(Skeleton::from_json(&text[..len]).is_err(), "{len}");
    }
    for at in 0..text.len() {
        let mut changed = text.clone();
        changed[at] ^= 1 << (at % 7);
        if let Ok(read) = Skeleton::from_json(&changed) {
            assert_eq!(Skeleton::from_json(read.to_json().as_bytes()), Ok(read));
        }
    }
}
