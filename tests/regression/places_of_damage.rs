//! Damage that makes later stretches undecodable: `info`, `verify`, `export` and `recover` name the same places.

use mocapd_take::damage::Problem;

use crate::{
    cli::{
        Folder,
        devices::{Recorder, Simulated},
    },
    support::{jump, mentions, rows},
};

#[test]
fn every_command_names_the_same_places() {
    let folder = Folder::new();
    let device = Simulated::of(jump(5, 120.0, 6.0));
    Recorder::start(&folder, &device, "a.take", &[]).wait().with_code(0);
    let mut bytes = folder.read("a.take");
    let middle = bytes.len() / 2;
    bytes[middle..middle + 40].iter_mut().for_each(|byte| *byte ^= 0x55);
    let problems = rows(&bytes).1;
    folder.write("bad.take", bytes);
    let places = problems.iter().filter(|problem| matches!(problem, Problem::Unplaced { .. }));
    let expected: Vec<String> = places.map(ToString::to_string).collect();
    assert!(expected.len() > 2, "{problems:?}");
    assert!(expected.windows(2).all(|pair| pair[0] != pair[1]), "{expected:?}");
    let places = |args: &[&str]| {
        let message = folder.run(args).with_code(3).stderr;
        // In any order.
        expected.iter().filter(|place| mentions(&message, place)).cloned().collect::<Vec<_>>()
    };
    for args in [
        &["info", "bad.take"][..],
        &["verify", "bad.take"],
        &["export", "bad.take", "-o", "bad.csv"],
        &["recover", "bad.take", "-o", "new.take"],
    ] {
        assert_eq!(places(args), expected, "{args:?}");
    }
}
