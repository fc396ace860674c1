//! Arbitrary bytes and commands: nothing panics, hangs, or grows without bound.

use mocapd_drivers::device::{Command, Protocol};
use mocapd_simulator::device::LineDevice;
use mocapd_simulator::ndi::{NdiDevice, NdiSettings};
use mocapd_testkit::random::Random;

use super::bench::{Bench, MS, assert_is_row, jump, settings};

#[test]
fn every_single_byte_of_an_answer_can_be_wrong() {
    let motion = jump(12, 60.0, 3.0);
    for bx2 in [true, false] {
        let settings = NdiSettings { looping: true, ..settings(&["head"], bx2) };
        let mut bench = Bench::new(motion.clone(), settings, 921_600);
        bench.identify();
        bench.start();
        bench.run_for(200 * MS);
        let mut at = 0;
        let mut flip = 0;
        let mut turn = 0;
        bench.damage = Box::new(move |answer| {
            // Only every third answer, so that the device does not count as lost.
            turn += 1;
            if turn % 3 == 0 && answer.starts_with(&[0xC4]) {
                let n = answer.len();
                answer[at % n] ^= [0x01, 0x80, 0xFF, 0x5A][flip % 4];
                at += 1;
                flip += usize::from(at % n == 0);
            }
        });
        bench.run_for(60_000 * MS);
        assert_eq!(bench.hellos.len(), 1);
        assert!(bench.host.counters().messages_damaged > 500);
        let head = motion.info.markers.iter().position(|m| m.label == "head").unwrap();
        for received in &bench.frames {
            let row = motion.frame(received.seq as usize % motion.n_frames());
            assert_is_row(received, row, &[(1, head)]);
        }
    }
}

#[test]
fn a_device_that_babbles_is_bounded_and_recovers() {
    for seed in 1..=40 {
        let settings = NdiSettings { looping: true, ..settings(&["head"], true) };
        let mut bench = Bench::new(jump(12, 60.0, 1.0), settings, 921_600);
        let mut random = Random::new(seed);
        bench.damage = Box::new(move |answer| {
            // Garbage before, after and instead of answers, up to more bytes than any answer has.
            match random.below(4) {
                0 => {}
                1 => answer.extend((0..random.below(5_000)).map(|_| random.byte())),
                2 => *answer = (0..random.below(200_000)).map(|_| random.byte()).collect(),
                _ => {
                    *answer = vec![[0xC4, 0xC8, b'\r', 0xA5][random.below(4)]; random.below(1_000)];
                }
            }
        });
        bench.send(Command::Identify);
        bench.send(Command::Start { line_bytes_per_s: 0 });
        bench.run_for(30_000 * MS);
        bench.damage = Box::new(|_| {});
        bench.failed = None;
        bench.send(Command::Identify);
        let hellos = bench.hellos.len();
        bench.run_until(|bench| bench.hellos.len() > hellos);
        bench.start();
        let frames = bench.frames.len();
        bench.run_until(|bench| bench.frames.len() > frames + 10);
    }
}

#[test]
fn the_device_survives_any_bytes_from_a_host() {
    for seed in 1..=60 {
        let mut random = Random::new(seed);
        let settings = NdiSettings { looping: true, ..settings(&["head"], true) };
        let mut device = NdiDevice::new(jump(12, 60.0, 1.0), settings).unwrap();
        let requests = [
            "INIT:E3A5\r",
            "TSTART:",
            "TSTOP:",
            "BX:",
            "BX2 ",
            "TX:1001",
            "PHSR:02",
            "PVWR:0A0000",
            "PHRQ:*********1****",
            "PHINF:01FFFF",
            "PENA:01D",
            "COMM:6",
            "VER:0",
            "\r",
            "RESET:",
            "\0",
            "GETINFO:Features.Firmware.Version0492\r",
            "PHF:0A",
            "é",
            "  ",
            "::",
            "FFFF",
            "SET:=",
        ];
        let mut now_ns = 0;
        for _ in 0..4_000 {
            let mut bytes = requests[random.below(requests.len())].as_bytes().to_vec();
            if random.one_in(3) {
                let crc = mocapd_drivers::ndi::crc16(&bytes);
                bytes.extend(format!("{crc:04X}\r").into_bytes());
            }
            if random.one_in(10) {
                bytes.extend((0..random.below(3_000)).map(|_| random.byte()));
            }
            device.on_bytes(&bytes, now_ns);
            now_ns += random.below(30) as u64 * MS;
            device.poll(now_ns);
            if random.one_in(50) {
                device.on_break(now_ns);
            }
            // A host that reads nothing for a while must not make the queue grow.
            assert!(device.pending().len() < 200_000);
            if random.one_in(20) {
                let n = device.pending().len();
                device.sent(n);
            }
        }
    }
}

#[test]
fn the_host_survives_commands_in_any_order() {
    for seed in 1..=60 {
        let mut random = Random::new(seed * 77);
        let settings = NdiSettings { looping: true, ..settings(&["head"], true) };
        let mut bench = Bench::new(jump(12, 60.0, 1.0), settings, 921_600);
        for turn in 0..600 {
            match random.below(8) {
                0 => bench.send(Command::Identify),
                1 => bench.send(Command::Start { line_bytes_per_s: 0 }),
                2 => bench.send(Command::Stop),
                3 => bench.send(Command::Ping { host_ns: turn }),
                4 => bench.send(Command::SetRate(60_000)),
                5 => bench.device.on_break(bench.now_ns),
                _ => bench.run_for(random.below(300) as u64 * MS),
            }
        }
        bench.send(Command::Stop);
        bench.run_for(4_000 * MS);
        if let Some(message) = bench.failed.take() {
            // Breaks during a change of speed look like a line that does not carry the higher speed.
            assert!(message.contains("60 Hz") && message.contains("baud"), "{message}");
        }
        bench.send(Command::Identify);
        let hellos = bench.hellos.len();
        bench.run_until(|bench| bench.hellos.len() > hellos);
        assert!(bench.host.counters().bytes > 0);
    }
}

#[test]
fn a_streaming_device_of_another_kind_is_not_mistaken_and_does_not_block_the_search() {
    let mut bench = Bench::new(jump(12, 60.0, 1.0), settings(&["head"], true), 921_600);
    bench.device.on_bytes(b"INIT:E3A5\r", 0);
    // The line carries a foreign stream without end.
    bench.babbles = true;
    bench.send(Command::Identify);
    bench.run_for(5_000 * MS);
    let counters = bench.host.counters();
    assert!(bench.hellos.is_empty() && bench.failed.is_none());
    assert!(counters.messages == 0 && counters.bytes_skipped > 100_000, "{counters:?}");
    assert!(bench.breaks >= 1 && bench.requests.len() >= 9, "{:?}", bench.requests_as_text());
    bench.babbles = false;
    bench.identify();
}
