//! Sampled channels: announced after the markers, sent in batches, ended with an empty one.

use std::sync::Arc;

use super::*;
use crate::{
    generator::ForcePlates,
    sampled::{BATCH_MS, SampledSource},
};

fn sources() -> Vec<SampledSource> {
    let plates = Arc::new(ForcePlates::new(&JumpSpec::new(8, 100.0)).unwrap());
    vec![
        SampledSource::plates(0, plates, 1000.0).unwrap(),
        SampledSource::electrodes(1, "3@2048Hz".parse().unwrap(), 5).unwrap(),
    ]
}

fn bench(settings: DeviceSettings) -> Bench {
    Bench::new(jump(1.0), DeviceSettings { sampled: sources(), ..settings })
}

/// The batches of a group, in the order of arrival.
fn batches(bench: &Bench, group: u8) -> Vec<SentSamples> {
    let of_group = |event: &Event| match event {
        Event::Samples(batch) if batch.group == group => Some(batch.clone()),
        _ => None,
    };
    bench.events.iter().filter_map(of_group).collect()
}

#[test]
fn every_sample_of_a_run_is_sent_once_in_order_and_counted_at_the_end() {
    let mut bench = bench(DeviceSettings::default());
    bench.send(Command::Identify);
    bench.send(start());
    bench.pass(2 * SECOND_NS, true);
    let groups = bench.events.iter().filter(|event| matches!(event, Event::Group(_)));
    assert_eq!(groups.count(), 2);
    let plates = bench.events.iter().filter_map(|event| match event {
        Event::Plate(plate) => Some((plate.number, plate.group, plate.channels.clone())),
        _ => None,
    });
    let expected = [(1, 0, (0..6).collect::<Vec<u8>>()), (2, 0, (6..12).collect())];
    assert_eq!(plates.collect::<Vec<_>>(), expected);
    for (group, source) in (0..).zip(sources()) {
        let (batches, n_channels) = (batches(&bench, group), source.info().channels.len());
        let mut received = Vec::new();
        for (number, batch) in (0..).zip(&batches) {
            assert_eq!(batch.number, number);
            assert_eq!(batch.first as usize * n_channels, received.len());
            let rate = f64::from(source.info().rate_millihertz) / 1000.0;
            let ticks = (batch.first as f64 / rate * TICK_HZ as f64) as u64;
            assert!(batch.ticks.abs_diff(ticks) <= 1, "{} {ticks}", batch.ticks);
            received.extend_from_slice(&batch.samples);
        }
        // From the first frame to the last, 0.99 s later.
        let n = received.len() / n_channels;
        let rate = source.info().rate_millihertz as usize / 1000;
        assert_eq!(n, rate * 99 / 100 + 1);
        let mut expected = Vec::new();
        source.samples(0, n as u64, &mut expected);
        assert_eq!(received, expected);
        assert!(batches.last().unwrap().samples.is_empty(), "the number of samples is stated");
        assert!(batches.len() as u64 <= 1000 / BATCH_MS + 5, "{}", batches.len());
    }
    let place = |of: fn(&Event) -> bool| bench.events.iter().rposition(of).unwrap();
    assert!(
        place(|event| matches!(event, Event::Samples(_))) < place(|e| matches!(e, Event::End(_)))
    );
}

#[test]
fn a_device_that_is_called_late_has_sampled_as_much_as_one_in_time() {
    let sent = |step_ns: u64| {
        let mut bench = bench(DeviceSettings { queue_bytes: Some(1 << 20), ..Default::default() });
        bench.send(start());
        for _ in 0..(2 * SECOND_NS).div_ceil(step_ns) {
            bench.now_ns += step_ns;
            bench.device.poll(bench.now_ns);
            bench.read();
        }
        [0, 1].map(|group| batches(&bench, group))
    };
    let in_time = sent(MS / 10);
    assert_eq!(in_time[0].iter().map(|batch| batch.samples.len()).sum::<usize>(), 991 * 12);
    for late_ns in [3 * MS, 17 * MS, 2 * SECOND_NS] {
        let late = sent(late_ns);
        assert!(late == in_time, "polled every {late_ns} ns");
    }
}

#[test]
fn numbers_continue_from_run_to_run_and_begin_again_after_a_loss_of_power() {
    let mut bench = bench(DeviceSettings::default());
    for run in 0..3 {
        if run == 2 {
            bench.device.lose_power();
            bench.device.power_up(bench.now_ns, true);
        }
        bench.send(start());
        bench.pass(SECOND_NS / 5, true);
        bench.send(Command::Stop);
        bench.read();
    }
    let batches = batches(&bench, 0);
    let firsts: Vec<u64> = batches.iter().map(|batch| batch.first).collect();
    let restart = firsts.iter().rposition(|&first| first == 0).unwrap();
    assert!(restart > 30);
    assert!(firsts[..restart].is_sorted() && firsts[restart..].is_sorted());
    assert_eq!(batches[restart].number, 0);
}

#[test]
fn a_full_queue_drops_whole_batches_whose_numbers_are_not_used() {
    let settings = DeviceSettings { queue_bytes: Some(20_000), ..DeviceSettings::default() };
    let mut bench = bench(settings);
    bench.device.keep_frame_log();
    bench.send(start());
    bench.pass(SECOND_NS * 2 / 5, false);
    bench.pass(SECOND_NS, true);
    let (log, logged) = (bench.device.log(), bench.device.take_batches());
    assert!(log.batches_dropped > 10, "{log:?}");
    let received = batches(&bench, 0);
    assert!((0..).zip(&received).all(|(number, batch)| batch.number == number));
    let kept = logged.iter().filter(|batch| batch.group == 0 && !batch.dropped);
    let kept: Vec<u64> = kept.map(|batch| batch.first).collect();
    assert_eq!(kept, received.iter().map(|batch| batch.first).collect::<Vec<_>>());
}

#[test]
fn the_budget_of_start_includes_the_batches() {
    let budget = |sampled| {
        let settings = DeviceSettings { sampled, ..DeviceSettings::default() };
        let mut bench = Bench::new(jump(0.1), settings);
        bench.send(start());
        bench.read();
        let started = |event: &Event| match event {
            Event::Started(budget) => Some(budget.needed_bytes_per_s),
            _ => None,
        };
        bench.events.iter().find_map(started).unwrap()
    };
    let more = budget(sources()) - budget(Vec::new());
    // 12 channels at 1 kHz and 3 at 2048 Hz, of two bytes, in 100 messages a second each.
    let samples = 2 * (12 * 1000 + 3 * 2048);
    assert!((samples + 2 * 100 * 30..samples + 2 * 103 * 40).contains(&more), "{more}");
}
