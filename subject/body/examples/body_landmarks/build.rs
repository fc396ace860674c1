//! A body in other builds: leaner, stouter, with longer and shorter bones.

use mocapd_body::extremity;
use mocapd_body::geodesic::{Adjacency, Graph, Workspace};
use mocapd_body::{Mesh, Refusal};

use crate::bones::{Lengths, Truth, stretched};
use crate::surface::{Girth, moved};

/// Number of random builds, in addition to the three fixed ones.
const DRAWN: u64 = 8;
/// Geodesic distance between the feet, in body scales.
const FEET: f64 = 1.09;

/// Modifications of a body.
pub(crate) struct Build {
    pub(crate) name: String,
    girth: Girth,
    lengths: Lengths,
}

/// The original; 2 cm less around the waist; 4 cm more; and random ones, with a girth for each part of the body and a
/// length for each bone.
pub(crate) fn builds() -> Vec<Build> {
    let fixed = [("as-is", 0.0), ("lean", -0.011), ("stout", 0.024)];
    let fixed = fixed.map(|(name, trunk)| Build {
        name: name.to_owned(),
        girth: Girth::evenly(trunk),
        lengths: Lengths::SAME,
    });
    fixed.into_iter().chain((0..DRAWN).map(drawn)).collect()
}

fn drawn(number: u64) -> Build {
    // In antithetic pairs: one exceeds the average by as much as the other falls short of it, so that the average is
    // kept.
    let mut random = Random { state: number / 2, mirrored: number % 2 == 1 };
    // Fat is added to trunk and thighs first; the rest of the limbs get independent shares of it.
    let trunk = random.between(-0.012, 0.036);
    let mut share = |low: f64, high: f64| trunk * random.between(low, high);
    let girth = Girth {
        wrist: share(0.0, 0.3),
        forearm: share(0.1, 0.5),
        upper_arm: share(0.2, 0.9),
        ankle: share(0.0, 0.5),
        calf: share(0.1, 0.7),
        knee: share(0.1, 0.6),
        thigh: share(0.5, 1.2),
        trunk,
    };
    let mut length = |by: f64| random.between(1.0 - by, 1.0 + by);
    let lengths = Lengths {
        upper_arm: length(0.09),
        forearm: length(0.09),
        thigh: length(0.09),
        shank: length(0.09),
        foot: length(0.09),
    };
    Build { name: format!("drawn-{number}"), girth, lengths }
}

/// The modified body and its joints.
pub(crate) fn changed(mesh: &Mesh, truth: &Truth, build: &Build) -> Result<(Mesh, Truth), Refusal> {
    let graph = Graph::with_short_cuts(mesh, &Adjacency::new(mesh)?);
    let ends = extremity::find(mesh, &graph, &mut Workspace::default())?;
    let scale = ends.fields[3][ends.extremities.feet[1] as usize] / FEET;
    let (mesh, truth) = stretched(mesh, truth, &ends.fields, scale, &build.lengths);
    Ok((moved(&mesh, &ends.fields, scale, &build.girth), truth))
}

/// Seeded pseudo-random numbers (Steele et al. 2014, `SplitMix64`).
struct Random {
    state: u64,
    /// Whether numbers are mirrored within their range.
    mirrored: bool,
}

impl Random {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^= mixed >> 31;
        let part = (mixed >> 11) as f64 / (1_u64 << 53) as f64;
        low + (high - low) * if self.mirrored { 1.0 - part } else { part }
    }
}
