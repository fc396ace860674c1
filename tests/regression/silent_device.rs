//! A device that is silent when its take ends: the frames due are on the ledger, and the take is not complete.

use std::{path::PathBuf, sync::Arc};

use mocapd_acquire::{ledger::TakeHealth, threads::Heartbeat};
use mocapd_service::{
    control::{Control, Request},
    engine::Engine,
    status::Presence,
};
use mocapd_simulator::{
    device::{Device, DeviceSettings},
    faults::{FaultyDevice, Script},
};

use crate::{
    cli::{
        Folder,
        devices::{Recorder, Simulated},
    },
    service::engine::{named, options, wait_until},
    support::jump,
};

/// A device that falls silent after a second and does not confirm a stop.
fn falls_silent(at: Option<PathBuf>) -> Simulated {
    let script = "seed = 1\n[[fault]]\nkind = 'stall'\nat_s = 1\nfor_s = 100";
    let script = Arc::new(Script::parse("stall", script).unwrap());
    let settings = DeviceSettings {
        looping: true,
        faults: Some(Arc::clone(&script)),
        ..DeviceSettings::default()
    };
    let device = Device::new(jump(1, 120.0, 2.0), settings).unwrap();
    Simulated::serve_at(at, FaultyDevice::new(device, &script), None)
}

#[test]
fn frames_due_in_a_silence_at_the_end_are_lost() {
    let folder = Folder::new();
    let device = falls_silent(None);
    let ran = Recorder::start(&folder, &device, "a.take", &["--json", "--seconds", "4s"]).wait();
    let report = ran.with_code(3).json();
    let ledger = &report["ledger"];
    assert_eq!(ledger["closes"], true, "{ledger}");
    // The frames of three of the four seconds, and no more.
    let lost = ledger["unknown_after_disconnect"].as_u64().unwrap();
    assert!((300..=370).contains(&lost), "{ledger}");
    let info = folder.run(&["info", "a.take", "--json"]).with_code(3).json();
    assert_eq!((&info["health"], &info["ledger"]), (&"lossy".into(), ledger));
    let events = info["events"].as_array().unwrap();
    assert_eq!((events.len(), &events[0]["kind"]), (1, &"host".into()), "{events:?}");
    folder.run(&["verify", "a.take"]).with_code(3);
}

#[test]
fn the_service_says_the_same_of_its_take() {
    let folder = Folder::new();
    let link = folder.path("device");
    let _device = falls_silent(Some(link.clone()));
    let engine = Engine::start(options(&folder.path(""), &link), &Heartbeat::default()).unwrap();
    engine.start(&named("walk")).unwrap();
    wait_until("two seconds of silence", || {
        engine.status().device.outage.is_some_and(|outage| outage.seconds > 2.0)
    });
    assert_eq!(engine.status().device.presence, Presence::Silent);
    let stopped = engine.stop(&Request::default()).unwrap();
    assert!(stopped.ledger.unknown_after_disconnect >= 240, "{stopped:?}");
    let listed = engine.takes(2).unwrap();
    assert_eq!((listed.len(), listed[0].health), (1, TakeHealth::Lossy));
}
