//! Streams of the Lab Streaming Layer: recorded, with and without faults, and compared with what was sent.

use std::{
    io::Write,
    sync::{
        Arc, LazyLock,
        atomic::{AtomicBool, Ordering},
    },
    thread::{Builder, JoinHandle},
};

use mocapd_simulator::{
    NetworkOptions,
    device::SentLog,
    faults::{Fate, FrameFate, Script},
    lsl::{LslDevice, LslOutlets, LslSettings, configure},
};
use mocapd_take::motion::{Motion, is_gap};
use serde_json::Value;

use super::{
    Folder, Ran,
    faults::{expected::expected, played::SharedLog, played::fates},
};
use crate::support::{assert_mentions, jump, rows};

const RATE_HZ: f64 = 240.0;
const SECONDS: f64 = 2.0;

/// LSL's configuration for this process and the recorders that it starts: it keeps them on this machine, and gives them a session
/// and ports of their own. LSL's default range of 32 ports is too small for two test programs at the same time.
static CONFIGURATION: LazyLock<Folder> = LazyLock::new(|| {
    let session = std::process::id();
    // Below the ports of outgoing connections.
    let base_port = 17_000 + session % 400 * 32;
    let text = format!(
        "[ports]\nBasePort={base_port}\n[multicast]\nResolveScope=machine\n[lab]\nKnownPeers={{127.0.0.1}}\nSessionID=tests-{session}\n"
    );
    let folder = Folder::new();
    folder.write("lsl.cfg", &text);
    configure(&text);
    folder
});

/// The streams of a motion, until they are dropped.
struct Served {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<SentLog>>,
    uri: String,
    log: SharedLog,
}

