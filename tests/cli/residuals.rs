//! Residuals of markers from a device to files: recorded from the link protocol, a QTM and a NatNet server, exported to C3D,
//! played again from that file and from its import, and seen in every output.

use std::{
    collections::HashMap,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{Builder, JoinHandle},
};

use mocapd_drivers::natnet::ServedStream;
use mocapd_simulator::{
    NetworkOptions,
    device::{Device, DeviceSettings},
    faults::Script,
    natnet::{NatNetDevice, NatNetListener, NatNetSettings},
    qtm::{QtmDevice, QtmListener, QtmSettings},
    source::{self, Residuals},
};
use mocapd_take::motion::{Motion, Position, is_gap};
use serde_json::Value;

use super::{Folder, faults::played::record_from, natnet::free_port};
use crate::support::{assert_mentions, jump};

const RATE_HZ: f64 = 240.0;

fn motion() -> Motion {
    jump(3, RATE_HZ, 2.0)
}

/// Asserts that a file has the residuals of `sent` where its markers are seen, from a frame of `sent` on.
#[track_caller]
fn assert_has(path: &Path, sent: &Residuals, skipped: usize) {
    let (found, _) = source::read(path).unwrap();
    let residuals = Residuals::read(path, &found).unwrap().expect("it has residuals");
    let original = motion();
    assert!(found.n_frames() > 100);
    for frame in 0..found.n_frames() {
        let sent = sent.frame((frame + skipped) as u64);
        let stored = residuals.frame(frame as u64);
        let of_markers = found.frame(frame).iter().zip(original.frame(frame + skipped));
        for (marker, ((got, was), (&stored, &sent))) in
            of_markers.zip(stored.iter().zip(sent)).enumerate()
        {
            assert_eq!(is_gap(*got), is_gap(*was));
            if !is_gap(*got) {
                assert_eq!(stored, sent, "{}: frame {frame} marker {marker}", path.display());
            }
        }
    }
}

/// A server on the network, until it is dropped.
struct Served {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    uri: String,
}

impl Served {
    fn new(uri: String, serve: impl FnOnce(&AtomicBool) + Send + 'static) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = Builder::new().name("simulator".to_owned());
        let thread = thread.spawn(move || serve(&stopped)).unwrap();
        Self { stop, thread: Some(thread), uri }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().map(JoinHandle::join);
    }
}

fn device(residuals: &Residuals) -> Device {
    let residuals = Some(Arc::new(residuals.clone()));
    Device::new(motion(), DeviceSettings { residuals, ..DeviceSettings::default() }).unwrap()
}

/// From the device to a take, to C3D, and from there to a take again: the residuals stay.
#[test]
fn residuals_go_from_a_device_to_c3d_and_back() {
    let folder = Folder::new();
    let sent = Residuals::generated(1, &motion());
    let options = ["-o", "a.take", "--residuals"];
    let (ran, _) = record_from(&folder, device(&sent), [None, None], &options);
    ran.with_code(0);
    assert_has(&folder.path("a.take"), &sent, 0);
    folder.run(&["verify", "a.take"]).with_code(0);
    let info = folder.run(&["info", "a.take", "--json"]).json();
    let group = &info["sampled_groups"][0];
    assert_eq!((&group["number"], &group["samples"]), (&32.into(), &480.into()), "{info:#}");
    assert_mentions(
        &folder.run(&["info", "a.take"]).stdout,
        &["residuals", "15 channels at 240 Hz"],
    );
    folder.run(&["export", "a.take", "-o", "a.c3d"]).with_code(0);
    assert_has(&folder.path("a.c3d"), &sent, 0);
    folder.run(&["import", "a.c3d", "-o", "b.take", "--lossless"]).with_code(0);
    assert_has(&folder.path("b.take"), &sent, 0);
    folder.run(&["export", "b.take", "-o", "b.c3d"]).with_code(0);
    assert_has(&folder.path("b.c3d"), &sent, 0);
    folder.run(&["cut", "a.take", "-o", "part.take", "--from", "0.5s"]).with_code(0);
    assert_has(&folder.path("part.take"), &sent, 120);
    folder.run(&["export", "a.take", "-o", "part.c3d", "--from", "0.5s"]).with_code(0);
    assert_has(&folder.path("part.c3d"), &sent, 120);
    // As columns, in millimetres.
    folder.run(&["export", "a.take", "-o", "a.csv"]).with_code(0);
    let csv = String::from_utf8(folder.read("a.sampled_32.csv")).unwrap();
    let head = csv.lines().next().unwrap();
    let label = &motion().info.markers[0].label;
    assert!(head.contains(&format!("{label}.residual (mm)")), "{head}");
    let first: f64 = csv.lines().nth(1).unwrap().split(',').nth(1).unwrap().parse().unwrap();
    assert!((first - f64::from(sent.frame(0)[0]) / 100.0).abs() < 1e-6, "{first}");
    let dataset = ["export", "a.take", "-o", "study", "--format", "bids"];
    folder.run(&dataset).with_code(0);
    let recording = "study/sub-01/motion/sub-01_task-a_tracksys-optical_recording-sampled32_physio";
    let document: Value =
        serde_json::from_slice(&folder.read(&format!("{recording}.json"))).unwrap();
    assert_eq!(document["Columns"].as_array().unwrap().len(), 1 + 15, "{document:#}");
    assert!(folder.read(&format!("{recording}.tsv.gz")).len() > 480);
}

