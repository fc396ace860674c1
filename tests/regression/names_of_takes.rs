//! Names of takes with a file extension, names in use, and names that are not UTF-8.

use std::{ffi::OsStr, fs, os::unix::ffi::OsStrExt};

use mocapd_acquire::threads::Heartbeat;
use mocapd_service::{
    control::{Control, Request},
    engine::Engine,
};

use crate::{
    cli::{Folder, devices::Simulated, service::Service},
    service::engine::{named, options, wait_until},
    support::jump,
};

#[test]
fn the_extension_is_added_once_and_a_listed_name_selects_that_take() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let engine =
        Engine::start(options(&folder.path(""), &device.path), &Heartbeat::default()).unwrap();
    let started = engine.start(&named("x.take.TAKE")).unwrap();
    assert_eq!(started.name, "x");
    engine.stop(&Request::default()).unwrap();
    // Another program may use this name.
    fs::copy(folder.path("x.take"), folder.path("x.take.take")).unwrap();
    let names: Vec<String> = engine.takes(9).unwrap().into_iter().map(|take| take.name).collect();
    assert!(names.contains(&"x.take".to_owned()), "{names:?}");
    assert_eq!(engine.take_path("x.take").unwrap(), folder.path("x.take.take"));
    fs::remove_file(folder.path("x.take.take")).unwrap();
    assert_eq!(engine.take_path("x.take").unwrap(), folder.path("x.take"));
}

#[test]
fn a_take_with_the_name_of_a_recovered_one_is_recovered() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let start =
        || Engine::start(options(&folder.path(""), &device.path), &Heartbeat::default()).unwrap();
    for recovered in ["n.recovered.take", "n.recovered-2.take"] {
        let engine = start();
        let take = engine.start(&named("n")).unwrap().path;
        std::thread::sleep(std::time::Duration::from_millis(700));
        let killed = fs::read(&take).unwrap();
        engine.stop(&Request::default()).unwrap();
        drop(engine);
        fs::write(&take, killed).unwrap();
        drop(start());
        let engine = start();
        wait_until("the recovery", || folder.path(recovered).exists());
        drop(engine);
        fs::remove_file(&take).unwrap();
    }
    // A recovered take is not recovered again.
    assert!(!folder.path("n.recovered-3.take").exists());
}

#[test]
fn a_name_that_is_not_utf_8_is_a_name() {
    let folder = Folder::new();
    folder.write_motion("a.csv", &jump(1, 100.0, 2.0));
    let name = OsStr::from_bytes(b"y\xff.take");
    let run = |args: &[&OsStr], code: i32| {
        let ran = std::process::Command::new(env!("CARGO_BIN_EXE_mocapd"))
            .args(args)
            .current_dir(folder.path(""))
            .output()
            .unwrap();
        assert_eq!(ran.status.code(), Some(code), "{args:?}: {ran:?}");
        serde_json::from_slice::<serde_json::Value>(&ran.stdout).unwrap()
    };
    let os = OsStr::new;
    let json = run(&[os("import"), os("a.csv"), os("-o"), name, os("--json")], 0);
    assert_eq!(json["take"], "y\u{fffd}.take");
    run(&[os("info"), name, os("--json")], 0);
    run(&[os("verify"), name, os("--json")], 0);
    let other = OsStr::from_bytes(b"z\xff.take");
    run(&[os("recover"), name, os("-o"), other, os("--json")], 0);
    // A take that is renamed in this way while recording is closed like any other.
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let mut service = Service::start(&folder, &device, "", "");
    service.post("/v1/start", r#"{"name": "live"}"#);
    let takes = folder.path("takes");
    fs::rename(takes.join("live.take"), takes.join(OsStr::from_bytes(b"live\xff.take"))).unwrap();
    service.wait_until("the notice", |status| status["take"]["file"] == "renamed");
    let (status, stopped) = service.post("/v1/stop", "{}");
    assert_eq!(status, 200, "{stopped}");
    assert!(stopped["path"].as_str().unwrap().ends_with("live\u{fffd}.take"), "{stopped}");
}
