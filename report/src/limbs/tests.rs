use mocapd_take::motion::{GAP, Marker, MotionInfo};

use super::*;

const RATE_HZ: f64 = 100.0;
const LABELS: [&str; 10] = [
    "l_shoulder",
    "l_elbow",
    "l_wrist",
    "r_shoulder",
    "r_elbow",
    "r_wrist",
    "l_hip",
    "l_knee",
    "l_ankle",
    "stick",
];
const BONES: [(&str, usize, usize, f64); 7] = [
    ("l_upper_arm", 0, 1, 300.0),
    ("l_forearm", 1, 2, 260.0),
    ("r_upper_arm", 3, 4, 300.0),
    ("r_forearm", 4, 5, 260.0),
    ("l_thigh", 6, 7, 430.0),
    ("l_shank", 7, 8, 420.0),
    ("shoulders", 0, 3, 360.0),
];

fn bones() -> Vec<Bone> {
    BONES
        .map(|(name, parent, child, length_mm)| Bone {
            name: name.to_owned(),
            parent: LABELS[parent].to_owned(),
            child: LABELS[child].to_owned(),
            length_mm,
            uncertainty_mm: Some(8.0),
            spread_mm: None,
            scans: 1,
        })
        .to_vec()
}

/// Arms and legs that swing at up to 30 rad/s, so that wrists exceed 15 m/s; bones keep their lengths, except that
/// markers slide by up to `slide_mm`.
fn motion(n_rows: usize, slide_mm: f64) -> Motion {
    let mut positions_mm = Vec::new();
    for row in 0..n_rows {
        let t = row as f64 / RATE_HZ;
        let mut at = [[0.0_f64; 3]; LABELS.len()];
        let x = 2000.0 * (0.8 * t).sin();
        at[0] = [x, 180.0, 1400.0];
        at[3] = [x, -180.0, 1400.0];
        at[6] = [x, 90.0, 900.0];
        for (i, (_, parent, child, length_mm)) in BONES[..6].iter().enumerate() {
            // Swings of several rates, so that speeds rise and fall.
            let angle = 2.0 * (1.7 * t + i as f64).sin() + 2.5 * (8.0 * t + 2.0 * i as f64).sin();
            let (sin, cos) = angle.sin_cos();
            let slid = length_mm + slide_mm * (3.0 * t + i as f64).sin();
            let from = at[*parent];
            at[*child] = [from[0] + slid * sin, from[1] + 20.0 * cos, from[2] - slid * cos];
        }
        at[9] = [x + 900.0, 0.0, 300.0];
        positions_mm.extend(at.map(|at| at.map(|value| value as f32)));
    }
    let marker = |label: &str| Marker { label: label.to_owned(), labelled: true };
    let markers = LABELS.map(marker).to_vec();
    let n_frames = n_rows as u64;
    let info = MotionInfo { rate_hz: RATE_HZ, n_frames, markers, ..Default::default() };
    Motion { info, positions_mm }
}

fn swap(motion: &mut Motion, [a, b]: [usize; 2], rows: Range<usize>) {
    for row in rows {
        motion.positions_mm.swap(row * LABELS.len() + a, row * LABELS.len() + b);
    }
}

fn check_all(motion: &Motion) -> LimbCheck {
    let (limbs, columns) = limbs(&bones(), &LABELS, "");
    assert_eq!((limbs.len(), columns.len()), (7, 10));
    check(motion, &limbs, &columns)
}

#[test]
fn fast_moves_are_not_swaps() {
    let clean = motion(3000, 12.0);
    let found = check_all(&clean);
    assert_eq!((found.swaps, found.outside), (vec![], vec![]));
    for (lengths, (name, _, _, length_mm)) in found.lengths.iter().zip(BONES) {
        assert_eq!((lengths.frames, lengths.frames_outside), (3000, 0), "{name}");
        assert!((lengths.median_mm - length_mm).abs() < 13.0, "{name}: {lengths:?}");
    }
}

