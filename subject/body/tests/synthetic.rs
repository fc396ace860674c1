//! Seeded bodies with known joints, from a mesh to a skeleton and a picture.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod synthetic {
    mod contact;
    mod extremity;
    mod neck;
    mod paper;
    mod picture;
    mod plausible;
    mod repair;
    mod skeleton;
}
