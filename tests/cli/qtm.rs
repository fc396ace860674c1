//! A QTM on the network: recorded by TCP and UDP, with and without faults, and compared with what it sent.

use std::{
    io::{Cursor, Write},
    net::{Ipv4Addr, TcpListener},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{Builder, JoinHandle},
};

use mocapd_drivers::device::PoseStatus;
use mocapd_simulator::{
    NetworkOptions,
    device::SentLog,
    faults::{Fate, FrameFate, Script},
    generator::{ForcePlates, JumpSpec, Occlusion, RigidBodies},
    qtm::{QtmDevice, QtmListener, QtmSettings, force_of},
    sampled::SampledSource,
};
use mocapd_take::{
    TakeMap,
    motion::{Motion, Position, is_gap},
    poses::{Pose as StoredPose, PoseState},
};
use serde_json::Value;

use super::{
    Folder, Ran,
    faults::{LATE_S_MAX, away_by_arrival_s, expected::expected, played::SharedLog, played::fates},
};
use crate::support::{assert_mentions, jump, rows};

const RATE_HZ: f64 = 240.0;
const SECONDS: f64 = 2.0;

/// A QTM on a port of its own, until it is dropped.
struct Served {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<SentLog>>,
    uri: String,
    log: SharedLog,
}

impl Served {
    fn new(motion: Motion, settings: QtmSettings) -> Self {
        let mut device = QtmDevice::new(motion, settings).unwrap();
        let mut listener = QtmListener::open(0).unwrap();
        listener.answer_searches();
        let uri = listener.uri();
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, log) = (Arc::clone(&stop), SharedLog::default());
        let output: Option<Box<dyn Write + Send>> = Some(Box::new(log.clone()));
        let serve = move || {
            let options = NetworkOptions { once: false, log: output };
            listener.serve(&mut device, options, &stopped).unwrap()
        };
        let thread = Builder::new().name("simulator".to_owned()).spawn(serve).unwrap();
        Self { stop, thread: Some(thread), uri, log }
    }

    /// Ends it; returns what it sent, and the fate of every frame.
    fn stop(mut self) -> (SentLog, Vec<FrameFate>) {
        self.stop.store(true, Ordering::Relaxed);
        let sent = self.thread.take().unwrap().join().unwrap();
        (sent, fates(&self.log.text()))
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// A QTM that keeps running while it is cut off: a busy machine has time to connect again before the end.
const SECONDS_CUT_OFF: f64 = 6.0;

/// A motion of which every third marker has no label.
fn motion() -> Motion {
    motion_of(SECONDS)
}

/// The motion that is played under a script.
fn motion_under(name: &str) -> Motion {
    motion_of(if name == "unplug" { SECONDS_CUT_OFF } else { SECONDS })
}

fn motion_of(seconds: f64) -> Motion {
    let mut motion = jump(3, RATE_HZ, seconds);
    for (column, marker) in motion.info.markers.iter_mut().enumerate() {
        marker.labelled = column % 3 != 2;
    }
    motion
}

fn record(folder: &Folder, uri: &str, take: &str, more: &[&str]) -> Ran {
    folder.run(&[&["record", "-d", uri, "-o", take, "--lossless", "--json"][..], more].concat())
}

fn transports(uri: &str) -> [String; 2] {
    [uri.to_owned(), format!("{uri}?transport=udp")]
}

/// Positions that are there, in any order: unlabelled markers have channels of their own.
fn present(frame: &[Position]) -> Vec<[u32; 3]> {
    let there = frame.iter().filter(|position| !is_gap(**position));
    let mut bits: Vec<_> = there.map(|position| position.map(f32::to_bits)).collect();
    bits.sort_unstable();
    bits
}

#[test]
fn a_recording_equals_what_was_sent_bit_for_bit() {
    let folder = Folder::new();
    let motion = motion();
    let served = Served::new(motion.clone(), QtmSettings::default());
    for (index, uri) in transports(&served.uri).iter().enumerate() {
        let take = format!("{index}.take");
        let ran = record(&folder, uri, &take, &[]).with_code(0);
        let report = ran.json();
        assert_eq!(report["ending"], "end of stream");
        assert_eq!(report["ledger"]["frames_sent"], 480);
        assert_eq!(report["ledger"]["recorded"], 480, "{}", ran.stderr);
        assert_eq!(report["ledger"]["closes"], true);
        let info = folder.run(&["info", &take, "--json"]).json();
        assert_eq!(
            (&info["device"]["driver"], &info["device"]["model"]),
            (&"qtm".into(), &"QTM".into())
        );
        let labels: Vec<_> =
            info["channels"].as_array().unwrap().iter().map(|c| c["label"].clone()).collect();
        let sent =
            motion.info.markers.iter().filter(|m| m.labelled).map(|m| Value::from(&*m.label));
        let n_labelled = sent.clone().count();
        assert_eq!(labels[..n_labelled], sent.collect::<Vec<_>>());
        assert_eq!(labels.len(), motion.info.markers.len());
        let (rows, problems) = rows(&folder.read(&take));
        assert_eq!((rows.len(), problems.len()), (480, 0));
        let labelled: Vec<usize> =
            (0..labels.len()).filter(|column| motion.info.markers[*column].labelled).collect();
        for (index, row) in rows.iter().enumerate() {
            let frame = motion.frame(index);
            for (channel, column) in labelled.iter().enumerate() {
                let [got, sent] = [row[channel], frame[*column]].map(|p| p.map(f32::to_bits));
                assert!(got == sent || (is_gap(row[channel]) && is_gap(frame[*column])), "{index}");
            }
            assert_eq!(present(row), present(frame), "row {index}");
        }
        folder.run(&["verify", &take]).with_code(0);
    }
    let (sent, fates) = served.stop();
    assert_eq!((sent.starts, sent.ends), (2, 2));
    assert!(fates.iter().all(|fate| fate.fate == Fate::Whole) && fates.len() == 960);
}

#[test]
fn more_unlabelled_markers_than_a_group_has_channels_are_all_recorded() {
    let folder = Folder::new();
    let spec = JumpSpec { seconds: Some(1.0), n_markers: 300, ..JumpSpec::new(3, RATE_HZ) };
    let mut motion = spec.generate().unwrap().motion;
    motion.info.markers.iter_mut().skip(50).for_each(|marker| marker.labelled = false);
    let served = Served::new(motion.clone(), QtmSettings::default());
    let report = record(&folder, &served.uri, "a.take", &[]).with_code(0).json();
    assert_eq!(
        (&report["ledger"]["recorded"], &report["ledger"]["markers_dropped"]),
        (&240.into(), &0.into())
    );
    let (rows, problems) = rows(&folder.read("a.take"));
    assert_eq!((rows.len(), problems.len()), (240, 0));
    for (index, row) in rows.iter().enumerate() {
        assert_eq!(present(row), present(motion.frame(index)), "row {index}");
    }
}

/// The ledger of a recording under a script, against the simulator's log.
#[track_caller]
fn ledger_agrees(transport: usize, name: &str, text: &str) -> (Value, String) {
    let folder = Folder::new();
    let script = Script::parse(name, text).unwrap();
    let settings = QtmSettings { faults: Some(Arc::new(script)), ..QtmSettings::default() };
    let served = Served::new(motion_under(name), settings);
    let uri = &transports(&served.uri)[transport];
    let ran = record(&folder, uri, "a.take", &[]);
    let report = ran.json();
    let ledger = report["ledger"].clone();
    let (sent, mut fates) = served.stop();
    // Nobody can know of frames behind the last one that arrived: QTM does not state how many it sent.
    while fates.last().is_some_and(|fate| !matches!(fate.fate, Fate::Whole | Fate::Late)) {
        fates.pop();
    }
    let wanted = expected(&fates);
    let totals = sent.faults.unwrap();
    let context = format!("{name}: {ledger:#}\n{}\n{}", ran.stderr, totals.summary());
    let count = |key: &str| ledger[key].as_u64().unwrap();
    assert_eq!(ledger["frame_balance"], 0, "{context}");
    assert_eq!(count("recorded"), wanted.recorded, "{context}");
    assert_eq!(count("duplicates"), wanted.duplicates, "{context}");
    assert_eq!(count("lost_on_link"), wanted.lost_on_link, "{context}");
    if name == "power-loss" {
        let unknown = count("unknown_after_disconnect") as f64 / RATE_HZ;
        let away = [wanted.away_s, away_by_arrival_s(&folder.read("a.take"))];
        assert!(away.iter().any(|s| (unknown - s).abs() < 0.5), "{unknown} s: {context}");
        assert!(away[1] < away[0] + LATE_S_MAX, "{away:?} s: {context}");
    } else {
        assert_eq!(count("unknown_after_disconnect"), wanted.unknown, "{context}");
        assert_eq!(count("frames_sent"), fates.len() as u64, "{context}");
    }
    equals_source(&folder.read("a.take"), &fates, &context);
    let info = folder.run(&["info", "a.take", "--json"]).json();
    (info, context)
}

/// Every frame that arrived has the positions that the simulator sent, bit for bit, and every other one has none. A QTM that
/// was switched off plays its file from the start, and `swaps` and `ghosts` change what it sends.
#[track_caller]
fn equals_source(take: &[u8], fates: &[FrameFate], context: &str) {
    let is_changed = ["swaps-and-ghosts", "occlusion-storm", "power-loss"];
    if is_changed.iter().any(|name| context.starts_with(name)) {
        return;
    }
    let motion = motion_under(context.split(':').next().unwrap());
    let (rows, problems) = rows(take);
    assert_eq!(problems.len(), 0, "{context}");
    let first = fates.iter().position(|fate| fate.fate == Fate::Whole).unwrap();
    assert_eq!(rows.len(), fates.len() - first, "{context}");
    for (index, (row, fate)) in (first..).zip(rows.iter().zip(&fates[first..])) {
        let sent = match fate.fate {
            Fate::Whole => present(motion.frame(index)),
            _ => Vec::new(),
        };
        assert_eq!(present(row), sent, "row {index}: {context}");
    }
}

/// The effects of a script on each of the two transports.
fn both(name: &str, text: &str) -> [(Value, String); 2] {
    [0, 1].map(|transport| ledger_agrees(transport, name, text))
}

fn supplied(name: &str) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/simulator/faults");
    std::fs::read_to_string(format!("{folder}/{name}.toml")).unwrap()
}

