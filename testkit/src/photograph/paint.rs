//! Colours and shading of a face (skin, lips, brows, eyes), and what covers parts of it: glasses, a beard, hair over
//! the forehead.

use mocapd_face::model::Model;

use super::raster::{Colour, Fragment, unit};
use crate::random::Random;

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
const RIM_AROUND_EYE: ([f64; 2], [f64; 2]) = ([33.0, -3.0], [24.0, 19.0]);
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
        let (middle, radii) = RIM_AROUND_EYE;
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

/// Linear albedo of skin, from very light to very dark.
const SKINS: [Colour; 5] = [
    [0.80, 0.52, 0.39],
    [0.72, 0.43, 0.29],
    [0.55, 0.31, 0.19],
    [0.36, 0.18, 0.10],
    [0.22, 0.11, 0.06],
];
const HAIRS: [Colour; 5] = [
    [0.02, 0.015, 0.01],
    [0.05, 0.03, 0.015],
    [0.12, 0.06, 0.03],
    [0.25, 0.15, 0.06],
    [0.18, 0.17, 0.16],
];
const IRISES: [Colour; 4] =
    [[0.03, 0.015, 0.008], [0.08, 0.04, 0.015], [0.05, 0.07, 0.04], [0.06, 0.10, 0.16]];
const CLOTHES: [Colour; 4] =
    [[0.03, 0.04, 0.12], [0.5, 0.5, 0.5], [0.2, 0.03, 0.03], [0.04, 0.10, 0.06]];
const SCLERA: Colour = [0.72, 0.69, 0.66];
const RIM_COLOUR: Colour = [0.03, 0.03, 0.03];
/// Radius of an iris: its horizontal diameter is 11.7 mm in adults of any size.
const IRIS_MM: f64 = 5.85;
const PUPIL_MM: f64 = 2.0;
const BROW_MM: f64 = 2.6;
const AMBIENT: f64 = 0.42;

/// The colours of one person, and the light on them.
pub(super) struct Palette {
    pub(super) skin: Colour,
    pub(super) hair: Colour,
    pub(super) clothes: Colour,
    iris: Colour,
    lips: Colour,
    light: [f64; 3],
    extras: Occlusions,
}

/// Positions of the features on the average face, in front view. Paint keeps its place on the skin when the shape
/// changes.
pub(super) struct FaceLayout {
    lips: Vec<[f64; 2]>,
    mouth_line: Vec<[f64; 2]>,
    brows: [Vec<[f64; 2]>; 2],
    upper_lids: [Vec<[f64; 2]>; 2],
    pupils: [[f64; 2]; 2],
    nostrils: [[f64; 2]; 2],
}

impl Palette {
    pub(super) fn new(random: &mut Random) -> Self {
        let shade = random.between(0.85, 1.1);
        let skin = random.one_of(&SKINS).map(|c| c * shade);
        // Lips are redder than skin: darker, most of all in green and blue.
        let lips = [skin[0] * 0.80, skin[1] * 0.48, skin[2] * 0.58];
        let light = unit([random.between(-0.7, 0.7), random.between(0.1, 0.8), 1.0]);
        let (hair, clothes, iris) =
            (random.one_of(&HAIRS), random.one_of(&CLOTHES), random.one_of(&IRISES));
        Self { skin, hair, clothes, iris, lips, light, extras: Occlusions::default() }
    }

    /// Adds glasses, beard and fringe, and sets the light if given.
    pub(super) fn with(self, extras: Occlusions) -> Self {
        Self { light: extras.light.map_or(self.light, unit), extras, ..self }
    }

    /// Shades a colour on a surface with this normal.
    pub(super) fn lit(&self, colour: Colour, normal: [f64; 3]) -> Colour {
        let facing: f64 = (0..3).map(|axis| self.light[axis] * normal[axis]).sum();
        // Wrapped diffuse shading: light scatters in skin, so surfaces turned slightly away are also lit.
        let light = AMBIENT + (1.0 - AMBIENT) * ((facing + 0.25) / 1.25).max(0.0);
        colour.map(|c| c * light)
    }

    /// Colour of the face at a fragment.
    pub(super) fn face(&self, layout: &FaceLayout, point: &Fragment) -> Colour {
        let at = [point.place[0], point.place[1]];
        let mut colour = self.skin;
        let mut blend =
            |over: Colour, share: f64| colour = mix(colour, over, share.clamp(0.0, 1.0));
        // Soft edges, about a millimetre wide.
        blend(self.lips, 0.5 + inside(&layout.lips, at));
        blend(self.skin.map(|c| c * 0.18), 0.9 * soft(distance(&layout.mouth_line, at), 0.6));
        for (brow, pupil) in layout.brows.iter().zip(&layout.pupils) {
            // A brow thins out towards the temple.
            let outward = ((at[0].abs() - pupil[0].abs()) / 25.0).clamp(0.0, 1.0);
            blend(self.hair, 0.88 * soft(distance(brow, at), BROW_MM * (1.0 - 0.5 * outward)));
        }
        for lid in &layout.upper_lids {
            blend(self.hair, 0.8 * soft(distance(lid, at), 0.8));
        }
        for nostril in &layout.nostrils {
            let reach = ((at[0] - nostril[0]) / 3.6).hypot((at[1] - nostril[1]) / 2.2);
            blend(self.skin.map(|c| c * 0.12), 0.9 * soft(2.0 * reach, 2.0));
        }
        let skin = 1.0 - (2.0 * inside(&layout.lips, at) + 1.0).clamp(0.0, 1.0);
        colour = mix(colour, self.hair, self.extras.hair(at) * skin);
        self.lit(mix(colour, RIM_COLOUR, self.extras.rim(at)), point.normal)
    }

