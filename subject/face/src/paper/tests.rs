use super::{RotatedBox, blocks, direction_rad, faces};
use crate::Photo;
use crate::plane::{Labels, Mask};

/// A face of ellipses, `half` pixels half as wide, rotated by `roll_rad`, in front of a blue wall.
fn drawn(half: f32, roll_rad: f32) -> Photo {
    let (sin, cos) = roll_rad.sin_cos();
    let pixels = (0..200 * 200)
        .map(|i| {
            let (dx, dy) = ((i % 200) as f32 - 100.0, (i / 200) as f32 - 100.0);
            let (x, y) = ((dx * cos + dy * sin) / half, (dy * cos - dx * sin) / half);
            let inside = |cx: f32, cy: f32, wide: f32, high: f32| {
                ((x.abs() - cx) / wide).hypot((y - cy) / high) < 1.0
            };
            let features = [
                inside(0.41, -0.59, 0.27, 0.07),
                inside(0.42, -0.32, 0.21, 0.10),
                inside(0.0, 0.33, 0.2, 0.06),
                inside(0.0, 0.74, 0.38, 0.12),
            ];
            match (inside(0.0, 0.0, 1.0, 1.3), features) {
                (true, [.., true]) => [120, 40, 60],
                (true, [false, false, false, false]) => [200, 146, 122],
                (true, _) => [50, 45, 44],
                (false, _) => [90, 110, 170],
            }
        })
        .collect();
    Photo::from_pixels(200, 200, pixels).unwrap()
}

#[test]
fn a_drawn_face_is_found_with_its_roll() {
    for (half, roll_rad) in [(40.0, 0.0), (60.0, 0.0), (55.0, 0.3), (55.0, -0.4)] {
        let found = faces(&drawn(half, roll_rad));
        let [found] = found.as_slice() else {
            panic!("{half} {roll_rad}: {found:?}");
        };
        assert!((found.roll_rad - f64::from(roll_rad)).abs() < 0.05, "{}", found.roll_rad);
        let (sin, cos) = f64::from(roll_rad).sin_cos();
        let half = f64::from(half);
        let place = |x: f64, y: f64| {
            [100.0 + half * (x * cos - y * sin), 100.0 + half * (x * sin + y * cos)]
        };
        for (eye, side) in found.eyes.iter().zip([-0.42, 0.42]) {
            let at = place(side, -0.32);
            let off = (eye[0] - at[0]).hypot(eye[1] - at[1]) / found.interocular_px;
            assert!(off < 0.15, "{roll_rad}: {off}");
        }
        // The left eye is at the picture's left.
        assert!(found.eyes[0][0] < found.eyes[1][0]);
    }
}

#[test]
fn skin_without_holes_is_not_a_face() {
    let pixels = (0..120 * 120)
        .map(|i: i32| {
            let inside = (i % 120 - 60).pow(2) + (i / 120 - 60).pow(2) < 45 * 45;
            if inside { [200, 146, 122] } else { [40, 90, 160] }
        })
        .collect();
    assert_eq!(faces(&Photo::from_pixels(120, 120, pixels).unwrap()), []);
    let black = Photo::from_pixels(40, 40, vec![[0; 3]; 1600]).unwrap();
    assert_eq!(faces(&black), []);
}

#[test]
fn axes_are_averaged_as_axes() {
    // Two bars, slightly to either side of upright: their axial mean is upright, unlike the arithmetic mean of the
    // angles.
    let bars = Mask::from_values(
        40,
        40,
        (0..1600)
            .map(|i: i32| {
                let (x, y) = (i % 40, i / 40);
                (x - 8 - y / 8).abs() < 2 || (x - 32 + y / 8).abs() < 2
            })
            .collect(),
    );
    let blobs = Labels::of(&bars, true).blobs;
    assert_eq!(blobs.len(), 2);
    assert!((direction_rad(&blobs).abs() - std::f64::consts::FRAC_PI_2).abs() < 0.02);
    assert_eq!(direction_rad(&[]), 0.0);
}

#[test]
fn a_block_keeps_its_ten_largest_holes() {
    let inside = |x: usize, y: usize| {
        let hole = |c: usize| (c - 4) % 12 < 4;
        !(4..94).contains(&x) || !(4..94).contains(&y) || !hole(x) || !hole(y)
    };
    let mask = Mask::from_values(98, 98, (0..98 * 98).map(|i| inside(i % 98, i / 98)).collect());
    let blocks = blocks(&mask);
    assert_eq!(blocks.len(), 1);
    assert_eq!(blocks[0].holes.len(), 10);
    // A square with the minimum height of a face.
    assert!(RotatedBox::around(&blocks[0].skin, 0.0).is_some());
}