#[test]
fn without_the_option_a_take_has_no_residuals() {
    let folder = Folder::new();
    let sent = Residuals::generated(2, &motion());
    let (ran, _) = record_from(&folder, device(&sent), [None, None], &["-o", "a.take"]);
    ran.with_code(0);
    let (found, _) = source::read(&folder.path("a.take")).unwrap();
    assert_eq!(Residuals::read(&folder.path("a.take"), &found).unwrap(), None);
}

#[test]
fn residuals_of_a_qtm_are_recorded() {
    let folder = Folder::new();
    let sent = Residuals::generated(3, &motion());
    let residuals = Some(Arc::new(sent.clone()));
    let mut device =
        QtmDevice::new(motion(), QtmSettings { residuals, ..QtmSettings::default() }).unwrap();
    let listener = QtmListener::open(0).unwrap();
    let served = Served::new(listener.uri(), move |stopped| {
        let options = NetworkOptions { once: false, log: None };
        listener.serve(&mut device, options, stopped).unwrap();
    });
    let record = ["record", "-d", &served.uri, "-o", "a.take", "--residuals", "--lossless"];
    folder.run(&record).with_code(0);
    assert_has(&folder.path("a.take"), &sent, 0);
}

#[test]
fn residuals_of_a_natnet_server_are_recorded() {
    let folder = Folder::new();
    let sent = Residuals::generated(4, &motion());
    let stream = ServedStream::Unicast(free_port());
    let residuals = Some(Arc::new(sent.clone()));
    let settings = NatNetSettings { residuals, looping: true, ..NatNetSettings::new(stream) };
    let mut device = NatNetDevice::new(motion(), settings).unwrap();
    let listener = NatNetListener::open(0).unwrap();
    let served = Served::new(listener.uri(), move |stopped| {
        let options = NetworkOptions { once: false, log: None };
        listener.serve(&mut device, options, stopped).unwrap();
    });
    let record = ["record", "-d", &served.uri, "-o", "a.take", "--residuals", "--lossless"];
    folder.run(&[&record[..], &["--seconds", "1s"]].concat()).with_code(0);
    let (found, _) = source::read(&folder.path("a.take")).unwrap();
    // Where the recording began in the motion.
    let on_the_wire = |position: [f32; 3]| position.map(|mm| (mm / 10.0).round());
    let is_alike = |skipped: &usize| {
        let same = |frame: usize| {
            let of = |motion: &Motion, frame| motion.frame(frame).to_vec();
            let pairs = of(&found, frame).into_iter().zip(of(&motion(), frame + skipped));
            pairs.into_iter().all(|(a, b)| {
                is_gap(a) == is_gap(b) && (is_gap(a) || on_the_wire(a) == on_the_wire(b))
            })
        };
        (0..20).all(same)
    };
    let n = motion().n_frames() - found.n_frames().min(motion().n_frames());
    let skipped = (0..=n).find(is_alike).expect("a part of the motion");
    assert_has(&folder.path("a.take"), &sent, skipped);
}

/// A motion of which every third marker has no label, and a script by which the others get theirs late.
fn late_labels(for_s: &str) -> (Motion, Arc<Script>) {
    let mut motion = motion();
    for (column, marker) in motion.info.markers.iter_mut().enumerate() {
        marker.labelled = column % 3 != 2;
    }
    let script = format!("seed = 1\n[[fault]]\nkind = \"late-model\"\nfor_s = {for_s}\n");
    (motion, Arc::new(Script::parse("late-model", &script).unwrap()))
}

