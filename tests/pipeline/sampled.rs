//! Sampled channels beside the frames: every sample is in the take bit for bit, or counted as lost, and no frame is
//! lost or late because of them.

use std::{io::Cursor, time::Duration};

use mocapd_acquire::{
    inspect::{Summary, Verdict},
    pipeline::{Intake, Pipeline, PipelineConfig},
};
use mocapd_drivers::device::{SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo};
use mocapd_take::{
    TakeMap,
    chunk::{self, ChunkParse, types},
    motion::Motion,
    record::EndingKind,
    recovery::RecoveryScan,
    timeline::LossCauses,
};

use super::{
    poses::assert_clean,
    takes::{PRE_ROLL, ended, feed_all, header, new_take},
};
use crate::support::{TICK_HZ, config, crowd, dense, feed, jump, places, start};

/// Samples of a channel in a batch: 10 ms at 2 kHz.
const BATCH: u64 = 20;
const RATE_HZ: f64 = 2000.0;
const TICKS_EACH: u64 = TICK_HZ / 2000;

fn groups() -> Vec<SampledGroupInfo> {
    let channel = |name: &str| SampledChannelInfo {
        name: name.to_owned(),
        unit: "N".to_owned(),
        scale: 0.25,
        offset: 0.0,
    };
    let group = |id, form, n: usize| SampledGroupInfo {
        id,
        form,
        rate_millihertz: 2_000_000,
        channels: (0..n).map(|i| channel(&format!("F{id}.{i}"))).collect(),
    };
    vec![group(3, SampleForm::Int16, 6), group(9, SampleForm::Float32, 2)]
}

/// Sample `number` of a channel: any bits of float32 in the second group.
fn value(group: &SampledGroupInfo, number: u64, channel: u64) -> f32 {
    let noise = (number * 7919 + channel * 104_729).wrapping_mul(2_654_435_761) >> 16;
    match group.form {
        SampleForm::Float32 if number.is_multiple_of(50) => f32::from_bits(noise as u32),
        SampleForm::Float32 => (number as f32 * 0.01).sin() + noise as u8 as f32 * 1e-3,
        _ => f32::from((number * (channel + 1) / 3) as u8) + f32::from(noise as u8 & 7),
    }
}

/// Batch `number` of a group, with its samples from `number * BATCH` on.
fn send(intake: &mut Intake, group: &SampledGroupInfo, number: u32, first: u64) {
    send_at(intake, group, number, first, 1_000 + first * TICKS_EACH);
}

fn send_at(intake: &mut Intake, group: &SampledGroupInfo, number: u32, first: u64, ticks: u64) {
    let n_channels = group.channels.len() as u64;
    let rows = first..first + BATCH;
    let samples: Vec<f32> = rows
        .flat_map(|row| (0..n_channels).map(move |c| (row, c)))
        .map(|(r, c)| value(group, r, c))
        .collect();
    intake.samples(&SampleBatch {
        group: group.id,
        number,
        first,
        device_ticks: ticks,
        form: group.form,
        n_channels: n_channels as u8,
        samples: &samples,
    });
}

/// Feeds frames with the batches whose last sample comes before each; `is_sent` selects the batches, by group and number.
fn feed_both(
    intake: &mut Intake,
    motion: &Motion,
    seqs: std::ops::Range<usize>,
    is_sent: impl Fn(&SampledGroupInfo, u64) -> bool,
) {
    let at = |seq: usize| (seq as f64 / motion.info.rate_hz * RATE_HZ / BATCH as f64) as u64;
    for seq in seqs {
        feed_all(intake, motion, [seq]);
        for number in at(seq)..at(seq + 1) {
            for group in &groups() {
                if is_sent(group, number) {
                    send(intake, group, number as u32, number * BATCH);
                }
            }
        }
    }
}

fn with_groups(motion: &Motion) -> PipelineConfig {
    PipelineConfig { sampled: groups(), ..config(motion, dense(1.0)) }
}

