//! The rig `sim`: its configuration, its units, and its users.

use std::{
    fs,
    net::UdpSocket,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::atomic::{AtomicU32, Ordering},
    time::{Duration, Instant},
};

use anyhow::{Context, ensure};

use crate::attached::wait_until;

/// Five times the longest wait on a loaded machine.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(40);

pub(crate) const UNIT: &str = "mocapd@sim";
pub(crate) const TAKES: &str = "/var/lib/mocapd/sim";
const CONFIG: &str = "/etc/mocapd/sim.toml";
const DROP_IN: &str = "/run/systemd/system/mocapd@sim.service.d";

/// The user who runs a command.
#[derive(Debug, Clone, Copy)]
pub(crate) enum User {
    Root,
    /// A member of the group `mocapd`.
    Member,
    /// A member of no relevant group.
    Stranger,
}

/// Stops the units of the scenario before, and clears their failures.
pub(crate) fn prepare() -> anyhow::Result<()> {
    let units = ["mocapd@*.service", "mocapd-sim@*.service"];
    run(User::Root, "systemctl", &[&["stop"][..], &units].concat())?;
    run(User::Root, "systemctl", &["reset-failed"])?;
    if Path::new(DROP_IN).exists() {
        fs::remove_dir_all(DROP_IN)?;
        ok("systemctl", &["daemon-reload"])?;
    }
    Ok(())
}

pub(crate) fn run(user: User, program: &str, arguments: &[&str]) -> anyhow::Result<Output> {
    let mut command = match user {
        User::Root => Command::new(program),
        User::Member | User::Stranger => Command::new("setpriv"),
    };
    match user {
        User::Root => {}
        User::Member => {
            let group = format!("--groups={}", id_of("mocapd", "/etc/group")?);
            command.args(["--reuid=1000", "--regid=1000", &group, program]);
        }
        User::Stranger => {
            command.args(["--reuid=1001", "--regid=1001", "--clear-groups", program]);
        }
    }
    command.args(arguments).output().context(program.to_owned())
}

/// Runs a command as root and returns its stdout; fails if the command fails.
pub(crate) fn ok(program: &str, arguments: &[&str]) -> anyhow::Result<String> {
    stdout_of(&run(User::Root, program, arguments)?, program, arguments)
}

pub(crate) fn stdout_of(output: &Output, program: &str, args: &[&str]) -> anyhow::Result<String> {
    let stderr = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{program} {args:?}: {}: {stderr}", output.status);
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// The id of a user or group.
pub(crate) fn id_of(name: &str, file: &str) -> anyhow::Result<u32> {
    let text = fs::read_to_string(file)?;
    let line = text.lines().find(|line| line.starts_with(&format!("{name}:")));
    let id = line
        .and_then(|line| line.split(':').nth(2))
        .with_context(|| format!("{name} in {file}"))?;
    Ok(id.parse()?)
}

pub(crate) fn show(unit: &str, property: &str) -> anyhow::Result<String> {
    Ok(ok("systemctl", &["show", "-P", property, unit])?.trim().to_owned())
}

/// Writes the supplied `sim.toml`, with a port for triggers and further lines appended.
pub(crate) fn configure(more: &str) -> anyhow::Result<()> {
    let shipped = fs::read_to_string("/usr/share/doc/mocapd/examples/sim.toml")?;
    let trigger = format!("[trigger]\nlisten = \"127.0.0.1:{}\"", SIM.port);
    Ok(fs::write(CONFIG, format!("{shipped}\n{trigger}\n{more}\n"))?)
}

/// Does what `systemctl edit` would do.
pub(crate) fn edit(lines: &str) -> anyhow::Result<()> {
    fs::create_dir_all(DROP_IN)?;
    fs::write(format!("{DROP_IN}/edit.conf"), format!("[Service]\n{lines}\n"))?;
    ok("systemctl", &["daemon-reload"]).map(drop)
}

/// Starts both units.
pub(crate) fn start() -> anyhow::Result<()> {
    ok("systemctl", &["start", "mocapd-sim@sim"])?;
    wait_until("the simulated rig", TIMEOUT, || {
        Path::new("/run/mocapd-sim/sim/rig").exists().then_some(())
    })?;
    ok("systemctl", &["start", UNIT])?;
    Ok(())
}

/// A rig and its UDP port for capture triggers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rig {
    pub(crate) name: &'static str,
    pub(crate) port: u16,
}

