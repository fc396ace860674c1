//! What annotators mean by a point, which is not quite where an edge is.

use super::search::Point;

/// Where annotators of iBUG-68 have a point, from where this chain has it: in outer eye corners' distances, x to the right
/// of the picture, y down. By the point's number on the subject's right; learned on the development photographs by
/// `--example faces_points offsets`.
const OFFSETS_IO: [(usize, [f64; 2]); 23] = [
    (17, [0.044, 0.033]),
    (18, [0.027, 0.031]),
    (19, [-0.034, 0.007]),
    (20, [-0.014, 0.021]),
    (21, [-0.068, -0.009]),
    (31, [0.012, 0.027]),
    (32, [-0.006, 0.007]),
    (33, [0.000, 0.009]),
    (36, [0.019, 0.038]),
    (37, [-0.015, 0.008]),
    (38, [0.000, 0.010]),
    (39, [-0.016, 0.025]),
    (40, [0.001, 0.025]),
    (41, [-0.007, 0.020]),
    (48, [-0.013, -0.016]),
    (49, [-0.030, 0.015]),
    (50, [-0.014, 0.008]),
    (51, [0.000, 0.024]),
    (57, [0.000, -0.022]),
    (58, [-0.022, -0.010]),
    (59, [-0.045, -0.052]),
    (62, [0.000, 0.021]),
    (66, [0.000, -0.004]),
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
