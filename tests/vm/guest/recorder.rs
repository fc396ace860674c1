//! `mocapd`, as a user runs it, and what it says with the time of each line.

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

use crate::attached::{PATIENCE, wait_until};

/// Who runs it.
#[derive(Debug, Clone, Copy)]
pub(crate) enum User {
    /// In the group `dialout`, as our rules ask for.
    Dialout,
    /// In no group that matters.
    Nobody,
    /// Who may do anything.
    Root,
}

type Lines = Arc<Mutex<Vec<(Instant, String)>>>;

/// A command under way; killed when it is let go.
pub(crate) struct Mocapd {
    child: Killed,
    lines: Lines,
    stdout: JoinHandle<String>,
    stderr: JoinHandle<()>,
}

/// A process that a scenario which fails half way does not leave to the next one.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        // Does nothing to one that was waited for.
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// A command that ended.
#[derive(Debug)]
pub(crate) struct Ran {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs a command to its end.
pub(crate) fn mocapd(user: User, arguments: &[&str]) -> anyhow::Result<Ran> {
    Mocapd::start(user, arguments)?.finish(PATIENCE * 3)
}

/// Starts `record` into a new take, as a user of the group, with `--json`.
pub(crate) fn record(uri: &str, take: &str, more: &[&str]) -> anyhow::Result<Mocapd> {
    fs::remove_file(take).ok();
    let arguments = ["record", "--json", "-d", uri, "-o", take];
    Mocapd::start(User::Dialout, &[&arguments, more].concat())
}

impl Mocapd {
    pub(crate) fn start(user: User, arguments: &[&str]) -> anyhow::Result<Self> {
        Self::start_program("mocapd", user, arguments)
    }

    /// The same for another program.
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
        let mut child = Killed(child);
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

    /// When it said a line with these words; waits for it.
    pub(crate) fn said(&mut self, words: &str, within: Duration) -> anyhow::Result<Instant> {
        let lines = Arc::clone(&self.lines);
        let found = wait_until(&format!("the line '{words}'"), within, || {
            let lines = lines.lock().unwrap_or_else(PoisonError::into_inner);
            let line = lines.iter().find(|(_, line)| line.contains(words));
            if let Some((at, _)) = line {
                return Some(Some(*at));
            }
            self.child.0.try_wait().ok().flatten().map(|_| None)
        });
        match found {
            Ok(Some(at)) => Ok(at),
            Ok(None) => bail!("it ended without '{words}', and said: {}", self.words()),
            Err(error) => bail!("{error:#}; it said: {}", self.words()),
        }
    }

    fn words(&self) -> String {
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.iter().map(|(_, line)| line.as_str()).collect::<Vec<_>>().join(" / ")
    }

    /// Waits until the take has frames on disk.
    pub(crate) fn has_recorded(&mut self, take: &str) -> anyhow::Result<()> {
        let n_frames = || {
            let file = fs::File::open(take).ok()?;
            TakeFrames::open(file).ok().map(|frames| frames.info().n_frames)
        };
        let outcome = wait_until("the first frames on disk", PATIENCE, || {
            let is_over = self.child.0.try_wait().ok().flatten().is_some();
            (is_over || n_frames().is_some_and(|n| n > 0)).then_some(())
        });
        outcome.with_context(|| self.words())
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

    pub(crate) fn finish(mut self, within: Duration) -> anyhow::Result<Ran> {
        let status = match wait_until("mocapd's end", within, || self.child.0.try_wait().ok()?) {
            Ok(status) => status,
            Err(error) => bail!("{error:#}: it hangs, and said: {}", self.words()),
        };
        let stdout = self.stdout.join().unwrap_or_default();
        self.stderr.join().ok();
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        let stderr = lines.iter().map(|(_, line)| format!("{line}\n")).collect();
        Ok(Ran { code: status.code(), stdout, stderr })
    }
}

impl Ran {
    pub(crate) fn with_code(self, code: i32) -> anyhow::Result<Self> {
        ensure!(self.code == Some(code), "exit code {:?} and not {code}: {self:?}", self.code);
        Ok(self)
    }

    /// What it says, be it one line or several, has each of these in it.
    pub(crate) fn says(&self, words: &[&str]) -> anyhow::Result<()> {
        for word in words {
            ensure!(self.stderr.contains(word), "nothing of '{word}' in: {}", self.stderr);
        }
        Ok(())
    }

    pub(crate) fn json(&self) -> anyhow::Result<serde_json::Value> {
        serde_json::from_str(&self.stdout).with_context(|| format!("no JSON: {self:?}"))
    }
}
