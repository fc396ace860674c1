//! Services that are killed or whose data plane hangs.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context, ensure};

use super::rig::{
    SIM, TAKES, TIMEOUT, UNIT, User, configure, edit, frames, journal, ok, restarted, run, show,
    start,
};
use crate::{Measurement, attached::wait_until};

pub(crate) fn killed() -> Measurement {
    configure("")?;
    start()?;
    let take = SIM.begin()?;
    sleep(Duration::from_secs(3));
    ok("systemctl", &["kill", "-s", "KILL", UNIT])?;
    let took = restarted(1)?;
    // The service recovers the take into a new file.
    let recovered = take.replace(".take", ".recovered.take");
    let n = wait_until("the take to be recovered", TIMEOUT, || frames(&recovered, 3).ok())?;
    ensure!(n > 100, "{n} frames of the killed take");
    let next = SIM.begin()?;
    SIM.end(0)?;
    // The number of samples after the cut is unknown.
    for (take, code) in [(&recovered, 3), (&next, 0)] {
        let verified = run(User::Member, "mocapd", &["verify", take])?;
        let stderr = String::from_utf8_lossy(&verified.stderr);
        ensure!(
            verified.status.code() == Some(code),
            "verify {take}: {}: {stderr}",
            verified.status
        );
    }
    let took_s = took.as_secs_f64();
    Ok(format!("up again after {took_s:.1} s, {n} frames recovered, and the next take is sound"))
}

/// The watchdog's limit in this scenario; with the unit's own, the scenario would take a minute.
const WATCHDOG_S: u64 = 8;

pub(crate) fn hangs() -> Measurement {
    configure("")?;
    let mut measured = Vec::new();
    for whom in ["reader", "worker", "writer"] {
        edit(&format!(
            "ExecStart=\nExecStart=/opt/hanging/mocapd run --config /etc/mocapd/sim.toml\n\
             WatchdogSec={WATCHDOG_S}\nEnvironment=MOCAPD_HANG={whom}"
        ))?;
        start()?;
        let take = SIM.begin()?;
        sleep(Duration::from_secs(2));
        let pid = show(UNIT, "MainPID")?;
        let began = Instant::now();
        ok("systemctl", &["kill", "--kill-whom=main", "-s", "USR2", UNIT])?;
        wait_until("the watchdog", TIMEOUT, || (show(UNIT, "MainPID").ok()? != pid).then_some(()))
            .with_context(|| format!("a {whom} that hangs"))?;
        let noticed_s = began.elapsed().as_secs_f64();
        restarted(1)?;
        let lines = journal(UNIT)?;
        let logged = |text: &str| {
            lines.iter().any(|line| line["MESSAGE"].as_str().unwrap_or("").contains(text))
        };
        ensure!(logged("Watchdog timeout"), "another end of a {whom} that hangs");
        ensure!(
            logged(&format!("the {whom} has been stuck for")),
            "no line about the {whom} that hangs"
        );
        let n = frames(&take, 3)?;
        ensure!(n > 0, "nothing of the take in {TAKES} before it hung");
        measured.push(format!("{whom} after {noticed_s:.0} s"));
        ok("systemctl", &["stop", UNIT, "mocapd-sim@sim"])?;
        ok("systemctl", &["reset-failed"])?;
    }
    Ok(format!("WatchdogSec={WATCHDOG_S}: restarted with a hanging {}", measured.join(", ")))
}
