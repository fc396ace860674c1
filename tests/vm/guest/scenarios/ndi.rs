//! An NDI system on a serial port of the kernel, with real breaks and changes of speed.

use std::{thread::sleep, time::Duration};

use anyhow::ensure;

use crate::{
    Measurement, attached::TIMEOUT, ledger::LedgerReport, recorder::record, simulator::Simulator,
};

/// Largest fraction of frames that an emulated host may miss of a system that keeps only one: the host may share its
/// core with other tests. The ledger has to be right in any case.
const MISSED_MAX: f64 = 0.5;

/// A system that is back has to be found at an unknown speed and set up again.
const BACK_WITHIN: Duration = Duration::from_secs(20);

fn system(serial: &str, more: &[&str]) -> anyhow::Result<(Simulator, String)> {
    let options = ["--protocol", "ndi", "--rate", "60", "--markers", "40"];
    let simulator = Simulator::port(serial, &[&options, more].concat())?;
    let uri = format!("{}?driver=ndi", simulator.uri);
    Ok((simulator, uri))
}

pub(crate) fn recorded() -> Measurement {
    let (simulator, uri) = system("NDI1", &["--seconds", "10"])?;
    let ran = record(&uri, "/tmp/ndi.take", &[])?.finish(TIMEOUT * 3)?;
    let ledger = LedgerReport::of(&ran.json()?)?;
    ledger.closes()?;
    let sent = simulator.stop()?;
    ensure!(ledger.ending == "end of stream", "it ended: {}, {}", ledger.ending, ran.stderr);
    ensure!(ledger.frames_sent == sent.produced && ledger.damaged == 0, "{ledger:?} of {sent:?}");
    // The host discards an answer that comes too late, so it cannot know the frame in it.
    let was_late = ledger.recorded + sent.dropped < sent.produced;
    ensure!(ledger.recorded + sent.dropped <= sent.produced, "{ledger:?} of {sent:?}");
    ensure!(was_late || ledger.samples == sent.samples, "{ledger:?} of {sent:?}");
    let missed = ledger.lost as f64 / sent.produced.max(1) as f64;
    ensure!(missed < MISSED_MAX, "{ledger:?} of {sent:?}");
    Ok(format!("{} of {} frames", ledger.recorded, sent.produced))
}

pub(crate) fn replugged() -> Measurement {
    let (simulator, uri) = system("NDI2", &["--loop"])?;
    let take = "/tmp/ndi-replug.take";
    let mut recorder = record(&uri, take, &[])?;
    recorder.has_recorded(take)?;
    let (controller, pulled) = simulator.unplug()?;
    let acted = recorder.wait_for_line("is gone: plug it in again", TIMEOUT)? - pulled;
    sleep(Duration::from_secs(1));
    let plugged = simulator.plug(&controller)?;
    let back = recorder.wait_for_line("the device is back", TIMEOUT)? - plugged;
    ensure!(back < BACK_WITHIN, "recorded again after {} ms", back.as_millis());
    sleep(Duration::from_secs(2));
    recorder.interrupt()?;
    let ran = recorder.finish(TIMEOUT)?.with_code(3)?;
    let ledger = LedgerReport::of(&ran.json()?)?;
    ledger.closes()?;
    Ok(format!(
        "acted on after {} ms, recorded again {} ms after the replug",
        acted.as_millis(),
        back.as_millis()
    ))
}
