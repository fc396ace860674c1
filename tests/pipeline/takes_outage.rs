//! Takes around an absence of the device, and reports that come late.

use std::time::Duration;

use mocapd_acquire::inspect::Summary;
use mocapd_drivers::device::Status;
use mocapd_take::record::{EndingKind, Event, EventKind};

use super::takes::{PRE_ROLL, arm, arrival_ns, ended, feed_all, new_take};
use crate::support::{assert_mentions, jump, rows};

const SOON: Duration = Duration::from_secs(30);

#[test]
fn a_take_that_begins_while_the_device_is_away_excludes_its_absence() {
    let motion = jump(21, 100.0, 20.0);
    // The device is away; it is back but has sent no frame; or its absence is not noticed yet.
    for when in ["away", "back", "silent"] {
        let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
        feed_all(&mut intake, &motion, 0..300);
        if when != "silent" {
            intake.set_away(true);
        }
        if when == "back" {
            intake.set_away(false);
            intake.rejoin();
        }
        let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 800)).unwrap();
        // The reader polls before the frame arrives.
        intake.tick(arrival_ns(&motion, 800));
        if when != "back" {
            intake.set_away(false);
            intake.rejoin();
        }
        feed_all(&mut intake, &motion, 900..1200);
        let first = handle.first.recv_timeout(SOON).unwrap();
        assert_eq!(first.arrival_ns, arrival_ns(&motion, 900), "{when}");
        armed.takes.end(EndingKind::Stopped).unwrap();
        feed_all(&mut intake, &motion, 1200..1201);
        let (written, take) = ended(&handle);
        let ledger = &written.ledger;
        assert_eq!((ledger.frames_sent, ledger.recorded), (300, 300), "{ledger:?}");
        assert!(ledger.closes() && ledger.contradictions.is_empty(), "{ledger:?}");
        let (rows, problems) = rows(&take);
        assert_eq!((rows.len(), problems.as_slice()), (300, &[][..]), "{when}");
        let summary = Summary::read(&take[..]).unwrap();
        assert_eq!(
            (summary.take.problems.as_slice(), summary.contradictions()),
            (&[][..], &[][..])
        );
        drop(intake);
        pipeline.join().unwrap();
    }
}

#[test]
fn an_end_does_not_wait_for_a_device_that_is_away() {
    let motion = jump(22, 100.0, 10.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 0)).unwrap();
    feed_all(&mut intake, &motion, 0..300);
    intake.set_away(true);
    armed.takes.end(EndingKind::Stopped).unwrap();
    intake.tick(arrival_ns(&motion, 400));
    let (written, take) = ended(&handle);
    let ledger = &written.ledger;
    // Frames due while it was away count as lost in this take: frame 400 is not due yet.
    assert_eq!((ledger.recorded, ledger.unknown_after_disconnect), (300, 100), "{ledger:?}");
    assert!(ledger.closes() && ledger.contradictions.is_empty(), "{ledger:?}");
    assert_eq!(rows(&take).0.len(), 400);
    // The end of a take that could not begin yet does not wait either.
    let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 500)).unwrap();
    intake.tick(arrival_ns(&motion, 500));
    armed.takes.end(EndingKind::Stopped).unwrap();
    intake.tick(arrival_ns(&motion, 600));
    assert_eq!(ended(&handle).0.ledger.recorded, 0);
    // Rows already counted are not counted again when the device is back.
    intake.set_away(false);
    intake.rejoin();
    feed_all(&mut intake, &motion, 700..800);
    assert_eq!(intake.counts().seen(), 800);
    assert_eq!(intake.next_row(), 800);
    drop(intake);
    pipeline.join().unwrap();
}

/// After a replug, frames may come before the requester is informed.
#[test]
fn a_take_does_not_wait_while_frames_come() {
    let motion = jump(26, 100.0, 10.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    feed_all(&mut intake, &motion, 0..300);
    intake.set_away(true);
    intake.rejoin();
    feed_all(&mut intake, &motion, 400..410);
    let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 410)).unwrap();
    feed_all(&mut intake, &motion, 410..500);
    let first = handle.first.recv_timeout(SOON).unwrap();
    assert_eq!(first.arrival_ns, arrival_ns(&motion, 410));
    drop(intake);
    assert_eq!(ended(&handle).0.ledger.recorded, 90);
    pipeline.join().unwrap();
}

/// With two seconds requested and one second since the return, the take has that second, not the minutes of absence.
#[test]
fn a_pre_roll_does_not_reach_back_beyond_an_absence() {
    let motion = jump(23, 100.0, 40.0);
    for requested_s in [2, 30] {
        let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
        feed_all(&mut intake, &motion, 0..330);
        intake.set_away(true);
        intake.set_away(false);
        intake.rejoin();
        feed_all(&mut intake, &motion, 3000..3100);
        let pre_roll = Duration::from_secs(requested_s);
        let handle = armed.takes.begin(new_take(&motion, pre_roll, 3100)).unwrap();
        feed_all(&mut intake, &motion, 3100..3300);
        let first = handle.first.recv_timeout(SOON).unwrap();
        armed.takes.end(EndingKind::Stopped).unwrap();
        feed_all(&mut intake, &motion, 3300..3301);
        let (written, take) = ended(&handle);
        let ledger = &written.ledger;
        assert!(ledger.closes() && ledger.contradictions.is_empty(), "{ledger:?}");
        let summary = Summary::read(&take[..]).unwrap();
        assert_eq!(
            (summary.take.problems.as_slice(), summary.contradictions()),
            (&[][..], &[][..])
        );
        if requested_s == 2 {
            assert_eq!((first.row, ledger.frames_sent, ledger.recorded), (3000, 300, 300));
        } else {
            // A request that reaches back beyond the absence includes its rows.
            assert!(first.row < 330, "{first:?}");
            assert_eq!(ledger.unknown_after_disconnect, 2670, "{ledger:?}");
            assert_eq!(ledger.recorded, 330 - first.row + 300);
        }
        let at_request = |event: &&Event| event.row == ledger.frames_sent - 200;
        let at_request = summary.take.events.iter().find(at_request);
        assert_eq!(at_request.map(|event| event.kind), Some(EventKind::Host));
        assert_eq!(rows(&take).0.len() as u64, ledger.frames_sent);
        drop(intake);
        pipeline.join().unwrap();
    }
}

