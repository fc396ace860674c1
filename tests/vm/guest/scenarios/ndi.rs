//! An NDI system on a serial port of the kernel's: breaks and changes of speed are real there.

use std::{thread::sleep, time::Duration};

use anyhow::ensure;

use crate::{
    Measured, attached::PATIENCE, ledger::Account, recorder::record, simulator::Simulator,
};

/// Of the frames of a system that keeps one at a time, so many may be missed by an emulated host: it has a core of its
/// own, or shares it with whatever else is tested. The account has to be right in either case.
const MISSED_MAX: f64 = 0.5;

/// A system that is back is searched for at every speed, and set up anew.
const BACK_WITHIN: Duration = Duration::from_secs(20);

fn system(serial: &str, more: &[&str]) -> anyhow::Result<(Simulator, String)> {
    let options = ["--protocol", "ndi", "--rate", "60", "--markers", "40"];
    let simulator = Simulator::port(serial, &[&options, more].concat())?;
    let uri = format!("{}?driver=ndi", simulator.uri);
    Ok((simulator, uri))
}

pub(crate) fn recorded() -> Measured {
    let (simulator, uri) = system("NDI1", &["--seconds", "10"])?;
    let ran = record(&uri, "/tmp/ndi.take", &[])?.finish(PATIENCE * 3)?;
    let account = Account::of(&ran.json()?)?;
    account.closes()?;
    let sent = simulator.stop()?;
    ensure!(account.ending == "end of stream", "it ended: {}, {}", account.ending, ran.stderr);
    ensure!(
        account.frames_sent == sent.produced && account.damaged == 0,
        "{account:?} of {sent:?}"
    );
    // An answer that comes after its time is one that nobody reads, and the host cannot tell what it held.
    let was_late = account.recorded + sent.dropped < sent.produced;
    ensure!(account.recorded + sent.dropped <= sent.produced, "{account:?} of {sent:?}");
    ensure!(was_late || account.samples == sent.samples, "{account:?} of {sent:?}");
    let missed = account.lost as f64 / sent.produced.max(1) as f64;
    ensure!(missed < MISSED_MAX, "{account:?} of {sent:?}");
    Ok(format!("{} of {} frames", account.recorded, sent.produced))
}

pub(crate) fn replugged() -> Measured {
    let (simulator, uri) = system("NDI2", &["--loop"])?;
    let take = "/tmp/ndi-replug.take";
    let mut recorder = record(&uri, take, &[])?;
    recorder.has_recorded(take)?;
    let (controller, pulled) = simulator.unplug()?;
    let acted = recorder.said("is gone: plug it in again", PATIENCE)? - pulled;
    sleep(Duration::from_secs(1));
    let plugged = simulator.plug(&controller)?;
    let back = recorder.said("the device is back", PATIENCE)? - plugged;
    ensure!(back < BACK_WITHIN, "recorded again after {} ms", back.as_millis());
    sleep(Duration::from_secs(2));
    recorder.interrupt()?;
    let ran = recorder.finish(PATIENCE)?.with_code(3)?;
    let account = Account::of(&ran.json()?)?;
    account.closes()?;
    Ok(format!(
        "acted on after {} ms, recorded again {} ms after the replug",
        acted.as_millis(),
        back.as_millis()
    ))
}
