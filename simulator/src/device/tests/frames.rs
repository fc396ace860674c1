//! Which frames arrive, and when.

use super::*;

#[test]
fn every_frame_arrives_in_order_bit_for_bit() {
    let motion = jump(3.0);
    let settings = DeviceSettings { log_frames: true, ..DeviceSettings::default() };
    let mut bench = Bench::new(motion.clone(), settings);
    bench.send(Command::Identify);
    bench.pass(700 * MS, true);
    let Event::Hello(hello) = &bench.events[0] else { panic!("{:?}", bench.events) };
    assert_eq!((hello.rate_millihertz, hello.n_frames, hello.up_axis), (100_000, 300, 3));
    assert_eq!(bench.events[1], Event::Markers(15));
    assert_eq!(bench.events.len(), 2, "frames before Start");
    bench.send(start());
    bench.pass(10_000 * MS, true);
    let frames = bench.frames();
    assert_eq!(frames.len(), 300);
    for (k, (seq, ticks, samples)) in frames.iter().enumerate() {
        assert_eq!(*seq as usize, k);
        // 0.7 s after power-on, then every 10 ms, in ticks of 100 ns.
        assert_eq!(*ticks, 7_000_000 + 100_000 * k as u64);
        assert_eq!(row_of(samples), expected(&motion, k));
    }
    let all = Status { frames_produced: 300, frames_dropped: 0, temperature_c_100: i16::MIN };
    assert_eq!(bench.ends(), [all]);
    // Frames continue for 2.99 s: a Status after each whole second, produced as counted by then.
    let statuses: Vec<_> = bench.events.iter().filter(|h| matches!(h, Event::Status(_))).collect();
    assert_eq!(statuses.len(), 2, "{statuses:?}");
    let log = bench.device.log();
    let present = motion.positions_mm.iter().filter(|p| !is_gap(**p)).count() as u64;
    assert_eq!((log.total.samples, log.total.samples_occluded), (present, 300 * 15 - present));
    assert_eq!((log.frames_sent, log.frames.len()), (300, 300));
    assert!(log.frames.iter().all(|f| !f.dropped && f.run == 1));
    bench.assert_counts_add_up();
}

#[test]
fn a_host_that_does_not_read_loses_whole_frames_and_gets_their_number() {
    let settings =
        DeviceSettings { queue_bytes: Some(10_000), log_frames: true, ..Default::default() };
    let mut bench = Bench::new(jump(3.0), settings);
    bench.send(start());
    bench.pass(1_000 * MS, false);
    assert!(bench.device.pending().len() <= 10_000);
    bench.pass(10_000 * MS, true);
    let frames = bench.frames();
    let log = bench.device.log();
    let [end] = bench.ends()[..] else { panic!("{:?}", bench.ends()) };
    assert_eq!((end.frames_produced, end.frames_dropped), (300, log.total.frames_dropped));
    assert!(log.total.frames_dropped > 50, "{log:?}");
    assert_eq!(frames.len() as u64 + log.total.frames_dropped, 300);
    // The holes in seq are the frames that the log says were dropped.
    let sent: Vec<u32> = log.frames.iter().filter(|f| !f.dropped).map(|f| f.seq).collect();
    assert_eq!(frames.iter().map(|f| f.0).collect::<Vec<_>>(), sent);
    assert_eq!(frames.last().unwrap().0, 299);
    bench.assert_counts_add_up();
}

#[test]
fn speed_multiplies_the_rate_and_keeps_the_frames() {
    let motion = jump(2.0);
    let settings = DeviceSettings { speed: 10.0, ..DeviceSettings::default() };
    let mut bench = Bench::new(motion.clone(), settings);
    assert_eq!(bench.device.hello().rate_millihertz, 1_000_000);
    bench.send(start());
    bench.pass(198 * MS, true);
    assert!(bench.ends().is_empty());
    bench.pass(2 * MS, true);
    let frames = bench.frames();
    assert_eq!((frames.len(), bench.ends().len()), (200, 1));
    assert_eq!(frames[199].1 - frames[0].1, 1_990_000);
    assert!((0..200).all(|k| row_of(&frames[k].2) == expected(&motion, k)));
    // An odd speed still plays the recorded frames, not interpolated ones.
    let settings = DeviceSettings { speed: 1.0 / 3.0, ..DeviceSettings::default() };
    let mut bench = Bench::new(motion.clone(), settings);
    bench.send(start());
    bench.pass(20_000 * MS, true);
    let frames = bench.frames();
    assert!((0..200).all(|k| row_of(&frames[k].2) == expected(&motion, k)));
}

