//! Whether limbs touch.

use mocapd_body::Survey;
use mocapd_body::skeleton::Method;
use mocapd_testkit::synthetic_body::{Options, Pose, body};

#[test]
fn free_limbs_are_in_no_doubt_whoever_it_is_and_however_he_stands() {
    for seed in 0..3 {
        for pose in Pose::ALL {
            let (mesh, _) = body(seed, pose, Options::default());
            let analysis = Survey::new(&mesh, Method::Default).unwrap();
            assert!(!analysis.in_contact, "{seed} {pose:?}");
        }
    }
}