/// The samples of a group of a take: number, and channel after channel; lost ones are left out.
fn read(take: &[u8], group: usize) -> (Vec<(u64, Vec<f32>)>, TakeMap) {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let found = map.recorded_groups().nth(group).unwrap().clone();
    let mut samples = Vec::new();
    let undecodable = found
        .read(&mut Cursor::new(take), |first, n, decoded| {
            for row in 0..decoded.map_or(0, |_| n) {
                let columns = decoded.unwrap().chunks_exact(n as usize);
                samples.push((first + row, columns.map(|column| column[row as usize]).collect()));
            }
            Ok(())
        })
        .unwrap();
    assert_eq!(undecodable, []);
    (samples, map)
}

/// Asserts that the samples are those of the device from number `from` on, at their times.
#[track_caller]
fn assert_true(take: &[u8], group: usize, from: u64) -> usize {
    let (n, n_untimed) = assert_true_if_timed(take, group, from);
    assert_eq!(n_untimed, 0);
    n
}

/// The same where some times may be lost. Returns the numbers of samples, and of those without a time.
#[track_caller]
fn assert_true_if_timed(take: &[u8], group: usize, from: u64) -> (usize, usize) {
    let (samples, map) = read(take, group);
    let info = &groups()[group];
    let found = map.recorded_groups().nth(group).unwrap();
    let (clock, mut n_untimed) = (found.clock(TICK_HZ), 0);
    for (number, values) in &samples {
        let sent = number + from;
        for (channel, got) in (0..).zip(values) {
            assert_eq!(got.to_bits(), value(info, sent, channel).to_bits(), "sample {sent}");
        }
        let Some(time) = clock.at(*number) else {
            n_untimed += 1;
            continue;
        };
        let ticks = time.device_ticks as f64 + time.fraction;
        assert!((ticks - (1_000 + sent * TICKS_EACH) as f64).abs() < 0.01, "{sent}: {time:?}");
    }
    (samples.len(), n_untimed)
}

#[test]
fn every_sample_is_in_the_take_bit_for_bit_with_its_time() {
    let motion = crowd(1, 200.0, 12.0);
    let (mut intake, pipeline) = start(&with_groups(&motion), Vec::new());
    feed_both(&mut intake, &motion, 0..2400, |_, _| true);
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert_eq!(written.ledger.recorded, 2400);
    for (group, ledger) in assert_clean(&take).iter().enumerate() {
        assert_eq!(assert_true(&take, group, 0), 24_000);
        assert_eq!((ledger.taken, ledger.stored, ledger.lost()), (24_000, 24_000, 0));
        assert_eq!((ledger.duplicates, ledger.jumps), (0, 0));
    }
    assert_eq!(written.sample_ledger.unwrap().groups.len(), 2);
}

