//! The life of a service: start, recording, reload and stop.

use std::{
    fs,
    net::TcpStream,
    os::unix::fs::MetadataExt,
    thread::sleep,
    time::{Duration, Instant},
};

use anyhow::{Context, ensure};

use super::rig::{
    SIM, TAKES, TIMEOUT, UNIT, User, configure, frames, id_of, ok, run, show, start, stdout_of,
};
use crate::{Measurement, attached::wait_until};

/// Time limit of a stop during a recording.
const STOP_WITHIN: Duration = Duration::from_secs(5);

pub(crate) fn ready_without_a_device() -> Measurement {
    configure("")?;
    let began = Instant::now();
    // Waits for READY=1, since the type is notify.
    ok("systemctl", &["start", UNIT])?;
    let ready_s = began.elapsed().as_secs_f64();
    ensure!(
        show(UNIT, "Type")? == "notify" && show(UNIT, "ActiveState")? == "active",
        "not active"
    );
    let absent = show(UNIT, "StatusText")?;
    ensure!(!absent.is_empty(), "no status");
    ok("systemctl", &["start", "mocapd-sim@sim"])?;
    let present = wait_until("another status", TIMEOUT, || {
        let status = show(UNIT, "StatusText").ok()?;
        (status != absent).then_some(status)
    })?;
    Ok(format!("ready after {ready_s:.1} s: '{absent}', then '{present}'"))
}

pub(crate) fn refused() -> Measurement {
    configure("[no_such_part]\nx = 1")?;
    let output = run(User::Root, "systemctl", &["start", UNIT])?;
    ensure!(!output.status.success(), "it started");
    sleep(Duration::from_secs(3));
    let restarts = show(UNIT, "NRestarts")?;
    ensure!(restarts == "0", "{restarts} restarts in vain");
    ensure!(show(UNIT, "ExecMainStatus")? == "2", "{}", show(UNIT, "ExecMainStatus")?);
    let lines = super::rig::journal(UNIT)?;
    let reported =
        lines.iter().any(|line| line["MESSAGE"].as_str().unwrap_or("").contains("no_such_part"));
    ensure!(reported, "the journal does not say why");
    Ok("exit code 2, reported in the journal, and not tried again".to_owned())
}

pub(crate) fn records() -> Measurement {
    configure("")?;
    start()?;
    let take = SIM.begin()?;
    sleep(Duration::from_secs(5));
    SIM.end(0)?;
    let meta = fs::metadata(&take)?;
    let (user, group) = (id_of("mocapd", "/etc/passwd")?, id_of("mocapd", "/etc/group")?);
    let owned = (meta.mode() & 0o777, meta.uid(), meta.gid());
    ensure!(owned == (0o640, user, group), "{take}: {owned:?}");
    ensure!(fs::metadata(TAKES)?.mode() & 0o777 == 0o750, "{TAKES}");
    let n = frames(&take, 0)?;
    ensure!(n > 100, "{n} frames");
    let verified = ["verify", &take];
    stdout_of(&run(User::Member, "mocapd", &verified)?, "mocapd", &verified)?;
    let hidden = run(User::Stranger, "mocapd", &["info", &take])?;
    ensure!(!hidden.status.success(), "a stranger reads takes");
    Ok(format!("{n} frames in five seconds, 0640 mocapd:mocapd, sound; hidden from strangers"))
}

pub(crate) fn group_access() -> Measurement {
    configure("")?;
    start()?;
    // Through the rig's own socket, through the default socket, and over TCP.
    let status = ["ctl", "status"];
    wait_until("the group to be let in", TIMEOUT, || {
        SIM.ctl(User::Member, &["status"]).ok()?.status.success().then_some(())
    })?;
    stdout_of(&run(User::Member, "mocapd", &status)?, "mocapd", &status)?;
    TcpStream::connect("127.0.0.1:7060").context("TCP on this machine")?;
    let refused = SIM.ctl(User::Stranger, &["status"])?;
    ensure!(!refused.status.success(), "a stranger may ask");
    let stderr = String::from_utf8_lossy(&refused.stderr);
    Ok(format!("the group by socket and TCP; a stranger gets '{}'", stderr.trim()))
}

pub(crate) fn triggered() -> Measurement {
    configure("")?;
    start()?;
    let take = SIM.trigger(Duration::from_secs(1))?;
    Ok(format!("a take of {} frames by UDP", frames(&take, 0)?))
}

pub(crate) fn reloads() -> Measurement {
    configure("")?;
    start()?;
    let pid = show(UNIT, "MainPID")?;
    SIM.begin()?;
    configure("[log]\nlevel = \"debug\"")?;
    ok("systemctl", &["reload", UNIT])?;
    wait_until("to be active again", TIMEOUT, || {
        (show(UNIT, "ActiveState").ok()? == "active").then_some(())
    })?;
    sleep(Duration::from_secs(1));
    ensure!(show(UNIT, "MainPID")? == pid, "a reload restarted it");
    SIM.end(0).context("the take went on")?;
    configure("[no_such_part]\nx = 1")?;
    ok("systemctl", &["reload", UNIT])?;
    sleep(Duration::from_secs(1));
    ensure!(show(UNIT, "MainPID")? == pid, "a configuration that is refused ended it");
    ensure!(show(UNIT, "ActiveState")? == "active", "not active");
    SIM.begin()?;
    SIM.end(0)?;
    Ok("in the midst of a take, and with a configuration that is refused".to_owned())
}

pub(crate) fn journal() -> Measurement {
    super::rig::journal(UNIT).map(drop)?;
    configure("")?;
    start()?;
    SIM.begin()?;
    SIM.end(0)?;
    let lines = super::rig::journal(UNIT)?;
    let ours: Vec<_> = lines.iter().filter(|line| line["SYSLOG_IDENTIFIER"] == "mocapd").collect();
    let has = |field: &str| ours.iter().filter(|line| line[field].is_string()).count();
    let counts = [has("MOCAPD_RIG"), has("MOCAPD_TAKE"), has("MOCAPD_DEVICE")];
    ensure!(counts.iter().all(|&n| n > 0), "rig, take, device: {counts:?} of {}", ours.len());
    ensure!(ours.iter().any(|line| line["MOCAPD_RIG"] == "sim"), "another rig");
    let found = ok("journalctl", &["--no-pager", "-o", "cat", "MOCAPD_RIG=sim"])?;
    ensure!(found.lines().count() > 0, "journalctl MOCAPD_RIG=sim finds nothing");
    let levels = ours.iter().all(|line| line["PRIORITY"].is_string());
    ensure!(levels, "lines without a priority");
    Ok(format!("rig, take and device in {counts:?} of {} lines", ours.len()))
}

pub(crate) fn stops() -> Measurement {
    configure("")?;
    start()?;
    let take = SIM.begin()?;
    sleep(Duration::from_secs(2));
    let began = Instant::now();
    ok("systemctl", &["stop", UNIT])?;
    let took = began.elapsed();
    ensure!(took < STOP_WITHIN, "{:.1} s", took.as_secs_f64());
    ensure!(show(UNIT, "Result")? == "success", "{}", show(UNIT, "Result")?);
    let n = frames(&take, 0)?;
    let verified = ["verify", &take];
    stdout_of(&run(User::Member, "mocapd", &verified)?, "mocapd", &verified)?;
    Ok(format!("{:.1} s, and a finished take of {n} frames", took.as_secs_f64()))
}
