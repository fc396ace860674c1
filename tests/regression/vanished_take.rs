//! Removing, renaming, truncating or unmounting a take while it is recorded is reported as a failure, and nothing is
//! lost that can be kept.

use std::{fs, path::PathBuf, process::Command};

use rustix::process::Signal;
use serde_json::Value;

use crate::{
    cli::{
        Folder,
        devices::{Recorder, Simulated},
        service::Service,
    },
    support::{assert_mentions, jump, mentions},
};

/// A folder with a subfolder for the take, and an endless device.
fn rig() -> (Folder, Simulated) {
    let folder = Folder::new();
    fs::create_dir(folder.path("in")).unwrap();
    (folder, Simulated::endless(jump(1, 120.0, 1.0)))
}

/// Records `in/a.take`, does something to it, waits for the message about it, and ends the recording with Ctrl-C.
fn record(folder: &Folder, device: &Simulated, change: impl FnOnce(&Folder)) -> Value {
    let mut recorder = Recorder::start(folder, device, "in/a.take", &["--json"]);
    change(folder);
    recorder.wait_for_message("/fd/");
    recorder.signal(Signal::INT);
    recorder.wait().with_code(3).json()
}

#[test]
fn record_continues_a_removed_take_and_saves_it() {
    let (folder, device) = rig();
    let report = record(&folder, &device, |folder| {
        fs::remove_file(folder.path("in/a.take")).unwrap();
    });
    assert_eq!((&report["file_state"], &report["ending"]), (&"removed".into(), &"stopped".into()));
    assert_eq!(report["file_path"], "in/a.saved.take");
    folder.run(&["verify", "in/a.saved.take"]).with_code(0);
    let info = folder.run(&["info", "in/a.saved.take", "--json"]).with_code(0).json();
    assert_eq!(info["ledger"]["recorded"], report["frames"]);
    assert_mentions(info["ending_detail"].as_str().unwrap(), &["removed"]);
    assert!(!folder.path("in/a.take").exists());
}

#[test]
fn record_continues_a_take_that_was_renamed_with_its_folder() {
    let (folder, device) = rig();
    let report = record(&folder, &device, |folder| {
        fs::rename(folder.path("in"), folder.path("out")).unwrap();
    });
    assert_eq!(report["file_state"], "renamed");
    let path = PathBuf::from(report["file_path"].as_str().unwrap());
    assert!(path.ends_with("out/a.take") && path.exists(), "{}", path.display());
    folder.run(&["verify", "out/a.take"]).with_code(0);
}

#[test]
fn record_says_when_a_take_is_lost_with_its_folder() {
    let (folder, device) = rig();
    let report = record(&folder, &device, |folder| {
        fs::remove_dir_all(folder.path("in")).unwrap();
    });
    let state = (&report["file_state"], &report["file_path"]);
    assert_eq!(state, (&"removed".into(), &Value::Null));
    assert!(folder.content().is_empty(), "no folder is made again");
}

#[test]
fn record_ends_a_take_that_was_cut_short() {
    let (folder, device) = rig();
    let mut recorder = Recorder::start(&folder, &device, "in/a.take", &["--json"]);
    let file = fs::File::options().write(true).open(folder.path("in/a.take")).unwrap();
    file.set_len(100).unwrap();
    let report = recorder.wait().with_code(3).json();
    assert_eq!(
        (&report["file_state"], &report["ending"]),
        (&"truncated".into(), &"truncated".into())
    );
    assert_eq!((&report["file_bytes"], &report["ledger"]["closes"]), (&100.into(), &false.into()));
    assert_eq!(folder.read("in/a.take").len(), 100, "nothing is written behind the cut");
}

