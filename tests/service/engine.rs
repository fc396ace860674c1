//! Tests of the engine: data reported as durable is on disk, and a refused command leaves nothing behind.

use std::{io::Write, path::Path, sync::Arc, time::Duration};

use mocapd_acquire::{files::TakeFile, inspect::Summary, ledger::TakeHealth, threads::Heartbeat};
use mocapd_service::{
    config::{ArchiveConfig, ArmConfig, DeviceChoice, DeviceConfig, NameTemplate, TakeConfig},
    control::{Control, Mark, RefusalKind, Request, SaveLast, Start},
    engine::{Engine, EngineOptions},
    live::LiveMessage,
    status::{Presence, ServiceEventKind, State},
};
use mocapd_take::record::{EndingKind, Subject};

use crate::{
    cli::{devices::Simulated, subjects::skeleton},
    support::{assert_mentions, dense, jump},
};

pub(crate) fn options(directory: &Path, device: &Path) -> EngineOptions {
    EngineOptions {
        rig: "test".to_owned(),
        device: DeviceConfig { uri: at(device), rate_hz: None, raw_log: false },
        take: TakeConfig {
            directory: directory.to_owned(),
            name: NameTemplate::parse("take-{count}").unwrap(),
            codec: dense(1.0),
            angle_degrees: None,
            residuals: false,
            up_axis: mocapd_take::motion::UpAxis::Unknown,
            stretch: Duration::from_millis(500),
            sync: Duration::from_millis(500),
            keep_free_bytes: 0,
            reconnect: Duration::from_secs(20),
            max_length: None,
            trash_keep: Duration::from_secs(3600),
        },
        subject: None,
        arm: ArmConfig {
            at_start: false,
            pre_roll: Duration::from_secs(5),
            include_pre_roll: Duration::ZERO,
            memory_max_bytes: 64 << 20,
        },
        archive: ArchiveConfig::default(),
        publishers: Vec::new(),
    }
}

/// A device choice for a pty.
pub(crate) fn at(device: &Path) -> DeviceChoice {
    DeviceChoice::At(format!("serial:{}", device.display()).parse().unwrap())
}

pub(crate) struct Room {
    pub(crate) directory: tempfile::TempDir,
    pub(crate) device: Simulated,
    pub(crate) engine: Engine,
}

pub(crate) fn room(change: impl FnOnce(&mut EngineOptions)) -> Room {
    let directory = tempfile::tempdir().unwrap();
    let device = Simulated::endless(jump(1, 120.0, 3.0));
    let mut options = options(directory.path(), &device.path);
    change(&mut options);
    let engine = Engine::start(options, &Heartbeat::default()).unwrap();
    Room { directory, device, engine }
}

