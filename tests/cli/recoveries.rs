//! `recover`, run as a program.

use mocapd_acquire::files::{FileError, NameTaken};
use mocapd_take::{NotATake, damage::Problem, recovery::RecoveryScan};
use rustix::process::Signal;

use super::{
    Folder,
    devices::{Recorder, Simulated},
};
use crate::support::{assert_mentions, jump};

#[test]
fn a_killed_recording_is_recovered() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let mut recorder = Recorder::start(&folder, &device, "killed.take", &[]);
    std::thread::sleep(std::time::Duration::from_millis(700));
    recorder.signal(Signal::KILL);
    recorder.wait();
    let killed = folder.read("killed.take");
    let ran = folder.run(&["recover", "killed.take", "-o", "new.take"]).with_code(3);
    assert_mentions(&ran.stdout, &["new.take"]);
    let losses = RecoveryScan::read(&killed[..]).unwrap().loss_summary();
    assert_mentions(&ran.stderr, &["killed.take", &Problem::CutOff.to_string(), &losses]);
    assert_eq!(folder.read("killed.take"), killed, "it is only read");
    let verified = folder.run(&["verify", "new.take", "--json"]).with_code(3).json();
    // The new take is intact; the frames after the cut cannot be counted.
    assert_eq!((&verified["intact"], &verified["health"]), (&true.into(), &"lossy".into()));
    // The other commands point to `recover`.
    for command in ["info", "verify"] {
        let ran = folder.run(&[command, "killed.take"]).with_code(3);
        assert_mentions(&ran.stderr, &["mocapd recover killed.take -o NEW.take"]);
        let again = folder.run(&[command, "new.take"]).stderr;
        assert!(!again.contains("mocapd recover"), "{command}: {again}");
    }
    let before = folder.run(&["info", "killed.take", "--json"]).with_code(3).json();
    let info = folder.run(&["info", "new.take", "--json"]).with_code(3).json();
    for same in ["frames", "samples", "markers", "stretches", "created", "resampler"] {
        assert_eq!(info[same], before[same], "{same}");
    }
    assert_eq!(info["finished"], true);
    assert_eq!(info["ledger"]["closes"], true);
    assert_eq!(info["ledger"]["recorded"], info["frames"]);
    let recovered = info["recovered"].as_str().unwrap();
    assert_mentions(recovered, &["mocapd", &losses]);
    assert_mentions(&folder.run(&["info", "new.take"]).with_code(3).stdout, &[recovered]);
}

#[test]
fn intact_takes_are_copied_and_reported() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(2, 60.0, 12.0));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    let report = folder.run(&["recover", "jump.take", "-o", "new.take", "--json"]).with_code(0);
    assert_eq!(report.stderr, "");
    let report = report.json();
    assert_eq!(report["lost"], false);
    assert_eq!(report["frames_recovered"], 720);
    folder.run(&["verify", "new.take", "--against", "jump.csv"]).with_code(0);
    // Without index and footer nothing is lost.
    let take = folder.read("jump.take");
    folder.write("cut.take", &take[..take.len() - 35]);
    let report = folder.run(&["recover", "cut.take", "-o", "mended.take", "--json"]).json();
    assert_eq!(report["lost"], false, "{report}");
    assert!(folder.read("mended.take") == folder.read("new.take"), "other bytes");
}

#[test]
fn nothing_is_overwritten_and_nothing_left_behind() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(2, 60.0, 1.0));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    folder.write("mine.take", "mine");
    for file in ["mine.take", "jump.take"] {
        let line = folder.refuses(&["recover", "jump.take", "-o", file], 1);
        assert_eq!(line, NameTaken { path: file.into() }.to_string());
    }
    let line = folder.refuses(&["recover", "jump.take", "-o", "new.csv"], 2);
    assert_mentions(&line, &["new.csv", ".take"]);
    let line = folder.refuses(&["recover", "no.take", "-o", "new.take"], 1);
    assert_eq!(line, FileError::NotFound("no.take".into()).to_string());
    let line = folder.refuses(&["recover", "jump.csv", "-o", "new.take"], 1);
    assert_mentions(&line, &["jump.csv", &NotATake::OtherMagic.to_string()]);
    // Half a header cannot be recovered.
    let take = folder.read("jump.take");
    folder.write("head.take", &take[..60]);
    let line = folder.refuses(&["recover", "head.take", "-o", "new.take"], 1);
    assert_mentions(&line, &["head.take", &NotATake::HeaderCut.to_string()]);
    // A header with two wrong bytes cannot be recovered either; the message does not recommend `recover`.
    let mut bad = take.clone();
    bad[40] ^= 0x20;
    bad[50] ^= 0x20;
    folder.write("bad.take", &bad);
    let line = folder.refuses(&["recover", "bad.take", "-o", "new.take"], 1);
    assert_mentions(&line, &["bad.take", &NotATake::HeaderLost.to_string()]);
    for line in [folder.refuses(&["info", "head.take"], 1), line] {
        assert!(!line.contains("mocapd recover"), "{line}");
    }
}

#[test]
fn a_wrong_byte_of_the_header_is_corrected() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(2, 60.0, 1.0));
    folder.run(&["import", "jump.csv", "-o", "jump.take", "--lossless"]).with_code(0);
    let mut take = folder.read("jump.take");
    take[40] ^= 0x20;
    folder.write("bad.take", &take);
    let line = folder.refuses(&["info", "bad.take"], 1);
    assert_mentions(&line, &["bad.take", &NotATake::HeaderDamaged.to_string(), "mocapd recover"]);
    let ran = folder.run(&["recover", "bad.take", "-o", "new.take"]).with_code(0);
    assert_eq!(ran.stderr, format!("mocapd: bad.take: {}\n", Problem::HeaderByte(40)));
    folder.run(&["verify", "new.take", "--against", "jump.csv"]).with_code(0);
}
