//! Complete recordings of everything sent.

use std::time::Duration;

use anyhow::ensure;

use crate::{
    Measurement,
    ledger::LedgerReport,
    recorder::{User, mocapd, record},
    simulator::Simulator,
};

const TIMEOUT: Duration = Duration::from_secs(90);

fn of(simulator: Simulator, take: &str) -> Measurement {
    let ran = record(&simulator.uri, take, &[])?.finish(TIMEOUT)?.with_code(0)?;
    let ledger = LedgerReport::of(&ran.json()?)?;
    let sent = simulator.stop()?;
    ledger.ensure_complete(&sent)?;
    ensure!(ledger.ending == "end of stream", "it ended: {}", ledger.ending);
    ensure!(ledger.damaged == 0, "{ledger:?}");
    let (frames, samples) = (ledger.recorded, ledger.samples);
    Ok(format!("{frames} of {} frames, {samples} of {} samples", sent.produced, sent.samples))
}

const FIVE_SECONDS: [&str; 6] = ["--rate", "240", "--markers", "24", "--seconds", "5"];

pub(crate) fn bulk() -> Measurement {
    of(Simulator::bulk("REC1", &FIVE_SECONDS)?, "/tmp/bulk.take")
}

pub(crate) fn port() -> Measurement {
    of(Simulator::port("REC2", &FIVE_SECONDS)?, "/tmp/port.take")
}

pub(crate) fn two_at_once() -> Measurement {
    let devices =
        [Simulator::bulk("TWO1", &FIVE_SECONDS)?, Simulator::bulk("TWO2", &FIVE_SECONDS)?];
    let mut under_way = Vec::new();
    for (number, device) in devices.iter().enumerate() {
        under_way.push(record(&device.uri, &format!("/tmp/two-{number}.take"), &[])?);
    }
    let mut results = Vec::new();
    for (recorder, device) in under_way.into_iter().zip(devices) {
        let ran = recorder.finish(TIMEOUT)?.with_code(0)?;
        let ledger = LedgerReport::of(&ran.json()?)?;
        let sent = device.stop()?;
        ledger.ensure_complete(&sent)?;
        results.push(format!("{} of {} frames", ledger.recorded, sent.produced));
    }
    Ok(results.join(" and "))
}

/// What differs between takes of one motion is what the connection and the moment make different (docs/networks.md).
pub(crate) fn one_motion() -> Measurement {
    const TAKES: [&str; 2] = ["/tmp/one-bulk.take", "/tmp/one-port.take"];
    let lossless = ["--lossless"];
    for (take, is_port) in TAKES.into_iter().zip([false, true]) {
        let device = match is_port {
            false => Simulator::bulk("ONE1", &FIVE_SECONDS)?,
            true => Simulator::port("ONE2", &FIVE_SECONDS)?,
        };
        record(&device.uri, take, &lossless)?.finish(TIMEOUT)?.with_code(0)?;
        device.stop()?;
    }
    mocapd(User::Root, &["diff", TAKES[0], TAKES[1], "--motion"])?.with_code(0)?;
    let found = mocapd(User::Root, &["diff", TAKES[0], TAKES[1]])?.with_code(1)?;
    println!("   mocapd diff of a take by USB and one by a serial port:\n{}", found.stdout);
    ensure!(found.stdout.contains("arrival"), "{}", found.stdout);
    let kept = ["device ticks", "ledger", "label"].iter().all(|what| !found.stdout.contains(what));
    ensure!(kept, "{}", found.stdout);
    Ok("the same frames, floats, ticks and ledger by USB and by a serial port".to_owned())
}
