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

/// Records two devices at the same time; each take has everything that was sent.
fn both(devices: [Simulator; 2], takes: [&str; 2], more: &[&str]) -> Measurement {
    let mut under_way = Vec::new();
    for (device, take) in devices.iter().zip(takes) {
        under_way.push(record(&device.uri, take, more)?);
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

pub(crate) fn two_at_once() -> Measurement {
    let devices =
        [Simulator::bulk("TWO1", &FIVE_SECONDS)?, Simulator::bulk("TWO2", &FIVE_SECONDS)?];
    both(devices, ["/tmp/two-0.take", "/tmp/two-1.take"], &[])
}

/// The motion of `tests/oracle/one_motion.py` through a pair of bulk endpoints and a port: the takes have the same floats.
pub(crate) fn one_motion() -> Measurement {
    let devices =
        [Simulator::bulk("ONE1", &FIVE_SECONDS)?, Simulator::port("ONE2", &FIVE_SECONDS)?];
    let takes = ["/tmp/one-bulk.take", "/tmp/one-port.take"];
    both(devices, takes, &["--lossless"])?;
    // Exit code 1: the headers differ, at least in the URI.
    let found = mocapd(User::Dialout, &["diff", takes[0], takes[1], "--json"])?.with_code(1)?;
    let motion = found.json()?["motion"].take();
    ensure!(motion["equal"] == true && motion["frames_missing"] == 0, "{motion}");
    ensure!(motion["samples"].as_u64().is_some_and(|n| n > 20_000), "{motion}");
    Ok(format!("0 of {} samples differ", motion["samples"]))
}
