//! Residuals of markers from a device to files: recorded from the link protocol, a QTM and a NatNet server, exported to C3D,
//! played again from that file and from its import, and seen in every output.

use std::{
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
    natnet::{NatNetDevice, NatNetListener, NatNetSettings},
    qtm::{QtmDevice, QtmListener, QtmSettings},
    source::{self, Residuals},
};
use mocapd_take::motion::{Motion, is_gap};
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