/// A subject with a skeleton of 14 bones, and a face posed by four of the markers.
fn subject() -> Arc<Subject> {
    let mut subject = Subject { name: "S01".to_owned(), documents: Vec::new() };
    subject.set(Subject::SKELETON, skeleton(&jump(1, 60.0, 1.0)).into_bytes());
    let face = r#"{"format":"mocapd-face","version":1,"vertices_mm":[[0,0,0],[9,0,0],[0,9,0],[0,0,9]],"lines":[[0,1]]}"#;
    subject.set(Subject::FACE, face.as_bytes().to_vec());
    let marker = |(at, label): (usize, &str)| format!(r#"{{"label":"{label}","at":{at}}}"#);
    let markers = ["head", "throat", "pelvis", "l_wrist"].into_iter().enumerate().map(marker);
    let markers = markers.collect::<Vec<_>>().join(",");
    let mapping =
        format!(r#"{{"format":"mocapd-face-mapping","version":1,"markers":[{markers}]}}"#);
    subject.set(Subject::FACE_MARKERS, mapping.into_bytes());
    Arc::new(subject)
}

fn request() -> Request {
    Request::default()
}

pub(crate) fn named(name: &str) -> Start {
    Start { name: Some(name.to_owned()), ..Start::default() }
}

/// Reads a take and checks that it is complete and without problems.
pub(crate) fn read(path: &Path) -> Summary {
    let summary =
        Summary::read(std::io::BufReader::new(std::fs::File::open(path).unwrap())).unwrap();
    assert_eq!((summary.take.problems.as_slice(), summary.contradictions()), (&[][..], &[][..]));
    assert!(summary.take.ledger.as_ref().unwrap().finished);
    summary
}

pub(crate) fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    for _ in 0..1500 {
        if condition() {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    panic!("timeout: {what}");
}

#[test]
fn a_take_exists_after_start_and_is_complete_after_stop() {
    let Room { directory, device, engine } = room(|options| options.subject = Some(subject()));
    assert_eq!(engine.status().state, State::Idle);
    let started = engine.start(&named("walk")).unwrap();
    assert_eq!(started.path, directory.path().join("walk.take"));
    let half = Summary::read(&std::fs::read(&started.path).unwrap()).unwrap();
    assert!(half.samples() > 0, "the first frames are in the file");
    let status = engine.status();
    assert_eq!((status.state, status.device.presence), (State::Recording, Presence::Streaming));
    assert_eq!(status.take.unwrap().name, "walk");
    assert_eq!(engine.start(&named("other")).unwrap_err().kind, RefusalKind::Conflict);
    assert_eq!(engine.disarm(&request()).unwrap_err().kind, RefusalKind::Conflict);
    std::thread::sleep(Duration::from_millis(700));
    let marked = engine.mark(&Mark { text: "heel strike".to_owned(), ..Mark::default() }).unwrap();
    std::thread::sleep(Duration::from_millis(100));
    let stopped = engine.stop(&request()).unwrap();
    let summary = read(&started.path);
    assert_eq!(stopped.bytes, started.path.metadata().unwrap().len());
    assert_eq!(summary.take.subject.as_ref(), Some(&*subject()));
    assert_eq!(stopped.ledger.recorded, summary.take.ledger.as_ref().unwrap().recorded);
    assert!(stopped.ledger.closes && stopped.seconds > 0.7, "{stopped:?}");
    let mark = summary.take.events.iter().find(|event| event.text == "heel strike").unwrap();
    assert_eq!(mark.row, marked.row);
    assert!(mark.row > 0 && mark.row < stopped.rows);
    // The next take starts at once.
    assert_eq!(engine.status().state, State::Armed);
    assert_eq!(engine.start(&named("walk")).unwrap_err().kind, RefusalKind::Exists);
    let again = engine.start(&Start::default()).unwrap();
    assert_eq!(again.name, "take-001");
    engine.stop(&request()).unwrap();
    read(&again.path);
    assert_eq!(engine.stop(&request()).unwrap_err().kind, RefusalKind::Conflict);
    let names: Vec<_> = engine.takes(9).unwrap().into_iter().map(|take| take.name).collect();
    assert_eq!(names, ["take-001", "walk"]);
    assert_eq!(engine.disarm(&request()).unwrap().state, State::Idle);
    drop(engine);
    assert_eq!(device.unplug().starts, 1, "the device was started once");
}

#[test]
fn the_pre_roll_is_in_the_take_and_can_be_saved() {
    let Room { directory: _directory, device: _device, engine } =
        room(|options| options.arm.at_start = true);
    wait_until("the pre-roll", || engine.status().pre_roll.held_s > 4.0);
    let start = Start { pre_roll_s: Some(2.0), ..named("early") };
    let started = engine.start(&start).unwrap();
    assert!((2.0..3.7).contains(&started.first_frame.before_request_s), "{started:?}");
    let save =
        SaveLast { seconds: Some(3.0), name: Some("last".to_owned()), ..SaveLast::default() };
    let saved = engine.save_last(&save).unwrap();
    assert!((2.9..4.9).contains(&saved.seconds), "{saved:?}");
    assert_eq!((saved.short_by_s, saved.remarks.len()), (0.0, 0));
    read(&saved.path);
    assert_eq!(engine.status().take.unwrap().name, "early", "it goes on");
    let stopped = engine.stop(&request()).unwrap();
    assert!(stopped.seconds > 2.0);
    read(&started.path);
    let long = Start { pre_roll_s: Some(600.0), ..named("long") };
    let started = engine.start(&long).unwrap();
    assert_eq!(started.remarks.len(), 1, "{started:?}");
    engine.stop(&request()).unwrap();
    assert!(read(&started.path).samples() > 0);
}

#[test]
fn a_repeated_request_is_executed_once() {
    let Room { directory: _directory, device: _device, engine } = room(|_| {});
    let id = |id: &str| Some(id.to_owned());
    let start = Start { request_id: id("a"), ..Start::default() };
    let first = engine.start(&start).unwrap();
    assert_eq!(engine.start(&start).unwrap(), first);
    let stop = Request { request_id: id("b") };
    let stopped = engine.stop(&stop).unwrap();
    assert_eq!(engine.stop(&stop).unwrap(), stopped);
    assert_eq!(engine.start(&start).unwrap(), first, "the take is over and not started again");
    assert_eq!(engine.status().state, State::Armed);
    let other = Request { request_id: id("a") };
    assert_eq!(engine.stop(&other).unwrap_err().kind, RefusalKind::Invalid);
    let save = SaveLast { request_id: id("b"), seconds: Some(1.0), ..SaveLast::default() };
    assert_eq!(engine.save_last(&save).unwrap_err().kind, RefusalKind::Invalid);
}

#[test]
fn an_absent_device_is_awaited_and_the_take_continues_when_it_is_back() {
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("device");
    let mut options = options(directory.path(), &link);
    options.arm.at_start = true;
    let engine = Engine::start(options, &Heartbeat::default()).unwrap();
    let refused = engine.start(&named("early")).unwrap_err();
    assert_eq!(refused.kind, RefusalKind::Device, "{refused}");
    assert!(!directory.path().join("early.take").exists());
    assert!(engine.status().device.obstacle.is_some());
    let motion = jump(2, 120.0, 3.0);
    let device = Simulated::endless_at(&link, "A", motion.clone());
    wait_until("the device", || engine.status().state == State::Armed);
    let started = engine.start(&named("unplugged")).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    device.unplug();
    wait_until("the outage", || engine.status().device.presence == Presence::Absent);
    assert_eq!(engine.status().state, State::Recording);
    let _device = Simulated::endless_at(&link, "A", motion);
    wait_until("its return", || engine.status().device.outages == 1);
    std::thread::sleep(Duration::from_millis(300));
    let stopped = engine.stop(&request()).unwrap();
    assert!(stopped.ledger.unknown_after_disconnect > 0, "{stopped:?}");
    read(&started.path);
}

#[test]
fn the_take_is_finished_when_the_service_stops_and_at_its_maximum_length() {
    let Room { directory, device: _device, engine } =
        room(|options| options.take.max_length = Some(Duration::from_millis(800)));
    let events = engine.events();
    let long = engine.start(&named("long")).unwrap();
    wait_until("the end", || engine.status().state == State::Armed);
    assert!(read(&long.path).samples() > 0);
    let mut ended = Vec::new();
    while let Some(event) = events.next(Duration::from_millis(100)) {
        ended.push(event);
    }
    let stopped = ended.iter().find(|event| event.kind == ServiceEventKind::TakeStopped).unwrap();
    assert_mentions(&stopped.message, &["long", EndingKind::Length.name()]);
    let open = engine.start(&named("open")).unwrap();
    engine.stop_service();
    assert!(read(&open.path).samples() > 0);
    let refused = engine.start(&named("late")).unwrap_err();
    assert_eq!(refused.kind, RefusalKind::Unavailable);
    assert!(!directory.path().join("late.take").exists());
}

#[test]
fn viewers_get_the_newest_frames_and_a_slow_one_costs_nothing() {
    let Room { directory: _directory, device: _device, engine } = room(|options| {
        options.arm.at_start = true;
        options.subject = Some(subject());
    });
    let (quick, slow) = (engine.live(), engine.live());
    let mut frames = 0;
    let mut tables = 0;
    let mut with_face = 0;
    let mut last = 0;
    for _ in 0..60 {
        match quick.next(Duration::from_secs(10)).unwrap() {
            LiveMessage::Table(table) => {
                tables += 1;
                assert_eq!(table.labels.len(), 15);
                assert_eq!((table.bones.len(), table.limbs.len()), (14, 14));
                assert_eq!(table.face.as_ref().unwrap().vertices_mm.len(), 4);
            }
            LiveMessage::Frame(frame) => {
                assert_eq!(frame.positions_mm.len(), 15);
                with_face += usize::from(frame.face.is_some());
                assert!(frame.row >= last);
                last = frame.row;
                frames += 1;
            }
        }
    }
    assert_eq!((tables, frames), (1, 59));
    // Markers are occluded at times, and a face needs three of its four.
    assert!(with_face > frames / 2, "{with_face} of {frames}");
    assert!(matches!(slow.next(Duration::ZERO), Some(LiveMessage::Table(_))));
    let mut newest = 0;
    while let Some(LiveMessage::Frame(frame)) = slow.next(Duration::ZERO) {
        newest = frame.row;
    }
    assert!(newest + 60 > last, "queued frames are recent: {newest} of {last}");
    let quality = engine.quality();
    assert_eq!(quality.len(), 15);
    assert!(quality.iter().all(|marker| marker.visible > 0.5), "{quality:?}");
}

#[test]
fn a_take_of_another_recorder_is_left_alone() {
    let Room { directory, device, engine } = room(|_| {});
    let started = engine.start(&named("mine")).unwrap();
    std::thread::sleep(Duration::from_millis(800));
    let begun = std::fs::read(&started.path).unwrap();
    engine.stop(&request()).unwrap();
    drop(engine);
    let mut theirs = TakeFile::create(&directory.path().join("theirs.take")).unwrap();
    theirs.write_all(&begun).unwrap();
    let mut options = options(directory.path(), &device.path);
    options.arm.at_start = true;
    let engine = Engine::start(options, &Heartbeat::default()).unwrap();
    wait_until("it is armed", || engine.status().state == State::Armed);
    let takes = engine.takes(9).unwrap();
    let theirs_now = takes.iter().find(|take| take.name == "theirs").unwrap();
    assert_eq!((theirs_now.is_open, theirs_now.health), (true, TakeHealth::Unknown));
    assert!(!directory.path().join("theirs.recovered.take").exists());
    drop(theirs);
    let closed = engine.takes(9).unwrap();
    let theirs_now = closed.iter().find(|take| take.name == "theirs").unwrap();
    assert_eq!((theirs_now.is_open, theirs_now.health), (false, TakeHealth::CutOff));
}

#[test]
fn takes_cut_off_by_a_kill_are_recovered_when_the_service_starts() {
    let Room { directory, device, engine } = room(|_| {});
    let started = engine.start(&named("killed")).unwrap();
    std::thread::sleep(Duration::from_millis(1200));
    let killed = std::fs::read(&started.path).unwrap();
    engine.stop(&request()).unwrap();
    drop(engine);
    std::fs::write(&started.path, &killed).unwrap();
    let engine =
        Engine::start(options(directory.path(), &device.path), &Heartbeat::default()).unwrap();
    let recovered = directory.path().join("killed.recovered.take");
    wait_until("the recovery", || recovered.exists());
    assert!(read(&recovered).samples() > 0);
    assert_eq!(std::fs::read(&started.path).unwrap(), killed, "the original file is unchanged");
    let takes = engine.takes(9).unwrap();
    let health = |name: &str| takes.iter().find(|take| take.name == name).unwrap().health;
    assert_eq!(
        (health("killed"), health("killed.recovered")),
        (TakeHealth::CutOff, TakeHealth::Lossy)
    );
    assert_eq!(engine.take_path("../killed").unwrap_err().kind, RefusalKind::Invalid);
    assert_eq!(engine.take_path("none").unwrap_err().kind, RefusalKind::NotFound);
}

#[test]
fn the_raw_log_lasts_from_arm_to_disarm() {
    let Room { directory, device: _device, engine } = room(|options| options.device.raw_log = true);
    engine.start(&named("logged")).unwrap();
    engine.stop(&request()).unwrap();
    engine.disarm(&request()).unwrap();
    drop(engine);
    let is_log = |path: &std::path::PathBuf| path.extension().is_some_and(|e| e == "rawlog");
    let entries = directory.path().read_dir().unwrap().map(|entry| entry.unwrap().path());
    let logs: Vec<_> = entries.filter(is_log).collect();
    assert_eq!(logs.len(), 1, "{logs:?}");
    let bytes = std::fs::read(&logs[0]).unwrap();
    assert!(bytes.len() > 2_000, "{}", bytes.len());
}

#[test]
fn a_full_disk_is_reported_and_nothing_is_left_on_it() {
    let Room { directory, device: _device, engine } =
        room(|options| options.take.keep_free_bytes = u64::MAX / 2);
    let refused = engine.start(&named("full")).unwrap_err();
    assert_eq!(refused.kind, RefusalKind::Disk, "{refused}");
    assert_mentions(&refused.message, &["take.keep_free"]);
    assert_eq!(directory.path().read_dir().unwrap().count(), 0);
    assert_eq!(engine.status().state, State::Idle);
}

#[test]
fn frames_missed_during_an_absence_are_in_the_ledger_of_the_take_that_ends() {
    let Room { directory: _directory, device, engine } = room(|_| {});
    let started = engine.start(&named("cut")).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    device.unplug();
    wait_until("the absence", || engine.status().device.presence == Presence::Absent);
    assert!(engine.status().device.obstacle.is_some());
    std::thread::sleep(Duration::from_millis(1200));
    let stopped = engine.stop(&request()).unwrap();
    let ledger = read(&started.path).take.ledger.unwrap();
    assert_eq!(ledger.unknown_after_disconnect, stopped.ledger.unknown_after_disconnect);
    assert!(ledger.closes() && ledger.unknown_after_disconnect >= 140, "{ledger:?}");
    assert_eq!(engine.takes(1).unwrap()[0].health, TakeHealth::Lossy);
    // The stop does not wait for a frame that cannot arrive.
    let asked = std::time::Instant::now();
    let refusal = engine.start(&named("next")).unwrap_err();
    assert_eq!(refusal.kind, RefusalKind::Device);
    assert!(
        asked.elapsed() < Duration::from_secs(1)
            && !started.path.with_file_name("next.take").exists()
    );
}