fn count(info: &Value, key: &str) -> u64 {
    info["ledger"][key].as_u64().unwrap()
}

#[test]
fn frames_that_qtm_leaves_out_or_the_network_loses_are_counted() {
    for (info, context) in both("lost-frames", &supplied("lost-frames")) {
        assert!(count(&info, "lost_on_link") >= 10, "{context}");
        assert_eq!(info["ledger"]["closes"], true, "{context}");
    }
}

#[test]
fn datagrams_that_come_twice_or_late_are_counted() {
    let (info, context) = ledger_agrees(1, "doubled-frames", &supplied("doubled-frames"));
    assert!(count(&info, "duplicates") >= 10 && count(&info, "lost_on_link") == 0, "{context}");
    let (info, context) = ledger_agrees(1, "late-frames", &supplied("late-frames"));
    assert!(count(&info, "duplicates") >= 5, "{context}");
}

#[test]
fn a_qtm_that_is_cut_off_goes_on_in_the_same_take() {
    for (info, context) in both("unplug", &supplied("unplug")) {
        assert!(count(&info, "unknown_after_disconnect") >= 100, "{context}");
        let events = info["events"].to_string();
        assert!(events.contains("the connection was lost: the other end closed it"), "{events}");
        assert_eq!(info["ledger"]["closes"], true, "{context}");
    }
}