#[test]
fn swaps_are_found_with_their_markers_and_frames() {
    // Both wrists; knee and ankle; a joint and a marker elsewhere; and a swap that lasts for most of the take.
    for (pair, rows) in
        [([2, 5], 400..700), ([7, 8], 100..130), ([1, 9], 1000..1004), ([4, 8], 300..1700)]
    {
        let mut swapped = motion(2000, 12.0);
        swap(&mut swapped, pair, rows.clone());
        let found = check_all(&swapped);
        assert_eq!(found.swaps.len(), 1, "{pair:?}: {found:?}");
        assert_eq!((found.swaps[0].markers, &found.swaps[0].rows), (pair, &rows));
        assert!(!found.swaps[0].limbs.is_empty());
        assert_eq!(found.outside, vec![], "{pair:?}: the swap explains it all");
    }
}

#[test]
fn concurrent_and_overlapping_swaps_are_distinguished() {
    let mut swapped = motion(2000, 5.0);
    swap(&mut swapped, [2, 5], 400..700);
    swap(&mut swapped, [7, 8], 500..600);
    swap(&mut swapped, [0, 3], 1200..1300);
    let found = check_all(&swapped).swaps;
    let swaps: Vec<_> = found.iter().map(|swap| (swap.markers, swap.rows.clone())).collect();
    assert_eq!(swaps, [([2, 5], 400..700), ([7, 8], 500..600), ([0, 3], 1200..1300)]);
}

#[test]
fn a_marker_that_fell_off_is_not_a_swap() {
    let mut fallen = motion(1000, 5.0);
    for row in 600..800 {
        let drop_mm = 400.0 * ((row - 600) as f32 / 100.0).min(1.0);
        fallen.positions_mm[row * LABELS.len() + 8][1] += drop_mm;
    }
    let found = check_all(&fallen);
    assert_eq!(found.swaps, vec![]);
    assert_eq!(found.outside.len(), 1, "{:?}", found.outside);
    let outside = &found.outside[0];
    assert_eq!(bones()[outside.limb].name, "l_shank");
    // Pulled across the limb: it is a tenth longer, 462 mm, when the marker is off by 192 mm.
    assert!((648..660).contains(&outside.rows.start) && outside.rows.end == 800, "{outside:?}");
    assert!(outside.extreme_mm > 550.0, "{outside:?}");
}

#[test]
fn a_swap_that_begins_in_a_gap_counts_if_it_lasts() {
    for (length, n) in [(60, 1), (3, 0)] {
        let mut swapped = motion(1000, 5.0);
        swap(&mut swapped, [2, 5], 500..500 + length);
        for row in 470..500 {
            swapped.positions_mm[row * LABELS.len() + 2] = GAP;
        }
        for row in 500 + length..530 + length {
            swapped.positions_mm[row * LABELS.len() + 5] = GAP;
        }
        assert_eq!(check_all(&swapped).swaps.len(), n, "{length} frames");
    }
}

#[test]
fn motions_without_limbs_or_samples_are_valid() {
    let (none, columns) = limbs(&bones(), &["u001", "u002"], "");
    assert!(none.is_empty() && columns.is_empty());
    assert_eq!(check(&motion(10, 0.0), &none, &columns), LimbCheck::default());
    let mut gaps = motion(50, 0.0);
    gaps.positions_mm.fill(GAP);
    let found = check_all(&gaps);
    assert!(found.swaps.is_empty() && found.lengths.iter().all(|of| of.frames == 0));
    assert_eq!(check_all(&motion(0, 0.0)).lengths.len(), 7);
}

#[test]
fn the_named_subject_is_measured() {
    let labels = ["Ann:LKNE", "Ann:LANK", "Bob:LHIP", "Bob:LKNE", "Bob:LANK"];
    let bones = &bones()[4..6];
    assert_eq!(limbs(bones, &labels, "").0.len(), 2, "Bob has more of them");
    let (of_ann, columns) = limbs(bones, &labels, "ann");
    assert_eq!((of_ann[0].ends, of_ann.len(), columns), ([0, 1], 1, vec![0, 1]));
}

#[test]
fn a_length_is_off_beyond_uncertainty_and_a_tenth() {
    let limb =
        |uncertainty_mm| Limb { bone: Bone { uncertainty_mm, ..bones()[0].clone() }, ends: [0, 1] };
    for sure in [limb(Some(8.0)), limb(None)] {
        assert!(!sure.is_off(329.0) && sure.is_off(331.0) && sure.is_off(269.0));
    }
    assert!(!limb(Some(50.0)).is_off(345.0) && limb(Some(50.0)).is_off(351.0));
}
