//! What annotators mean by a point, which is not quite where an edge is.

use super::search::Point;

/// Where annotators of iBUG-68 have a point, from where this chain has it: in outer eye corners' distances, x to the right
/// of the picture, y down. By the point's number on the subject's right; learned on the development photographs by
/// `--example faces_points offsets`.
const OFFSETS_IO: [(usize, [f64; 2]); 23] = [
    (17, [0.036, 0.023]),
    (18, [0.022, 0.013]),
    (19, [-0.031, -0.025]),
    (20, [0.007, -0.015]),
    (21, [-0.018, -0.035]),
    (31, [-0.004, 0.022]),
    (32, [0.003, 0.012]),
    (33, [0.000, 0.015]),
    (36, [0.027, 0.037]),
    (37, [0.001, 0.023]),
    (38, [0.006, 0.027]),
    (39, [-0.024, 0.020]),
    (40, [0.013, 0.013]),
    (41, [-0.004, 0.018]),
    (48, [-0.012, -0.020]),
    (49, [-0.033, 0.014]),
    (50, [-0.021, 0.006]),
    (51, [0.000, 0.022]),
    (57, [0.000, -0.025]),
    (58, [-0.014, 0.006]),
    (59, [-0.050, -0.013]),
    (62, [0.000, 0.022]),
    (66, [0.000, 0.017]),
];

/// [`OFFSETS_IO`] of either half of the face, x to the right of the picture.
pub(super) fn offset_io(landmark: usize) -> Point {
    let (right, sign) = match landmark {
        22..=26 => (43 - landmark, -1.0),
        34 | 35 => (66 - landmark, -1.0),
        42..=45 => (81 - landmark, -1.0),
        46 | 47 => (87 - landmark, -1.0),
        52..=54 => (102 - landmark, -1.0),
        55 | 56 => (114 - landmark, -1.0),
        _ => (landmark, 1.0),
    };
    let found = OFFSETS_IO.iter().find(|(i, _)| *i == right);
    found.map_or([0.0; 2], |(_, [x, y])| [sign * x, *y])
}
