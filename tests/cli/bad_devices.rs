//! Devices that cannot be recorded: each error says why and what to do, and no take is left behind.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    thread::{scope, sleep},
    time::Duration,
};

use mocapd_drivers::transport::TransportError;
use mocapd_simulator::device::DeviceSettings;
use rustix::process::Signal;

use super::{
    Folder,
    devices::{RawLine, Recorder, Simulated},
    unprivileged,
};
use crate::support::{assert_mentions, jump, mentions};

#[track_caller]
fn refused(folder: &Folder, device: &str) -> String {
    folder.refuses(&["record", "-d", device, "-o", "new.take", "--json"], 1)
}

#[test]
fn absent_devices_and_other_files_are_refused() {
    let folder = Folder::new();
    folder.write("file", "");
    let absent = |device: &str| TransportError::NotFound { device: device.to_owned() }.to_string();
    assert_eq!(refused(&folder, "serial:/dev/mocapd-none"), absent("/dev/mocapd-none"));
    for path in ["file", ".", "/dev/null"] {
        assert_mentions(&refused(&folder, &format!("serial:{path}")), &[path, "/dev/ttyUSB0"]);
    }
    assert_eq!(refused(&folder, "usb:1209:0001:none"), absent("usb:1209:0001:none"));
    assert_mentions(&absent(""), &["mocapd devices"]);
}

#[test]
fn a_device_in_use_is_refused() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 2.0));
    let mut first = Recorder::start(&folder, &device, "first.take", &[]);
    let mut second = folder.command(&["record", "-d", &device.uri(), "-o", "second.take"]);
    let second = super::Ran::from(second.output().unwrap()).with_code(1);
    let busy = TransportError::Busy {
        device: device.path.display().to_string(),
        holder: Some(format!("mocapd (process {})", first.pid())),
    };
    assert_eq!(second.stderr, format!("mocapd: {busy}\n"));
    assert!(!folder.path("second.take").exists());
    first.signal(Signal::INT);
    first.wait().with_code(0);
    folder.run(&["verify", "first.take"]).with_code(0);
}

#[test]
fn a_device_without_permission_is_refused() {
    let folder = Folder::new();
    let device = Simulated::of(jump(1, 120.0, 1.0));
    let Some(user) = unprivileged::command_in(&folder) else { return };
    unprivileged::forbid(&device.path);
    let line = folder.refused(user(&["record", "-d", &device.uri(), "-o", "new.take"]), 1);
    assert_mentions(&line, &[&device.path.display().to_string()]);
    assert!(["udev", "usermod"].iter().any(|remedy| mentions(&line, remedy)), "{line}");
}

#[test]
fn a_line_too_slow_for_the_rate_names_the_rate_that_fits() {
    let folder = Folder::new();
    let baud = 115_200;
    let settings =
        DeviceSettings { line_bytes_per_s: u64::from(baud) / 10, ..DeviceSettings::default() };
    let device = Simulated::start(jump(1, 500.0, 0.5), settings, Some(baud));
    let uri = device.uri();
    let line = folder.refuses(&["record", "-d", &uri, "-o", "new.take"], 1);
    assert_mentions(&line, &["500 Hz", "11520"]);
    let rate = line.split("--rate ").nth(1).and_then(|rest| rest.split(',').next());
    let rate = rate.unwrap_or_else(|| panic!("no rate in: {line}"));
    assert!(rate.parse::<f64>().is_ok_and(|hz| hz > 10.0 && hz < 500.0), "{line}");
    // The stated rate fits, and a slightly higher one does not.
    let record = ["record", "-d", &uri, "-o", "new.take", "--json", "--rate"];
    let report = folder.run(&[&record[..], &[rate]].concat()).with_code(0).json();
    assert_eq!(report["rate_hz"].as_f64(), rate.parse().ok());
    assert_eq!(report["ledger"]["closes"], true);
    std::fs::remove_file(folder.path("new.take")).unwrap();
    let more = format!("{}", rate.parse::<f64>().unwrap() + 1.0);
    let line = folder.refuses(&[&record[..], &[more.as_str()]].concat(), 1);
    assert_mentions(&line, &[&more, "11520", "--rate", rate]);
}

/// Both wait for an answer that never comes, in parallel.
#[test]
fn silent_and_foreign_devices_are_refused() {
    let (mute, noisy) = (RawLine::open(), RawLine::open());
    let noisy_uri = noisy.uri();
    let done = AtomicBool::new(false);
    scope(|scope| {
        scope.spawn(|| {
            let mut noise = 1_u32;
            while !done.load(Ordering::Relaxed) {
                let bytes: Vec<u8> = (0..200)
                    .map(|_| {
                        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        (noise >> 24) as u8
                    })
                    .collect();
                rustix::io::write(&noisy.master, &bytes).ok();
                let mut commands = [0; 4096];
                rustix::io::read(&noisy.master, &mut commands).ok();
                sleep(Duration::from_millis(10));
            }
        });
        let noisy_refused = scope.spawn(|| refused(&Folder::new(), &noisy_uri));
        let mute_refused = scope.spawn(|| refused(&Folder::new(), &mute.uri()));
        let ended = (noisy_refused.join(), mute_refused.join());
        done.store(true, Ordering::Relaxed);
        let (noisy_line, mute_line) = (ended.0.unwrap(), ended.1.unwrap());
        // The message names the driver that could not decode the noise; silence has none to name.
        assert_mentions(&noisy_line, &[&noisy_uri, "dvmc", "baud", "?driver=NAME"]);
        assert_mentions(&mute_line, &[&mute.uri(), "cable", "baud", "?driver=NAME"]);
        assert!(!mentions(&mute_line, "dvmc"), "{mute_line}");
    });
}
