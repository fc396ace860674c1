//! Cables that are pulled while a take is being recorded.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context, ensure};

use crate::{
    Measured,
    attached::{PATIENCE, run, wait_for_absence, wait_until},
    ledger::Account,
    recorder::{Mocapd, User, mocapd, record},
    simulator::Simulator,
};

/// A pulled plug is acted on by the transfer that fails.
const ACTED_WITHIN: Duration = Duration::from_millis(100);

/// A device that is back is recorded again.
const BACK_WITHIN: Duration = Duration::from_secs(2);

/// By how much the take of a device that lost its power may be off the wall clock: the process that plays it is
/// killed and started again, and its first frame comes a little after it is back.
const KEEPS_TIME_WITHIN_S: f64 = 0.3;

/// Half a second in which a busy machine lets the device stand still.
const STOOD_STILL_MAX: u64 = 120;

const ENDLESS: [&str; 5] = ["--rate", "240", "--markers", "24", "--loop"];

/// How long the device is away, and recorded before and after.
const WHILE: Duration = Duration::from_millis(1500);

fn pull_and_plug(simulator: Simulator, take: &str) -> Measured {
    let mut recorder = record(&simulator.uri, take, &[])?;
    recorder.has_recorded(take)?;
    sleep(WHILE);
    let (controller, pulled) = simulator.unplug()?;
    let acted = recorder.said("is gone: plug it in again", PATIENCE)? - pulled;
    sleep(WHILE);
    let plugged = simulator.plug(&controller)?;
    let back = recorder.said("the device is back", PATIENCE)? - plugged;
    sleep(WHILE);
    let account = ended(recorder, take)?;
    let sent = simulator.stop()?;
    let lost_frames = account.unknown;
    // What was sent after the last frame that arrived nobody can know of but the simulator; and where the host took long
    // from its Stop to its Start, the counter stood still, and the take keeps time by the device's clock.
    ensure!(
        account.frames_sent <= sent.produced + STOOD_STILL_MAX
            && sent.produced <= account.frames_sent + 240,
        "{account:?} of {sent:?}"
    );
    ensure!(lost_frames >= 240, "an outage of more than a second, and {account:?}");
    ensure!(acted < ACTED_WITHIN, "acted on after {} ms", acted.as_millis());
    ensure!(back < BACK_WITHIN, "recorded again after {} ms", back.as_millis());
    Ok(format!(
        "acted on after {} ms, recorded again {} ms after the replug; {} of {} frames, {lost_frames} in the gap",
        acted.as_millis(),
        back.as_millis(),
        account.recorded,
        account.frames_sent
    ))
}

/// Ctrl-C; the take is whole, and says that the device was away.
fn ended(recorder: Mocapd, take: &str) -> anyhow::Result<Account> {
    recorder.interrupt()?;
    let ran = recorder.finish(PATIENCE)?.with_code(3)?;
    let account = Account::of(&ran.json()?)?;
    account.closes()?;
    ensure!(account.ending == "stopped", "{account:?}: {}", ran.stderr);
    let info = mocapd(User::Dialout, &["info", take])?;
    for event in ["the device was disconnected", "the device is back after"] {
        ensure!(info.stdout.contains(event), "no event '{event}' in {}", info.stdout);
    }
    Ok(account)
}

pub(crate) fn bulk() -> Measured {
    pull_and_plug(Simulator::bulk("PLUG1", &ENDLESS)?, "/tmp/plug-1.take")
}

pub(crate) fn port() -> Measured {
    pull_and_plug(Simulator::port("PLUG2", &ENDLESS)?, "/tmp/plug-2.take")
}

/// Nobody says that devices come: whoever waits looks.
pub(crate) fn without_udev() -> Measured {
    let simulator = Simulator::bulk("PLUG3", &ENDLESS)?;
    let mut recorder = record(&simulator.uri, "/tmp/plug-3.take", &[])?;
    recorder.has_recorded("/tmp/plug-3.take")?;
    run("udevadm", &["control", "--exit"])?;
    let measured = (|| {
        let (controller, pulled) = simulator.unplug()?;
        let acted = recorder.said("is gone: plug it in again", PATIENCE)? - pulled;
        sleep(WHILE);
        let plugged = simulator.plug(&controller)?;
        // Without udev nobody sets permissions either: this stands in for a machine that has its own way.
        open_to_all("PLUG3")?;
        let back = recorder.said("the device is back", PATIENCE)? - plugged;
        ensure!(acted < ACTED_WITHIN, "acted on after {} ms", acted.as_millis());
        ensure!(back < BACK_WITHIN, "recorded again after {} ms", back.as_millis());
        Ok(format!("recorded again {} ms after the replug", back.as_millis()))
    })();
    run("/lib/systemd/systemd-udevd", &["--daemon"])?;
    run("udevadm", &["trigger", "--action=add"])?;
    run("udevadm", &["settle"])?;
    let measured = measured?;
    ended(recorder, "/tmp/plug-3.take")?;
    Ok(measured)
}

