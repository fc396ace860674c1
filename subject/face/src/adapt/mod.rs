//! Adaptation of the wireframe to the points of a photograph by radial basis functions (Yang et al. 2004, (6) to (14)).

mod radial;
#[cfg(test)]
mod tests;

use crate::model::{Camera, Landmark, Model, OUTER_EYES_MM};
pub use radial::{AdaptError, RadialMap};

/// The d of the multiquadric ([`RadialMap`]): how far around a point the vertices follow it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Width {
    /// In pixels of the photograph.
    Pixels(f64),
    /// In outer interocular distances, as the camera would see them from the front.
    OuterEyes(f64),
}

impl Width {
    /// The value of Yang et al. 2004: 1. They state no unit; here it is a pixel.
    ///
    /// In outer interocular distances it would be twenty times the distance between features: the map would meet the
    /// points, but vertices between them would be up to an interocular distance from where they belong.
    pub const PAPER: Self = Self::Pixels(1.0);
}

impl Default for Width {
    /// A twentieth of the interocular distance, about the distance between features: the same at every resolution.
    fn default() -> Self {
        Self::OuterEyes(0.05)
    }
}

/// Source of the result's depth. A photograph has none, and Yang et al. 2004 do not mention it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Depth<'a> {
    /// The model's depth, scaled like its width and height.
    Model,
    /// A separate map in three dimensions through the depth of each point: pixels in front of the model's origin, in
    /// the order of the points. A fitted shape provides them.
    Points(&'a [f64]),
}

/// An adapted face.
#[derive(Debug, Clone, PartialEq)]
pub struct Adapted {
    /// Each vertex in the picture: x, y and depth in front of the model's origin, in pixels.
    pub vertices_px: Vec<[f64; 3]>,
    /// Each vertex facing forward, in the model's frame and nominal millimetres.
    pub vertices_mm: Vec<[f64; 3]>,
}

/// Adapts the face `vertices_mm`, posed by `camera`, to `points` (Yang et al. 2004, section 5): the features come to
/// lie on the points, the other vertices between them.
///
/// # Errors
/// [`AdaptError`] if the points determine no map: too few, duplicates, or on one line.
pub fn adapt(
    model: &Model,
    vertices_mm: &[[f64; 3]],
    camera: &Camera,
    points: &[Landmark],
    width: Width,
    depth: Depth<'_>,
) -> Result<Adapted, AdaptError> {
    // Steps 1 and 2: rotation and orthographic projection, in interocular distances.
    let turned = Camera { scale_px_per_mm: 1.0 / OUTER_EYES_MM, origin_px: [0.0; 2], ..*camera };
    let projected = turned.project(vertices_mm);
    let features = turned.project(&model.feature_points(vertices_mm, &camera.rotation()));
    // Step 3: centres and targets.
    let nodes: Vec<_> = points.iter().map(|point| features[point.id.index()]).collect();
    let flat: Vec<_> = nodes.iter().map(|&[x, y, _]| [x, y]).collect();
    let interocular_px = camera.scale_px_per_mm * OUTER_EYES_MM;
    let unit = |point: &Landmark| point.xy_px.map(|v| v / interocular_px);
    let targets: Vec<_> = points.iter().map(unit).collect();
    // Steps 4 to 6. Another unit of r scales d, and adds a factor that the weights absorb.
    let d = match width {
        Width::Pixels(d) => d * (1.0 / interocular_px),
        Width::OuterEyes(d) => d,
    };
    let map = RadialMap::new(d, &flat, &targets)?;
    let place = |&[x, y, z]: &[f64; 3]| {
        let [u, v] = map.at(&[x, y]);
        [u * interocular_px, v * interocular_px, z]
    };
    let mut vertices_px: Vec<_> = projected.iter().map(place).collect();
    match depth {
        Depth::Model => {
            let scale_px = interocular_px * spread(&targets) / spread(&flat);
            vertices_px.iter_mut().for_each(|v| v[2] *= scale_px);
        }
        Depth::Points(depths) => {
            let targets: Vec<_> = depths.iter().map(|z| [z / interocular_px]).collect();
            let map = RadialMap::<3, 1>::new(d, &nodes, &targets)?;
            for (vertex, place) in vertices_px.iter_mut().zip(&projected) {
                vertex[2] = map.at(place)[0] * interocular_px;
            }
        }
    }
    let vertices_mm = camera.unproject(&vertices_px);
    Ok(Adapted { vertices_px, vertices_mm })
}

/// Root mean square distance from the centroid.
fn spread(points: &[[f64; 2]]) -> f64 {
    let n = points.len() as f64;
    let mean = [0, 1].map(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / n);
    let squares: f64 =
        points.iter().map(|p| (p[0] - mean[0]).powi(2) + (p[1] - mean[1]).powi(2)).sum();
    (squares / n).sqrt()
}
