//! Between two recorded frames.

use mocapd_take::motion::{GAP, Motion, Position, is_gap};

/// Appends every marker between frame `before` and the next one; `part` in (0, 1) of the way.
pub(super) fn between(motion: &Motion, before: usize, part: f64, row: &mut Vec<Position>) {
    let here = motion.frame(before);
    let next = motion.frame(before + 1);
    let earlier = before.checked_sub(1).map_or(&[][..], |i| motion.frame(i));
    let later = motion.frame(before + 2);
    for (marker, &p1) in here.iter().enumerate() {
        let get = |frame: &[Position]| frame.get(marker).copied().filter(|p| !is_gap(*p));
        row.push(match get(next) {
            Some(p2) if !is_gap(p1) => cubic(get(earlier), p1, p2, get(later), part),
            _ => GAP,
        });
    }
}

/// The cubic between `p1` and `p2` whose slopes are the neighbours' chords.
///
/// Catmull and Rom, "A class of local interpolating splines", 1974; Hermite form. At the end of a run the slope
/// is that of the piece itself: a parabola there, a line where both ends are.
fn cubic(
    p0: Option<Position>,
    p1: Position,
    p2: Position,
    p3: Option<Position>,
    x: f64,
) -> Position {
    let mut out = [0.0; 3];
    for (axis, value) in out.iter_mut().enumerate() {
        let at = |p: Position| f64::from(p[axis]);
        let (a, b) = (at(p1), at(p2));
        let from = p0.map_or(b - a, |p| 0.5 * (b - at(p)));
        let to = p3.map_or(b - a, |p| 0.5 * (at(p) - a));
        let d = b - a;
        let (c2, c3) = (3.0 * d - 2.0 * from - to, from + to - 2.0 * d);
        *value = (a + x * (from + x * (c2 + x * c3))) as f32;
    }
    out
}
