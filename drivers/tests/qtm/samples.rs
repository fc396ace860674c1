//! Analog devices and force plates: groups of sampled channels, whose samples are those that QTM sent, with their numbers.

use mocapd_drivers::{
    device::SampledGroupInfo,
    qtm::{AnalogDevice, FORCE_VALUES, ForcePlate, ServedSettings},
};

use crate::pair::{LABELS, Pair, SentBatch};

/// Two analog devices, of which one has more channels than a group, and a plate.
fn settings() -> ServedSettings {
    let channels = |n: usize| (0..n).map(|k| (format!("EMG {k}"), "V".to_owned())).collect();
    ServedSettings {
        frequency_hz: 100.0,
        up_axis: "+Z",
        labels: LABELS.map(str::to_owned).to_vec(),
        analog: vec![
            AnalogDevice { id: 4, rate_hz: 1000.0, channels: channels(3) },
            AnalogDevice { id: 1, rate_hz: 200.0, channels: channels(70) },
        ],
        plates: vec![ForcePlate { id: 2, rate_hz: 500.0, corners_mm: None }],
        ..ServedSettings::default()
    }
}

/// The value of a channel at a sample.
fn value(device: u32, channel: usize, number: u64) -> f32 {
    device as f32 * 1000.0 + channel as f32 + number as f32 / 1024.0
}

fn samples(device: u32, n_channels: usize, first: u64, n: u64) -> Vec<f32> {
    let sample = |number| (0..n_channels).map(move |channel| value(device, channel, number));
    (first..first + n).flat_map(sample).collect()
}

/// Ten milliseconds of all devices, and the frame behind them.
fn frame(pair: &mut Pair, number: u32) {
    let passed = u64::from(number);
    pair.server.add_samples(false, 4, 10 * passed, &samples(4, 3, 10 * passed, 10));
    pair.server.add_samples(false, 1, 2 * passed, &samples(1, 70, 2 * passed, 2));
    pair.server.add_samples(true, 2, 5 * passed, &samples(2, FORCE_VALUES, 5 * passed, 5));
    pair.frame(number, 1_000_000 + passed * 10_000, &[]);
}

fn of_group(pair: &Pair, group: u8) -> Vec<&SentBatch> {
    pair.driver.reported.batches.iter().filter(|batch| batch.group == group).collect()
}

#[test]
fn every_sample_arrives_with_its_number_and_its_bits() {
    for port in [None, Some(5000)] {
        let mut pair = Pair::with(port, settings());
        pair.start();
        let request =
            pair.driver.sent.iter().find(|sent| sent.starts_with("StreamFrames")).unwrap();
        assert!(request.ends_with("3DRes 3DNoLabelsRes Analog Force"), "{request}");
        let groups: Vec<_> = pair
            .driver
            .reported
            .groups
            .iter()
            .map(|SampledGroupInfo { rate_millihertz, channels, .. }| {
                let last = &channels[channels.len() - 1];
                (*rate_millihertz, channels.len(), last.name.as_str(), last.unit.as_str())
            })
            .collect();
        let expected = [
            (1_000_000, 3, "EMG 2", "V"),
            (200_000, 64, "EMG 63", "V"),
            (200_000, 6, "EMG 69", "V"),
            (500_000, 9, "COPz2", "mm"),
        ];
        assert_eq!(groups, expected);
        for number in 0..20 {
            frame(&mut pair, number);
            pair.step();
        }
        assert_eq!(pair.driver.reported.frames.len(), 20);
        let devices = [(4, 0, 3, 10), (1, 0, 64, 2), (1, 64, 6, 2), (2, 0, 9, 5)];
        for (group, (device, first_channel, n_channels, per_frame)) in
            devices.into_iter().enumerate()
        {
            let batches = of_group(&pair, group as u8);
            assert_eq!(batches.len(), 20);
            for (index, batch) in batches.iter().enumerate() {
                let first = index as u64 * per_frame;
                assert_eq!((batch.number, batch.first), (index as u32, first));
                let expected: Vec<f32> = (first..first + per_frame)
                    .flat_map(|number| {
                        (first_channel..first_channel + n_channels)
                            .map(move |channel| value(device, channel, number))
                    })
                    .collect();
                assert_eq!(batch.samples, expected);
                // The last sample is of the frame's time.
                let rate = [1000, 200, 200, 500][group];
                let last = 1_000_000 + index as u64 * 10_000;
                assert_eq!(batch.device_ticks, last - (per_frame - 1) * 1_000_000 / rate);
            }
        }
        pair.driver.command(mocapd_drivers::device::Command::Stop);
        pair.steps(20);
        assert!(pair.driver.reported.ended.is_some());
        assert_eq!(pair.driver.reported.notes, ["QTM: RT From File Started"]);
    }
}