fn open_to_all(serial: &str) -> anyhow::Result<()> {
    use std::os::unix::fs::PermissionsExt;

    let node = wait_until("the device", PATIENCE, || {
        let all = mocapd_drivers::transport::usb::devices().ok()?;
        let found = all.into_iter().find(|device| device.serial.as_deref() == Some(serial))?;
        found.node.exists().then_some(found.node)
    })?;
    Ok(std::fs::set_permissions(node, PermissionsExt::from_mode(0o666))?)
}

/// The device's counter and clock begin anew.
fn cut_power(plug_in: impl Fn() -> anyhow::Result<Simulator>, take: &str) -> Measured {
    let simulator = plug_in()?;
    let uri = simulator.uri.clone();
    let mut recorder = record(&uri, take, &[])?;
    recorder.has_recorded(take)?;
    let cut = Instant::now();
    simulator.kill()?;
    let simulator = plug_in()?;
    let away_s = (recorder.said("the device is back", PATIENCE)? - cut).as_secs_f64();
    sleep(WHILE);
    let account = ended(recorder, take)?;
    // The device's counter says nothing of the time between: the take keeps it by the host's clock.
    ensure!(
        (account.away_s - away_s).abs() < KEEPS_TIME_WITHIN_S,
        "{account:?}: away for {away_s} s"
    );
    let info = mocapd(User::Dialout, &["info", take])?;
    ensure!(info.stdout.contains("started again"), "{}", info.stdout);
    let sent = simulator.stop()?;
    ensure!(account.recorded > sent.produced, "{account:?}: no frame of before the cut");
    let off_ms = (account.away_s - away_s) * 1e3;
    Ok(format!(
        "{} frames, {away_s:.2} s away, of which the take has {off_ms:+.0} ms",
        account.recorded
    ))
}

pub(crate) fn power_cut() -> Measured {
    let bulk = cut_power(|| Simulator::bulk("POWER1", &ENDLESS), "/tmp/power-1.take")?;
    let port = cut_power(|| Simulator::port("POWER2", &ENDLESS), "/tmp/power-2.take")?;
    Ok(format!("bulk: {bulk}; CDC-ACM: {port}; the takes say so"))
}

pub(crate) fn another() -> Measured {
    let first = Simulator::bulk("SERIAL1", &ENDLESS)?;
    let mut recorder = record(&first.uri, "/tmp/serial.take", &["--reconnect", "6s"])?;
    recorder.has_recorded("/tmp/serial.take")?;
    let sent = first.stop()?;
    recorder.said("is gone: plug it in again", PATIENCE)?;
    wait_for_absence("SERIAL1")?;
    let second = Simulator::bulk("SERIAL2", &ENDLESS)?;
    recorder.said(
        "still waiting: usb:1209:0001:SERIAL1 (attached with these ids: usb:1209:0001:SERIAL2)",
        PATIENCE,
    )?;
    let ran = recorder.finish(PATIENCE * 3)?.with_code(3)?;
    ran.says(&["the device was disconnected: the take ends there"])?;
    let account = Account::of(&ran.json()?)?;
    account.closes()?;
    ensure!(account.recorded <= sent.produced, "{account:?} of {sent:?}: frames of another device");
    let asked = second.stop()?.produced;
    ensure!(asked == 0, "the other device was started");
    Ok("told which one is there and which is waited for; the other is left alone".to_owned())
}

pub(crate) fn never() -> Measured {
    let simulator = Simulator::bulk("NEVER1", &ENDLESS)?;
    let mut recorder = record(&simulator.uri, "/tmp/never.take", &["--reconnect", "2s"])?;
    recorder.has_recorded("/tmp/never.take")?;
    simulator.stop()?;
    let gone = recorder.said("is gone: plug it in again within 2 s", PATIENCE)?;
    let ran = recorder.finish(PATIENCE)?.with_code(3)?;
    let waited = gone.elapsed().as_secs_f64();
    let account = Account::of(&ran.json()?)?;
    account.closes().context("after the wait")?;
    ensure!(account.ending == "disconnected", "{account:?}");
    Ok(format!("ended {waited:.1} s after it was told that it waits 2 s"))
}