#[test]
fn losses_are_stated_with_their_causes_and_duplicates_change_nothing() {
    let motion = jump(2, 200.0, 6.0);
    let (mut intake, pipeline) = start(&with_groups(&motion), Vec::new());
    let info = groups();
    let mut number_sent = 0;
    for seq in 0..1200_u64 {
        feed_all(&mut intake, &motion, [seq as usize]);
        if seq % 2 == 1 {
            continue;
        }
        let number = seq / 2;
        let first = number * BATCH;
        match number {
            // The device dropped these: their numbers are not used.
            100..110 => continue,
            // These were lost on the link.
            200..203 => {}
            300 => {
                for _ in 0..3 {
                    send(&mut intake, &info[0], number_sent, first);
                }
                send(&mut intake, &info[0], number_sent - 2, first - 2 * BATCH);
            }
            _ => send(&mut intake, &info[0], number_sent, first),
        }
        number_sent += 1;
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let ledger = assert_clean(&take)[0];
    assert_eq!(assert_true(&take, 0, 0), (600 - 13) * 20);
    assert_eq!(ledger.taken, 600 * 20);
    assert_eq!((ledger.dropped_by_device, ledger.lost_on_link), (200, 60));
    assert_eq!((ledger.duplicates, ledger.jumps), (60, 0));
    let (_, map) = read(&take, 0);
    let lost = map.recorded_groups().next().unwrap().lost();
    let lost: Vec<_> = lost.iter().map(|lost| (lost.first, lost.n, lost.causes.unwrap())).collect();
    let expected =
        [(2000, 200, LossCauses::DROPPED_BY_DEVICE), (4000, 60, LossCauses::NOT_RECEIVED)];
    assert_eq!(lost, expected);
}

/// Numbers and clock of the device begin again, twice; then only its clock jumps.
#[test]
fn a_device_that_starts_again_begins_a_run_with_times_of_its_own() {
    let motion = jump(3, 200.0, 4.0);
    let (mut intake, pipeline) = start(&with_groups(&motion), Vec::new());
    let group = &groups()[0];
    let mut expected = Vec::new();
    for seq in 0..800_u64 {
        feed_all(&mut intake, &motion, [seq as usize]);
        if seq % 2 == 0 {
            let batch = seq / 2 % 100;
            if seq == 200 {
                intake.rejoin();
            }
            let (first, by) = match seq / 200 {
                3 => (batch * BATCH + 2000, 77_000_000),
                _ => (batch * BATCH, 0),
            };
            let ticks = 1_000 + by + first * TICKS_EACH;
            send_at(&mut intake, group, (first / BATCH) as u32, first, ticks);
            expected.push((first, ticks));
        }
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let ledger = assert_clean(&take)[0];
    assert_eq!((ledger.stored, ledger.lost(), ledger.jumps), (8000, 0, 2));
    let (samples, map) = read(&take, 0);
    let found = map.recorded_groups().next().unwrap();
    let clock = found.clock(TICK_HZ);
    let mut runs: Vec<u64> = found.anchors().iter().map(|anchor| anchor.run_start).collect();
    runs.dedup();
    assert_eq!(runs, [0, 2000, 4000, 6000]);
    for (at, (first, ticks)) in (0..).step_by(20).zip(expected) {
        assert_eq!(samples[at as usize].1[0], value(group, first, 0), "sample {at}");
        let time = clock.at(at).unwrap();
        let off = time.device_ticks.abs_diff(ticks);
        assert!(off <= 1, "sample {at}: {time:?} is not {ticks}");
    }
}

#[test]
fn groups_that_contradict_their_announcement_are_refused_and_reported_in_bounds() {
    let motion = jump(4, 200.0, 2.0);
    let (mut intake, pipeline) = start(&with_groups(&motion), Vec::new());
    let info = groups();
    for seq in 0..400 {
        feed_all(&mut intake, &motion, [seq]);
        let mut other = info[0].clone();
        match seq {
            // Endless announcements of other groups, and of known ones.
            ..100 => {
                other.id = seq as u8;
                other.channels[0].name = format!("a{seq}");
                intake.announce_group(&other);
                intake.announce_group(&info[0]);
                intake.announce_group(&info[1]);
            }
            // The same number of channels, under other names: not stored under the old ones.
            100 => {
                other.channels[0].scale = 77.0;
                intake.announce_group(&other);
            }
            200 => intake.announce_group(&info[0]),
            _ => {}
        }
        let number = seq as u64;
        send(&mut intake, &info[0], number as u32, number * BATCH);
        // Of another shape, and of no group.
        let wrong = SampledGroupInfo { channels: info[1].channels.clone(), ..info[0].clone() };
        send(&mut intake, &wrong, number as u32, number * BATCH);
        send(&mut intake, &SampledGroupInfo { id: 200, ..info[0].clone() }, 0, 0);
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert_eq!(written.ledger.recorded, 400);
    let ledger = assert_clean(&take)[0];
    assert_true(&take, 0, 0);
    assert_eq!((ledger.stored, ledger.lost_other, ledger.lost()), (300 * 20, 100 * 20, 100 * 20));
    let (_, map) = read(&take, 0);
    assert_eq!(map.sample_ledger.unwrap().batches_refused, 2 * 400 + 100);
    let texts = map.events.iter().filter(|event| event.text.contains("sampled channels"));
    assert_eq!(texts.count(), 32, "a device cannot fill the take with events");
}

#[test]
fn more_samples_than_can_be_encoded_are_dropped_in_whole_batches_and_no_frame_is() {
    let motion = jump(5, 200.0, 3.0);
    let mut config = with_groups(&motion);
    config.sampled[0].rate_millihertz = 60_000_000;
    config.sampled[0].channels = vec![config.sampled[0].channels[0].clone(); 64];
    let group = config.sampled[0].clone();
    let (mut intake, pipeline) = start(&config, Vec::new());
    // Minutes of samples in a second of frames: far more than a processor encodes in the time of the test.
    let samples: Vec<f32> = (0..256 * 64).map(|i| f32::from((i * 7919 % 251) as u8)).collect();
    let mut first = 0_u64;
    // The rings of the frames have room for all of them.
    for seq in 0..40 {
        feed(&mut intake, &motion, seq);
        for _ in 0..200 {
            intake.samples(&SampleBatch {
                group: group.id,
                number: (first / 256) as u32,
                first,
                device_ticks: first * TICK_HZ / 60_000,
                form: group.form,
                n_channels: 64,
                samples: &samples,
            });
            first += 256;
        }
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert_eq!(written.ledger.recorded, 40);
    assert_eq!(written.ledger.frames_lost(), 0);
    assert!(written.ledger.closes(), "{:?}", written.ledger);
    let ledger = assert_clean(&take)[0];
    assert_eq!(ledger.taken, first);
    assert!(ledger.lost_ring_full > first / 4, "{ledger:?}");
    assert_eq!((ledger.lost(), ledger.stored % 256), (ledger.lost_ring_full, 0));
    let (kept, _) = read(&take, 0);
    assert_eq!(kept.len() as u64, ledger.stored);
    let is_true = |(number, values): &(u64, Vec<f32>)| {
        let at = (number % 256) as usize * 64;
        values[..] == samples[at..at + 64]
    };
    assert!(kept.iter().all(is_true));
}

#[test]
fn takes_have_the_samples_between_their_boundaries() {
    let motion = crowd(6, 200.0, 20.0);
    let mut config = with_groups(&motion);
    config.pre_roll = Some(PRE_ROLL);
    let (mut intake, pipeline, mut armed) = Pipeline::arm(&config, &header(&motion)).unwrap();
    let all = |_: &SampledGroupInfo, _: u64| true;
    feed_both(&mut intake, &motion, 0..400, all);
    // At the next frame.
    let handle = armed.takes.begin(new_take(&motion, Duration::ZERO, 400)).unwrap();
    feed_both(&mut intake, &motion, 400..1000, all);
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_both(&mut intake, &motion, 1000..1500, all);
    let (_, take) = ended(&handle);
    for (group, ledger) in assert_clean(&take).iter().enumerate() {
        assert_eq!(assert_true(&take, group, 4000), 6000);
        assert_eq!((ledger.taken, ledger.lost()), (6000, 0));
    }
    // With a pre-roll of two seconds, and saved from it.
    let handle = armed.takes.begin(new_take(&motion, Duration::from_secs(2), 1500)).unwrap();
    feed_both(&mut intake, &motion, 1500..1800, all);
    let saved = armed.takes.save(new_take(&motion, Duration::from_secs(60), 1800)).unwrap();
    feed_both(&mut intake, &motion, 1800..2000, all);
    armed.takes.end(EndingKind::Stopped).unwrap();
    feed_both(&mut intake, &motion, 2000..2001, all);
    for (handle, end) in [(handle, 2000), (saved, 1800)] {
        let (written, take) = ended(&handle);
        let first = end - written.ledger.recorded;
        for (group, ledger) in assert_clean(&take).iter().enumerate() {
            assert_eq!(
                assert_true(&take, group, first * 10),
                10 * written.ledger.recorded as usize
            );
            assert_eq!((ledger.taken, ledger.lost()), (written.ledger.recorded * 10, 0));
        }
        assert!(written.ledger.recorded >= 700, "{}", written.ledger.recorded);
    }
    drop(intake);
    pipeline.join().unwrap();
}

#[test]
fn a_take_that_is_cut_off_anywhere_has_true_samples_and_can_be_recovered() {
    let motion = jump(7, 100.0, 0.7);
    let mut config = with_groups(&motion);
    config.sampled.truncate(1);
    config.sampled[0].channels.truncate(2);
    let (mut intake, pipeline) = start(&config, Vec::new());
    for seq in 0..70 {
        feed(&mut intake, &motion, seq);
        if seq != 50 {
            send(&mut intake, &config.sampled[0], seq as u32, seq as u64 * BATCH);
        }
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let whole = assert_true(&take, 0, 0);
    let (mut longest, mut n_known) = (0, 0);
    for cut in 0..take.len() {
        let part = &take[..cut];
        let Ok(map) = TakeMap::scan(&mut Cursor::new(part)) else { continue };
        if map.recorded_groups().next().is_none() {
            continue;
        }
        n_known += 1;
        let n = assert_true(part, 0, 0);
        assert!(n >= longest, "{cut}: what was readable stays so");
        longest = n;
        let scan = RecoveryScan::read(part).unwrap();
        let mut recovered = Vec::new();
        scan.write(Cursor::new(part), &mut recovered, "test").unwrap();
        assert_eq!(assert_true(&recovered, 0, 0), n, "{cut}");
        let ledger = assert_clean(&recovered)[0];
        assert_eq!(ledger.stored, n as u64);
    }
    assert!(n_known > take.len() / 2 && longest == whole);
}

/// One bit of every byte is inverted: no sample and no time is wrong, in the take and in the recovered one.
#[test]
fn a_damaged_take_has_no_wrong_samples() {
    let motion = jump(8, 100.0, 0.4);
    let mut config = with_groups(&motion);
    config.sampled.truncate(1);
    config.sampled[0].channels.truncate(2);
    let (mut intake, pipeline) = start(&config, Vec::new());
    for seq in 0..40 {
        feed(&mut intake, &motion, seq);
        send(&mut intake, &config.sampled[0], seq as u32, seq as u64 * BATCH);
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let places = places(&take);
    let header = places[0].1.end;
    let last = places.iter().rfind(|(kind, _)| *kind == types::SAMPLE_LEDGER);
    let last_ledger = last.unwrap().1.clone();
    let times: Vec<_> = places
        .iter()
        .filter(|place| place.0 == types::SAMPLE_TIMES)
        .map(|place| &place.1)
        .collect();
    for at in header..take.len() {
        let mut damaged = take.clone();
        damaged[at] ^= 1 << (at % 8);
        let map = TakeMap::scan(&mut Cursor::new(&damaged)).unwrap();
        let scan = RecoveryScan::read(&damaged[..]).unwrap();
        let mut recovered = Vec::new();
        scan.write(Cursor::new(&damaged), &mut recovered, "test").unwrap();
        let ledger = assert_clean(&recovered)[0];
        // Every sample is still known to have been taken, unless no other ledger states the last of them.
        let is_stated = !last_ledger.contains(&at);
        assert!(ledger.taken == 800 || !is_stated, "byte {at}: {ledger:?}");
        let mut n = 0;
        if map.recorded_groups().next().is_some() {
            let n_untimed;
            (n, n_untimed) = assert_true_if_timed(&damaged, 0, 0);
            assert_eq!(assert_true_if_timed(&recovered, 0, 0), (n, n_untimed), "byte {at}");
            assert!(n_untimed == 0 || times.iter().any(|times| times.contains(&at)), "byte {at}");
        }
        assert_eq!(ledger.stored, n as u64, "byte {at}");
        assert_eq!(ledger.lost_other, ledger.taken - n as u64, "byte {at}");
    }
}

#[test]
fn parts_have_their_samples_and_joined_again_they_are_those_of_the_take() {
    use mocapd_take::edit::{EditContext, SourceTake, check_repacked, concat, cut, repack};
    let motion = crowd(9, 200.0, 12.0);
    let (mut intake, pipeline) = start(&with_groups(&motion), Vec::new());
    feed_both(&mut intake, &motion, 0..2400, |group, number| {
        group.id == 9 || !(300..310).contains(&number)
    });
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    assert_clean(&take);
    let new_scratch = || Err(std::io::ErrorKind::Unsupported.into());
    let context = EditContext { software: "test", new_scratch: &new_scratch, on_rows: &|_| () };
    let source = |take: &[u8]| SourceTake::read(&mut Cursor::new(take)).unwrap();
    let cut_to = |rows: std::ops::Range<u64>| {
        let mut part = Vec::new();
        let report = cut(&source(&take), Cursor::new(&take), rows, &mut part, &context).unwrap();
        assert_eq!(report.left_out, [""; 0]);
        part
    };
    let parts = [cut_to(0..777), cut_to(777..778), cut_to(778..2400)];
    let mut next = [0; 2];
    for part in &parts {
        for (group, ledger) in assert_clean(part).iter().enumerate() {
            // Frame 777 was taken at 3.885 s, which is sample 7770 less the millisecond by which sample 0 came later.
            assert_true(part, group, next[group]);
            next[group] += ledger.taken;
        }
    }
    assert_eq!(next, [24_000; 2]);
    let first = assert_clean(&parts[0])[0];
    assert_eq!((first.taken, first.lost_on_link), (7768, 200));
    assert_eq!(assert_clean(&parts[1])[1].taken, 10);
    let sources: Vec<SourceTake> = parts.iter().map(|part| source(part)).collect();
    let mut joined = Vec::new();
    let open = |i: usize| Ok(Cursor::new(parts[i].clone()));
    let report = concat(&sources, open, &mut joined, &context).unwrap();
    assert_eq!(report.left_out, [""; 0]);
    let mut repacked = Vec::new();
    repack(&source(&take), Cursor::new(&take), None, &mut repacked, &context).unwrap();
    let checked =
        check_repacked(&source(&take), Cursor::new(&take), Cursor::new(&repacked), None, &context);
    assert_eq!(checked.unwrap(), None);
    for other in [&joined, &repacked] {
        assert_clean(other);
        for group in 0..2 {
            assert_eq!(assert_true(other, group, 0), [23_800, 24_000][group]);
        }
        let differing = recorded_difference(&take, other);
        assert_eq!(differing, [""; 0]);
    }
    // Two groups, and the ledger.
    assert_eq!(recorded_difference(&take, &parts[0]).len(), 3);
    // So is a batch that one of them lacks.
    assert_eq!(recorded_difference(&take, &one_batch_less(&motion)).len(), 2);
}

/// The same recording without one batch of the second group.
fn one_batch_less(motion: &Motion) -> Vec<u8> {
    let (mut intake, pipeline) = start(&with_groups(motion), Vec::new());
    feed_both(&mut intake, motion, 0..2400, |group, number| {
        group.id == 9 && number != 700 || group.id == 3 && !(300..310).contains(&number)
    });
    intake.finish();
    pipeline.finish().unwrap().1
}

fn recorded_difference(a: &[u8], b: &[u8]) -> Vec<String> {
    let map = |take: &[u8]| TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let (one, other) = (map(a), map(b));
    let found = mocapd_take::compare::compare_recorded(
        (&one, &mut Cursor::new(a)),
        (&other, &mut Cursor::new(b)),
    );
    found.unwrap().into_iter().map(|difference| difference.b.unwrap_or_default()).collect()
}

/// Stretches longer than the ring: blocks end before it is full.
#[test]
fn long_stretches_lose_no_samples() {
    let motion = jump(10, 200.0, 25.0);
    let mut config = with_groups(&motion);
    config.stretch = Duration::from_secs(10);
    let (mut intake, pipeline) = start(&config, Vec::new());
    feed_both(&mut intake, &motion, 0..5000, |_, _| true);
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    for (group, ledger) in assert_clean(&take).iter().enumerate() {
        assert_eq!((assert_true(&take, group, 0), ledger.lost()), (50_000, 0));
    }
}

/// A camera that waits for its trigger while the plates run: four seconds of real time.
#[test]
fn samples_without_frames_are_recorded_and_synced() {
    let motion = jump(11, 200.0, 1.0);
    let (mut intake, pipeline) = start(&with_groups(&motion), Vec::new());
    feed_both(&mut intake, &motion, 0..20, |_, _| true);
    let group = &groups()[0];
    // 40 s of samples in four: the ring has room for less than a tenth of them.
    for number in 10..4000_u64 {
        send(&mut intake, group, number as u32, number * BATCH);
        intake.tick(5_000_000 + number * 10_000_000);
        if number.is_multiple_of(10) {
            std::thread::sleep(Duration::from_millis(10));
        }
    }
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let ledger = assert_clean(&take)[0];
    assert_eq!((assert_true(&take, 0, 0), ledger.lost()), (80_000, 0));
}

/// What only the ledger knows of lost samples: how many there were at the end, and a group without its description.
#[test]
fn a_recovered_take_says_what_is_lost_at_the_end_and_with_a_description() {
    let motion = jump(12, 200.0, 2.0);
    let (mut intake, pipeline) = start(&with_groups(&motion), Vec::new());
    feed_both(&mut intake, &motion, 0..400, |_, _| true);
    intake.finish();
    let (_, take) = pipeline.finish().unwrap();
    let places = places(&take);
    let last = places.iter().rfind(|(kind, _)| *kind == types::SAMPLES).unwrap();
    let first = places.iter().find(|(kind, _)| *kind == types::SAMPLED_GROUP).unwrap();
    for (place, is_description) in [(last, false), (first, true)] {
        let mut damaged = take.clone();
        damaged[place.1.start + 8] ^= 4;
        let map = TakeMap::scan(&mut Cursor::new(&damaged)).unwrap();
        assert!(map.damaged && !map.problems.is_empty());
        let scan = RecoveryScan::read(&damaged[..]).unwrap();
        assert!(scan.lost_anything() && !scan.loss_summary().is_empty());
        let mut recovered = Vec::new();
        scan.write(Cursor::new(&damaged), &mut recovered, "test").unwrap();
        let ledgers = assert_clean(&recovered);
        assert_eq!(ledgers.len(), 2);
        assert!(ledgers.iter().all(|ledger| ledger.taken == 4000), "{ledgers:?}");
        let lost = ledgers.iter().map(|ledger| ledger.lost_other).sum::<u64>();
        if is_description {
            assert_eq!([ledgers[0].stored, ledgers[1].stored], [0, 4000]);
            assert_eq!(lost, 4000);
        } else {
            assert!((100..=1000).contains(&lost), "{lost}");
        }
    }
}

/// The take with every chunk of one type in a version that this program does not know.
fn of_later_version(take: &[u8], of: u8) -> Vec<u8> {
    let mut new = take.to_vec();
    for (_, place) in places(take).into_iter().filter(|(kind, _)| *kind == of) {
        let ChunkParse::Whole { payload, .. } = chunk::parse(&take[place.clone()]) else {
            unreachable!("it was parsed");
        };
        let payload_at = payload.as_ptr() as usize - take.as_ptr() as usize;
        new[payload_at] = 77;
        let crc_at = place.end - 4;
        let crc = crc32fast::hash(&new[place.start..crc_at]);
        new[crc_at..place.end].copy_from_slice(&crc.to_le_bytes());
    }
    assert_ne!(new, take);
    new
}

#[test]
fn chunks_of_later_versions_are_held_against_nothing_and_recovered_unchanged() {
    let motion = jump(6, 200.0, 4.0);
    let (mut intake, pipeline) = start(&with_groups(&motion), Vec::new());
    feed_both(&mut intake, &motion, 0..800, |_, number| number % 10 != 3);
    intake.finish();
    let take = pipeline.finish().unwrap().1;
    let stated = assert_clean(&take);
    assert!(stated.iter().all(|group| group.stored > 0 && group.lost() > 0));
    for kind in [types::SAMPLED_GROUP, types::SAMPLE_TIMES, types::SAMPLE_LEDGER] {
        let later = of_later_version(&take, kind);
        let of_kind = |take: &[u8]| -> Vec<Vec<u8>> {
            let found = places(take).into_iter().filter(|(found, _)| *found == kind);
            found.map(|(_, place)| take[place].to_vec()).collect()
        };
        let check = |take: &[u8]| {
            let summary = Summary::read(take).unwrap();
            let verdict = Verdict::of(&summary);
            assert!(verdict.problems.is_empty(), "{kind:x}: {:?}", verdict.problems);
            assert_eq!(verdict.contradictions, [""; 0], "{kind:x}");
        };
        check(&later);
        let scan = RecoveryScan::read(&later[..]).unwrap();
        assert!(!scan.lost_anything(), "{kind:x}: {:?}", scan.problems);
        let mut new = Vec::new();
        scan.write(Cursor::new(&later), &mut new, "test").unwrap();
        check(&new);
        assert_eq!(of_kind(&new), of_kind(&later), "{kind:x}");
        if kind != types::SAMPLE_LEDGER {
            let ledger = TakeMap::scan(&mut Cursor::new(&new)).unwrap().sample_ledger.unwrap();
            assert!(ledger.finished);
            assert_eq!(ledger.groups, stated, "{kind:x}");
        }
    }
}
