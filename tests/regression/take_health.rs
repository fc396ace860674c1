//! A take keeps its health and ending after further recordings.

use std::{fs, path::Path, time::Duration};

use mocapd_acquire::threads::Heartbeat;
use mocapd_service::{
    control::{Control, Request},
    engine::Engine,
};
use mocapd_take::chunk::{self, types};
use serde_json::{Value, json};

use crate::{
    cli::{
        Folder,
        devices::{Recorder, Simulated},
    },
    service::engine::{Room, named, options, room, wait_until},
    support::{config, dense, jump, places, record},
};

/// A service with a folder of takes, whose device is never connected.
fn service_of(folder: &Path) -> Engine {
    Engine::start(options(folder, &folder.join("no-device")), &Heartbeat::default()).unwrap()
}

/// Health and ending by name, as the API lists them.
fn listed(engine: &Engine) -> Value {
    let takes = serde_json::to_value(engine.takes(100).unwrap()).unwrap();
    let of = |take: &Value| {
        (take["name"].as_str().unwrap().to_owned(), json!([take["health"], take["ending"]]))
    };
    takes.as_array().unwrap().iter().map(of).collect()
}

/// Health and ending by `info --json`.
fn health_by_info(folder: &Folder, name: &str) -> Value {
    let info = folder.run(&["info", &format!("{name}.take"), "--json"]).json();
    json!([info["health"], info["ending"].as_str().unwrap_or_default()])
}

#[test]
fn losses_come_from_the_last_ledger() {
    let folder = Folder::new();
    // A service that starts closes the takes that were cut off before.
    let engine = service_of(&folder.path(""));
    let motion = jump(1, 60.0, 3.0);
    let config = config(&motion, dense(1.0));
    folder.write("whole.take", record(&motion, &config, 0..motion.n_frames()).1);
    let lossy = record(&motion, &config, (0..motion.n_frames()).filter(|seq| seq % 50 != 20)).1;
    folder.write("lossy.take", &lossy);
    folder.write("cut.take", &lossy[..lossy.len() - 1]);
    folder.write("noise.take", [7; 3000]);
    // One whose footer points to a damaged ledger.
    let (_, ledger) = places(&lossy).into_iter().rfind(|(kind, _)| *kind == types::LEDGER).unwrap();
    let mut damaged = lossy.clone();
    damaged[ledger.start + 5] ^= 1;
    folder.write("damaged.take", damaged);
    // One of a version without SUMMARY.
    let mut old = chunk::MAGIC.to_vec();
    for (_, place) in places(&lossy).iter().filter(|(kind, _)| *kind != 0x8d) {
        old.extend_from_slice(&lossy[place.clone()]);
    }
    // Its footer must have the offset of the index.
    let index = places(&old).into_iter().find(|(kind, _)| *kind == types::INDEX).unwrap().1.start;
    let ledger =
        places(&old).into_iter().rfind(|(kind, _)| *kind == types::LEDGER).unwrap().1.start;
    old.truncate(old.len() - mocapd_take::index::Footer::CHUNK_BYTES);
    let footer = mocapd_take::index::Footer {
        index_offset: index as u64,
        ledger_offset: ledger as u64,
        n_rows: 180,
    };
    chunk::put(&mut old, types::FOOTER, &footer.to_payload()).unwrap();
    folder.write("old.take", old);

    let takes = listed(&engine);
    assert_eq!(takes["whole"], json!(["complete", "stopped"]));
    assert_eq!(takes["lossy"], json!(["lossy", "stopped"]));
    assert_eq!(takes["old"], json!(["lossy", ""]));
    assert_eq!(takes["cut"], json!(["cut off", ""]));
    assert_eq!(takes["noise"], json!(["unreadable", ""]));
    assert_eq!(takes["damaged"][0], "damaged");
    for name in ["whole", "lossy", "old"] {
        assert_eq!(health_by_info(&folder, name), takes[name], "{name}");
    }
    assert_eq!(health_by_info(&folder, "damaged")[0], "damaged");
    // The list is cached, and updated when a file changes.
    assert_eq!(listed(&engine), takes);
    fs::copy(folder.path("whole.take"), folder.path("cut.take")).unwrap();
    assert_eq!(listed(&engine)["cut"], takes["whole"]);
}

#[test]
fn how_a_take_ended_is_known_after_the_next_one_and_after_a_restart() {
    let Room { directory, device, engine } = room(|options| {
        options.take.max_length = Some(Duration::from_millis(600));
    });
    engine.start(&named("long")).unwrap();
    wait_until("its end", || engine.status().take.is_none());
    engine.start(&named("asked")).unwrap();
    engine.stop(&Request::default()).unwrap();
    engine.start(&named("open")).unwrap();
    engine.stop_service();
    drop(engine);
    drop(device);
    let takes = listed(&service_of(directory.path()));
    assert_eq!(takes["long"], json!(["complete", "length"]));
    assert_eq!(takes["asked"], json!(["complete", "stopped"]));
    assert_eq!(takes["open"], json!(["complete", "service stopped"]));
}

#[test]
fn a_device_that_went_away_and_a_recorder_that_was_killed_are_in_the_take() {
    let folder = Folder::new();
    let motion = jump(1, 120.0, 1.0);
    let device = Simulated::endless(motion.clone());
    let mut recorder = Recorder::start(&folder, &device, "gone.take", &["--reconnect", "0s"]);
    device.unplug();
    recorder.wait().with_code(3);
    let device = Simulated::endless(motion);
    let mut recorder = Recorder::start(&folder, &device, "killed.take", &[]);
    recorder.signal(rustix::process::Signal::KILL);
    recorder.wait();
    folder.run(&["recover", "killed.take", "-o", "recovered.take"]).with_code(3);
    folder.run(&["recover", "recovered.take", "-o", "again.take"]).with_code(0);
    folder.run(&["recover", "gone.take", "-o", "copied.take"]).with_code(0);
    let engine = service_of(&folder.path(""));
    let takes = listed(&engine);
    for (name, expected) in [
        ("gone", ["lossy", "device gone"]),
        ("copied", ["lossy", "device gone"]),
        ("killed", ["cut off", ""]),
        ("recovered", ["lossy", "cut off"]),
        ("again", ["lossy", "cut off"]),
    ] {
        assert_eq!(takes[name], json!(expected), "{name}");
        assert_eq!(health_by_info(&folder, name), json!(expected), "{name}");
    }
    for name in ["gone", "copied"] {
        let take = format!("{name}.take");
        folder.run(&["info", &take]).with_code(3);
        let verified = folder.run(&["verify", &take, "--json"]).with_code(3).json();
        assert_eq!(json!([verified["health"], verified["ending"]]), takes[name], "{verified}");
    }
}
