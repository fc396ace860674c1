//! The noise estimate is the same everywhere: by fourth differences, per axis.

use mocapd_codec::Settings;
use mocapd_report::{
    decoded::DecodedTake,
    plot::{MarkerQuality, QualityPlot},
};
use mocapd_service::control::Control;
use mocapd_take::motion::Motion;

use crate::{
    cli::devices::Simulated,
    service::engine::{Room, at, room, wait_until},
    support::{config, dense, jump, lossless, record},
};

const RATE_HZ: f64 = 240.0;

/// Standard deviation of a marker's noise on one axis.
fn noise_mm(marker: usize) -> f64 {
    0.1 + 0.02 * marker as f64
}

/// Normal numbers from a seed.
struct Normal(u64);

impl Normal {
    fn next(&mut self) -> f64 {
        let uniform = |state: &mut u64| {
            *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_041);
            (*state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform(&mut self.0)).sum::<f64>() - 6.0
    }
}

/// Every second marker stands still, the others swing as an arm does while they walk; all with noise.
fn noisy() -> Motion {
    let mut motion = jump(1, RATE_HZ, 8.0);
    let n_markers = motion.info.markers.len();
    let mut normal = Normal(11);
    for (i, position) in motion.positions_mm.iter_mut().enumerate() {
        let (frame, marker) = (i / n_markers, i % n_markers);
        let t = if marker % 2 == 0 { 0.0 } else { frame as f64 / RATE_HZ };
        let phase = marker as f64;
        let path = [900.0 * t, 150.0 * (6.0 * t + phase).sin(), 90.0 * (11.0 * t + phase).cos()];
        *position = path.map(|at| (at + 100.0 * phase + noise_mm(marker) * normal.next()) as f32);
    }
    motion
}

/// The noise that `plot quality` shows.
fn shown(
    motion: &Motion,
    settings: Settings,
    original: Option<(&Motion, Option<Settings>)>,
) -> Vec<Option<f64>> {
    let take = record(motion, &config(motion, settings), 0..motion.n_frames()).1;
    let decoded = DecodedTake::read(&take[..]).unwrap();
    let all = MarkerQuality::all(&QualityPlot {
        name: "noisy",
        take: &decoded,
        original: original.map(|(motion, _)| motion),
        original_settings: original.and_then(|(_, settings)| settings),
    });
    all.into_iter().map(|marker| marker.noise_mm).collect()
}

#[track_caller]
fn assert_near(found: &[Option<f64>], within: f64) {
    assert_eq!(found.len(), 15);
    for (marker, found) in found.iter().enumerate() {
        let found = found.unwrap_or_else(|| panic!("marker {marker} has no figure"));
        let off = found / noise_mm(marker) - 1.0;
        assert!(off.abs() < within, "marker {marker}: {found} mm of {}", noise_mm(marker));
    }
}

#[test]
fn the_noise_of_a_take_is_that_of_its_markers_or_is_not_shown() {
    let motion = noisy();
    assert_near(&shown(&motion, lossless(), None), 0.1);
    assert_near(&shown(&motion, dense(1.0), Some((&motion, None))), 0.1);
    assert_eq!(shown(&motion, dense(1.0), Some((&motion, Some(dense(1.0))))), [None; 15]);
    // With a tolerance of ten times the noise there is no estimate.
    assert_eq!(shown(&motion, dense(1.0), None), [None; 15]);
    // With a fine tolerance there still is one.
    assert_near(&shown(&motion, dense(0.02), None), 0.1);
}

#[test]
fn the_service_shows_the_same_figure_of_the_markers_that_come() {
    let motion = noisy();
    let device = Simulated::endless(motion);
    let path = device.path.clone();
    let Room { directory: _directory, device: _other, engine } = room(|options| {
        options.device.uri = at(&path);
        options.arm.at_start = true;
    });
    let figures = || engine.quality().iter().map(|marker| marker.noise_mm).collect::<Vec<_>>();
    wait_until("the noise of every marker", || {
        let figures = figures();
        figures.len() == 15 && figures.iter().all(Option::is_some)
    });
    let quality = engine.quality();
    let figures: Vec<_> = quality.iter().map(|marker| marker.noise_mm).collect();
    // Estimated from a few seconds, each figure has a spread of 8 %.
    assert_near(&figures, 0.3);
    assert!(quality.iter().all(|marker| marker.still_sigma_mm == marker.noise_mm));
}
