//! Detection of touching limbs.

use mocapd_body::ScanAnalysis;
use mocapd_body::skeleton::Method;
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

#[test]
fn free_limbs_are_certain_on_every_body_and_in_every_pose() {
    for seed in 0..3 {
        for pose in Pose::ALL {
            let (mesh, _) = body(seed, pose, BodyOptions::default());
            let analysis = ScanAnalysis::new(&mesh, Method::Default).unwrap();
            assert!(!analysis.in_contact, "{seed} {pose:?}");
        }
    }
}