    /// Colour of the eyeball at a fragment.
    pub(super) fn eye(&self, layout: &FaceLayout, point: &Fragment) -> Colour {
        let at = [point.place[0], point.place[1]];
        let reach = layout.pupils.iter().map(|p| (at[0] - p[0]).hypot(at[1] - p[1]));
        let reach = reach.fold(f64::INFINITY, f64::min);
        let colour = mix(SCLERA, self.iris, soft(reach, IRIS_MM));
        let colour = mix(colour, [0.004; 3], soft(reach, PUPIL_MM));
        // Shadow of the upper lid.
        let lid =
            layout.upper_lids.iter().map(|lid| distance(lid, at)).fold(f64::INFINITY, f64::min);
        let shade = 1.0 - 0.6 * soft(lid, 1.5);
        let colour = self.lit(colour.map(|c| c * shade), point.normal);
        // Reflection of the light.
        let glint = layout.pupils.iter().map(|p| (at[0] - p[0] - 1.6).hypot(at[1] - p[1] - 1.6));
        mix(colour, [0.9; 3], soft(glint.fold(f64::INFINITY, f64::min), 0.7))
    }
}

impl FaceLayout {
    pub(super) fn new(model: &Model) -> Self {
        let at = |name: &str| {
            let vertex = model.features.get(name).and_then(|&v| model.vertices.get(v));
            vertex.map_or([0.0; 2], |v| [v[0], v[1]])
        };
        let sides = ["right", "left"];
        let ring =
            ["right", "top_right_outer", "top_right", "top", "top_left", "top_left_outer", "left"];
        let below =
            ["bottom_left_outer", "bottom_left", "bottom", "bottom_right", "bottom_right_outer"];
        let lips = ring.iter().chain(&below).map(|name| at(&format!("mouth_{name}"))).collect();
        let brow = |side| (1..=5).map(|i| at(&format!("{side}_brow_{i}"))).collect();
        let lid = |side| {
            let names = ["outer", "top_outer", "top_inner", "inner"];
            names.iter().map(|name| at(&format!("{side}_eye_{name}"))).collect()
        };
        let nostril = |side| {
            let (wing, base) = (at(&format!("nose_{side}")), at(&format!("nose_bottom_{side}")));
            [(wing[0] + base[0]) / 2.0, (wing[1] + base[1]) / 2.0 + 0.5]
        };
        Self {
            lips,
            mouth_line: ["mouth_right", "mouth_inner_top", "mouth_left"].map(at).to_vec(),
            brows: sides.map(brow),
            upper_lids: sides.map(lid),
            pupils: sides.map(|side| at(&format!("{side}_pupil"))),
            nostrils: sides.map(nostril),
        }
    }
}

fn mix(under: Colour, over: Colour, share: f64) -> Colour {
    std::array::from_fn(|i| under[i] + share * (over[i] - under[i]))
}

/// 1 inside `radius` and 0 outside it, with a transition of half a millimetre on either side.
fn soft(distance: f64, radius: f64) -> f64 {
    (radius - distance + 0.5).clamp(0.0, 1.0)
}

/// Distance inside a polygon, millimetres; negative outside.
fn inside(polygon: &[[f64; 2]], at: [f64; 2]) -> f64 {
    let closed: Vec<_> = polygon.iter().chain(polygon.first()).copied().collect();
    let crossings = closed.windows(2).filter(|pair| {
        let (a, b) = (pair[0], pair[1]);
        (a[1] > at[1]) != (b[1] > at[1])
            && at[0] < a[0] + (at[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    });
    let sign = if crossings.count() % 2 == 1 { 1.0 } else { -1.0 };
    sign * distance(&closed, at)
}

/// Distance to the nearest point of a polyline.
fn distance(line: &[[f64; 2]], at: [f64; 2]) -> f64 {
    let nearest = line.windows(2).map(|pair| {
        let along = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
        let to = [at[0] - pair[0][0], at[1] - pair[0][1]];
        let length2 = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
        let t = ((to[0] * along[0] + to[1] * along[1]) / length2).clamp(0.0, 1.0);
        (to[0] - t * along[0]).hypot(to[1] - t * along[1])
    });
    nearest.fold(f64::INFINITY, f64::min)
}
