//! Commands over many files and folders, and standard streams.

use std::{
    fs,
    io::Write,
    process::{Command, Stdio},
};

use mocapd_take::motion::Motion;

use super::{Folder, folder::Ran};
use crate::support::{assert_mentions, jump};

/// A folder `in` with `n` motion files `0.csv`... at its top and in `in/day 2`.
fn files(n: usize) -> (Folder, Motion) {
    let folder = Folder::new();
    let motion = jump(1, 60.0, 1.0);
    fs::create_dir_all(folder.path("in/day 2")).unwrap();
    for i in 0..n {
        let place = if i % 2 == 0 { "in" } else { "in/day 2" };
        folder.write_motion(&format!("{place}/{i}.csv"), &motion);
    }
    (folder, motion)
}

/// Runs a command with `input` on its standard input. Its output may be anything.
fn with_input(mut command: Command, input: &[u8]) -> (Option<i32>, Vec<u8>, String) {
    command.stdin(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_vec();
    // The program may refuse it unread.
    let write = move || drop(stdin.write_all(&input));
    let writer = std::thread::Builder::new().name("input".to_owned()).spawn(write).unwrap();
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    (output.status.code(), output.stdout, String::from_utf8(output.stderr).unwrap())
}

#[test]
fn a_folder_is_imported_but_for_the_files_that_fail_and_the_next_run_does_the_rest() {
    let (folder, motion) = files(6);
    folder.write("in/broken.csv", "no motion");
    folder.write("in/notes.txt", "not read");
    let import = ["import", "in", "--recursive", "-o", "out"];
    let ran = folder.run(&import).with_code(1);
    assert_eq!(ran.stderr.lines().count(), 1, "one reason: {}", ran.stderr);
    assert_mentions(&ran.stderr, &["in/broken.csv"]);
    let line = |name: &str| ran.stdout.lines().filter(|line| line.starts_with(name)).count();
    for (place, i) in [("out", 0), ("out/day 2", 1), ("out", 2), ("out/day 2", 5)] {
        assert_eq!(line(&format!("{place}/{i}.take: ")), 1, "{}", ran.stdout);
    }
    let table: Vec<Vec<&str>> = ran.stdout.lines().map(|line| line.split(' ').collect()).collect();
    let count = |name: &str, ran: &Ran| {
        let row = ran.stdout.lines().find_map(|line| line.strip_prefix(name));
        row.map_or(0, |row| row.split_whitespace().next().unwrap().parse::<u32>().unwrap())
    };
    assert_eq!((count("imported", &ran), count("failed", &ran)), (6, 1), "{table:?}");
    let first = folder.read("out/0.take");
    folder.run(&["import", "in/0.csv", "-o", "alone.take"]).with_code(0);
    assert!(first == folder.read("alone.take"), "the take is that of the command for one file");

    folder.write_motion("in/broken.csv", &motion);
    let again = folder.run(&import).with_code(0);
    assert_eq!((count("imported", &again), count("unchanged", &again)), (1, 6), "{}", again.stdout);
    let other = folder.run(&["import", "in", "-r", "-o", "out", "--lossless"]).with_code(1);
    assert_eq!(count("failed", &other), 7, "other settings are another take: {}", other.stdout);
    assert!(first == folder.read("out/0.take"), "and none is overwritten");
}

/// The take itself is not an original, and the case of an extension does not matter.
#[test]
fn an_original_in_the_folder_of_the_take_is_found() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(5, 120.0, 1.0));
    folder.run(&["import", "jump.csv"]).with_code(0);
    fs::rename(folder.path("jump.csv"), folder.path("jump.CSV")).unwrap();
    let verify = ["verify", "jump.take", "--against", ".", "--json"];
    let report = folder.run(&verify).with_code(0).json();
    assert_eq!(report["against"]["within_tolerance"], true);
    fs::remove_file(folder.path("jump.CSV")).unwrap();
    assert_mentions(&folder.run(&verify).with_code(1).stderr, &["no original"]);
}

#[test]
fn outputs_of_one_name_are_refused_before_any_work() {
    let (folder, motion) = files(2);
    folder.write_motion("in/0.trc", &motion);
    for import in [
        &["import", "in", "-o", "out"][..],
        &["import", "in/0.csv", "in/0.trc"],
        &["import", "in/0.csv", "in/day 2/1.csv", "-o", "one.take"],
    ] {
        folder.refuses(import, 2);
    }
    let take = ["export", "in/0.csv", "in/0.trc", "-o", "out"];
    assert_mentions(&folder.refuses(&take, 2), &["--to c3d"]);
}

