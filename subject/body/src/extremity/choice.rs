//! Choices that do not change when a mesh is turned.

/// Two lengths that differ by less than this part of the longer are taken for the same.
///
/// Turning or moving a mesh changes a sum of some hundred lengths in its last digits, some 1e-13 of it; a symmetric body
/// has ties that those digits would break.
const SAME: f64 = 1e-9;

/// The vertex with the greatest finite value, among those that are allowed; of equals, the first.
pub(super) fn farthest(field: &[f64], allowed: impl Fn(u32) -> bool) -> Option<u32> {
    let vertices = || (0_u32..).zip(field).filter(|(at, value)| value.is_finite() && allowed(*at));
    let most = vertices().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max);
    vertices().find(|(_, value)| **value >= most - SAME * most.abs()).map(|(vertex, _)| vertex)
}

/// `length`, so that two that are the same but for their last digits are equal, nearly always.
pub(super) fn rounded(length: f64, unit: f64) -> f64 {
    (length / (SAME * unit)).round()
}
