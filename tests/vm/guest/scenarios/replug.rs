//! Cables pulled during a recording.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context, ensure};

use crate::{
    Measurement,
    attached::{TIMEOUT, run, wait_for_absence, wait_until},
    ledger::LedgerReport,
    recorder::{Mocapd, User, mocapd, record},
    simulator::Simulator,
};

/// Limits of the recorder's reaction to a cable.
struct Limits {
    /// From the pull to the line that reports it.
    acted: Duration,
    /// From the replug to the device's being recorded again.
    back: Duration,
}

/// A recorder that did not see transfers fail would notice the device's silence after 5 s; one that neither polled nor
/// was told of new devices would not find it again. An emulated machine beside other load takes up to 0.2 s for the
/// first and 1 s for the second.
const BESIDE_OTHERS: Limits =
    Limits { acted: Duration::from_secs(2), back: Duration::from_secs(10) };

/// On an otherwise idle machine the recorder reacts as soon as a transfer fails.
const ALONE: Limits = Limits { acted: Duration::from_millis(100), back: Duration::from_secs(2) };

impl Limits {
    fn check(&self, acted: Duration, back: Duration) -> anyhow::Result<()> {
        ensure!(acted < self.acted, "acted on after {} ms", acted.as_millis());
        ensure!(back < self.back, "recorded again after {} ms", back.as_millis());
        Ok(())
    }
}

/// Tolerance of the outage's duration in the take of a device that lost its power: the simulator is killed and started
/// again, and its first frame comes a little after it is back.
const KEEPS_TIME_WITHIN_S: f64 = 0.6;

/// Frames of a second, for which a busy machine may pause the device.
const STOOD_STILL_MAX: u64 = 240;

const ENDLESS: [&str; 5] = ["--rate", "240", "--markers", "24", "--loop"];

/// Duration of the outage, and of the recording before and after it.
const WHILE: Duration = Duration::from_millis(1500);

fn pull_and_plug(simulator: Simulator, take: &str, limits: &Limits) -> Measurement {
    let mut recorder = record(&simulator.uri, take, &[])?;
    recorder.has_recorded(take)?;
    sleep(WHILE);
    let (controller, pulled) = simulator.unplug()?;
    let acted = recorder.wait_for_line("is gone: plug it in again", TIMEOUT)? - pulled;
    sleep(WHILE);
    let plugged = simulator.plug(&controller)?;
    let back = recorder.wait_for_line("the device is back", TIMEOUT)? - plugged;
    sleep(WHILE);
    let ledger = ended(recorder, take)?;
    let sent = simulator.stop()?;
    let lost_frames = ledger.unknown;
    // Only the simulator knows of frames sent after the last one that arrived. While the host is slow between Stop and
    // Start, the counter stands still, and the take keeps time by the device's clock.
    ensure!(
        ledger.frames_sent <= sent.produced + STOOD_STILL_MAX
            && sent.produced <= ledger.frames_sent + 240,
        "{ledger:?} of {sent:?}"
    );
    ensure!(lost_frames >= 240, "an outage of more than a second, and {ledger:?}");
    limits.check(acted, back)?;
    Ok(format!(
        "acted on after {} ms, recorded again {} ms after the replug; {} of {} frames, {lost_frames} in the gap",
        acted.as_millis(),
        back.as_millis(),
        ledger.recorded,
        ledger.frames_sent
    ))
}

/// Stops the recorder by Ctrl-C; checks that the take is complete and reports the outage.
fn ended(recorder: Mocapd, take: &str) -> anyhow::Result<LedgerReport> {
    recorder.interrupt()?;
    let ran = recorder.finish(TIMEOUT)?.with_code(3)?;
    let ledger = LedgerReport::of(&ran.json()?)?;
    ledger.closes()?;
    ensure!(ledger.ending == "stopped", "{ledger:?}: {}", ran.stderr);
    let info = mocapd(User::Dialout, &["info", take])?;
    for event in ["the device was disconnected", "the device is back after"] {
        ensure!(info.stdout.contains(event), "no event '{event}' in {}", info.stdout);
    }
    Ok(ledger)
}

pub(crate) fn bulk() -> Measurement {
    pull_and_plug(Simulator::bulk("PLUG1", &ENDLESS)?, "/tmp/plug-1.take", &BESIDE_OTHERS)
}

pub(crate) fn port() -> Measurement {
    pull_and_plug(Simulator::port("PLUG2", &ENDLESS)?, "/tmp/plug-2.take", &BESIDE_OTHERS)
}

/// Needs the whole machine.
pub(crate) fn alone() -> Measurement {
    let bulk = pull_and_plug(Simulator::bulk("PLUG4", &ENDLESS)?, "/tmp/plug-4.take", &ALONE)?;
    let port = pull_and_plug(Simulator::port("PLUG5", &ENDLESS)?, "/tmp/plug-5.take", &ALONE)?;
    Ok(format!("bulk: {bulk}; CDC-ACM: {port}"))
}

