//! What annotators mean by a point, which is not quite where an edge is.

use super::search::Point;

/// Where annotators of iBUG-68 have a point, from where this chain has it: in outer eye corners' distances, x to the right
/// of the picture, y down. By the point's number on the subject's right; learned on the development photographs by
/// `--example faces_points offsets`.
const OFFSETS_IO: [(usize, [f64; 2]); 23] = [
    (17, [0.044, 0.037]),
    (18, [0.026, 0.025]),
    (19, [-0.030, 0.003]),
    (20, [-0.012, 0.018]),
    (21, [-0.069, -0.015]),
    (31, [0.015, 0.023]),
    (32, [-0.005, 0.011]),
    (33, [0.000, 0.009]),
    (36, [0.013, 0.035]),
    (37, [-0.016, 0.007]),
    (38, [0.002, 0.009]),
    (39, [-0.011, 0.018]),
    (40, [0.007, 0.024]),
    (41, [-0.003, 0.017]),
    (48, [-0.010, -0.011]),
    (49, [-0.026, 0.014]),
    (50, [-0.015, 0.006]),
    (51, [0.000, 0.020]),
    (57, [0.000, -0.028]),
    (58, [-0.020, -0.004]),
    (59, [-0.042, -0.038]),
    (62, [0.000, 0.015]),
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
