//! Runs `mocapd` as a user would, and records its output with the time of each line.

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    os::unix::process::CommandExt,
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex, PoisonError},
    thread::{Builder, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context, bail, ensure};
use mocapd_take::{TakeFrames, motion::FrameSource};
use rustix::process::{Pid, Signal, kill_process};

use crate::attached::{TIMEOUT, wait_until};

/// The user who runs it.
#[derive(Debug, Clone, Copy)]
pub(crate) enum User {
    /// A member of the group `dialout`, as the udev rules require.
    Dialout,
    /// A member of no relevant group.
    Nobody,
    /// The superuser.
    Root,
}

type Lines = Arc<Mutex<Vec<(Instant, String)>>>;

/// A running command; killed when dropped.
pub(crate) struct Mocapd {
    child: KillOnDrop,
    lines: Lines,
    stdout: JoinHandle<String>,
    stderr: JoinHandle<()>,
}

/// Kills a process when dropped, so that a failing scenario does not leave it to the next one.
struct KillOnDrop(Child);

impl Drop for KillOnDrop {
    fn drop(&mut self) {
        // No effect after a wait.
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// The result of a finished command.
#[derive(Debug)]
pub(crate) struct CommandOutput {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs a command to its end.
pub(crate) fn mocapd(user: User, arguments: &[&str]) -> anyhow::Result<CommandOutput> {
    Mocapd::start(user, arguments)?.finish(TIMEOUT * 3)
}

/// Starts `mocapd record --json` into a new take, as a member of `dialout`.
pub(crate) fn record(uri: &str, take: &str, more: &[&str]) -> anyhow::Result<Mocapd> {
    fs::remove_file(take).ok();
    let arguments = ["record", "--json", "-d", uri, "-o", take];
    Mocapd::start(User::Dialout, &[&arguments, more].concat())
}

impl Mocapd {
    pub(crate) fn start(user: User, arguments: &[&str]) -> anyhow::Result<Self> {
        Self::start_program("mocapd", user, arguments)
    }

    /// Starts another program.
    pub(crate) fn start_program(
        program: &str,
        user: User,
        arguments: &[&str],
    ) -> anyhow::Result<Self> {
        const GUEST: u32 = 1000;
        const DIALOUT: u32 = 20;
        let (user, group) = match user {
            User::Dialout => (GUEST, DIALOUT),
            User::Nobody => (GUEST, GUEST),
            User::Root => (0, 0),
        };
        let child = Command::new(program)
            .args(arguments)
            .uid(user)
            .gid(group)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| program.to_owned())?;
        let mut child = KillOnDrop(child);
        let mut out = child.0.stdout.take().context("its stdout")?;
        let stdout = Builder::new().name("stdout".to_owned()).spawn(move || {
            let mut text = String::new();
            out.read_to_string(&mut text).ok();
            text
        })?;
        let lines = Lines::default();
        let (err, kept) = (child.0.stderr.take().context("its stderr")?, Arc::clone(&lines));
        let stderr = Builder::new().name("stderr".to_owned()).spawn(move || {
            for line in BufReader::new(err).lines().map_while(Result::ok) {
                kept.lock().unwrap_or_else(PoisonError::into_inner).push((Instant::now(), line));
            }
        })?;
        Ok(Self { child, lines, stdout, stderr })
    }

    /// Waits for a line on stderr that contains `text`; returns its time.
    pub(crate) fn wait_for_line(&mut self, text: &str, limit: Duration) -> anyhow::Result<Instant> {
        let lines = Arc::clone(&self.lines);
        let found = wait_until(&format!("the line '{text}'"), limit, || {
            let lines = lines.lock().unwrap_or_else(PoisonError::into_inner);
            let line = lines.iter().find(|(_, line)| line.contains(text));
            if let Some((at, _)) = line {
                return Some(Some(*at));
            }
            self.child.0.try_wait().ok().flatten().map(|_| None)
        });
        match found {
            Ok(Some(at)) => Ok(at),
            Ok(None) => bail!("it ended without '{text}'; stderr: {}", self.log_text()),
            Err(error) => bail!("{error:#}; stderr: {}", self.log_text()),
        }
    }

    fn log_text(&self) -> String {
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.iter().map(|(_, line)| line.as_str()).collect::<Vec<_>>().join(" / ")
    }

    /// Waits until the take has frames on disk.
    pub(crate) fn has_recorded(&mut self, take: &str) -> anyhow::Result<()> {
        let n_frames = || {
            let file = fs::File::open(take).ok()?;
            TakeFrames::open(file).ok().map(|frames| frames.info().n_frames)
        };
        let outcome = wait_until("the first frames on disk", TIMEOUT, || {
            let is_over = self.child.0.try_wait().ok().flatten().is_some();
            (is_over || n_frames().is_some_and(|n| n > 0)).then_some(())
        });
        outcome.with_context(|| self.log_text())
    }

    pub(crate) fn interrupt(&self) -> anyhow::Result<()> {
        Ok(kill_process(Pid::from_child(&self.child.0), Signal::INT)?)
    }

    /// Whether it has ended.
    pub(crate) fn ended(&mut self) -> Option<()> {
        self.child.0.try_wait().ok().flatten().map(drop)
    }

    /// Processor time so far, in seconds.
    pub(crate) fn processor_s(&self) -> anyhow::Result<f64> {
        const TICKS_PER_S: f64 = 100.0;
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.child.0.id()))?;
        let after_name = stat.rsplit_once(')').context("its name")?.1;
        let ticks = after_name.split_whitespace().skip(11).take(2).flat_map(str::parse::<f64>);
        Ok(ticks.sum::<f64>() / TICKS_PER_S)
    }

    pub(crate) fn finish(mut self, within: Duration) -> anyhow::Result<CommandOutput> {
        let status = match wait_until("mocapd's end", within, || self.child.0.try_wait().ok()?) {
            Ok(status) => status,
            Err(error) => bail!("{error:#}: it hangs; stderr: {}", self.log_text()),
        };
        let stdout = self.stdout.join().unwrap_or_default();
        self.stderr.join().ok();
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        let stderr = lines.iter().map(|(_, line)| format!("{line}\n")).collect();
        Ok(CommandOutput { code: status.code(), stdout, stderr })
    }
}

impl CommandOutput {
    pub(crate) fn with_code(self, code: i32) -> anyhow::Result<Self> {
        ensure!(self.code == Some(code), "exit code {:?} and not {code}: {self:?}", self.code);
        Ok(self)
    }

    /// Fails unless stderr contains all of these facts.
    pub(crate) fn mentions(&self, facts: &[&str]) -> anyhow::Result<()> {
        for fact in facts {
            ensure!(self.stderr.contains(fact), "nothing of '{fact}' in: {}", self.stderr);
        }
        Ok(())
    }

    pub(crate) fn json(&self) -> anyhow::Result<serde_json::Value> {
        serde_json::from_str(&self.stdout).with_context(|| format!("no JSON: {self:?}"))
    }
}
