//! Occlusions of a face: glasses, a beard, hair over the forehead.

/// Glasses, beard, fringe and light of a sitter; none by default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Occlusions {
    /// Thickness of the rims of glasses; 0 for none.
    pub rims_mm: f64,
    /// Density of a beard: 0 is none, 1 covers the skin.
    pub beard: f64,
    /// Length of the fringe below the hairline; the brows are 50 mm below it.
    pub fringe_mm: f64,
    /// Direction to the light in the camera's frame (right, up, towards the camera); random if `None`.
    pub light: Option<[f64; 3]>,
}

/// Centre and semi-axes of the rim around an eye, mm.
const RIM: ([f64; 2], [f64; 2]) = ([33.0, -3.0], [24.0, 19.0]);
/// Position of the bridge and half its width, mm.
const BRIDGE: ([f64; 2], f64) = ([0.0, 4.0], 9.0);
const HAIRLINE_MM: f64 = 66.0;
/// Upper edge of a beard in the middle, and x and y of it at the ears, mm.
const MOUSTACHE_MM: f64 = -47.0;
const CHEEKS: (f64, f64) = (45.0, -30.0);

impl Occlusions {
    /// Whether all values can be drawn.
    pub(super) fn is_finite(&self) -> bool {
        let lengths = [self.rims_mm, self.beard, self.fringe_mm];
        lengths.iter().chain(self.light.iter().flatten()).all(|v| v.abs() < 1e3)
    }

    /// Coverage of a point on the average face by the rims, 0 to 1.
    pub(super) fn rim(&self, [x, y]: [f64; 2]) -> f64 {
        if self.rims_mm <= 0.0 {
            return 0.0;
        }
        let (middle, radii) = RIM;
        let reach = ((x.abs() - middle[0]) / radii[0]).hypot((y - middle[1]) / radii[1]);
        let ring = (reach - 1.0).abs() * radii[1];
        let bridge = if x.abs() < BRIDGE.1 { (y - BRIDGE.0[1]).abs() } else { f64::INFINITY };
        (self.rims_mm / 2.0 - ring.min(bridge) + 0.5).clamp(0.0, 1.0)
    }

    /// Coverage of a point on the average face by hair, 0 to 1; the caller keeps the lips free.
    pub(super) fn hair(&self, [x, y]: [f64; 2]) -> f64 {
        // A beard's upper edge drops from the ears to the corners of the mouth, with a moustache under the nose.
        let aside = (x.abs() / CHEEKS.0).min(1.5);
        let edge =
            if aside < 0.6 { MOUSTACHE_MM } else { CHEEKS.1 - 60.0 * (1.2 - aside).max(0.0) };
        let beard = self.beard * ((edge - y) / 6.0).clamp(0.0, 1.0);
        let ragged = HAIRLINE_MM - self.fringe_mm + 3.0 * (0.35 * x).sin() + 0.0015 * x * x;
        let fringe = if self.fringe_mm > 0.0 { ((y - ragged) / 3.0).clamp(0.0, 1.0) } else { 0.0 };
        beard.max(fringe).clamp(0.0, 1.0)
    }
}