#[test]
fn every_command_takes_a_folder() {
    let (folder, _) = files(4);
    folder.run(&["import", "in", "-r", "-o", "takes", "--verify"]).with_code(0);
    for command in [
        &["info", "takes", "-r"][..],
        &["verify", "takes", "-r", "--against", "in"],
        &["export", "takes", "-r", "-o", "c3d", "--to", "c3d"],
        &["export", "takes", "-r", "--to", "npz"],
        &["export", "takes", "-r", "--to", "trc", "--from", "0.5s", "--to", "0.8s", "-o", "parts/"],
        &["recover", "takes", "-r", "-o", "recovered"],
        &["plot", "trajectory", "takes", "-r", "-o", "plots", "--to", "png"],
        &["plot", "quality", "in", "-o", "quality"],
        &["plot", "sizes", "in", "takes", "-r", "-o", "sizes.svg", "--tolerances", "5mm"],
    ] {
        let ran = folder.run(command).with_code(0);
        let unexpected =
            ran.stderr.lines().find(|line| !line.contains("not supported by the format"));
        assert_eq!(unexpected, None, "{command:?}");
    }
    for output in [
        "c3d/0.c3d",
        "c3d/day 2/1.c3d",
        "takes/0.npz",
        "parts/0.trc",
        "recovered/day 2/3.take",
        "plots/day 2/1.png",
    ] {
        assert!(folder.path(output).is_file(), "{output}");
    }
    let unchanged = folder.run(&["export", "takes", "-r", "-o", "c3d", "--to", "c3d"]).with_code(0);
    assert_mentions(&unchanged.stdout, &["unchanged"]);
    folder.write("c3d/0.c3d", b"mine");
    folder.run(&["export", "takes", "-r", "-o", "c3d", "--to", "c3d"]).with_code(1);
    assert_eq!(folder.read("c3d/0.c3d"), b"mine");
}

#[test]
fn the_worst_file_decides_the_exit_code() {
    let (folder, _) = files(2);
    folder.run(&["import", "in", "-r", "-o", "takes"]).with_code(0);
    let bytes = folder.read("takes/0.take");
    folder.write("takes/cut.take", &bytes[..bytes.len() / 2]);
    for command in ["info", "verify"] {
        folder.run(&[command, "takes", "-r"]).with_code(3);
    }
    folder.write("takes/empty.take", b"");
    for command in ["info", "verify"] {
        let ran = folder.run(&[command, "takes", "-r", "--json"]).with_code(1);
        assert_eq!(ran.stdout.lines().count(), 4, "a document a file: {}", ran.stdout);
    }
}

#[test]
fn standard_input_and_output_carry_files() {
    let folder = Folder::new();
    let motion = jump(2, 60.0, 1.0);
    folder.write_motion("jump.csv", &motion);
    let csv = folder.read("jump.csv");
    let import = folder.command(&["import", "-", "--format", "csv", "-o", "-"]);
    let (code, take, stderr) = with_input(import, &csv);
    assert_eq!(code, Some(0), "{stderr}");
    folder.write("piped.take", &take);
    folder.run(&["verify", "piped.take", "--against", "jump.csv"]).with_code(0);
    let export = folder.command(&["export", "-", "-o", "-", "--to", "csv"]);
    let (code, exported, stderr) = with_input(export, &take);
    assert_eq!(code, Some(0), "{stderr}");
    folder.run(&["export", "piped.take", "-o", "piped.csv"]).with_code(0);
    assert!(exported == folder.read("piped.csv"));
    let (code, stdout, _) = with_input(folder.command(&["info", "-", "--format", "take"]), &take);
    assert!(code == Some(0) && !stdout.is_empty());

    let before = folder.content();
    for (args, code) in [
        (&["import", "-", "-o", "x.take"][..], 2),
        (&["info", "-"], 2),
        (&["info", "-", "-", "--format", "take"], 2),
        (&["import", "-", "--format", "csv"], 2),
        (&["import", "jump.csv", "-o", "-", "--json"], 2),
        (&["import", "-", "--format", "csv", "-o", "x.take", "--max-input", "1kB"], 1),
        (&["export", "-", "-o", "-", "--format", "bids"], 2),
    ] {
        let (found, stdout, stderr) = with_input(folder.command(args), &csv);
        assert_eq!(found, Some(code), "{args:?}: {stderr}");
        assert!(stdout.is_empty() && stderr.lines().count() == 1, "{args:?}: {stderr}");
    }
    assert!(before == folder.content(), "nothing was written");
}

#[test]
fn an_interrupted_export_leaves_nothing() {
    let folder = Folder::new();
    folder.write_motion("long.csv", &jump(3, 240.0, 20.0));
    folder.run(&["import", "long.csv", "-o", "long.take"]).with_code(0);
    let before = folder.content();
    // BIDS is a folder: it has a temporary name until it is complete.
    for format in ["bids", "csv"] {
        let export = ["export", "long.take", "-o", "out", "--format", format];
        let remove_output = || {
            let out = folder.path("out");
            fs::remove_dir_all(&out).or_else(|_| fs::remove_file(&out)).unwrap();
        };
        folder.run(&export).with_code(0);
        let finished = folder.content();
        remove_output();
        for _ in 0..5 {
            let mut child = folder.command(&export).spawn().unwrap();
            std::thread::sleep(std::time::Duration::from_millis(60));
            Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
            let status = child.wait().unwrap();
            let after = folder.content();
            if after.contains_key(&folder.path("out")) {
                // The output had its name before the signal came, so it is complete.
                assert!(after == finished, "{format}, {status}: {:?}", after.keys());
                remove_output();
            } else {
                assert!(after == before, "{format}, {status}: {:?}", after.keys());
            }
        }
    }
}

#[test]
fn other_names_of_a_file_are_left_out_and_counted() {
    let (folder, _) = files(1);
    std::os::unix::fs::symlink("0.csv", folder.path("in/link.csv")).unwrap();
    let ran = folder.run(&["import", "in", "in/0.csv", "-o", "out/"]).with_code(0);
    assert_mentions(&ran.stderr, &["in/link.csv: left out, it is in/0.csv", "in/0.csv: left out"]);
    assert_mentions(&ran.stdout, &["same file          2"]);
    assert_eq!(fs::read_dir(folder.path("out")).unwrap().count(), 1);
}
