//! `export --format bids`: several subjects, sessions and runs in one data set.

use std::{fs, path::Path, time::Duration};

use super::Folder;
use crate::support::{assert_mentions, jump};

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.trc", &jump(1, 100.0, 1.0));
    folder.run(&["import", "jump.trc", "-o", "jump.take", "--lossless"]).with_code(0);
    folder
}

fn export<'a>(labels: &[&'a str]) -> Vec<&'a str> {
    [&["export", "jump.take", "-o", "study", "--format", "bids"], labels].concat()
}

/// The files of the data set, with `/` between folders, hidden ones included.
fn files(folder: &Path) -> Vec<String> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() {
            files.extend(self::files(&path).iter().map(|inner| format!("{name}/{inner}")));
        } else {
            files.push(name);
        }
    }
    files.sort();
    files
}

#[test]
fn subjects_sessions_and_runs_share_a_data_set() {
    let folder = folder();
    let all: [&[&str]; 5] = [
        &["--subject", "01", "--task", "jump", "--run", "1"],
        &["--subject", "01", "--task", "jump", "--run", "2"],
        &["--subject", "02", "--task", "jump"],
        &["--subject", "02", "--session", "pre", "--task", "jump"],
        &["--subject", "02", "--session", "post", "--task", "jump", "--run", "07"],
    ];
    for labels in all {
        folder.run(&export(labels)).with_code(0);
    }
    let found = files(&folder.path("study"));
    for file in [
        "participants.tsv",
        "sub-01/motion/sub-01_task-jump_tracksys-optical_run-1_motion.tsv",
        "sub-01/motion/sub-01_task-jump_tracksys-optical_run-2_channels.tsv",
        "sub-02/motion/sub-02_task-jump_tracksys-optical_motion.json",
        "sub-02/ses-pre/motion/sub-02_ses-pre_task-jump_tracksys-optical_motion.tsv",
        "sub-02/ses-post/motion/sub-02_ses-post_task-jump_tracksys-optical_run-07_motion.tsv",
    ] {
        assert!(found.iter().any(|name| name == file), "{file}: {found:#?}");
    }
    assert_eq!(found.len(), 4 + 5 * 4, "{found:#?}");
    assert_eq!(folder.text("study/participants.tsv"), "participant_id\nsub-01\nsub-02\n");
    // Existing files are not replaced, and the message says what to do.
    for labels in all {
        let line = folder.refuses(&export(labels), 1);
        assert_mentions(&line, &["study", "--run", "--session"]);
    }
    for (labels, what) in [
        (["--subject", "a b"], "subject"),
        (["--session", "../x"], "session"),
        (["--run", "first"], "run"),
    ] {
        assert_mentions(&folder.refuses(&export(&labels), 2), &[what]);
    }
    let other = ["export", "jump.take", "-o", "a.csv", "--run", "1"];
    assert_mentions(&folder.refuses(&other, 2), &["--run", "bids"]);
}

#[test]
fn a_folder_that_is_not_a_data_set_is_refused() {
    let folder = folder();
    fs::create_dir(folder.path("study")).unwrap();
    folder.write("study/notes.txt", "mine");
    let line = folder.refuses(&export(&[]), 1);
    assert_mentions(&line, &["study", "dataset_description.json"]);
    // A data set of another program.
    folder.write("study/dataset_description.json", r#"{"Name": "mine", "BIDSVersion": "1.8.0"}"#);
    folder.run(&export(&["--subject", "7"])).with_code(0);
    assert_eq!(folder.text("study/participants.tsv"), "participant_id\nsub-7\n");
    assert_eq!(folder.text("study/notes.txt"), "mine");
    assert!(folder.text("study/dataset_description.json").contains("mine"));
    let stdout = ["export", "jump.take", "-o", "-", "--format", "bids"];
    folder.refuses(&stdout, 2);
}

/// An export killed at any moment leaves the whole recording or only hidden files, which the next export removes.
#[test]
fn a_killed_export_leaves_nothing_visible() {
    let folder = folder();
    folder.write_motion("long.trc", &jump(2, 240.0, 60.0));
    folder.run(&["import", "long.trc", "-o", "long.take", "--lossless"]).with_code(0);
    folder.run(&export(&["--subject", "01", "--task", "jump"])).with_code(0);
    let visible = |name: &str| {
        let all = files(&folder.path(name));
        all.into_iter().filter(|file| !file.starts_with('.')).collect::<Vec<_>>()
    };
    let mut n_killed = 0;
    for step in 0..12 {
        let subject = format!("k{step}");
        let (dataset, is_new) = if step % 2 == 0 { ("study", false) } else { ("fresh", true) };
        let args =
            ["export", "long.take", "-o", dataset, "--format", "bids", "--subject", &subject];
        let mut child = folder.command(&args).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(50 * step));
        let is_killed = child.try_wait().unwrap().is_none();
        child.kill().ok();
        child.wait().unwrap();
        n_killed += u32::from(is_killed);
        let found = visible(dataset);
        let of_subject: Vec<_> = found.iter().filter(|file| file.contains(&subject)).collect();
        assert!([0, 4].contains(&of_subject.len()), "{step}: {of_subject:?}");
        if is_new && !of_subject.is_empty() {
            assert_eq!(found.len(), 4 + 4, "{found:?}");
            fs::remove_dir_all(folder.path(dataset)).unwrap();
        } else if is_new {
            assert!(!folder.path(dataset).exists());
        }
    }
    eprintln!("{n_killed} of 12 exports were killed before they ended");
    assert!(n_killed > 0);
    folder.run(&export(&["--subject", "02", "--task", "jump"])).with_code(0);
    assert!(files(&folder.path("study")).iter().all(|file| !file.starts_with('.')));
    let rows = folder.text("study/participants.tsv");
    for row in rows.lines().skip(1) {
        assert!(folder.path("study").join(row).is_dir(), "{row} has no folder: {rows}");
    }
}
