//! Subjects in marker labels.

use mocapd_take::interchange::Format;
use mocapd_take::motion::{Marker, Motion, MotionFrames, MotionInfo, Source};

fn written(labels: &[&str]) -> Vec<u8> {
    let markers =
        labels.iter().map(|l| Marker { label: (*l).to_owned(), labelled: !l.starts_with('*') });
    let info = MotionInfo {
        rate_hz: 100.0,
        n_frames: 1,
        markers: markers.collect(),
        source: Source { factor: 1.0, first_frame: 1, ..Source::default() },
        ..MotionInfo::default()
    };
    let motion = Motion { positions_mm: vec![[1.0; 3]; labels.len()], info };
    let mut bytes = Vec::new();
    Format::C3d.write(&mut MotionFrames::new(&motion), &mut bytes).expect("memory");
    bytes
}

#[test]
fn prefixes_of_all_labels_are_subjects() {
    let holds = |bytes: &[u8], text: &[u8]| bytes.windows(text.len()).any(|window| window == text);
    let two = written(&["Anna:LASI", "Anna:RASI", "*3", "Ben:LASI"]);
    assert!(holds(&two, b"SUBJECTS") && holds(&two, b"Anna:Ben: "));
    for labels in [&["LASI", "Anna:RASI"][..], &[":LASI"], &["LASI:"], &["*1"]] {
        assert!(!holds(&written(labels), b"SUBJECTS"), "{labels:?}");
    }
}