#[test]
fn a_qtm_that_is_restarted_goes_on_in_the_same_take() {
    for (info, context) in both("power-loss", &supplied("power-loss")) {
        assert_eq!(info["ledger"]["closes"], true, "{context}");
    }
}

#[test]
fn stalls_hidden_markers_and_ghosts_lose_no_frame() {
    for name in ["stall", "occlusion-storm", "swaps-and-ghosts", "clock"] {
        for (info, context) in both(name, &supplied(name)) {
            assert_eq!(count(&info, "recorded"), 480, "{context}");
            assert_eq!(info["ledger"]["closes"], true, "{context}");
        }
    }
}

/// A live number may stand still: the time counts.
#[test]
fn a_frame_number_that_stands_still_loses_nothing() {
    let script = "seed = 1\n[[fault]]\nkind = \"counter-repeat\"\nrate = 1.0\n\
                  [[fault]]\nkind = \"lost-frames\"\nrate = 0.05\nrun = 3\n";
    for (info, context) in both("standing number", script) {
        assert!(count(&info, "lost_on_link") > 10, "{context}");
        assert_eq!(info["ledger"]["closes"], true, "{context}");
    }
}

/// The label of the last labelled marker comes late: until then it is an unlabelled one.
#[test]
fn a_label_that_comes_late_is_followed_and_costs_no_sample() {
    let script = "seed = 1\n[[fault]]\nkind = \"late-model\"\nfor_s = 0.7\n";
    for (info, context) in both("late label", script) {
        assert_eq!(count(&info, "recorded"), 480, "{context}");
        let events = info["events"].to_string();
        assert!(events.contains("QTM's list of labels changed: 10 labels"), "{events}");
        let labels: Vec<_> =
            motion().info.markers.iter().filter(|m| m.labelled).map(|m| m.label.clone()).collect();
        let found = |label: &String| {
            let channels = info["channels"].as_array().unwrap();
            channels.iter().find(|channel| channel["label"] == label.as_str()).cloned()
        };
        assert!(labels.iter().all(|label| found(label).is_some()), "{info:#}");
        // From 0.7 s on, or as soon as a busy machine has asked for the labels; the marker is seen all the time.
        let late = found(labels.last().unwrap()).unwrap();
        let samples = late["samples"].as_u64().unwrap();
        assert!((60..=320).contains(&samples), "{late:#}");
        let channels = info["channels"].as_array().unwrap().iter();
        let recorded: u64 = channels.map(|channel| channel["samples"].as_u64().unwrap()).sum();
        let motion = motion();
        let sent: usize = (0..480).map(|frame| present(motion.frame(frame)).len()).sum();
        assert_eq!(recorded, sent as u64, "{context}");
    }
}

