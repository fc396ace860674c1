//! Recording on a small real file system: a tmpfs in its own mount namespace.

use std::process::{Command, Stdio};

use super::{Folder, Ran, devices::Simulated};
use crate::support::{assert_mentions, crowd};

/// Runs a script in `folder`, where `disk` is a file system of `bytes` bytes; prints the reason and returns `None`
/// if none can be mounted. The program is `$mocapd`, the device `$device`.
#[expect(clippy::print_stderr, reason = "a test that is skipped says why")]
fn on_small_disk(folder: &Folder, bytes: u64, device: &str, script: &str) -> Option<Ran> {
    std::fs::create_dir(folder.path("disk")).unwrap();
    let mount = format!("mount -t tmpfs -o size={bytes} tmpfs disk");
    let unshared = |script: &str| {
        let mut command = Command::new("unshare");
        command.args(["--map-root-user", "--mount", "sh", "-c", script]);
        command.current_dir(folder.path("")).stdin(Stdio::null());
        command.env("mocapd", env!("CARGO_BIN_EXE_mocapd")).env("device", device);
        command.output()
    };
    let can_mount = unshared(&mount).is_ok_and(|output| output.status.success());
    if !can_mount {
        eprintln!("skipped: no file system can be mounted here (unshare --map-root-user --mount)");
        return None;
    }
    Some(unshared(&format!("{mount} || exit 99\n{script}")).unwrap().into())
}

/// The lines of a recording without those that say that no frame came for a while: a machine that stands still stops the
/// simulator, too.
fn complaints(stderr: &str) -> Vec<&str> {
    stderr.lines().filter(|line| !line.contains("no frame came for ")).collect()
}

/// 150 markers, 1000 times a second.
fn device() -> Simulated {
    Simulated::endless(crowd(5, 1000.0, 2.0))
}

#[test]
fn a_take_is_closed_before_the_disk_is_full_and_the_next_is_refused() {
    let (folder, device) = (Folder::new(), device());
    let script = "
        $mocapd record --device $device -o disk/a.take --lossless --keep-free 4MiB --seconds 60s --json > a.json 2> a.err
        echo $? > a.code
        cp disk/a.take .
        head -c 2000000 /dev/zero > disk/more
        $mocapd record --device $device -o disk/b.take --keep-free 4MiB --seconds 1s";
    let Some(second) = on_small_disk(&folder, 9 << 20, &device.uri(), script) else { return };
    assert_eq!(folder.text("a.code").trim(), "3", "{}", folder.text("a.err"));
    assert_eq!(complaints(&folder.text("a.err")).len(), 1, "{}", folder.text("a.err"));
    let report: serde_json::Value = serde_json::from_str(&folder.text("a.json")).unwrap();
    assert_eq!(report["ending"], "disk full");
    let ledger = &report["ledger"];
    assert_eq!((&ledger["closes"], &ledger["recorded"]), (&true.into(), &ledger["frames_sent"]));
    folder.run(&["verify", "a.take"]).with_code(0);

    assert_eq!(second.code, Some(1), "{}", second.stderr);
    let line = second.stderr.lines().last().unwrap();
    assert_mentions(line, &["disk/b.take", "4 MB", "--keep-free"]);
}

/// Every message about a full disk says what to do, for every kind of file.
#[test]
fn a_full_disk_has_a_remedy() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &crowd(40, 120.0, 5.0));
    folder.run(&["import", "jump.csv", "-o", "jump.take", "--lossless"]).with_code(0);
    let script = "
        for line in 'import jump.csv -o disk/new.take --lossless' 'export jump.take -o disk/new.csv' \
                    'export jump.take -o disk/new --format bids' 'recover jump.take -o disk/new.take'; do
            $mocapd $line 2>>err
            echo $? >>codes
        done
        $mocapd demo --out disk/demo 2>>err
        echo $? >>codes
        ls -A disk";
    let Some(ran) = on_small_disk(&folder, 64 << 10, "", script) else { return };
    let lines = folder.text("err");
    assert_eq!(folder.text("codes"), "1\n".repeat(5), "{lines}");
    let lines: Vec<&str> = lines.lines().collect();
    assert_eq!(lines.len(), 5, "{lines:?}");
    for line in &lines[..4] {
        assert_mentions(
            line,
            &["disk/new", "(os error 28): free some space or choose another folder"],
        );
    }
    assert_mentions(lines[4], &["disk/demo", "--out", "free some space"]);
    assert!(!lines[4].contains("--keep-free"), "demo has no such option: {}", lines[4]);
    assert_eq!(ran.stdout.trim(), "demo", "nothing is left half written");
}

/// What a take has reserved is free for the next one, and the last is closed as a single one would be.
#[test]
fn a_divided_recording_ends_before_the_disk_is_full() {
    let (folder, device) = (Folder::new(), device());
    let script = "
        $mocapd record --device $device -o disk/a.take --lossless --keep-free 2MiB --split 1s --seconds 60s --json > a.json 2> a.err
        echo $? > a.code
        cp disk/*.take .";
    if on_small_disk(&folder, 12 << 20, &device.uri(), script).is_none() {
        return;
    }
    assert_eq!(folder.text("a.code").trim(), "3", "{}", folder.text("a.err"));
    assert_eq!(complaints(&folder.text("a.err")).len(), 1, "{}", folder.text("a.err"));
    let report: serde_json::Value = serde_json::from_str(&folder.text("a.json")).unwrap();
    assert_eq!(report["ending"], "disk full");
    let ledger = &report["ledger"];
    assert_eq!((&ledger["closes"], &ledger["recorded"]), (&true.into(), &ledger["frames_sent"]));
    let parts = report["parts"].as_array().unwrap();
    assert!(parts.len() >= 3, "{report}");
    let (last, whole) = parts.split_last().unwrap();
    assert_eq!(last["ending"], "disk full");
    assert!(whole.iter().all(|part| part["frames"] == 1000), "{report}");
    for number in 1..=parts.len() {
        folder.run(&["verify", &format!("a-{number:03}.take")]).with_code(0);
    }
}

#[test]
fn a_take_can_be_closed_when_something_else_takes_all_that_is_left() {
    let (folder, device) = (Folder::new(), device());
    // Another program fills the rest of the disk between two polls, once more than 500 frames are on it.
    let script = "
        $mocapd record --device $device -o disk/a.take --keep-free 64KiB --seconds 60s --json > a.json 2> a.err &
        recorder=$!
        frames() { $mocapd info --json disk/a.take 2>/dev/null | sed -n 's/^  \"frames\": \\([0-9]*\\),$/\\1/p'; }
        tries=0
        until [ \"$(frames)\" -gt 500 ] || [ $((tries += 1)) -gt 400 ]; do sleep 0.1; done 2>/dev/null
        echo $tries > a.tries
        cat /dev/zero > disk/more
        wait $recorder
        echo $? > a.code
        cp disk/a.take .";
    if on_small_disk(&folder, 12 << 20, &device.uri(), script).is_none() {
        return;
    }
    let tries: u32 = folder.text("a.tries").trim().parse().unwrap();
    assert!(tries <= 400, "info has not stated 500 frames: {}", folder.text("a.err"));
    assert_eq!(folder.text("a.code").trim(), "3", "{}", folder.text("a.err"));
    let report: serde_json::Value = serde_json::from_str(&folder.text("a.json")).unwrap();
    assert_eq!(
        (&report["ending"], &report["ledger"]["closes"]),
        (&"disk full".into(), &true.into())
    );
    assert!(report["frames"].as_u64().unwrap() > 500, "{report}");
    folder.run(&["verify", "a.take"]).with_code(0);
}
