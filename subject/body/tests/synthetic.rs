//! Seeded bodies with known joints, from a mesh to a skeleton and a picture.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod synthetic {
    mod extremity;
    mod paper;
    mod picture;
    mod repair;
    mod scan_faults;
    mod skeleton;
}