/// The number of labels stays as it is: QTM's event tells.
#[test]
fn settings_that_change_in_mid_stream_are_followed_and_cost_no_sample() {
    let script = "seed = 1\n[[fault]]\nkind = \"model-change\"\nat_s = 0.5\n";
    for (info, context) in both("model change", script) {
        assert_eq!(count(&info, "recorded"), 480, "{context}");
        let last = motion().info.markers.iter().rfind(|m| m.labelled).unwrap().label.clone();
        let channels = info["channels"].as_array().unwrap();
        let samples = |label: &str| {
            let channel = channels.iter().find(|channel| channel["label"] == label).unwrap();
            channel["samples"].as_u64().unwrap()
        };
        let column = motion().info.markers.iter().rposition(|m| m.labelled).unwrap();
        let motion = motion();
        let seen = |frames: std::ops::Range<usize>| {
            frames.filter(|frame| !is_gap(motion.frame(*frame)[column])).count() as u64
        };
        let (before, after) = (samples(&last), samples(&format!("{last} renamed")));
        assert_eq!(before + after, seen(0..480), "{context}");
        // The change is due with the first frame half a second after the first request; a busy machine asks later what
        // has changed.
        assert!(before >= seen(0..115) && after >= 60, "{before} {after}");
    }
}

/// A packet with a false size: nothing tells where the next one begins, so that the driver connects again.
#[test]
fn a_broken_server_is_connected_to_again_in_the_same_take() {
    let script = "seed = 1\n[[fault]]\nkind = \"broken-packet\"\nat_s = 0.4\n";
    for (info, context) in both("broken packet", script) {
        let events = info["events"].to_string();
        assert!(events.contains("no packet of the QTM RT protocol"), "{events}");
        assert!(count(&info, "unknown_after_disconnect") > 0, "{context}");
        assert_eq!(info["ledger"]["closes"], true, "{context}");
    }
}

#[test]
fn reordered_and_doubled_datagrams_leave_the_frames_as_they_were_sent() {
    let script = "seed = 4\n[[fault]]\nkind = \"late-frames\"\nrate = 0.1\nby = 3\n\
                  [[fault]]\nkind = \"doubled-frames\"\nrate = 0.2\n";
    let (info, context) = ledger_agrees(1, "reordered", script);
    assert!(count(&info, "duplicates") > 50, "{context}");
    assert_eq!(info["ledger"]["closes"], true, "{context}");
}