/// On a tmpfs in its own mount namespace: needs root, or user namespaces.
#[test]
fn record_ends_a_take_whose_file_system_goes_away() {
    let (folder, device) = rig();
    let unshared = |script: &str| {
        let mut command = Command::new("unshare");
        command.args(["--map-root-user", "--mount", "sh", "-c", script]);
        command.current_dir(folder.path(""));
        command.env("mocapd", env!("CARGO_BIN_EXE_mocapd")).env("device", device.uri());
        command.output()
    };
    let mount = "mount -t tmpfs tmpfs in";
    if !unshared(mount).is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: no file system can be mounted here (unshare --map-root-user --mount)");
        return;
    }
    for (name, change) in [("gone", "umount -l in"), ("covered", mount)] {
        let script = format!(
            "{mount} || exit 99
            exec 9< in
            $mocapd record --device $device -o in/a.take --keep-free 0 --seconds 60s --json > {name}.json &
            until [ -s in/a.take ]; do sleep 0.05; done
            {change} || exit 98
            wait $!
            code=$?
            cp /proc/self/fd/9/a.take {name}.take
            exit $code"
        );
        let ran = unshared(&script).unwrap();
        assert_eq!(ran.status.code(), Some(3), "{name}: {}", String::from_utf8_lossy(&ran.stderr));
        let report: Value = serde_json::from_str(&folder.text(&format!("{name}.json"))).unwrap();
        assert_eq!(
            (&report["file_state"], &report["ending"], &report["file_path"]),
            (&"unmounted".into(), &"unmounted".into(), &Value::Null)
        );
        // It is whole on the file system that went away.
        let take = format!("{name}.take");
        folder.run(&["verify", &take]).with_code(0);
        assert_eq!(folder.run(&["info", &take, "--json"]).json()["ending"], "unmounted");
    }
}

