//! A Motive on the network: recorded by multicast and unicast, with and without faults, and compared with what it sent.

use std::{
    io::Write,
    net::{Ipv4Addr, SocketAddrV4, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{Builder, JoinHandle},
};

use mocapd_drivers::natnet::{Bitstream, ServedStream};
use mocapd_simulator::{
    NetworkOptions,
    device::SentLog,
    faults::{Fate, FrameFate, Script},
    natnet::{NatNetDevice, NatNetListener, NatNetSettings},
};
use mocapd_take::motion::{Motion, Position, is_gap};
use serde_json::Value;

use super::{
    Folder, Ran,
    faults::played::{SharedLog, fates},
};
use crate::support::{assert_mentions, jump, rows};

const RATE_HZ: f64 = 240.0;
const SECONDS: f64 = 3.0;

/// A port that is free now, for a group of this test alone.
pub(super) fn free_port() -> u16 {
    UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port()
}

fn streams() -> [ServedStream; 2] {
    let group = SocketAddrV4::new(Ipv4Addr::new(239, 255, 42, 99), free_port());
    [ServedStream::Multicast(group), ServedStream::Unicast(free_port())]
}

/// A Motive on a port of its own, until it is dropped.
struct Served {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<SentLog>>,
    uri: String,
    log: SharedLog,
}

impl Served {
    fn new(motion: Motion, settings: NatNetSettings) -> Self {
        let mut device = NatNetDevice::new(motion, settings).unwrap();
        let listener = NatNetListener::open(0).unwrap();
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

/// A motion of which every third marker has no label.
fn motion() -> Motion {
    let mut motion = jump(3, RATE_HZ, SECONDS);
    for (column, marker) in motion.info.markers.iter_mut().enumerate() {
        marker.labelled = column % 3 != 2;
    }
    motion
}

fn record(folder: &Folder, uri: &str, take: &str, more: &[&str]) -> Ran {
    let command = ["record", "-d", uri, "-o", take, "--lossless", "--json", "--seconds", "2200ms"];
    folder.run(&[&command[..], more].concat())
}

/// A position as it is recorded: rounded to metres of float32 by the server, and to millimetres by the driver.
fn on_the_wire(position: Position) -> Position {
    position.map(|mm| (f64::from((f64::from(mm) / 1000.0) as f32) * 1000.0) as f32)
}

/// Positions that are there, in any order: unlabelled markers have channels of their own.
fn present(frame: impl Iterator<Item = Position>) -> Vec<[u32; 3]> {
    let there = frame.filter(|position| !is_gap(*position));
    let mut bits: Vec<_> = there.map(|position| position.map(f32::to_bits)).collect();
    bits.sort_unstable();
    bits
}

#[test]
fn a_recording_equals_the_floats_on_the_wire_bit_for_bit() {
    for version in [Bitstream::new(2, 10), Bitstream::new(3, 1), Bitstream::new(4, 1)] {
        for stream in streams() {
            let folder = Folder::new();
            let motion = motion();
            let settings = NatNetSettings { bitstream: version, ..NatNetSettings::new(stream) };
            let served = Served::new(motion.clone(), settings);
            let ran = record(&folder, &served.uri, "a.take", &[]).with_code(0);
            let report = ran.json();
            assert_eq!(report["ledger"]["closes"], true, "{}", ran.stderr);
            assert_eq!(report["ledger"]["lost_on_link"], 0, "{}", ran.stderr);
            let info = folder.run(&["info", "a.take", "--json"]).json();
            assert_eq!(info["device"]["driver"], "natnet");
            let labels: Vec<_> =
                info["channels"].as_array().unwrap().iter().map(|c| c["label"].clone()).collect();
            let labelled: Vec<usize> =
                (0..labels.len()).filter(|column| motion.info.markers[*column].labelled).collect();
            let sent =
                labelled.iter().map(|column| Value::from(&*motion.info.markers[*column].label));
            assert_eq!(labels[..labelled.len()], sent.collect::<Vec<_>>());
            let (rows, problems) = rows(&folder.read("a.take"));
            assert!(rows.len() >= 500 && problems.is_empty(), "{} rows", rows.len());
            let sent = |index: usize| motion.frame(index).iter().copied().map(on_the_wire);
            let first = present(rows[0].iter().copied());
            let start =
                (0..motion.n_frames()).find(|index| present(sent(*index)) == first).unwrap();
            for (index, row) in rows.iter().enumerate() {
                let frame: Vec<Position> = sent(start + index).collect();
                for (channel, column) in labelled.iter().enumerate() {
                    let [got, sent] = [row[channel], frame[*column]];
                    let are_gaps = is_gap(got) && is_gap(sent);
                    assert!(got.map(f32::to_bits) == sent.map(f32::to_bits) || are_gaps, "{index}");
                }
                assert_eq!(present(row.iter().copied()), present(frame.into_iter()), "row {index}");
            }
            folder.run(&["verify", "a.take"]).with_code(0);
            let log = served.log.clone();
            served.stop();
            folder.write("sent.csv", log.text().as_bytes());
            let against = folder.run(&["verify", "a.take", "--against", "sent.csv", "--json"]);
            let account = &against.with_code(0).json()["sent"]["accounts"][0];
            assert_eq!(account["recorded"], rows.len() as u64, "{account:#}");
        }
    }
}

/// The ledger of a recording under a script, against the simulator's log. Faults of frames are to lie between 0.8 and 1.8 s
/// after the first message, which every recording here covers.
#[track_caller]
fn ledger_agrees(stream: ServedStream, text: &str, code: Option<i32>) -> (Value, String) {
    let folder = Folder::new();
    let script = Script::parse("script", &format!("seed = 1\n{text}")).unwrap();
    let settings = NatNetSettings {
        faults: Some(Arc::new(script)),
        looping: true,
        ..NatNetSettings::new(stream)
    };
    let served = Served::new(motion(), settings);
    let ran = record(&folder, &served.uri, "a.take", &[]);
    if let Some(code) = code {
        assert_eq!(ran.code, Some(code), "{}", ran.stderr);
    }
    let ledger = ran.json()["ledger"].clone();
    let (sent, fates) = served.stop();
    let context = format!("{ledger:#}\n{}\n{}", ran.stderr, sent.faults.unwrap().summary());
    let n = |fate: Fate| fates.iter().filter(|one| one.fate == fate).count() as u64;
    let again: u64 = fates.iter().map(|fate| u64::from(fate.again)).sum();
    let count = |key: &str| ledger[key].as_u64().unwrap();
    assert_eq!(ledger["frame_balance"], 0, "{context}");
    assert_eq!(ledger["closes"], true, "{context}");
    // A late frame is missing where it belongs, and a duplicate where it comes.
    assert_eq!(count("lost_on_link"), n(Fate::Lost) + n(Fate::Late), "{context}");
    assert_eq!(count("duplicates"), again + n(Fate::Late), "{context}");
    let info = folder.run(&["info", "a.take", "--json"]).json();
    (info, context)
}

#[test]
fn frames_that_are_lost_late_or_come_twice_are_counted() {
    for (kind, keys) in [
        ("lost-frames", "rate = 0.05\nrun = 3\n"),
        ("late-frames", "rate = 0.1\nby = 4\n"),
        ("doubled-frames", "rate = 0.1\n"),
    ] {
        let window = "from_s = 0.8\nto_s = 1.8\n";
        let script = format!("[[fault]]\nkind = \"{kind}\"\n{keys}{window}");
        for stream in streams() {
            let (info, context) = ledger_agrees(stream, &script, None);
            let ledger = &info["ledger"];
            let effects =
                ledger["lost_on_link"].as_u64().unwrap() + ledger["duplicates"].as_u64().unwrap();
            assert!(effects > 5, "{context}");
        }
    }
}

#[test]
fn a_cable_that_is_pulled_and_a_stall_lose_what_was_not_sent() {
    for script in [
        "[[fault]]\nkind = \"unplug\"\nat_s = 1.0\nfor_s = 0.4\n",
        "[[fault]]\nkind = \"stall\"\nat_s = 1.0\nfor_s = 0.3\n",
        "[[fault]]\nkind = \"occlusion-storm\"\npart = 0.5\ngap_s = 0.1\n",
    ] {
        for stream in streams() {
            ledger_agrees(stream, script, None);
        }
    }
}

#[test]
fn definitions_that_change_open_a_channel_and_lose_no_frame() {
    for stream in streams() {
        let script = "[[fault]]\nkind = \"model-change\"\nat_s = 1.2\n";
        let (info, context) = ledger_agrees(stream, script, Some(0));
        let channels = info["channels"].as_array().unwrap();
        let renamed =
            channels.iter().filter(|c| c["label"].as_str().unwrap().ends_with(" renamed"));
        assert_eq!(renamed.count(), 1, "{context}");
        assert_mentions(&info["events"].to_string(), &["definitions changed"]);
    }
}

#[test]
fn definitions_that_come_late_and_frames_that_come_early_cost_nothing_else() {
    let script = "[[fault]]\nkind = \"late-model\"\nfor_s = 2.3\n[[fault]]\nkind = \"early-frames\"\ncount = 20\n";
    let (info, context) = ledger_agrees(streams()[1], script, None);
    let labels: Vec<_> =
        info["channels"].as_array().unwrap().iter().map(|c| c["label"].clone()).collect();
    let motion = motion();
    let named = motion.info.markers.iter().filter(|m| m.labelled).count();
    let found = motion.info.markers.iter().filter(|m| labels.contains(&Value::from(&*m.label)));
    assert_eq!(found.count(), named, "{labels:?}\n{context}");
    assert_mentions(&info["events"].to_string(), &["has not sent its definitions yet"]);
}

#[test]
fn another_bitstream_is_read_on() {
    let script = "[[fault]]\nkind = \"bitstream-change\"\nat_s = 1.2\nmajor = 3\nminor = 0\n";
    for stream in streams() {
        let (info, _) = ledger_agrees(stream, script, Some(0));
        assert_mentions(&info["events"].to_string(), &["layout of bitstream 3.1, and not of 4.2"]);
    }
}

#[test]
fn what_cannot_be_recorded_is_explained_in_one_line() {
    let folder = Folder::new();
    let silent = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let silent = format!("natnet:{}", silent.local_addr().unwrap());
    for (uri, facts) in [
        (&*silent, vec!["no NatNet server answers", "Motive", "local="]),
        ("natnet:127.0.0.1?local=eth99", vec!["no interface 'eth99'", "127.0.0.1"]),
        ("natnet:[::1]", vec!["no IPv4 address", "natnet:192.168.0.10"]),
        ("natnet:127.0.0.1?driver=qtm", vec!["qtm", "qtm:HOST"]),
    ] {
        let line = folder.refuses(&["record", "-d", uri, "-o", "a.take"], 1);
        assert_mentions(&line, &facts);
    }
    let raw = ["record", "-d", "natnet:127.0.0.1", "-o", "a.take", "--raw", "a.rawlog"];
    assert_mentions(&folder.refuses(&raw, 1), &["raw log", "datagrams", "--raw"]);
}
