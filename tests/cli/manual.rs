//! `completions` and `man`.

use std::process::Command;

use super::Folder;
use crate::support::assert_mentions;

#[test]
fn the_help_shows_both_with_examples() {
    let folder = Folder::new();
    assert_mentions(&folder.run(&["--help"]).with_code(0).stdout, &["completions", "man "]);
    for (command, facts) in [
        ("completions", ["mocapd completions bash >", "fish", "zsh"]),
        ("man", ["mocapd man import | man -l -", "mocapd man --out", "mocapd man plot pose"]),
    ] {
        assert_mentions(&folder.run(&[command, "--help"]).with_code(0).stdout, &facts);
    }
}

#[test]
fn the_help_of_each_command_begins_with_its_line_in_the_list() {
    let folder = Folder::new();
    let list = folder.run(&["--help"]).with_code(0).stdout;
    let one_line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let (_, list) = list.split_once("Commands:\n").unwrap();
    let list = one_line(list.split("\n\n").next().unwrap());
    for command in [
        "import",
        "export",
        "info",
        "gaps",
        "verify",
        "recover",
        "repack",
        "record",
        "man",
        "completions",
    ] {
        let help = folder.run(&[command, "--help"]).with_code(0).stdout;
        let text = one_line(help.split("\n\n").next().unwrap());
        assert!(list.contains(&format!("{command} {text}")), "{command}: {text}");
    }
}

#[test]
fn a_page_is_printed_or_all_are_written() {
    let folder = Folder::new();
    let import = folder.run(&["man", "import"]).with_code(0).stdout;
    assert_mentions(
        &import,
        &[".TH MOCAPD-IMPORT 1", "mocapd manual", "tolerance", "EXIT STATUS", "fB130"],
    );
    let pose = folder.run(&["man", "plot", "pose"]).with_code(0).stdout;
    assert_mentions(&pose, &[".TH MOCAPD-PLOT-POSE 1"]);
    assert_mentions(&folder.run(&["man"]).with_code(0).stdout, &[".TH MOCAPD 1"]);

    std::fs::create_dir(folder.path("man1")).unwrap();
    // As after an upgrade: a page is replaced.
    folder.write("man1/mocapd-import.1", "old");
    assert_eq!(folder.run(&["man", "--out", "man1"]).with_code(0).stdout, "");
    assert_eq!(folder.text("man1/mocapd-import.1"), import);
    assert_eq!(folder.text("man1/mocapd-plot-pose.1"), pose);
}

#[test]
fn invalid_arguments_are_refused() {
    let folder = Folder::new();
    let line = folder.refuses(&["man", "frob"], 2);
    assert_mentions(&line, &["'mocapd' has no command 'frob'", "import", "export"]);
    let line = folder.refuses(&["man", "plot", "frob"], 2);
    assert_mentions(&line, &["'mocapd plot' has no command 'frob'", "trajectory", "pose"]);
    // A hidden command has no page.
    folder.refuses(&["man", "bench", "device"], 2);
    folder.refuses(&["man", "import", "--out", "."], 2);
    assert_mentions(&folder.refuses(&["man", "--out", "none"], 1), &["none"]);
    assert_mentions(&folder.refuses(&["completions", "cmd"], 2), &["bash", "fish", "zsh"]);
}

#[test]
fn bash_completes_commands_and_options() {
    let folder = Folder::new();
    folder.write("mocapd.bash", folder.run(&["completions", "bash"]).with_code(0).stdout);
    let completed = |words: &str| {
        let script = format!(
            "source ./mocapd.bash; COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); \
             _mocapd mocapd \"${{COMP_WORDS[COMP_CWORD]}}\" \"${{COMP_WORDS[COMP_CWORD - 1]}}\"; echo \"${{COMPREPLY[@]}}\""
        );
        let mut bash = Command::new("bash");
        let output = bash.args(["-c", &script]).current_dir(folder.path("")).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    };
    assert_eq!(completed("mocapd imp"), "import");
    assert_eq!(completed("mocapd import --tol"), "--tolerance");
    assert_eq!(completed("mocapd export a.take --to c"), "c3d csv");
    assert_eq!(completed("mocapd plot pose a.take --to p"), "png");
    assert_eq!(completed("mocapd import --resampler d"), "dense");
    assert_eq!(completed("mocapd bench codec --resampler l"), "lossless");
}

#[test]
fn a_full_disk_fails_help_and_version_too() {
    for args in [&["--help"][..], &["--version"], &["import", "--help"], &["help", "export"]] {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let mut program = Command::new(env!("CARGO_BIN_EXE_mocapd"));
        let output = program.args(args).stdout(full).output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{args:?}: {message}");
        assert_mentions(&message, &["mocapd: cannot write to standard output", "free some space"]);
    }
}
