//! Takes that end by themselves, starts at a time of day, and names with a count.

use std::{fs, sync::Arc, time::Duration};

use mocapd_acquire::threads::Heartbeat;
use mocapd_service::{
    control::{Control, RefusalKind, Request, SaveLast, Start},
    engine::Engine,
    finished::Trash,
    status::{Presence, ServiceEventKind, State},
};
use mocapd_take::record::{EndingKind, Subject};

use super::engine::{Room, named, options, read, room, wait_until};
use crate::support::assert_mentions;

fn of(seconds: f64, name: &str) -> Start {
    Start { seconds: Some(seconds), ..named(name) }
}

#[test]
fn a_take_with_a_length_ends_by_itself_at_exactly_that_frame() {
    let Room { directory: _directory, device: _device, engine } = room(|_| {});
    let events = engine.events();
    for (seconds, rows) in [(0.5, 60), (1.0, 120), (0.001, 1)] {
        let started = engine.start(&of(seconds, &format!("timed-{rows}"))).unwrap();
        let status = engine.status();
        if let Some(take) = status.take {
            assert_eq!(take.wanted_s, Some(seconds));
        }
        wait_until("its end", || engine.status().state == State::Armed);
        let summary = read(&started.path);
        assert_eq!(summary.take.n_rows, rows);
        assert_eq!(summary.take.ending.unwrap().kind, EndingKind::Length);
        let last = engine.status().last_take.unwrap();
        assert_eq!((last.name, last.ending), (started.name, Some(EndingKind::Length)));
    }
    let mut ended = Vec::new();
    while let Some(event) = events.next(Duration::from_millis(200)) {
        if event.kind == ServiceEventKind::TakeStopped {
            ended.push(event);
        }
    }
    assert_eq!(ended.len(), 3);
    assert_mentions(&ended[0].message, &["timed-60", EndingKind::Length.name()]);
    // A stop before the end is a stop, and the pre-roll comes in addition.
    let started = engine.start(&of(600.0, "stopped")).unwrap();
    let stopped = engine.stop(&Request::default()).unwrap();
    assert_eq!(stopped.ending, Some(EndingKind::Stopped));
    read(&started.path);
    wait_until("the pre-roll", || engine.status().pre_roll.held_s > 2.0);
    let start = Start { pre_roll_s: Some(1.0), ..of(0.5, "with-pre-roll") };
    let started = engine.start(&start).unwrap();
    wait_until("its end", || engine.status().state == State::Armed);
    let seconds = read(&started.path).take.n_rows as f64 / 120.0;
    let before_s = started.first_frame.before_request_s;
    assert!(before_s >= 1.0 && (seconds - before_s - 0.5).abs() < 0.1, "{seconds} {before_s}");
    for seconds in [0.0, -1.0, f64::NAN, f64::INFINITY, 86_401.0] {
        let refused = engine.start(&of(seconds, "bad")).unwrap_err();
        assert_eq!(refused.kind, RefusalKind::Invalid, "{seconds}");
    }
}

#[test]
fn a_take_with_a_length_ends_also_while_the_device_is_away() {
    let Room { directory: _directory, device, engine } = room(|_| {});
    let started = engine.start(&of(1.0, "away")).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    device.unplug();
    wait_until("the absence", || engine.status().device.presence == Presence::Absent);
    wait_until("its end", || engine.status().last_take.is_some());
    let last = engine.status().last_take.unwrap();
    assert_eq!((last.name.as_str(), last.ending), ("away", Some(EndingKind::Length)));
    let take = read(&started.path).take;
    assert_eq!(take.n_rows, 120, "lost ones included, and none beyond the length");
    let ledger = take.ledger.unwrap();
    assert!(ledger.closes() && ledger.unknown_after_disconnect > 0, "{ledger:?}");
}

/// The time of day in so many seconds.
fn time_in(seconds: i64) -> String {
    let at = jiff::Zoned::now().checked_add(jiff::SignedDuration::from_secs(seconds)).unwrap();
    at.strftime("%H:%M:%S").to_string()
}

fn at(seconds: i64, name: &str) -> Start {
    Start { at: Some(time_in(seconds)), ..named(name) }
}

