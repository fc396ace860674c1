//! A device that is away shows in the status and in `ctl status`, with what its absence costs so far.

use std::{sync::Arc, time::Duration};

use mocapd_acquire::threads::Heartbeat;
use mocapd_service::{
    control::{Control, Request},
    engine::Engine,
    http::{HttpOptions, HttpServer},
    status::{Presence, State},
};

use crate::{
    cli::{Folder, devices::Simulated},
    service::engine::{named, options, wait_until},
    support::{assert_mentions, jump},
};

#[test]
fn a_recording_without_its_device_is_not_shown_as_healthy() {
    let folder = Folder::new();
    let link = folder.path("device");
    let motion = jump(1, 120.0, 3.0);
    let device = Simulated::endless_at(&link, "A", motion.clone());
    let mut options = options(&folder.path(""), &link);
    options.take.reconnect = Duration::from_secs(600);
    let engine = Arc::new(Engine::start(options, &Heartbeat::default()).unwrap());
    let socket = folder.path("rig.sock");
    let options = HttpOptions { unix_socket: Some(socket.clone()), ..HttpOptions::default() };
    let control: Arc<dyn Control> = Arc::<Engine>::clone(&engine);
    let _server = HttpServer::start(options, control).unwrap();
    let connect = format!("unix:{}", socket.display());
    let ctl = |args: &[&str]| folder.run(&[&["ctl", "--connect", &connect], args].concat());

    engine.start(&named("walk")).unwrap();
    let status = engine.status();
    assert_eq!((status.device.is_awaited, status.device.outage), (false, None));
    device.unplug();
    wait_until("the outage", || engine.status().device.presence == Presence::Absent);
    wait_until("half a second of it", || {
        engine.status().device.outage.is_some_and(|outage| outage.seconds > 0.5)
    });
    let status = engine.status();
    let outage = status.device.outage.unwrap();
    assert_eq!((status.state, status.device.is_awaited), (State::Recording, true));
    assert_eq!(outage.frames, (outage.seconds * status.device.rate_hz) as u64);
    assert!((590.0..600.0).contains(&outage.ends_in_s.unwrap()), "{outage:?}");
    // The systemd status and the first line of `ctl status` begin with it.
    assert!(status.summary().starts_with("no device for "), "{}", status.summary());
    let printed = ctl(&["status"]).with_code(0).stdout;
    let first = printed.lines().next().unwrap();
    // The remaining time for which the take waits for it.
    assert_mentions(first, &["test", "9 min"]);
    let json = ctl(&["status", "--json"]).with_code(0).json();
    assert!(json["device"]["outage"]["frames"].as_u64().unwrap() >= outage.frames);

    let _device = Simulated::endless_at(&link, "A", motion);
    wait_until("its return", || engine.status().device.outage.is_none());
    assert_eq!(engine.status().device.outages, 1);
    assert_mentions(&ctl(&["status"]).stdout, &["test", "recording", "walk"]);
    let stopped = engine.stop(&Request::default()).unwrap();
    assert!(stopped.ledger.unknown_after_disconnect >= 60, "{stopped:?}");
}

#[test]
fn a_service_that_waits_for_its_device_says_so() {
    let folder = Folder::new();
    let mut options = options(&folder.path(""), &folder.path("device"));
    options.arm.at_start = true;
    let engine = Engine::start(options, &Heartbeat::default()).unwrap();
    wait_until("the device is missed", || engine.status().device.obstacle.is_some());
    let status = engine.status();
    assert_eq!((status.state, status.device.presence), (State::Idle, Presence::Absent));
    assert_eq!((status.device.is_awaited, status.device.outage), (true, None));
    engine.disarm(&Request::default()).unwrap();
    assert!(!engine.status().device.is_awaited);
}