impl Served {
    /// `name` is that of one test.
    fn new(motion: Motion, name: &str, settings: LslSettings) -> Self {
        LazyLock::force(&CONFIGURATION);
        let settings = LslSettings { name: name.to_owned(), ..settings };
        let mut device = LslDevice::new(motion, settings).unwrap();
        let outlets = LslOutlets::open(&device).unwrap();
        let uri = outlets.uri();
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, log) = (Arc::clone(&stop), SharedLog::default());
        let output: Option<Box<dyn Write + Send>> = Some(Box::new(log.clone()));
        let serve = move || {
            outlets
                .serve(&mut device, NetworkOptions { once: false, log: output }, &stopped)
                .unwrap()
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

fn motion() -> Motion {
    jump(3, RATE_HZ, SECONDS)
}

fn record(folder: &Folder, uri: &str, seconds: &str) -> Ran {
    let args = ["record", "-d", uri, "-o", "a.take", "--lossless", "--json", "--seconds", seconds];
    let mut command = folder.command(&args);
    command.env("LSLAPICFG", CONFIGURATION.path("lsl.cfg"));
    command.output().unwrap().into()
}

#[test]
fn a_recording_equals_the_floats_on_the_wire_converted_once() {
    let folder = Folder::new();
    let motion = motion();
    let served = Served::new(motion.clone(), "equal", LslSettings::default());
    let ran = record(&folder, &served.uri, "3s").with_code(0);
    let report = ran.json();
    assert_eq!(report["ledger"]["recorded"], 480, "{}", ran.stderr);
    assert_eq!(report["ledger"]["closes"], true);
    let info = folder.run(&["info", "a.take", "--json"]).json();
    assert_eq!(
        (&info["device"]["driver"], &info["device"]["serial"]),
        (&"lsl".into(), &"equal".into())
    );
    let labels = info["channels"].as_array().unwrap().iter().map(|c| c["label"].clone());
    let sent = motion.info.markers.iter().map(|marker| Value::from(&*marker.label));
    assert_eq!(labels.collect::<Vec<_>>(), sent.collect::<Vec<_>>());
    let (rows, problems) = rows(&folder.read("a.take"));
    assert_eq!((rows.len(), problems.len()), (480, 0));
    let wired = |mm: f32| {
        let metres = (f64::from(mm) / 1000.0) as f32;
        (f64::from(metres) * 1000.0) as f32
    };
    for (index, row) in rows.iter().enumerate() {
        for (got, sent) in row.iter().zip(motion.frame(index)) {
            let is_equal = got.map(f32::to_bits) == sent.map(|mm| wired(mm).to_bits());
            assert!(is_equal || (is_gap(*got) && is_gap(*sent)), "row {index}");
        }
    }
    let (sent, fates) = served.stop();
    assert_eq!((sent.starts, sent.ends), (1, 1));
    assert!(fates.iter().all(|fate| fate.fate == Fate::Whole) && fates.len() == 480);
}

/// The ledger of a recording under a script, against the simulator's log.
#[track_caller]
fn ledger_agrees(name: &str, text: &str, seconds: f64) -> (Value, String) {
    let folder = Folder::new();
    let script = Script::parse(name, text).unwrap();
    let settings = LslSettings { faults: Some(Arc::new(script)), ..LslSettings::default() };
    let served = Served::new(jump(3, RATE_HZ, seconds), name, settings);
    // A stream does not say that it is over.
    let ran = record(&folder, &served.uri, &format!("{}s", seconds + 1.0));
    let ledger = ran.json()["ledger"].clone();
    let (sent, mut fates) = served.stop();
    // Nobody can know of frames behind the last one that arrived.
    while fates.last().is_some_and(|fate| fate.fate != Fate::Whole) {
        fates.pop();
    }
    let wanted = expected(&fates);
    let totals = sent.faults.unwrap();
    let context = format!("{name}: {ledger:#}\n{}\n{}", ran.stderr, totals.summary());
    let count = |key: &str| ledger[key].as_u64().unwrap();
    assert_eq!(ledger["frame_balance"], 0, "{context}");
    // A clock that went back is a contradiction.
    assert_eq!(ledger["closes"], name != "clock-back", "{context}");
    assert_eq!(count("recorded"), wanted.recorded, "{context}");
    // TCP loses nothing: what is missing was not sent.
    assert_eq!(count("dropped_by_device"), wanted.lost_on_link, "{context}");
    assert_eq!(count("lost_on_link") + count("duplicates"), 0, "{context}");
    if wanted.unknown > 0 {
        let unknown = count("unknown_after_disconnect") as f64 / RATE_HZ;
        assert!((unknown - wanted.away_s).abs() < 0.5, "{unknown} s: {context}");
    } else {
        assert_eq!(count("frames_sent"), fates.len() as u64, "{context}");
    }
    let info = folder.run(&["info", "a.take", "--json"]).json();
    (info, context)
}

fn supplied(name: &str) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/simulator/faults");
    std::fs::read_to_string(format!("{folder}/{name}.toml")).unwrap()
}

#[test]
fn frames_that_the_sender_leaves_out_show_in_the_time_stamps() {
    let (info, context) = ledger_agrees("lost-frames", &supplied("lost-frames"), SECONDS);
    assert!(info["ledger"]["dropped_by_device"].as_u64().unwrap() >= 10, "{context}");
}

#[test]
fn streams_that_die_and_come_back_are_an_outage_with_its_cause() {
    let (info, context) = ledger_agrees("unplug", &supplied("unplug"), 6.0);
    assert!(info["ledger"]["unknown_after_disconnect"].as_u64().unwrap() >= 100, "{context}");
    let events = info["events"].to_string();
    assert!(events.contains("the stream 'unplug' is over"), "{events}");
}

#[test]
fn stalls_hidden_markers_and_clocks_that_jump_lose_no_frame() {
    for name in ["stall", "occlusion-storm", "clock", "clock-back"] {
        let (info, context) = ledger_agrees(name, &supplied(name), SECONDS);
        assert_eq!(info["ledger"]["recorded"], 480, "{context}");
    }
}

#[test]
fn irregular_time_stamps_lose_no_frame() {
    // Most of a period of 4.2 ms: more would be a clock that goes back.
    let script = "seed = 1\n[[fault]]\nkind = \"stamp-jitter\"\nms = 4\n";
    let (info, context) = ledger_agrees("jitter", script, SECONDS);
    assert_eq!(info["ledger"]["recorded"], 480, "{context}");
}

#[test]
fn faults_of_lines_are_refused() {
    let script = "seed = 1\n[[fault]]\nkind = \"late-frames\"\nrate = 0.1\nby = 2\n";
    let faults = Some(Arc::new(Script::parse("late", script).unwrap()));
    let error =
        LslDevice::new(motion(), LslSettings { faults, ..LslSettings::default() }).unwrap_err();
    assert_mentions(&error.to_string(), &["late-frames", "remove it"]);
}
