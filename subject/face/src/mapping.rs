//! Mapping of a take's markers to places on the wireframe, so that a fitted face can be drawn under its markers.
//!
//! `docs/subject-face-format.md` describes the format.
//!
//! `docs/subject-face-format.md` describes the format.

use std::collections::{BTreeMap, HashSet};

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::document::{DocumentError, Format};

/// Minimum number of markers for an alignment: three fix a rigid body, a fourth shows whether they fit.
pub const MARKERS_MIN: usize = 4;
/// Markers are collinear if their spread across is below this fraction of that along; the rotation about the line is
/// then undetermined.
const FLAT: f64 = 1e-3;
/// A thousand kilometres: products of four coordinates stay far within the range of a double.
const MAX_COORDINATE_MM: f64 = 1e9;

/// Places of markers on a face.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mapping {
    /// One entry per placed marker.
    pub markers: Vec<Marker>,
}

/// A marker and its place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Marker {
    /// Label in the take.
    pub label: String,
    /// Place on the wireframe.
    #[serde(rename = "at")]
    pub place: Place,
    /// Weight in the alignment: 0 for a marker that moves much, such as on the lips.
    #[serde(default = "one")]
    pub weight: f64,
}

/// A place on the wireframe.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Place {
    /// A vertex by its feature name.
    Feature(String),
    /// A vertex by its index, from 0.
    Vertex(usize),
}

fn one() -> f64 {
    1.0
}

impl Place {
    /// The vertex, if the wireframe has it.
    pub fn vertex(&self, features: &BTreeMap<String, usize>, vertices: usize) -> Option<usize> {
        let index = match self {
            Self::Feature(name) => *features.get(name)?,
            Self::Vertex(index) => *index,
        };
        (index < vertices).then_some(index)
    }
}

/// Whether the alignment may scale the face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scaling {
    /// Free: a photograph has no scale, so the markers give it.
    Free,
    /// Fixed: the size is known from an earlier frame.
    Fixed,
}

/// Why a face cannot be aligned.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum AlignError {
    /// Too few markers of the mapping are in the frame and on the wireframe.
    #[error(
        "{0} markers of the mapping are in this frame and on this face, at least {MARKERS_MIN} are needed"
    )]
    TooFew(usize),
    /// The markers do not determine the rotation.
    #[error("the mapped markers of this frame lie on one line")]
    Flat,
    /// A coordinate that is not finite, or beyond a thousand kilometres.
    #[error("marker {0:?} has no finite position, or is beyond 1e9 mm: check the unit")]
    NotFinite(String),
}

/// Position of a face among markers: x ↦ scale · rotation · x + translation.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// The take's millimetres per millimetre of the face.
    pub scale: f64,
    /// Rotation from the face's frame to the take's, by rows.
    pub rotation: [[f64; 3]; 3],
    /// Translation in the take's millimetres.
    pub translation_mm: [f64; 3],
    /// Weighted root mean square distance of the markers from their places, in the take's millimetres.
    pub rms_mm: f64,
    /// Number of markers used.
    pub markers: usize,
}

impl Mapping {
    /// Aligns a face with the markers of one frame by weighted least squares (Umeyama 1991).
    ///
    /// `marker` returns the position of the marker with a label, in the take's millimetres, if present. Markers of
    /// weight 0 are ignored.
    ///
    /// # Errors
    /// [`AlignError`]: too few markers, all on one line, or not finite.
    pub fn align(
        &self,
        vertices_mm: &[[f64; 3]],
        features: &BTreeMap<String, usize>,
        marker: impl Fn(&str) -> Option<[f64; 3]>,
        scaling: Scaling,
    ) -> Result<Alignment, AlignError> {
        let mut pairs = Vec::new();
        for entry in self.markers.iter().filter(|entry| entry.weight > 0.0) {
            let vertex = entry.place.vertex(features, vertices_mm.len());
            if let (Some(vertex), Some(at)) = (vertex, marker(&entry.label)) {
                if !at.iter().chain(&vertices_mm[vertex]).all(|v| v.abs() < MAX_COORDINATE_MM) {
                    return Err(AlignError::NotFinite(entry.label.clone()));
                }
                let (from, to) = (vertices_mm[vertex].into(), at.into());
                pairs.push(Pair { weight: entry.weight, from, to });
            }
        }
        if pairs.len() < MARKERS_MIN {
            return Err(AlignError::TooFew(pairs.len()));
        }
        solve(&pairs, scaling)
    }
}