/// A slow server: it sends nothing for a while, then everything at once, three times.
#[test]
fn a_slow_server_costs_nothing_but_time() {
    let script: String = [0.2, 0.7, 1.3]
        .map(|at| format!("[[fault]]\nkind = \"stall\"\nat_s = {at}\nfor_s = 0.3\n"))
        .concat();
    for (info, context) in both("slow server", &format!("seed = 1\n{script}")) {
        assert_eq!(count(&info, "recorded"), 480, "{context}");
        assert_eq!(info["ledger"]["closes"], true, "{context}");
    }
}

/// The poses of all bodies in every frame of a take.
fn recorded_poses(take: &[u8]) -> Vec<Vec<StoredPose>> {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let mut all: Vec<Vec<StoredPose>> = Vec::new();
    for (index, group) in map.pose_groups().enumerate() {
        let n_bodies = group.group.bodies().count();
        let mut at = 0;
        let read = |first, _, poses: Option<&[StoredPose]>| {
            assert_eq!(first, at as u64, "no gap");
            for poses in poses.unwrap_or_default().chunks_exact(n_bodies) {
                match index {
                    0 => all.push(poses.to_vec()),
                    _ => all[at].extend_from_slice(poses),
                }
                at += 1;
            }
            Ok(())
        };
        assert_eq!(group.read_poses(&mut Cursor::new(take), read).unwrap(), []);
    }
    all
}

#[test]
fn bodies_are_recorded_as_the_simulator_moved_them() {
    let folder = Folder::new();
    let occlusion = Some(Occlusion { fraction: 0.1, mean_gap_s: 0.2 });
    let spec = JumpSpec { seconds: Some(SECONDS), occlusion, ..JumpSpec::new(4, RATE_HZ) };
    let bodies = Arc::new(RigidBodies::new(&spec, 12).unwrap());
    let settings = QtmSettings { bodies: Some(Arc::clone(&bodies)), ..QtmSettings::default() };
    let served = Served::new(spec.generate().unwrap().motion, settings);
    for (index, uri) in transports(&served.uri).iter().enumerate() {
        let take = format!("{index}.take");
        let report = record(&folder, uri, &take, &[]).with_code(0).json();
        assert_eq!(report["ledger"]["recorded"], 480);
        assert_eq!(report["sample_ledger"]["closes"], true, "{report:#}");
        let bytes = folder.read(&take);
        let map = TakeMap::scan(&mut Cursor::new(&bytes)).unwrap();
        let names: Vec<_> =
            map.pose_groups().flat_map(|group| group.group.bodies()).map(str::to_owned).collect();
        assert!(names.iter().eq(bodies.infos().iter().map(|info| &info.name)), "{names:?}");
        let found = recorded_poses(&bytes);
        assert_eq!(found.len(), 480);
        let (mut sent, mut n_tracked) = (Vec::new(), 0);
        for (number, found) in (0..).zip(&found) {
            bodies.poses(number, RATE_HZ, &mut sent);
            for (info, found) in bodies.infos().iter().zip(found) {
                let sent = sent.iter().find(|pose| pose.body == info.id);
                let Some(sent) = sent.filter(|pose| pose.status == PoseStatus::Tracked) else {
                    assert_eq!(found.state, PoseState::Lost, "{number} {info:?}");
                    continue;
                };
                assert_eq!(found.state, PoseState::Tracked, "{number} {info:?}");
                assert_eq!(found.position_mm, sent.position_mm);
                assert_eq!(found.residual_mm, sent.residual_mm);
                let pairs = found.quaternion.iter().zip(sent.quaternion);
                let product: f32 = pairs.clone().map(|(a, b)| a * b).sum();
                let apart = pairs.map(|(a, b)| (a - product.signum() * b).abs());
                assert!(apart.fold(0.0, f32::max) < 5e-7, "{found:?} {sent:?}");
                n_tracked += 1;
            }
        }
        assert!((4000..5500).contains(&n_tracked), "{n_tracked}");
        folder.run(&["verify", &take]).with_code(0);
    }
}