#[test]
fn the_service_says_where_a_take_is_that_was_removed_or_renamed() {
    let (folder, device) = rig();
    let mut service = Service::start(&folder, &device, "", "");
    let place = |name: &str| folder.path(&format!("takes/{name}.take"));
    let recording = |service: &Service, name: &str| {
        let (status, started) = service.post("/v1/start", &format!(r#"{{"name": "{name}"}}"#));
        assert_eq!(status, 200, "{started}");
    };

    recording(&service, "removed");
    fs::remove_file(place("removed")).unwrap();
    let status = service.wait_until("the notice", |status| status["take"]["file"] == "removed");
    let notice = status["take"]["file_notice"].as_str().unwrap();
    let open_at = format!("/proc/{}/fd/", service.pid());
    assert!(notice.contains(&open_at), "{notice}");
    let (status, stopped) = service.post("/v1/stop", "{}");
    assert_eq!((status, &stopped["file"]), (200, &"removed".into()), "{stopped}");
    assert_eq!(stopped["path"], place("removed.saved").to_str().unwrap());
    folder.run(&["verify", "takes/removed.saved.take"]).with_code(0);

    recording(&service, "renamed");
    fs::rename(place("renamed"), place("other")).unwrap();
    service.wait_until("the notice", |status| status["take"]["file"] == "renamed");
    let takes = service.get("/v1/takes");
    let open = takes.as_array().unwrap().iter().find(|take| take["name"] == "other").unwrap();
    assert_eq!(open["is_open"], true, "{takes}");
    let socket = format!("unix:{}", folder.path("rig.sock").display());
    let ran = folder.run(&["ctl", "--connect", &socket, "stop", "--json"]).with_code(3);
    assert_eq!(ran.json()["path"], place("other").to_str().unwrap());
    folder.run(&["verify", "takes/other.take"]).with_code(0);

    // A take that cannot be saved stays open, and the exit code says so.
    recording(&service, "lost");
    fs::rename(folder.path("takes"), folder.path("old")).unwrap();
    fs::remove_dir_all(folder.path("old")).unwrap();
    let (status, problem) = service.post("/v1/stop", "{}");
    assert_eq!((status, &problem["kind"]), (410, &"vanished".into()), "{problem}");
    let message = problem["message"].as_str().unwrap();
    let from = message.find(&open_at).unwrap();
    let open_at = message[from..].split(' ').next().unwrap();
    folder.write("saved.take", fs::read(open_at).unwrap());
    folder.run(&["verify", "saved.take"]).with_code(0);
    assert_eq!(service.get("/v1/status")["state"], "failed");
}

#[test]
fn the_service_ends_a_take_that_was_cut_short() {
    let (folder, device) = rig();
    let mut service = Service::start(&folder, &device, "", "");
    assert_eq!(service.post("/v1/start", r#"{"name": "short"}"#).0, 200);
    let file = fs::File::options().write(true).open(folder.path("takes/short.take")).unwrap();
    file.set_len(150).unwrap();
    let status = service.wait_until("the end", |status| !status["last_take"].is_null());
    let last = &status["last_take"];
    assert_eq!((&last["ending"], &last["bytes"]), (&"truncated".into(), &150.into()), "{last}");
    assert_ne!(last["health"], "complete");
    assert_eq!(&service.get("/v1/takes")[0], last, "the list says the same");
    let (status, problem) = service.post("/v1/stop", "{}");
    assert_eq!((status, &problem["kind"]), (409, &"data_lost".into()), "{problem}");
    let socket = format!("unix:{}", folder.path("rig.sock").display());
    folder.run(&["ctl", "--connect", &socket, "stop"]).with_code(3);
    assert_eq!(file.metadata().unwrap().len(), 150, "nothing is written behind the cut");
    let log = folder.text("rig.log");
    let is_closing = |line: &str| mentions(line, "short") && mentions(line, "mocapd recover");
    assert!(log.lines().any(is_closing), "{log}");
    // The next take is not affected.
    assert_eq!(service.post("/v1/start", r#"{"name": "next"}"#).0, 200);
    let (status, stopped) = service.post("/v1/stop", "{}");
    assert_eq!((status, &stopped["file"]), (200, &"in_place".into()), "{stopped}");
    assert_eq!(service.post("/v1/stop", "{}").1["kind"], "conflict");
}

#[test]
fn a_renamed_take_is_live_under_the_name_that_it_has() {
    let (folder, device) = rig();
    let mut service = Service::start(&folder, &device, "", "");
    let place = |name: &str| folder.path(&format!("takes/{name}.take"));
    assert_eq!(service.post("/v1/start", r#"{"name": "a"}"#).0, 200);
    let names_it = |name: &str| {
        let name = format!("/{name}.take");
        move |status: &Value| {
            status["take"]["file_notice"].as_str().is_some_and(|notice| notice.contains(&name))
        }
    };
    fs::rename(place("a"), place("b")).unwrap();
    service.wait_until("the notice", names_it("b"));
    let verify = |name: &str| service.post(&format!("/v1/takes/{name}/verify"), "{}");
    let (status, problem) = verify("b");
    assert_eq!((status, &problem["kind"]), (409, &"conflict".into()), "{problem}");
    // Another file with the old name is not being recorded.
    fs::write(place("a"), b"another").unwrap();
    let (status, check) = verify("a");
    assert_eq!((status, &check["health"]), (200, &"unreadable".into()), "{check}");
    fs::rename(place("b"), place("c")).unwrap();
    service.wait_until("the new notice", names_it("c"));
    let (status, stopped) = service.post("/v1/stop", "{}");
    assert_eq!((status, &stopped["name"]), (200, &"c".into()), "{stopped}");
    assert_eq!(stopped["path"], place("c").to_str().unwrap());
}

/// Limits files to 12 KiB, with an error instead of a signal.
const LIMITED: &str = "trap '' XFSZ; ulimit -f 24";

#[test]
fn a_removed_take_is_saved_when_its_disk_fails_later() {
    let (folder, device) = rig();
    let mut service = Service::start(&folder, &device, "lossless = true", LIMITED);
    assert_eq!(service.post("/v1/start", r#"{"name": "a"}"#).0, 200);
    fs::remove_file(folder.path("takes/a.take")).unwrap();
    let status = service.wait_until("the end", |status| status["state"] == "failed");
    let failure = status["failure"].as_str().unwrap();
    assert!(failure.contains("a.saved.take"), "{failure}");
    let info = folder.run(&["info", "takes/a.saved.take", "--json"]).with_code(3).json();
    assert!(info["frames"].as_u64().unwrap() > 0, "{info}");
    drop(service);

    let script = format!(
        "{LIMITED}; exec \"$mocapd\" record --device \"$device\" -o in/b.take --lossless --keep-free 0"
    );
    let mut record = Command::new("sh")
        .args(["-c", &script])
        .env("mocapd", env!("CARGO_BIN_EXE_mocapd"))
        .env("device", device.uri())
        .current_dir(folder.path(""))
        .stderr(fs::File::create(folder.path("record.log")).unwrap())
        .spawn()
        .unwrap();
    while fs::metadata(folder.path("in/b.take")).map_or(0, |file| file.len()) == 0 {
        assert_eq!(record.try_wait().unwrap(), None, "{}", folder.text("record.log"));
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    fs::remove_file(folder.path("in/b.take")).unwrap();
    assert_eq!(record.wait().unwrap().code(), Some(1));
    let record_log = folder.text("record.log");
    assert!(record_log.contains("b.saved.take"), "{record_log}");
    let info = folder.run(&["info", "in/b.saved.take", "--json"]).with_code(3).json();
    assert!(info["frames"].as_u64().unwrap() > 0, "{info}");
}
