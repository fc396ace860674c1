//! Notifies systemd that the service is ready, of its status, and that its data plane is making progress.
//!
//! Without systemd, notifications do nothing.

use std::{
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::Context;
use crossbeam_channel::{RecvTimeoutError, Sender, bounded};
use mocapd_take::escape::visible;
use sd_notify::NotifyState;

use mocapd_acquire::threads;
pub use mocapd_acquire::threads::{Heartbeat, HeartbeatHandle, ThreadRole};

/// Longest status text in bytes: `systemctl status` shows one line.
const STATUS_BYTES_MAX: usize = 512;

/// Notifies the service manager, if one started this process.
#[derive(Debug, Clone, Default)]
pub struct Notifier {
    status: String,
}

impl Notifier {
    /// Reports that the service is ready, so that units waiting for it can start. `status` may say that the device is
    /// missing.
    pub fn ready(&mut self, status: &str) {
        self.status = one_line(status);
        send(&[NotifyState::Ready, NotifyState::Status(&self.status)]);
    }

    /// Reports a status text, unless it has not changed.
    pub fn status(&mut self, status: &str) {
        let status = one_line(status);
        if status != self.status {
            send(&[NotifyState::Status(&status)]);
            self.status = status;
        }
    }

    /// Reports that the configuration is being reloaded, until the next [`ready`](Self::ready).
    pub fn reloading(&mut self) {
        self.status = "reloading the configuration".to_owned();
        match NotifyState::monotonic_usec_now() {
            Ok(now) => send(&[NotifyState::Reloading, now, NotifyState::Status(&self.status)]),
            Err(_) => send(&[NotifyState::Reloading, NotifyState::Status(&self.status)]),
        }
    }

    /// Reports that the service is stopping; `status` says what it is still doing, such as finishing a take.
    pub fn stopping(&mut self, status: &str) {
        self.status = one_line(status);
        send(&[NotifyState::Stopping, NotifyState::Status(&self.status)]);
    }

    /// Starts a thread that pings the watchdog while every thread in `heartbeat` makes progress, until the returned
    /// value is dropped. `None` if the watchdog is off.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn watch(heartbeat: &Heartbeat) -> anyhow::Result<Option<Pings>> {
        let Some(watchdog) = sd_notify::watchdog_enabled().filter(|time| !time.is_zero()) else {
            return Ok(None);
        };
        // A stalled thread is detected after half the watchdog's time, and pings then stop. Two checks fit into that
        // half.
        let (limit, every) = (watchdog / 2, watchdog / 4);
        let heartbeat = heartbeat.clone();
        let (stop, stopped) = bounded::<()>(1);
        let thread = threads::spawn("mocapd-notify", move || {
            let mut watch = heartbeat.watchdog(Instant::now());
            let mut is_reported = false;
            loop {
                match watch.overdue(Instant::now(), limit) {
                    None => {
                        send(&[NotifyState::Watchdog]);
                        is_reported = false;
                    }
                    Some(overdue) if !is_reported => {
                        tracing::error!(
                            "{overdue}: not pinging the watchdog, so systemd will restart the service"
                        );
                        send(&[NotifyState::Status(&format!("{overdue}"))]);
                        is_reported = true;
                    }
                    Some(_) => {}
                }
                if stopped.recv_timeout(every) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
        })
        .context("cannot start the watchdog thread")?;
        Ok(Some(Pings { stop: Some(stop), thread: Some(thread) }))
    }
}

/// Pings the watchdog until it is dropped.
#[derive(Debug)]
pub struct Pings {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Pings {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

/// Asks systemd to wait this much longer for the service to stop, regardless of `TimeoutStopSec=`.
pub(super) fn extend_stop(by: Duration) {
    let usec = u32::try_from(by.as_micros()).unwrap_or(u32::MAX);
    send(&[NotifyState::ExtendTimeoutUsec(usec)]);
}

fn send(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::warn!("cannot notify systemd: {error}");
    }
}

/// Makes a text safe for one assignment of the protocol: a line break would begin another.
fn one_line(text: &str) -> String {
    let mut line = visible(text).into_owned();
    line.truncate(line.floor_char_boundary(STATUS_BYTES_MAX));
    line
}

#[cfg(test)]
mod tests {
    use std::{
        os::unix::net::UnixDatagram,
        path::Path,
        process::{Command, ExitStatus},
        time::Duration,
    };

    use super::*;

    /// Runs `scene` in its own process and collects the messages it sends to a socket in place of systemd's. The
    /// environment belongs to a whole process, and tests share one.
    fn messages_of(scene: &str, watchdog_usec: Option<u64>) -> (Vec<String>, ExitStatus) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        let mut child = child(scene, &path);
        if let Some(usec) = watchdog_usec {
            child.env("WATCHDOG_USEC", usec.to_string());
        }
        let mut child = child.spawn().unwrap();
        let (mut messages, mut buffer) = (Vec::new(), [0; 4096]);
        loop {
            // Checked before reading: whatever it sent before it ended has arrived by then.
            let ended = child.try_wait().unwrap();
            while let Ok(n) = socket.recv(&mut buffer) {
                messages.push(String::from_utf8(buffer[..n].to_vec()).unwrap());
            }
            if let Some(status) = ended {
                return (messages, status);
            }
        }
    }

    fn child(scene: &str, socket: &Path) -> Command {
        let mut child = Command::new(std::env::current_exe().unwrap());
        child.args(["--exact", &format!("notify::tests::{scene}"), "--ignored"]);
        child.env_remove("WATCHDOG_USEC").env_remove("WATCHDOG_PID").env("NOTIFY_SOCKET", socket);
        child
    }

    #[test]
    #[ignore = "run in its own process by the test below"]
    fn service_lifecycle() {
        let mut notifier = Notifier::default();
        notifier.ready("idle; the device is not there");
        notifier.status("armed");
        notifier.status("armed");
        notifier.status("recording\nREADY=0\tjump.take");
        notifier.reloading();
        notifier.ready("idle");
        notifier.stopping(&format!("finishing {}", "ä".repeat(400)));
        extend_stop(Duration::from_secs(25));
    }

    #[test]
    fn systemd_is_notified_from_ready_to_stopping() {
        let (messages, status) = messages_of("service_lifecycle", None);
        assert!(status.success());
        assert_eq!(messages.len(), 7, "{messages:?}");
        assert_eq!(messages[0], "READY=1\nSTATUS=idle; the device is not there\n");
        assert_eq!(messages[1], "STATUS=armed\n");
        assert_eq!(messages[2], "STATUS=recording\\nREADY=0\\tjump.take\n");
        let mut lines = messages[3].lines();
        assert_eq!(lines.next(), Some("RELOADING=1"));
        let usec = lines.next().unwrap().strip_prefix("MONOTONIC_USEC=").unwrap();
        assert!(usec.parse::<u64>().unwrap() > 0);
        assert_eq!(messages[4], "READY=1\nSTATUS=idle\n");
        assert!(messages[5].starts_with("STOPPING=1\nSTATUS=finishing ää"));
        assert!(messages[5].len() < STATUS_BYTES_MAX + 30, "cut: {}", messages[5].len());
        assert_eq!(messages[6], "EXTEND_TIMEOUT_USEC=25000000\n");
    }

    /// Makes progress for a second, stalls for one, and makes progress again.
    #[test]
    #[ignore = "run in its own process by the test below"]
    fn a_reader_that_hangs() {
        let heartbeat = Heartbeat::default();
        let (reader, idle) = (
            heartbeat.register(ThreadRole::Reader).unwrap(),
            heartbeat.register(ThreadRole::Worker),
        );
        let idle = idle.unwrap();
        idle.idle();
        let pings = Notifier::watch(&heartbeat).unwrap().expect("the watchdog is on");
        let move_for_a_second = || {
            for _ in 0..50 {
                reader.beat();
                std::thread::sleep(Duration::from_millis(20));
            }
        };
        move_for_a_second();
        send(&[NotifyState::Custom("X_HANGS=1")]);
        std::thread::sleep(Duration::from_secs(1));
        send(&[NotifyState::Custom("X_MOVES=1")]);
        move_for_a_second();
        drop(pings);
        send(&[NotifyState::Custom("X_ENDED=1")]);
        std::thread::sleep(Duration::from_millis(300));
    }

    #[test]
    fn the_watchdog_is_pinged_only_while_the_reader_moves() {
        let (messages, status) = messages_of("a_reader_that_hangs", Some(400_000));
        assert!(status.success());
        let at = |what: &str| {
            let found = messages.iter().position(|message| message.starts_with(what));
            found.unwrap_or_else(|| panic!("no {what} in {messages:?}"))
        };
        let pings = |messages: &[String]| messages.iter().filter(|m| *m == "WATCHDOG=1\n").count();
        let (hangs, complains, moves, ended) =
            (at("X_HANGS"), at("STATUS=the reader"), at("X_MOVES"), at("X_ENDED"));
        // Every 100 ms, on a machine that may be busy.
        assert!(pings(&messages[..hangs]) >= 3, "{messages:?}");
        assert!(hangs < complains && complains < moves, "{messages:?}");
        assert_eq!(pings(&messages[complains..moves]), 0, "{messages:?}");
        assert!(pings(&messages[moves..ended]) >= 3, "{messages:?}");
        assert_eq!(pings(&messages[ended..]), 0, "{messages:?}");
    }

    #[test]
    #[ignore = "run in its own process by the test below"]
    fn no_watchdog() {
        assert!(Notifier::watch(&Heartbeat::default()).unwrap().is_none());
    }

    #[test]
    fn without_a_watchdog_nothing_is_sent() {
        for usec in [None, Some(0)] {
            let (messages, status) = messages_of("no_watchdog", usec);
            assert!(status.success() && messages.is_empty(), "{messages:?}");
        }
        // Without a socket nothing fails, either.
        service_lifecycle();
    }
}