/// A place on the face and the position of its marker.
struct Pair {
    weight: f64,
    from: Vector3<f64>,
    to: Vector3<f64>,
}

fn solve(pairs: &[Pair], scaling: Scaling) -> Result<Alignment, AlignError> {
    let total: f64 = pairs.iter().map(|pair| pair.weight).sum();
    let from = pairs.iter().map(|pair| pair.from * pair.weight).sum::<Vector3<f64>>() / total;
    let to = pairs.iter().map(|pair| pair.to * pair.weight).sum::<Vector3<f64>>() / total;
    let mut covariance = Matrix3::zeros();
    let mut spread = 0.0;
    for pair in pairs {
        covariance += (pair.to - to) * (pair.from - from).transpose() * pair.weight;
        spread += pair.weight * (pair.from - from).norm_squared();
    }
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(AlignError::Flat) };
    let mut widths = svd.singular_values;
    let [largest, middle] = [0, 1].map(|i| widths[i]);
    if !(middle > FLAT * largest && spread > 0.0) {
        return Err(AlignError::Flat);
    }
    // A reflection would fit better: invert the least certain direction.
    let mut mirror = Matrix3::identity();
    if u.determinant() * v_t.determinant() < 0.0 {
        mirror[(2, 2)] = -1.0;
        widths[2] = -widths[2];
    }
    let rotation = u * mirror * v_t;
    let scale = match scaling {
        Scaling::Free => widths.sum() / spread,
        Scaling::Fixed => 1.0,
    };
    let translation = to - rotation * from * scale;
    let off = |pair: &Pair| {
        pair.weight * (rotation * pair.from * scale + translation - pair.to).norm_squared()
    };
    let rms_mm = (pairs.iter().map(off).sum::<f64>() / total).sqrt();
    Ok(Alignment {
        scale,
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
        translation_mm: translation.into(),
        rms_mm,
        markers: pairs.len(),
    })
}

impl Alignment {
    /// Transforms the face to the markers.
    pub fn apply(&self, vertices_mm: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let turn = |v: &[f64; 3]| {
            std::array::from_fn(|i| {
                let turned: f64 = (0..3).map(|j| self.rotation[i][j] * v[j]).sum();
                self.scale * turned + self.translation_mm[i]
            })
        };
        vertices_mm.iter().map(turn).collect()
    }
}

const MAPPING: Format = Format {
    name: "mocapd-face-mapping",
    version: 1,
    made_by: "such as subject/face/data/singing-face-mapping.json",
    bytes_max: 256 * 1024,
};
/// More markers than any face was captured with.
const MARKERS_MAX: usize = 1000;
const NAME_MAX: usize = 255;
const WEIGHT_MAX: f64 = 1000.0;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MappingFile {
    format: String,
    version: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    about: Option<String>,
    markers: Vec<Marker>,
}

impl Mapping {
    /// Reads a mapping. Unknown keys are rejected.
    ///
    /// # Errors
    /// [`DocumentError`] with the reason.
    pub fn from_json(bytes: &[u8]) -> Result<Self, DocumentError> {
        let MappingFile { markers, .. } = MAPPING.read(bytes)?;
        let (count, expected) = ([markers.len()], format!("0 to {MARKERS_MAX}"));
        let place = |_| "markers.length".to_owned();
        MAPPING.expect(count, place, &expected, |count| *count <= MARKERS_MAX)?;
        let expected = format!("1 to {NAME_MAX} bytes without control characters");
        let is_name = |name: &&String| {
            (1..=NAME_MAX).contains(&name.len()) && !name.contains(char::is_control)
        };
        let labels = || markers.iter().map(|marker| &marker.label);
        MAPPING.expect(labels(), |i| format!("markers[{i}].label"), &expected, is_name)?;
        let named = markers.iter().enumerate().filter_map(|(i, marker)| match &marker.place {
            Place::Feature(name) => Some((i, name)),
            Place::Vertex(_) => None,
        });
        let (at, names): (Vec<_>, Vec<_>) = named.unzip();
        MAPPING.expect(names, |i| format!("markers[{}].at", at[i]), &expected, is_name)?;
        let expected = format!("0 to {WEIGHT_MAX}");
        let weights = markers.iter().map(|marker| marker.weight);
        let is_weight = |weight: &f64| (0.0..=WEIGHT_MAX).contains(weight);
        MAPPING.expect(weights, |i| format!("markers[{i}].weight"), &expected, is_weight)?;
        let mut known = HashSet::new();
        let place = |i| format!("markers[{i}].label");
        MAPPING.expect(labels(), place, "each label once", |label| known.insert(*label))?;
        Ok(Self { markers })
    }

