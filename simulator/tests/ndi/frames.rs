//! Every frame arrives once and unchanged.

use mocapd_drivers::device::{Command, PoseStatus, Protocol};
use mocapd_drivers::ndi::crc16;
use mocapd_drivers::transport::polled::Request;
use mocapd_simulator::device::LineDevice;
use mocapd_simulator::ndi::NdiSettings;

use super::bench::{Bench, MS, assert_is_row, jump, settings};

#[test]
fn every_frame_arrives_once_and_unchanged() {
    let lines = [(true, 60.0, 53), (false, 60.0, 53), (true, 250.0, 15), (true, 59.94, 20)];
    for (bx2, rate_hz, n_markers) in lines {
        let motion = jump(n_markers, rate_hz, 4.0);
        let labels: Vec<_> =
            [0, 7, 9].map(|column| motion.info.markers[column].label.clone()).into();
        let named: Vec<_> = labels.iter().map(String::as_str).collect();
        let mut bench = Bench::new(motion.clone(), settings(&named, bx2), 1_228_739);
        bench.identify();
        assert_eq!(bench.markers.len(), 3);
        bench.start();
        bench.run_until(|bench| bench.end.is_some());
        let n_frames = motion.n_frames();
        assert_eq!(bench.frames.len(), n_frames, "{bx2} {rate_hz}");
        let sent = bench.device.take_frames();
        assert_eq!(bench.device.log().total.frames_dropped, 0);
        assert_eq!(bench.device.log().frames_sent, n_frames as u64);
        let tools = [(1, 0), (2, 7), (3, 9)];
        for (index, (received, sent)) in bench.frames.iter().zip(&sent).enumerate() {
            assert_eq!((received.seq, sent.seq), (index as u32, index as u32));
            assert_is_row(received, motion.frame(index), &tools);
            let present = received.markers.iter().filter(|sample| !sample.occluded).count();
            assert_eq!(present, sent.present as usize);
            let ticks = if bx2 { sent.device_ticks } else { index as u64 * 1000 };
            assert_eq!(received.ticks, ticks);
            // The tools are bodies, too; the simulated system does not turn them.
            let (seq, ticks, poses) = &bench.poses[index];
            assert_eq!((*seq, *ticks), (received.seq, received.ticks));
            for (pose, marker) in poses.iter().zip(&received.markers) {
                let is_tracked = pose.status == PoseStatus::Tracked;
                assert_eq!((pose.body, is_tracked), (marker.id, !marker.occluded));
                let found = (pose.position_mm, pose.quaternion);
                assert!(!is_tracked || found == (marker.position_mm, [1.0, 0.0, 0.0, 0.0]));
            }
        }
        assert!(bench.bodies.iter().map(|body| &body.name).eq(&labels));
        assert_eq!(bench.poses.len(), n_frames);
        assert_eq!(bench.end.unwrap().frames_produced, n_frames as u64);
        let counters = bench.host.counters();
        assert_eq!((counters.messages_damaged, counters.bytes_skipped), (0, 0));
        let polls = bench.requests_as_text().iter().filter(|text| text.starts_with("BX")).count();
        assert!(polls < 2 * n_frames, "{polls} polls for {n_frames} frames");
    }
}

#[test]
fn a_stop_ends_it_and_a_start_begins_again() {
    let settings = NdiSettings { looping: true, ..settings(&["head"], true) };
    let mut bench = Bench::new(jump(10, 60.0, 1.0), settings, 115_200);
    bench.identify();
    for run in 1..=3 {
        bench.start();
        bench.run_for(3_000 * MS);
        let farewell: Vec<_> = bench.farewell.iter().map(Request::as_bytes).collect();
        assert_eq!(farewell, [&b"TSTOP:2C14\r"[..], b"COMM:000000084\r"]);
        bench.send(Command::Stop);
        bench.run_until(|bench| bench.end.is_some());
        let n_frames = bench.end.take().unwrap().frames_produced;
        assert_eq!(bench.frames.len() as u64, n_frames);
        assert!((175..200).contains(&n_frames), "{n_frames}");
        assert!(bench.frames.is_sorted_by(|a, b| b.seq == a.seq + 1));
        assert!(bench.frames.is_sorted_by(|a, b| b.ticks > a.ticks));
        bench.frames.clear();
        assert!(!bench.device.is_running() && bench.device.log().starts == run);
        bench.read();
        assert_eq!(bench.farewell.len(), 1);
    }
}