#[test]
fn a_loop_never_ends() {
    let motion = jump(0.3);
    let settings = DeviceSettings { looping: true, ..DeviceSettings::default() };
    let mut bench = Bench::new(motion.clone(), settings);
    assert_eq!(bench.device.hello().n_frames, 0);
    bench.send(start());
    bench.pass(995 * MS, true);
    let frames = bench.frames();
    assert_eq!(frames.len(), 100);
    for (k, (seq, ticks, samples)) in frames.iter().enumerate() {
        assert_eq!((*seq as usize, *ticks - frames[0].1), (k, 100_000 * k as u64));
        assert_eq!(row_of(samples), expected(&motion, k % 30));
    }
    assert!(bench.ends().is_empty());
}

#[test]
fn unlabelled_markers_are_listed_only_while_visible() {
    let mut motion = jump(1.0);
    motion.info.markers[3].labelled = false;
    motion.info.markers[4].label = "a\nb".to_owned();
    let mut bench = Bench::new(motion.clone(), DeviceSettings::default());
    assert_eq!(bench.device.warnings().len(), 1);
    bench.send(start());
    bench.pass(2_000 * MS, true);
    let mut vanished = 0;
    for (k, (_, _, samples)) in bench.frames().iter().enumerate() {
        let seen = !is_gap(motion.frame(k)[3]);
        assert_eq!(samples.iter().any(|s| s.id == 3), seen, "frame {k}");
        assert_eq!(samples.len(), 14 + usize::from(seen));
        vanished += usize::from(!seen);
    }
    assert!(vanished > 0);
}

#[test]
fn compact_frames_are_within_half_a_micrometre() {
    let motion = jump(1.0);
    let settings = DeviceSettings { form: FrameForm::Compact, ..DeviceSettings::default() };
    let mut bench = Bench::new(motion.clone(), settings);
    bench.send(start());
    bench.pass(2_000 * MS, true);
    for (k, (_, _, samples)) in bench.frames().iter().enumerate() {
        for (sample, truth) in samples.iter().zip(motion.frame(k)).filter(|(s, _)| !s.occluded) {
            for (sent, truth) in sample.position_mm.iter().zip(truth) {
                let off = (f64::from(*sent) - f64::from(*truth)).abs();
                assert!(off < 0.000_7, "{off}");
            }
        }
    }
    assert_eq!(bench.frames().len(), 100);
}

#[test]
fn residuals_are_those_of_the_nearest_recorded_frame_and_of_seen_markers_only() {
    let motion = jump(1.0);
    let residuals = Arc::new(crate::source::Residuals::generated(3, &motion));
    let n_reported = residuals.frame(0).iter().filter(|count| **count > 0).count();
    assert!(n_reported > 10 && residuals.frame(100).is_empty());
    for (rate_hz, per_frame) in [(None, 1.0), (Some(40.0), 2.5)] {
        let residuals = Some(Arc::clone(&residuals));
        let settings = DeviceSettings { rate_hz, residuals, ..DeviceSettings::default() };
        let recorded = settings.residuals.clone().unwrap();
        let mut bench = Bench::new(motion.clone(), settings);
        bench.send(start());
        bench.pass(2_000 * MS, true);
        let frames = bench.frames();
        assert_eq!(frames.len(), (99.0 / per_frame) as usize + 1);
        for (index, (_, _, samples)) in frames.iter().enumerate() {
            let sent = recorded.frame((index as f64 * per_frame).round() as u64);
            for sample in samples {
                let wanted = if sample.occluded { 0 } else { sent[usize::from(sample.id)] };
                assert_eq!(sample.residual_10um, wanted, "frame {index}");
            }
        }
    }
}