    /// Serialises a mapping.
    ///
    /// # Errors
    /// None for a mapping that was read.
    pub fn to_json(&self) -> Result<String, DocumentError> {
        let (format, version, markers) =
            (MAPPING.name.to_owned(), MAPPING.version, self.markers.clone());
        let file = MappingFile { format, version, about: None, markers };
        serde_json::to_string_pretty(&file).map_err(|error| DocumentError::Shape(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;
    use crate::model::{Camera, Model};

    /// The mapping of the public recording of a singing face with 37 markers (c3d.org, sample 19), whose labels run from
    /// `root-1` to `section14-3`.
    fn singing_face() -> Mapping {
        Mapping::from_json(include_bytes!("../data/singing-face-mapping.json")).unwrap()
    }

    fn moved(vertices: &[[f64; 3]]) -> Vec<[f64; 3]> {
        // An arbitrary similarity: rotated, scaled by 1.07, translated. Project flips y; twice is the identity.
        let camera = Camera {
            scale_px_per_mm: 1.07,
            yaw_deg: 70.0,
            pitch_deg: -30.0,
            roll_deg: 100.0,
            origin_px: [0.0; 2],
        };
        camera
            .project(vertices)
            .into_iter()
            .map(|[x, y, z]| [x - 14.0, 900.0 - y, z + 250.0])
            .collect()
    }

    #[test]
    fn a_similarity_is_recovered() {
        let model = Model::generic().unwrap();
        let mapping = singing_face();
        let there = moved(&model.vertices);
        let place = |label: &str| {
            let marker = mapping.markers.iter().find(|marker| marker.label == label)?;
            Some(there[marker.place.vertex(&model.features, there.len())?])
        };
        let found = mapping.align(&model.vertices, &model.features, place, Scaling::Free).unwrap();
        assert!((found.scale - 1.07).abs() < 1e-9 && found.rms_mm < 1e-9, "{found:?}");
        for (a, b) in found.apply(&model.vertices).iter().flatten().zip(there.iter().flatten()) {
            assert!((a - b).abs() < 1e-8, "{a} {b}");
        }
        // With another size prescribed, the remaining parameters are optimal for it.
        let fixed = mapping.align(&model.vertices, &model.features, place, Scaling::Fixed).unwrap();
        assert_eq!(fixed.scale, 1.0);
        assert!(fixed.rms_mm > 1.0 && fixed.rms_mm < 10.0, "{fixed:?}");
    }

    #[test]
    fn noise_and_missing_markers_change_the_alignment_little() {
        let model = Model::generic().unwrap();
        let mapping = singing_face();
        let there = moved(&model.vertices);
        let mut random = Random::new(11);
        let noisy: BTreeMap<String, [f64; 3]> = mapping
            .markers
            .iter()
            .filter_map(|marker| {
                let vertex = marker.place.vertex(&model.features, there.len())?;
                Some((marker.label.clone(), there[vertex].map(|v| v + 1.5 * random.normal())))
            })
            .filter(|(label, _)| !label.starts_with("section1-"))
            .collect();
        let place = |label: &str| noisy.get(label).copied();
        let found = mapping.align(&model.vertices, &model.features, place, Scaling::Free).unwrap();
        let off = |(a, b): (&[f64; 3], &[f64; 3])| {
            (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
        };
        let worst = found.apply(&model.vertices).iter().zip(&there).map(off).fold(0.0, f64::max);
        assert!(worst < 5.0, "{worst} mm");
    }

    #[test]
    fn degenerate_markers_are_refused() {
        let model = Model::generic().unwrap();
        let mapping = singing_face();
        let align = |marker: &dyn Fn(&str) -> Option<[f64; 3]>| {
            mapping.align(&model.vertices, &model.features, marker, Scaling::Free).unwrap_err()
        };
        assert_eq!(align(&|_| None), AlignError::TooFew(0));
        let mut along = 0.0;
        let line: BTreeMap<_, _> = mapping
            .markers
            .iter()
            .map(|marker| {
                along += 1.0;
                (marker.label.clone(), [along, 2.0 * along, 3.0])
            })
            .collect();
        assert_eq!(align(&|label| line.get(label).copied()), AlignError::Flat);
        assert_eq!(align(&|_| Some([1.0; 3])), AlignError::Flat);
        assert!(matches!(align(&|_| Some([f64::NAN, 0.0, 0.0])), AlignError::NotFinite(_)));
        assert!(matches!(align(&|_| Some([0.0, 1e300, 0.0])), AlignError::NotFinite(_)));
    }

    #[test]
    fn the_mapping_of_the_singing_face_fits_the_generic_face() {
        let model = Model::generic().unwrap();
        let mapping = singing_face();
        let vertex = |label: &str| {
            let marker = mapping.markers.iter().find(|marker| marker.label == label).unwrap();
            model.vertices[marker.place.vertex(&model.features, model.vertices.len()).unwrap()]
        };
        for marker in &mapping.markers {
            vertex(&marker.label);
        }
        // The nose's tip is in front; the left of the face is on the left.
        assert!(vertex("section7-2")[2] > vertex("section7-1")[2]);
        for (left, right) in [
            ("section1-2", "section2-2"),
            ("section8-1", "section9-1"),
            ("section11-1", "section12-1"),
        ] {
            assert!(vertex(left)[0] > 5.0 && vertex(right)[0] < -5.0, "{left} {right}");
        }
    }

    #[test]
    fn mappings_are_written_and_read_and_refused() {
        let mapping = singing_face();
        let text = mapping.to_json().unwrap();
        assert_eq!(Mapping::from_json(text.as_bytes()).unwrap(), mapping);
        for (from, to) in [
            ("mocapd-face-mapping", "mocapd-face"),
            ("\"version\": 1", "\"version\": 2"),
            ("\"label\"", "\"name\""),
            ("section7-2", "section7-1"),
            ("section7-2", ""),
            ("\"weight\": ", "\"weight\": -"),
        ] {
            assert!(text.contains(from), "{from}");
            assert!(
                Mapping::from_json(text.replacen(from, to, 1).as_bytes()).is_err(),
                "{from} {to}"
            );
        }
        assert!(Mapping::from_json(&[b' '; 1 << 20]).is_err());
        // Authors of mappings by hand see the file's own names in messages.
        for (head, why) in [
            ("", "no version: write \"version\": 1"),
            (r#""version": 0,"#, "no version 0 of mocapd-face-mapping: write \"version\": 1"),
            (r#""version": 2,"#, "use a newer mocapd"),
            (r#""version": 1,"#, "`markers[1].at` is \"\", expected"),
        ] {
            let markers = r#""markers": [{"label": "a", "at": 0}, {"label": "b", "at": ""}]"#;
            let text = format!(r#"{{"format": "mocapd-face-mapping", {head} {markers}}}"#);
            let found = Mapping::from_json(text.as_bytes()).unwrap_err().to_string();
            assert!(found.contains(why), "{found}");
        }
    }

    #[test]
    fn an_error_is_a_short_line_for_any_mapping() {
        let long = "y\\t".repeat(2000);
        let kind = r#"{"format": "mocapd-face-mapping", "version": 1, "#;
        for text in [
            format!(r#"{kind}"{long}": 1}}"#),
            format!(r#"{kind}"markers": [{{"label": "a", "at": -1}}]}}"#),
            format!(r#"{kind}"markers": [{{"label": "{long}", "at": 1}}]}}"#),
            format!(r#"{kind}"markers": [{{"label": "a", "at": 1, "weight": 1e400}}]}}"#),
            format!(r#"{kind}"markers": [{}]}}"#, r#"{"label": "a", "at": 1},"#.repeat(1200)),
            "{".repeat(100_000),
        ] {
            let reason = Mapping::from_json(text.as_bytes()).unwrap_err().to_string();
            assert!(
                reason.chars().count() < 300 && !reason.contains(char::is_control),
                "{reason:?}"
            );
        }
    }

    #[test]
    fn changed_bytes_give_an_error_or_a_valid_mapping() {
        let good = singing_face().to_json().unwrap().into_bytes();
        let mut random = Random::new(5);
        let mut read = 0;
        for _ in 0..400 {
            let mut bytes = good.clone();
            let at = (random.unit() * bytes.len() as f64) as usize;
            bytes[at] = random.one_of(b"0123456789-.e,[]{}\"ax ");
            if let Ok(mapping) = Mapping::from_json(&bytes) {
                let again = Mapping::from_json(mapping.to_json().unwrap().as_bytes()).unwrap();
                assert_eq!(again.markers.len(), mapping.markers.len());
                read += 1;
            }
        }
        assert!(read > 20, "{read}");
    }
}
