//! A comparison of takes without a common frame is an error, and lists few labels.

use mocapd_take::compare::{CompareError, FrameNumbers, compare};
use mocapd_take::motion::{Marker, Motion, MotionFrames, MotionInfo, Source};

use crate::{
    cli::Folder,
    support::{assert_mentions, mentions},
};

fn motion(first_frame: u64, n_frames: u64, n_markers: usize, prefix: &str) -> Motion {
    let markers = (0..n_markers).map(|i| Marker { label: format!("{prefix}{i}"), labelled: true });
    let info = MotionInfo {
        rate_hz: 100.0,
        n_frames,
        markers: markers.collect(),
        source: Source { factor: 1.0, first_frame, ..Source::default() },
        ..MotionInfo::default()
    };
    Motion { info, positions_mm: vec![[100.0, 200.0, 300.0]; n_frames as usize * n_markers] }
}

#[test]
fn no_frame_in_common_is_a_specific_error() {
    let (take, original) = (motion(1, 10, 2, "m"), motion(100, 20, 2, "m"));
    let found = compare(MotionFrames::new(&take), MotionFrames::new(&original)).unwrap_err();
    let CompareError::NoFrameInCommon { take: ours, original: theirs } = &found else {
        panic!("{found}")
    };
    assert_eq!(*ours, FrameNumbers { first: 1, n: 10 });
    assert_eq!(*theirs, FrameNumbers { first: 100, n: 20 });
    let folder = Folder::new();
    folder.write_motion("a.c3d", &take);
    folder.write_motion("b.c3d", &original);
    folder.run(&["import", "a.c3d", "-o", "a.take"]).with_code(0);
    let line = folder.refuses(&["verify", "a.take", "--against", "b.c3d"], 1);
    assert_mentions(&line, &["a.take", "b.c3d", &found.to_string()]);
}

#[test]
fn at_most_ten_labels_are_listed() {
    let folder = Folder::new();
    folder.write_motion("a.csv", &motion(1, 10, 40, "a"));
    folder.write_motion("b.csv", &motion(1, 10, 40, "b"));
    folder.run(&["import", "a.csv", "-o", "a.take"]).with_code(0);
    let printed = folder.run(&["verify", "a.take", "--against", "b.csv"]).with_code(1).stdout;
    let line = printed.lines().find(|line| mentions(line, "b9")).unwrap();
    assert_mentions(line, &["b0", "30"]);
    assert!(!mentions(line, "b10"), "{line}");
    let ran = folder.run(&["verify", "a.take", "--against", "b.csv", "--json"]).with_code(1);
    assert_eq!(ran.json()["against"]["labels_differing"].as_array().unwrap().len(), 40);
}