#[test]
fn lost_and_repeated_datagrams_show_in_the_numbers() {
    let mut pair = Pair::with(Some(5000), settings());
    pair.start();
    for number in 0..10 {
        frame(&mut pair, number);
        match number {
            // Lost.
            3 | 4 => drop(pair.server.take_datagrams()),
            // Twice.
            7 => {
                let twice = pair.server.take_datagrams();
                for datagram in twice.iter().chain(&twice) {
                    pair.driver.push(&datagram.bytes, true);
                }
            }
            _ => {}
        }
        pair.step();
    }
    let found: Vec<_> =
        of_group(&pair, 0).iter().map(|batch| (batch.number, batch.first)).collect();
    let expected = [
        (0, 0),
        (1, 10),
        (2, 20),
        // One number is skipped: the samples between were lost on the way.
        (4, 50),
        (5, 60),
        (6, 70),
        // The copy counts no batch.
        (7, 70),
        (7, 80),
        (8, 90),
    ];
    assert_eq!(found, expected);
}

#[test]
fn what_qtm_skips_is_its_own_loss_where_nothing_is_lost_on_the_way() {
    let mut pair = Pair::with(None, settings());
    pair.start();
    for number in [0, 1, 5] {
        frame(&mut pair, number);
        pair.step();
    }
    let found: Vec<_> =
        of_group(&pair, 0).iter().map(|batch| (batch.number, batch.first)).collect();
    assert_eq!(found, [(0, 0), (1, 10), (2, 50)]);
}

#[test]
fn a_stream_of_fewer_frames_has_all_samples() {
    let mut pair = Pair::with(None, settings());
    pair.start();
    let mut packet = Vec::new();
    mocapd_drivers::qtm::put_text(
        mocapd_drivers::qtm::PacketKind::Command,
        "StreamFrames FrequencyDivisor:4 3DRes 3DNoLabelsRes Analog Force",
        &mut packet,
    );
    pair.server.receive(pair.client, &packet);
    for number in 0..12 {
        frame(&mut pair, number);
        pair.step();
    }
    let found: Vec<_> =
        of_group(&pair, 3).iter().map(|batch| (batch.first, batch.samples.len() / 9)).collect();
    assert_eq!(found, [(0, 5), (5, 20), (25, 20)]);
}

#[test]
fn samples_that_the_settings_do_not_have_are_left_out_and_counted() {
    let mut pair = Pair::with(None, settings());
    pair.start();
    let other = ServedSettings {
        analog: vec![AnalogDevice { id: 4, rate_hz: 1000.0, channels: Vec::new() }],
        ..settings()
    };
    // A device with one channel in place of three.
    let mut server = Pair::with(None, other);
    server.start();
    let mut packet = Vec::new();
    mocapd_drivers::qtm::put_text(
        mocapd_drivers::qtm::PacketKind::Command,
        "StreamFrames AllFrames 3DRes 3DNoLabelsRes Analog",
        &mut packet,
    );
    server.server.receive(server.client, &packet);
    server.server.take_pending(server.client);
    server.server.add_samples(false, 4, 0, &[1.0; 5]);
    server.frame(0, 1_000_000, &[]);
    let bytes = server.server.take_pending(server.client);
    pair.driver.push(&bytes, false);
    assert_eq!((pair.driver.reported.frames.len(), of_group(&pair, 0).len()), (1, 0));
    pair.driver.command(mocapd_drivers::device::Command::Stop);
    pair.steps(20);
    let notes = pair.driver.reported.notes.join("\n");
    assert!(notes.contains("5 analog samples or forces were left out"), "{notes}");
}

#[test]
fn lumps_of_samples_have_times_in_step_with_their_numbers() {
    let mut pair = Pair::with(None, settings());
    pair.start();
    for number in 0..60 {
        // Thirty samples with every third frame.
        if number % 3 == 2 {
            let first = u64::from(number - 2) * 10;
            pair.server.add_samples(false, 4, first, &samples(4, 3, first, 30));
        }
        pair.frame(number, 1_000_000 + u64::from(number) * 10_000, &[]);
        pair.step();
    }
    let batches = of_group(&pair, 0);
    assert_eq!(batches.len(), 20);
    for pair in batches.windows(2) {
        let samples = pair[1].first - pair[0].first;
        let off_us = (pair[1].device_ticks - pair[0].device_ticks).abs_diff(samples * 1000);
        assert!(samples == 30 && off_us < 1000, "{pair:?}");
    }
}

#[test]
fn a_component_of_samples_that_cannot_be_read_costs_no_marker() {
    let mut pair = Pair::with(None, settings());
    pair.start();
    pair.frame(0, 1_000_000, &[]);
    let mut packet = pair.server.take_pending(pair.client);
    // One more component: a plate without forces, of which the number is left out.
    packet[20] += 1;
    packet.extend([20_u32, 4, 1, 2, 0].iter().flat_map(|field| field.to_le_bytes()));
    let size = packet.len() as u32;
    packet[..4].copy_from_slice(&size.to_le_bytes());
    pair.driver.push(&packet, false);
    assert_eq!(pair.driver.reported.frames.len(), 1);
    pair.driver.command(mocapd_drivers::device::Command::Stop);
    pair.steps(20);
    let notes = pair.driver.reported.notes.join("\n");
    assert!(notes.contains("1 components of analog samples or forces cannot be read"), "{notes}");
}
