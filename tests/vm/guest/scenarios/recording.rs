//! Takes that hold all that was sent.

use std::time::Duration;

use anyhow::ensure;

use crate::{Measured, ledger::Account, recorder::record, simulator::Simulator};

const PATIENCE: Duration = Duration::from_secs(90);

fn of(simulator: Simulator, take: &str) -> Measured {
    let ran = record(&simulator.uri, take, &[])?.finish(PATIENCE)?.with_code(0)?;
    let account = Account::of(&ran.json()?)?;
    let sent = simulator.stop()?;
    account.has_all_of(&sent)?;
    ensure!(account.ending == "end of stream", "it ended: {}", account.ending);
    ensure!(account.damaged == 0, "{account:?}");
    let (frames, samples) = (account.recorded, account.samples);
    Ok(format!("{frames} of {} frames, {samples} of {} samples", sent.produced, sent.samples))
}

const FIVE_SECONDS: [&str; 6] = ["--rate", "240", "--markers", "24", "--seconds", "5"];

pub(crate) fn bulk() -> Measured {
    of(Simulator::bulk("REC1", &FIVE_SECONDS)?, "/tmp/bulk.take")
}

pub(crate) fn port() -> Measured {
    of(Simulator::port("REC2", &FIVE_SECONDS)?, "/tmp/port.take")
}

pub(crate) fn two_at_once() -> Measured {
    let devices =
        [Simulator::bulk("TWO1", &FIVE_SECONDS)?, Simulator::bulk("TWO2", &FIVE_SECONDS)?];
    let mut under_way = Vec::new();
    for (number, device) in devices.iter().enumerate() {
        under_way.push(record(&device.uri, &format!("/tmp/two-{number}.take"), &[])?);
    }
    let mut words = Vec::new();
    for (recorder, device) in under_way.into_iter().zip(devices) {
        let ran = recorder.finish(PATIENCE)?.with_code(0)?;
        let account = Account::of(&ran.json()?)?;
        let sent = device.stop()?;
        account.has_all_of(&sent)?;
        words.push(format!("{} of {} frames", account.recorded, sent.produced));
    }
    Ok(words.join(" and "))
}