#[test]
fn a_mark_whose_handle_is_dropped_is_cancelled() {
    let motion = jump(24, 100.0, 5.0);
    let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
    let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 0)).unwrap();
    feed_all(&mut intake, &motion, 0..100);
    drop(armed.takes.mark("given up", 1).unwrap());
    let mark = armed.takes.mark("waited for", 2).unwrap();
    feed_all(&mut intake, &motion, 100..200);
    assert_eq!(mark.row.recv_timeout(SOON), Ok(100));
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_all(&mut intake, &motion, 200..201);
    let summary = Summary::read(&ended(&handle).1[..]).unwrap();
    let texts: Vec<_> = summary.take.events.iter().map(|event| event.text.as_str()).collect();
    assert_eq!(texts, ["waited for"]);
    drop(intake);
    pipeline.join().unwrap();
}

/// A device reports its drops from time to time: those reported after a take began may belong to the time before.
#[test]
fn drops_that_are_reported_late_contradict_nothing() {
    let status = |frames_produced, frames_dropped| Status {
        frames_produced,
        frames_dropped,
        ..Status::default()
    };
    let motion = jump(25, 100.0, 10.0);
    for (dropped, contradicts) in [(20, false), (25, false), (26, true)] {
        let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
        intake.status(status(0, 0), false);
        feed_all(&mut intake, &motion, (0..300).filter(|seq| !(100..120).contains(seq)));
        let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 300)).unwrap();
        feed_all(&mut intake, &motion, (300..600).filter(|seq| !(400..405).contains(seq)));
        handle.first.recv_timeout(SOON).unwrap();
        intake.status(status(600, dropped), true);
        intake.finish();
        let ledger = ended(&handle).0.ledger;
        assert_eq!((ledger.frames_sent, ledger.recorded), (300, 295));
        assert_eq!(ledger.closes(), !contradicts, "{ledger:?}");
        assert_eq!(ledger.contradictions.len(), usize::from(contradicts), "{ledger:?}");
        pipeline.join().unwrap();
    }
}

/// 300 frames, then a silence of 200, in which the take is stopped. During the silence the counter stands still,
/// continues, or continues with late frames; the device reports nothing meanwhile, or that it produced none.
#[test]
fn frames_due_in_a_silence_belong_to_the_take_that_ends_in_it() {
    let motion = jump(27, 100.0, 20.0);
    for (continues, accounted) in [(true, false), (false, false), (false, true)] {
        let (mut intake, pipeline, mut armed) = arm(&motion, PRE_ROLL);
        let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 0)).unwrap();
        feed_all(&mut intake, &motion, 0..300);
        intake.tick(arrival_ns(&motion, 400));
        if accounted {
            let (frames_produced, frames_dropped) = (300, 0);
            intake.status(Status { frames_produced, frames_dropped, ..Status::default() }, false);
        }
        armed.takes.end(EndingKind::Stopped).unwrap();
        intake.tick(arrival_ns(&motion, 500));
        let (written, take) = ended(&handle);
        let ledger = &written.ledger;
        let lost = if accounted { 99 } else { 200 };
        assert_eq!((ledger.recorded, ledger.unknown_after_disconnect), (300, lost), "{ledger:?}");
        assert!(ledger.closes() && ledger.lost_anything(), "{ledger:?}");
        let summary = Summary::read(&take[..]).unwrap();
        assert_eq!(
            (summary.take.problems.as_slice(), summary.contradictions()),
            (&[][..], &[][..])
        );
        let event = summary.take.events.last().unwrap();
        assert_eq!(event.kind, EventKind::Host);
        assert_mentions(&event.text, &["2.010 s"]);
        // The next take begins during the silence.
        let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 600)).unwrap();
        intake.tick(arrival_ns(&motion, 600));
        let resumed = if continues { 700 } else { 300 };
        feed_all(&mut intake, &motion, resumed..resumed + 100);
        let frames_produced = resumed as u64 + 100;
        intake.status(Status { frames_produced, ..Status::default() }, true);
        drop(intake);
        let (written, take) = ended(&handle);
        let ledger = &written.ledger;
        // Frames 500 to 700 are in no take: they are the loss of the take that was open then.
        let lost = if continues { 200 } else { 0 };
        assert_eq!((ledger.recorded, ledger.frames_lost()), (100, lost), "{ledger:?}");
        assert!(ledger.closes(), "{ledger:?}");
        let summary = Summary::read(&take[..]).unwrap();
        assert_eq!(
            (summary.take.problems.as_slice(), summary.contradictions()),
            (&[][..], &[][..])
        );
        pipeline.join().unwrap();
    }
}