/// Without udev there are no notifications of new devices: the recorder has to poll.
pub(crate) fn without_udev() -> Measurement {
    let simulator = Simulator::bulk("PLUG3", &ENDLESS)?;
    let mut recorder = record(&simulator.uri, "/tmp/plug-3.take", &[])?;
    recorder.has_recorded("/tmp/plug-3.take")?;
    run("udevadm", &["control", "--exit"])?;
    let measured = (|| -> Measurement {
        let (controller, pulled) = simulator.unplug()?;
        let acted = recorder.wait_for_line("is gone: plug it in again", TIMEOUT)? - pulled;
        sleep(WHILE);
        let plugged = simulator.plug(&controller)?;
        // Without udev, permissions have to be set in another way.
        open_to_all("PLUG3")?;
        let back = recorder.wait_for_line("the device is back", TIMEOUT)? - plugged;
        BESIDE_OTHERS.check(acted, back)?;
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

    let node = wait_until("the device", TIMEOUT, || {
        let all = mocapd_drivers::transport::usb::devices().ok()?;
        let found = all.into_iter().find(|device| device.serial.as_deref() == Some(serial))?;
        found.node.exists().then_some(found.node)
    })?;
    Ok(std::fs::set_permissions(node, PermissionsExt::from_mode(0o666))?)
}

/// A loss of power: the device's counter and clock restart.
fn cut_power(plug_in: impl Fn() -> anyhow::Result<Simulator>, take: &str) -> Measurement {
    let simulator = plug_in()?;
    let uri = simulator.uri.clone();
    let mut recorder = record(&uri, take, &[])?;
    recorder.has_recorded(take)?;
    let cut = Instant::now();
    simulator.kill()?;
    let simulator = plug_in()?;
    let away_s = (recorder.wait_for_line("the device is back", TIMEOUT)? - cut).as_secs_f64();
    sleep(WHILE);
    let ledger = ended(recorder, take)?;
    // The device's counter does not cover the outage: the take measures it by the host's clock.
    ensure!(
        (ledger.away_s - away_s).abs() < KEEPS_TIME_WITHIN_S,
        "{ledger:?}: away for {away_s} s"
    );
    let info = mocapd(User::Dialout, &["info", take])?;
    ensure!(info.stdout.contains("restarted"), "{}", info.stdout);
    let sent = simulator.stop()?;
    ensure!(ledger.recorded > sent.produced, "{ledger:?}: no frame of before the cut");
    let off_ms = (ledger.away_s - away_s) * 1e3;
    Ok(format!(
        "{} frames, {away_s:.2} s away, of which the take has {off_ms:+.0} ms",
        ledger.recorded
    ))
}

pub(crate) fn power_cut() -> Measurement {
    let bulk = cut_power(|| Simulator::bulk("POWER1", &ENDLESS), "/tmp/power-1.take")?;
    let port = cut_power(|| Simulator::port("POWER2", &ENDLESS), "/tmp/power-2.take")?;
    Ok(format!("bulk: {bulk}; CDC-ACM: {port}; the takes say so"))
}

pub(crate) fn another() -> Measurement {
    let first = Simulator::bulk("SERIAL1", &ENDLESS)?;
    let mut recorder = record(&first.uri, "/tmp/serial.take", &["--reconnect", "6s"])?;
    recorder.has_recorded("/tmp/serial.take")?;
    let sent = first.stop()?;
    recorder.wait_for_line("is gone: plug it in again", TIMEOUT)?;
    wait_for_absence("SERIAL1")?;
    let second = Simulator::bulk("SERIAL2", &ENDLESS)?;
    recorder.wait_for_line(
        "still waiting: usb:1209:0001:SERIAL1 (attached with these ids: usb:1209:0001:SERIAL2)",
        TIMEOUT,
    )?;
    let ran = recorder.finish(TIMEOUT * 3)?.with_code(3)?;
    ran.mentions(&["the device was disconnected: the take ends there"])?;
    let ledger = LedgerReport::of(&ran.json()?)?;
    ledger.closes()?;
    ensure!(ledger.recorded <= sent.produced, "{ledger:?} of {sent:?}: frames of another device");
    let asked = second.stop()?.produced;
    ensure!(asked == 0, "the other device was started");
    Ok("reports the device attached and the one awaited; leaves the other alone".to_owned())
}

pub(crate) fn never() -> Measurement {
    let simulator = Simulator::bulk("NEVER1", &ENDLESS)?;
    let mut recorder = record(&simulator.uri, "/tmp/never.take", &["--reconnect", "2s"])?;
    recorder.has_recorded("/tmp/never.take")?;
    simulator.stop()?;
    let gone = recorder.wait_for_line("is gone: plug it in again within 2 s", TIMEOUT)?;
    let ran = recorder.finish(TIMEOUT)?.with_code(3)?;
    let waited = gone.elapsed().as_secs_f64();
    let ledger = LedgerReport::of(&ran.json()?)?;
    ledger.closes().context("after the wait")?;
    ensure!(ledger.ending == "disconnected", "{ledger:?}");
    Ok(format!("ended {waited:.1} s after announcing a wait of 2 s"))
}