#[test]
fn a_start_waits_for_its_time_and_can_be_cancelled() {
    let Room { directory, device: _device, engine } = room(|options| options.arm.at_start = true);
    wait_until("it is armed", || engine.status().state == State::Armed);
    let pending = engine.schedule(&at(3600, "later")).unwrap();
    assert_eq!((pending.remarks.len(), pending.name.as_deref()), (0, Some("later")));
    assert_eq!(engine.status().pending_start, Some(pending.clone()));
    assert_eq!(engine.schedule(&at(60, "other")).unwrap_err().kind, RefusalKind::Conflict);
    assert_eq!(engine.stop(&Request::default()).unwrap_err().kind, RefusalKind::Conflict);
    assert_eq!(engine.status().pending_start, Some(pending.clone()), "a stop ends takes");
    assert_eq!(engine.cancel(&Request::default()).unwrap(), pending);
    assert_eq!(engine.status().pending_start, None);
    assert_eq!(engine.cancel(&Request::default()).unwrap_err().kind, RefusalKind::Conflict);
    assert_eq!(directory.path().read_dir().unwrap().count(), 0, "nothing was recorded");

    let start = Start { seconds: Some(0.5), ..at(2, "timed") };
    let pending = engine.schedule(&start).unwrap();
    wait_until("the take", || engine.status().last_take.is_some());
    assert_eq!(engine.status().pending_start, None);
    let take = read(&directory.path().join("timed.take")).take;
    assert_eq!(take.n_rows, 60);
    let late_ms = take.header.created_unix_ms - pending.at_unix_ms;
    assert!((0..500).contains(&late_ms), "{late_ms} ms late");
    // A time that has just passed is that of tomorrow.
    let day =
        || jiff::Zoned::now().checked_sub(jiff::SignedDuration::from_secs(60)).unwrap().date();
    if day() == jiff::Zoned::now().date() {
        let tomorrow = engine.schedule(&at(-60, "passed")).unwrap();
        assert_mentions(&tomorrow.remarks[0], &["tomorrow"]);
        engine.cancel(&Request::default()).unwrap();
    }
    // The same request again is not executed again.
    let again = Start { request_id: Some("a".to_owned()), ..at(600, "again") };
    let first = engine.schedule(&again).unwrap();
    assert_eq!(engine.schedule(&again).unwrap(), first);
    let refused = engine.start(&at(600, "x")).unwrap_err();
    assert_eq!(refused.kind, RefusalKind::Invalid);
}

#[test]
fn a_start_that_does_not_take_place_is_in_the_status_and_an_event() {
    let Room { directory, device: _device, engine } = room(|_| {});
    let events = engine.events();
    let pending = engine.schedule(&at(2, "idle")).unwrap();
    assert_eq!(pending.remarks.len(), 1, "it is not armed: {pending:?}");
    wait_until("its time", || engine.status().missed_start.is_some());
    let status = engine.status();
    assert_mentions(status.missed_start.as_ref().unwrap(), &[&pending.at, "not armed"]);
    assert_eq!((status.pending_start, status.state), (None, State::Idle));
    let mut kinds = Vec::new();
    while let Some(event) = events.next(Duration::from_millis(100)) {
        kinds.push(event.kind);
    }
    assert!(kinds.contains(&ServiceEventKind::Failure), "{kinds:?}");
    assert_eq!(directory.path().read_dir().unwrap().count(), 0);
    // While a take is recorded.
    engine.start(&named("now")).unwrap();
    assert_eq!(engine.status().missed_start, None, "another start took place");
    engine.schedule(&at(2, "second")).unwrap();
    wait_until("its time", || engine.status().missed_start.is_some());
    assert_mentions(&engine.status().missed_start.unwrap(), &["now", "being recorded"]);
    assert_eq!(engine.status().take.unwrap().name, "now", "it goes on");
    engine.stop(&Request::default()).unwrap();
    // What could never be executed is refused at once.
    for (start, kind) in [
        (at(60, "now"), RefusalKind::Exists),
        (at(60, "../x"), RefusalKind::Invalid),
        (Start { seconds: Some(-1.0), ..at(60, "x") }, RefusalKind::Invalid),
        (Start { trial: Some("a/b".to_owned()), ..at(60, "x") }, RefusalKind::Invalid),
        (Start { at: Some("25:00".to_owned()), ..named("x") }, RefusalKind::Invalid),
    ] {
        assert_eq!(engine.schedule(&start).unwrap_err().kind, kind, "{start:?}");
    }
    let events = engine.events();
    engine.schedule(&at(3600, "never")).unwrap();
    engine.stop_service();
    let mut messages = Vec::new();
    while let Some(event) = events.next(Duration::from_millis(100)) {
        messages.push(event.message.clone());
    }
    assert!(messages.iter().any(|message| message.contains("the service stops")), "{messages:?}");
}

