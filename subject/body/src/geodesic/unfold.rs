//! Two triangles laid into one plane.

/// How long the straight way from `from` to `to` is across the edge that their triangles share, when both lie in one
/// plane; none if that way would leave the two triangles, since one along edges is then as short.
///
/// On the edge's own axis each corner is an offset along it and a height above it. The heights point to opposite sides
/// once unfolded, so they add.
pub(super) fn across([a, b]: [[f64; 3]; 2], from: [f64; 3], to: [f64; 3]) -> Option<f64> {
    let axis = minus(b, a);
    let squared = dot(axis, axis);
    if squared <= 0.0 {
        return None;
    }
    let edge = squared.sqrt();
    let corner = |point: [f64; 3]| {
        let arm = minus(point, a);
        let along = dot(arm, axis) / edge;
        (along, (dot(arm, arm) - along * along).max(0.0).sqrt())
    };
    let ((x_from, y_from), (x_to, y_to)) = (corner(from), corner(to));
    let height = y_from + y_to;
    if height <= 0.0 {
        return None;
    }
    let crossing = x_from + (x_to - x_from) * y_from / height;
    let inside = crossing > 0.0 && crossing < edge;
    inside.then(|| (x_to - x_from).hypot(height))
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
