use super::*;
use crate::model::{Camera, Model};
use mocapd_testkit::photograph::PictureRng;

/// The mapping of the public recording of a singing face with 37 markers (c3d.org, sample 19), whose labels run from
/// `root-1` to `section14-3`.
fn singing_face() -> Mapping {
    Mapping::from_json(include_bytes!("../../data/singing-face-mapping.json")).unwrap()
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
    camera.project(vertices).into_iter().map(|[x, y, z]| [x - 14.0, 900.0 - y, z + 250.0]).collect()
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
    let mut random = PictureRng::new(11);
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
    let off =
        |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
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
    for (left, right) in
        [("section1-2", "section2-2"), ("section8-1", "section9-1"), ("section11-1", "section12-1")]
    {
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
        assert!(Mapping::from_json(text.replacen(from, to, 1).as_bytes()).is_err(), "{from} {to}");
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
        assert!(reason.chars().count() < 300 && !reason.contains(char::is_control), "{reason:?}");
    }
}

#[test]
fn changed_bytes_give_an_error_or_a_valid_mapping() {
    let good = singing_face().to_json().unwrap().into_bytes();
    let mut random = PictureRng::new(5);
    let mut read = 0;
    for _ in 0..400 {
        let mut bytes = good.clone();
        let at = (random.uniform() * bytes.len() as f64) as usize;
        bytes[at] = random.one_of(b"0123456789-.e,[]{}\"ax ");
        if let Ok(mapping) = Mapping::from_json(&bytes) {
            let again = Mapping::from_json(mapping.to_json().unwrap().as_bytes()).unwrap();
            assert_eq!(again.markers.len(), mapping.markers.len());
            read += 1;
        }
    }
    assert!(read > 20, "{read}");
}