#[test]
fn without_a_time_all_that_is_held_is_saved() {
    let Room { directory: _directory, device: _device, engine } =
        room(|options| options.arm.at_start = true);
    wait_until("the pre-roll", || engine.status().pre_roll.held_s > 3.0);
    let held_s = engine.status().pre_roll.held_s;
    let saved = engine.save_last(&SaveLast::default()).unwrap();
    assert!(saved.seconds >= held_s - 0.1, "{saved:?}");
    assert_eq!((saved.short_by_s, saved.remarks.len()), (0.0, 0), "nothing is missing");
    read(&saved.path);
    engine.disarm(&Request::default()).unwrap();
    let refused = engine.save_last(&SaveLast::default()).unwrap_err();
    assert_eq!(refused.kind, RefusalKind::Conflict);
}

fn trial(subject: &str, session: &str, trial: &str) -> Start {
    let [subject, session, trial] = [subject, session, trial].map(|part| Some(part.to_owned()));
    Start { subject, session, trial, ..Start::default() }
}

#[test]
fn takes_are_named_after_subject_session_and_trial_with_a_count_that_never_returns() {
    let Room { directory, device, engine } = room(|options| {
        let mut subject = Subject { name: "S01".to_owned(), documents: Vec::new() };
        subject.set(Subject::SKELETON, b"{}".to_vec());
        options.subject = Some(Arc::new(subject));
    });
    let record = |engine: &Engine, start: &Start| {
        let started = engine.start(start).unwrap();
        engine.stop(&Request::default()).unwrap();
        started
    };
    let jump = trial("S02", "session1", "jump");
    let first = record(&engine, &jump);
    assert_eq!(first.name, "S02_session1_jump_001");
    assert_mentions(&first.remarks.join(" "), &["S02", "S01", "skeleton"]);
    let subject = read(&first.path).take.subject.unwrap();
    assert_eq!((subject.name.as_str(), subject.documents.len()), ("S02", 0));
    assert_eq!(engine.status().names.unwrap().trial, "jump");
    // Without a subject, the configured one.
    let walk = record(&engine, &Start { subject: None, ..trial("", "", "walk") });
    assert_eq!((walk.name.as_str(), walk.remarks.len()), ("S01_walk_001", 0));
    assert_eq!(read(&walk.path).take.subject.unwrap().documents.len(), 1);
    let second = record(&engine, &jump);
    assert_eq!(second.name, "S02_session1_jump_002");
    engine.trash(&second.name, &Trash::default()).unwrap();
    assert_eq!(record(&engine, &jump).name, "S02_session1_jump_003");
    drop(engine);
    // After a restart, and although the takes were moved away.
    for entry in directory.path().read_dir().unwrap().map(Result::unwrap) {
        if entry.path().extension().is_some_and(|extension| extension == "take") {
            fs::remove_file(entry.path()).unwrap();
        }
    }
    fs::remove_dir_all(directory.path().join(".trash")).unwrap();
    let engine =
        Engine::start(options(directory.path(), &device.path), &Heartbeat::default()).unwrap();
    assert_eq!(record(&engine, &jump).name, "S02_session1_jump_004");
    // A name of its own comes first.
    let own = Start { name: Some("mine".to_owned()), ..jump };
    assert_eq!(record(&engine, &own).name, "mine");
    for bad in ["../x", "a/b", ".x", "-x", "a\nb", "x ", &"x".repeat(61)] {
        for start in [trial(bad, "", ""), trial("", bad, ""), trial("", "", bad)] {
            assert_eq!(engine.start(&start).unwrap_err().kind, RefusalKind::Invalid, "{bad:?}");
        }
    }
    let reserved = Start { name: Some("NUL".to_owned()), ..Start::default() };
    assert_eq!(engine.start(&reserved).unwrap_err().kind, RefusalKind::Invalid);
}
