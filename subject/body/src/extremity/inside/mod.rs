//! Ends told through the inside of a body, where its limbs touch.
//!
//! Where skin touches skin, a scan grows together, and ways along its surface step from an arm to the hip. Inside, limbs
//! are still thick and the places where they touch are thin: with a layer taken off all over, they come apart. How thick a
//! layer that takes is not known, so several are tried.

mod depth;
mod find;
mod frame;
mod grid;

#[cfg(test)]
mod tests;

pub(super) use find::find;