#[test]
fn a_number_that_jumps_is_reported_and_costs_no_frame() {
    let script = "seed = 1\n[[fault]]\nkind = \"counter-jump\"\nat_s = 0.5\nby = 50000000\n";
    let folder = Folder::new();
    let faults = Some(Arc::new(Script::parse("jump", script).unwrap()));
    let served = Served::new(motion(), QtmSettings { faults, ..QtmSettings::default() });
    let report = record(&folder, &served.uri, "a.take", &[]).with_code(3).json();
    let ledger = &report["ledger"];
    let counts = ["frames_sent", "recorded", "lost_on_link", "lost_other"].map(|key| &ledger[key]);
    assert_eq!(counts, [480, 480, 0, 0], "{ledger}");
    let text = ledger["contradictions"].to_string();
    assert!(text.contains("the device's frame counter jumped"), "{text}");
}

#[test]
fn a_timed_recording_stops_and_the_next_one_goes_on() {
    let folder = Folder::new();
    let served = Served::new(motion(), QtmSettings { looping: true, ..QtmSettings::default() });
    for (index, uri) in transports(&served.uri).iter().enumerate() {
        let take = format!("{index}.take");
        let report = record(&folder, uri, &take, &["--seconds", "500ms"]).with_code(0).json();
        assert_eq!((&report["ending"], &report["frames"]), (&"stopped".into(), &120.into()));
        assert_eq!(report["ledger"]["closes"], true, "{report}");
    }
    let (sent, _) = served.stop();
    assert_eq!(sent.starts, 2);
}

/// Longer than the ten seconds after which a recorder asks other devices who they are, and so restarts them.
#[test]
fn a_pause_of_frames_restarts_nothing() {
    let folder = Folder::new();
    let script =
        "seed = 1\n[[fault]]\nkind = \"lost-frames\"\nrate = 1.0\nfrom_s = 0.5\nto_s = 12.0\n";
    let faults = Some(Arc::new(Script::parse("pause", script).unwrap()));
    let served =
        Served::new(motion(), QtmSettings { looping: true, faults, ..QtmSettings::default() });
    let ran = record(&folder, &served.uri, "a.take", &["--seconds", "12500ms"]).with_code(3);
    let ledger = &ran.json()["ledger"];
    assert_eq!((&ledger["recorded"], &ledger["lost_on_link"]), (&240.into(), &2760.into()));
    let info = folder.run(&["info", "a.take", "--json"]).json();
    let events = info["events"].to_string();
    assert!(!events.contains("restarted") && events.contains("no frame came for"), "{events}");
    let (sent, _) = served.stop();
    assert_eq!(sent.starts, 1);
}

#[test]
fn what_cannot_be_opened_is_explained_in_one_line() {
    let folder = Folder::new();
    // A port that nobody listens on: it was free a moment ago.
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port();
    let refused = format!("qtm:127.0.0.1:{free}");
    for (uri, facts) in [
        (refused.as_str(), vec!["127.0.0.1", "nothing listens", "qtm:127.0.0.1:PORT"]),
        (
            "qtm:no-such-machine.invalid",
            vec!["no-such-machine.invalid", "no machine named", "address"],
        ),
        ("serial:/dev/null?driver=qtm", vec!["qtm", "qtm:HOST"]),
        ("qtm:127.0.0.1?driver=ndi", vec!["ndi", "serial:PATH"]),
        ("qtm:[fe80::1]:9", vec!["interface", "%eth0"]),
    ] {
        let line = folder.refuses(&["record", "-d", uri, "-o", "a.take"], 1);
        assert_mentions(&line, &facts);
    }
    let raw =
        ["record", "-d", "qtm:127.0.0.1:9?transport=udp", "-o", "a.take", "--raw", "a.rawlog"];
    assert_mentions(&folder.refuses(&raw, 1), &["raw log", "datagrams", "transport=udp"]);
    // A machine that accepts the connection and is silent, as another program's port is.
    let silent = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let uri = format!("qtm:{}", silent.local_addr().unwrap());
    let line = folder.refuses(&["record", "-d", &uri, "-o", "a.take"], 1);
    assert_mentions(&line, &["nobody greets", "22223"]);
    let served = Served::new(motion(), QtmSettings::default());
    let line = folder.refuses(&["record", "-d", &served.uri, "-o", "a.take", "--rate", "100"], 1);
    assert_mentions(&line, &["100 Hz", "240 Hz", "--rate"]);
}