#[test]
fn an_unfetched_frame_is_missing_and_the_device_counts_it() {
    let settings = NdiSettings { looping: true, ..settings(&["head"], true) };
    let mut bench = Bench::new(jump(10, 60.0, 1.0), settings, 921_600);
    bench.identify();
    bench.start();
    bench.run_for(500 * MS);
    // The host is busy with something else.
    bench.now_ns += 100 * MS;
    bench.run_for(500 * MS);
    bench.send(Command::Stop);
    bench.run_until(|bench| bench.end.is_some());
    let sent = bench.device.take_frames();
    let dropped: Vec<_> = sent.iter().filter(|frame| frame.dropped).map(|f| f.seq).collect();
    assert!((5..=7).contains(&dropped.len()), "{dropped:?}");
    let received: Vec<_> = bench.frames.iter().map(|frame| frame.seq).collect();
    let fetched: Vec<_> =
        sent.iter().filter(|frame| !frame.dropped && !frame.unasked).map(|f| f.seq).collect();
    assert_eq!(received, fetched);
    let produced = bench.end.unwrap().frames_produced;
    assert_eq!(produced, received.len() as u64 + dropped.len() as u64);
    assert_eq!(bench.end.unwrap().frames_dropped, dropped.len() as u64);
    // Reported as soon as known, not only at the end.
    assert_eq!(bench.status.unwrap().frames_dropped, dropped.len() as u64);
    let log = bench.device.log();
    assert_eq!(log.run.frames_produced, produced + log.run.frames_unasked);
}

#[test]
fn a_reset_device_is_set_up_again_and_reported_as_restarted() {
    for has_break in [true, false] {
        let settings = NdiSettings { looping: true, ..settings(&["head"], true) };
        let mut bench = Bench::new(jump(10, 60.0, 1.0), settings, 921_600);
        bench.has_break = has_break;
        bench.identify();
        bench.start();
        bench.run_for(500 * MS);
        bench.device.on_break(bench.now_ns);
        let at_ns = bench.now_ns;
        bench.run_until(|bench| bench.hellos.len() == 2);
        assert!(bench.now_ns - at_ns < 4_000 * MS, "{} ns", bench.now_ns - at_ns);
        let before = bench.frames.len();
        bench.start();
        bench.run_for(500 * MS);
        assert!(bench.frames.len() > before + 25);
        assert!(bench.end.is_none() && bench.failed.is_none());
        // It was started again: produced frames count from there.
        bench.send(Command::Stop);
        bench.run_until(|bench| bench.end.is_some());
        let (first, last) = (bench.frames[before].seq, bench.frames.last().unwrap().seq);
        assert_eq!(bench.end.unwrap().frames_produced, u64::from(last - first + 1));
    }
}

#[test]
fn damaged_requests_are_repeated() {
    // A device that answers every fifth request of any kind with ERROR04.
    let settings = NdiSettings { looping: true, ..settings(&["head", "throat"], true) };
    let mut bench = Bench::new(jump(10, 60.0, 1.0), settings, 921_600);
    let mut n_answers = 0;
    bench.damage = Box::new(move |answer| {
        n_answers += 1;
        if n_answers % 5 == 0 {
            *answer = format!("ERROR04{:04X}\r", crc16(b"ERROR04")).into_bytes();
        }
    });
    bench.identify();
    bench.start();
    bench.run_for(2_000 * MS);
    assert!(bench.failed.is_none() && bench.hellos.len() == 1);
    assert!(bench.frames.len() > 70, "{}", bench.frames.len());
    assert_eq!(bench.host.counters().messages_damaged, 0);
}