/// Asserts that every sample of a take has the residual that was sent with its position, whichever channel it is in, and that
/// this holds for channels that appeared after the start.
#[track_caller]
fn assert_each_has(path: &Path, sent: &Residuals, on_the_wire: fn(Position) -> Position) {
    let mut of_position: HashMap<[u32; 3], Vec<u8>> = HashMap::new();
    let original = motion();
    for frame in 0..original.n_frames() {
        for (&position, &residual) in original.frame(frame).iter().zip(sent.frame(frame as u64)) {
            let bits = on_the_wire(position).map(f32::to_bits);
            of_position.entry(bits).or_default().push(residual);
        }
    }
    let (found, _) = source::read(path).unwrap();
    let residuals = Residuals::read(path, &found).unwrap().expect("it has residuals");
    let mut n_late = vec![0; found.info.markers.len()];
    for frame in 0..found.n_frames() {
        let row = found.frame(frame).iter().zip(residuals.frame(frame as u64));
        for (marker, (position, residual)) in row.enumerate().filter(|(_, (at, _))| !is_gap(**at)) {
            let known = of_position.get(&position.map(f32::to_bits));
            let is_its = known.is_some_and(|known| known.contains(residual));
            assert!(is_its, "frame {frame} marker {marker}: {residual} of {known:?}");
            n_late[marker] += u32::from(*residual > 0);
        }
    }
    assert!(n_late.iter().all(|n| *n > 0), "{n_late:?}");
    let events = found.info.events.iter().map(|event| &event.text);
    assert!(events.into_iter().all(|text| !text.contains("residuals are not recorded")));
}

#[test]
fn residuals_of_markers_whose_labels_come_late_from_a_qtm_are_recorded() {
    let folder = Folder::new();
    let (motion, script) = late_labels("0.7");
    let sent = Residuals::generated(5, &motion);
    let (residuals, faults) = (Some(Arc::new(sent.clone())), Some(script));
    let settings = QtmSettings { residuals, faults, ..QtmSettings::default() };
    let mut device = QtmDevice::new(motion, settings).unwrap();
    let listener = QtmListener::open(0).unwrap();
    let served = Served::new(listener.uri(), move |stopped| {
        let options = NetworkOptions { once: false, log: None };
        listener.serve(&mut device, options, stopped).unwrap();
    });
    let record = ["record", "-d", &served.uri, "-o", "a.take", "--residuals", "--lossless"];
    folder.run(&record).with_code(0);
    let info = folder.run(&["info", "a.take", "--json"]).json();
    assert!(info["sampled_groups"].as_array().unwrap().len() > 1, "{info:#}");
    assert_each_has(&folder.path("a.take"), &sent, |position| position);
    folder.run(&["verify", "a.take"]).with_code(0);
}

#[test]
fn residuals_of_markers_whose_names_come_late_from_a_natnet_server_are_recorded() {
    let folder = Folder::new();
    let (motion, faults) = late_labels("1.3");
    let stream = ServedStream::Unicast(free_port());
    let sent = Residuals::generated(6, &motion);
    let (residuals, faults) = (Some(Arc::new(sent.clone())), Some(faults));
    let settings = NatNetSettings { residuals, faults, ..NatNetSettings::new(stream) };
    let settings = NatNetSettings { looping: true, ..settings };
    let mut device = NatNetDevice::new(motion, settings).unwrap();
    let listener = NatNetListener::open(0).unwrap();
    let served = Served::new(listener.uri(), move |stopped| {
        let options = NetworkOptions { once: false, log: None };
        listener.serve(&mut device, options, stopped).unwrap();
    });
    let record = ["record", "-d", &served.uri, "-o", "a.take", "--residuals", "--lossless"];
    folder.run(&[&record[..], &["--seconds", "3s"]].concat()).with_code(0);
    // Rounded to metres of float32 by the server, and to millimetres by the driver.
    assert_each_has(&folder.path("a.take"), &sent, |position| {
        position.map(|mm| (f64::from((f64::from(mm) / 1000.0) as f32) * 1000.0) as f32)
    });
    folder.run(&["verify", "a.take"]).with_code(0);
}
