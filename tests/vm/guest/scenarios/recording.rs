//! Complete recordings of everything sent.

use std::time::Duration;

use anyhow::ensure;

use crate::{Measurement, ledger::LedgerReport, recorder::record, simulator::Simulator};

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