/// How many samples a take has of each group, without gaps, and the samples one after another.
fn recorded_samples(take: &[u8]) -> Vec<(u64, Vec<f32>)> {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let mut found = Vec::new();
    for group in map.recorded_groups() {
        let n_channels = group.group.channels.len();
        let (mut rows, mut n_numbers) = (Vec::new(), 0);
        group
            .read(&mut Cursor::new(take), |first, n, decoded| {
                let Some(decoded) = decoded else { return Ok(()) };
                assert_eq!(first, n_numbers, "no gap");
                n_numbers += n;
                for row in 0..n as usize {
                    rows.extend((0..n_channels).map(|c| decoded[c * n as usize + row]));
                }
                Ok(())
            })
            .unwrap();
        found.push((n_numbers, rows));
    }
    found
}

#[test]
fn force_plates_and_electrodes_are_recorded_bit_for_bit() {
    let folder = Folder::new();
    let spec = JumpSpec { seconds: Some(SECONDS), ..JumpSpec::new(4, RATE_HZ) };
    let plates = Arc::new(ForcePlates::new(&spec).unwrap());
    let sampled = vec![
        SampledSource::plates(0, plates, 1000.0).unwrap(),
        SampledSource::electrodes(1, "5@2kHz".parse().unwrap(), 9).unwrap(),
    ];
    let settings = QtmSettings { sampled: sampled.clone(), ..QtmSettings::default() };
    let served = Served::new(spec.generate().unwrap().motion, settings);
    // The last of 480 frames is 479/240 s behind the first.
    let n_samples = [1996_u64, 3992];
    let counts = [0, 1].map(|index| {
        let mut counts = Vec::new();
        sampled[index].samples(0, n_samples[index], &mut counts);
        counts
    });
    let scaled = |index: usize, sample: &[f32]| -> Vec<f64> {
        let channels = &sampled[index].info().channels;
        sample.iter().zip(channels).map(|(count, c)| f64::from(*count) * c.scale).collect()
    };
    let of_plate = |plate: usize| {
        let samples = counts[0].chunks(12).map(|sample| scaled(0, sample));
        samples.flat_map(|felt| force_of(&felt[6 * plate..6 * plate + 6])).collect::<Vec<_>>()
    };
    let electrodes: Vec<f32> = counts[1]
        .chunks(5)
        .flat_map(|sample| scaled(1, sample).into_iter().map(|value| value as f32))
        .collect();
    for (index, uri) in transports(&served.uri).iter().enumerate() {
        let take = format!("{index}.take");
        let ran = record(&folder, uri, &take, &[]).with_code(0);
        let report = ran.json();
        assert_eq!(report["ledger"]["recorded"], 480, "{}", ran.stderr);
        let document = &report["sample_ledger"];
        assert_eq!(document["closes"], true, "{document:#}");
        let groups = document["groups"].as_array().unwrap();
        let stored: Vec<_> = groups.iter().map(|group| group["stored"].as_u64().unwrap()).collect();
        assert_eq!(stored, [3992, 1996, 1996], "{document:#}");
        let found = recorded_samples(&folder.read(&take));
        let expected = [(3992, electrodes.clone()), (1996, of_plate(0)), (1996, of_plate(1))];
        for (group, (found, expected)) in found.iter().zip(&expected).enumerate() {
            assert!(found == expected, "{uri}: group {group}");
        }
        assert!(expected[1].1.iter().any(|value| *value != 0.0), "somebody stands on it");
        let info = folder.run(&["info", &take, "--json"]).json();
        assert_eq!(info["sample_ledger"], *document);
    }
}

/// Each by a line, with what it says to be.
#[test]
fn devices_lists_every_qtm_that_answers() {
    let folder = Folder::new();
    let served = [1, 2]
        .map(|_| Served::new(motion(), QtmSettings { looping: true, ..QtmSettings::default() }));
    let listed = folder.run(&["devices", "--json"]).with_code(0).json();
    let text = folder.run(&["devices"]).with_code(0).stdout;
    for Served { uri, .. } in &served {
        let of_uri = |device: &&Value| device["device"] == uri.as_str();
        let device = listed.as_array().unwrap().iter().find(of_uri);
        let device = device.unwrap_or_else(|| panic!("{uri} is not in {listed:#}"));
        assert_eq!((&device["driver"], &device["certain"]), (&"qtm".into(), &true.into()));
        assert!(device["product"].as_str().unwrap().starts_with("localhost, mocapd-sim "));
        assert!(text.lines().any(|line| line.starts_with(uri.as_str())), "{text}");
    }
}