pub(crate) const SIM: Rig = Rig { name: "sim", port: 8989 };

/// Unique numbers for triggers and takes.
static NUMBER: AtomicU32 = AtomicU32::new(1);

impl Rig {
    fn send(self, element: &str, name: &str) -> anyhow::Result<()> {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let text = format!(
            "<{element}><Name VALUE=\"{name}\"/><PacketID VALUE=\"{number}\"/></{element}>"
        );
        let socket = UdpSocket::bind("127.0.0.1:0")?;
        socket.send_to(text.as_bytes(), ("127.0.0.1", self.port))?;
        Ok(())
    }

    /// Runs `mocapd ctl` against the rig's service.
    pub(crate) fn ctl(self, user: User, arguments: &[&str]) -> anyhow::Result<Output> {
        let socket = format!("unix:/run/mocapd/{}/mocapd.sock", self.name);
        run(user, "mocapd", &[&["ctl", "--connect", &socket][..], arguments].concat())
    }

    fn new_take(self) -> (String, String) {
        let name = format!("take-{}", NUMBER.fetch_add(1, Ordering::Relaxed));
        let take = format!("/var/lib/mocapd/{}/{name}.take", self.name);
        (name, take)
    }

    /// Starts a take; returns its file. Retries while the service has not found a new device yet.
    pub(crate) fn begin(self) -> anyhow::Result<String> {
        let (name, take) = self.new_take();
        let mut last = String::new();
        let begun = wait_until(&format!("{take} to begin"), TIMEOUT, || {
            let output = self.ctl(User::Member, &["start", "--name", &name]).ok()?;
            last = String::from_utf8_lossy(&output.stderr).into_owned();
            if !output.status.success() {
                std::thread::sleep(Duration::from_millis(300));
            }
            output.status.success().then_some(())
        });
        begun.with_context(|| last)?;
        Ok(take)
    }

    /// Stops the take. `code` is the exit code: 3 if frames are missing.
    pub(crate) fn end(self, code: i32) -> anyhow::Result<()> {
        let output = self.ctl(User::Member, &["stop"])?;
        let stderr = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.code() == Some(code), "stop: {}: {stderr}", output.status);
        Ok(())
    }

    /// Starts and stops a take over UDP, as other programs do; returns its file.
    pub(crate) fn trigger(self, length: Duration) -> anyhow::Result<String> {
        let (name, take) = self.new_take();
        wait_until(&format!("{take} to begin"), TIMEOUT, || {
            self.send("CaptureStart", &name).ok()?;
            std::thread::sleep(Duration::from_millis(500));
            frames_so_far(&take).filter(|&n| n > 0)
        })?;
        std::thread::sleep(length);
        self.send("CaptureStop", &name)?;
        wait_until(&format!("{take} to end"), TIMEOUT, || frames(&take, 0).ok())?;
        Ok(take)
    }
}

fn frames_so_far(take: &str) -> Option<u64> {
    let output = run(User::Root, "mocapd", &["info", "--json", take]).ok()?;
    serde_json::from_slice::<serde_json::Value>(&output.stdout).ok()?["frames"].as_u64()
}

/// The takes of the rig, by name.
pub(crate) fn takes() -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(TAKES)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "take") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Frames of a take, by `mocapd info`; `code` is its exit code.
pub(crate) fn frames(take: &str, code: i32) -> anyhow::Result<u64> {
    let output = run(User::Member, "mocapd", &["info", "--json", take])?;
    let stderr = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.code() == Some(code), "info {take}: {}: {stderr}", output.status);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    json["frames"].as_u64().context("no frames in the JSON")
}

/// The lines of the unit's journal, as JSON objects.
pub(crate) fn journal(unit: &str) -> anyhow::Result<Vec<serde_json::Value>> {
    ok("journalctl", &["--sync"])?;
    let text = ok("journalctl", &["--no-pager", "-o", "json", "-u", unit])?;
    text.lines().map(|line| Ok(serde_json::from_str(line)?)).collect()
}

/// Waits until the unit is up again after this many restarts; returns how long that took.
pub(crate) fn restarted(times: u32) -> anyhow::Result<Duration> {
    let began = Instant::now();
    wait_until("a restart", TIMEOUT, || {
        let restarts = show(UNIT, "NRestarts").ok()?.parse::<u32>().ok()?;
        (restarts >= times && show(UNIT, "ActiveState").ok()? == "active").then_some(())
    })?;
    Ok(began.elapsed())
}
