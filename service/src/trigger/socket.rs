//! Triggers on the network: a thread that hears them, and a sender.

use std::{
    io,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    os::fd::OwnedFd,
    thread::JoinHandle,
    time::Duration,
};

use anyhow::{Context, anyhow};
use mocapd_acquire::threads;
use rustix::{
    event::{PollFd, PollFlags, poll},
    io::Errno,
    pipe::{PipeFlags, pipe_with},
};

use super::{DATAGRAM_BYTES_MAX, Heard, Listener, Received, TriggerQueue};

/// A network that is down is down for a while.
const RETRY_DELAY: Duration = Duration::from_millis(100);

/// Hears triggers until it is dropped.
#[derive(Debug)]
pub struct ListenerThread {
    stop: Option<OwnedFd>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for ListenerThread {
    fn drop(&mut self) {
        // Its other end is readable then.
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has told so already.
            drop(thread.join());
        }
    }
}

/// What the thread that hears triggers asks the service.
pub struct TakeQueries {
    /// Whether there is a take of a name.
    pub exists: Box<dyn Fn(&str) -> bool + Send>,
    /// Which take is being recorded.
    pub recording: Box<dyn Fn() -> Option<String> + Send>,
}

impl std::fmt::Debug for TakeQueries {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TakeQueries").finish_non_exhaustive()
    }
}

/// Opens the socket.
///
/// # Errors
/// Why not, and what helps.
pub fn bind(listen: SocketAddr) -> anyhow::Result<UdpSocket> {
    let socket = UdpSocket::bind(listen).map_err(|error| match error.kind() {
        io::ErrorKind::AddrInUse => anyhow!(
            "cannot hear triggers on {listen}: another program does; `ss -ulpn` shows which, or choose another port"
        ),
        io::ErrorKind::PermissionDenied => anyhow!(
            "cannot hear triggers on {listen}: ports below 1024 need CAP_NET_BIND_SERVICE; \
             give it in the unit (AmbientCapabilities=), or choose another port"
        ),
        io::ErrorKind::AddrNotAvailable => anyhow!(
            "cannot hear triggers on {listen}: no interface has this address; `ip address` shows them, \
             or use 0.0.0.0:{}",
            listen.port()
        ),
        _ => anyhow!("cannot hear triggers on {listen}: {error}"),
    })?;
    // It is waited for beside the stop, and a datagram that is not whole is none.
    socket.set_nonblocking(true).context("a socket cannot be read without waiting")?;
    Ok(socket)
}

/// Hears triggers on a thread of its own until what it returns is dropped. `say` is told what is refused, a few words at a time.
///
/// # Errors
/// When the system refuses the thread or a pipe.
pub fn listen(
    socket: UdpSocket,
    mut listener: Listener,
    queries: TakeQueries,
    queue: TriggerQueue,
    mut report: impl FnMut(&str) + Send + 'static,
) -> anyhow::Result<ListenerThread> {
    let (stopped, stop) = pipe_with(PipeFlags::CLOEXEC).context("cannot open a pipe")?;
    let thread = threads::spawn("mocapd-trigger", move || {
        let mut rate_limit = RateLimit::default();
        let mut buffer = vec![0; DATAGRAM_BYTES_MAX];
        while wait_readable(&socket, &stopped) {
            let received = socket.recv_from(&mut buffer);
            let now = queue.now();
            let message = match received {
                Ok((n_bytes, from)) => {
                    let datagram = buffer.get(..n_bytes).unwrap_or_default();
                    let heard = listener.hear(from.ip(), datagram, now, &queries.exists);
                    let accepted = heard.and_then(|heard| match heard {
                        Heard::Repeat | Heard::Own => Ok(()),
                        Heard::Trigger(trigger) => {
                            let pushed = queue.push(Received {
                                from,
                                trigger: trigger.clone(),
                                is_known: listener.is_known(from.ip()),
                                recording: (queries.recording)(),
                            });
                            if pushed.is_err() {
                                listener.forget(from.ip(), &trigger, datagram);
                            }
                            pushed
                        }
                    });
                    match accepted {
                        Ok(()) => continue,
                        Err(refusal) => format!("a datagram from {from} is refused: {refusal}"),
                    }
                }
                Err(error) if is_idle(&error) => continue,
                Err(error) => {
                    std::thread::sleep(RETRY_DELAY);
                    format!("cannot hear triggers: {error}")
                }
            };
            if let Some(message) = rate_limit.admit(&message, now) {
                report(&message);
            }
        }
    })?;
    Ok(ListenerThread { stop: Some(stop), thread: Some(thread) })
}

/// Waits for a datagram. `false`: it is time to end.
fn wait_readable(socket: &UdpSocket, stopped: &OwnedFd) -> bool {
    let mut fds = [PollFd::new(socket, PollFlags::IN), PollFd::new(stopped, PollFlags::IN)];
    match poll(&mut fds, None) {
        Ok(_) => fds[1].revents().is_empty(),
        Err(Errno::INTR) => true,
        // Without memory it is tried again, like a network that is down.
        Err(_) => {
            std::thread::sleep(RETRY_DELAY);
            true
        }
    }
}

fn is_idle(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), WouldBlock | TimedOut | Interrupted)
}

/// Sends datagrams, to broadcast addresses too.
#[derive(Debug)]
pub struct TriggerSender {
    to: Vec<SocketAddr>,
    ipv4: Option<UdpSocket>,
    ipv6: Option<UdpSocket>,
}

impl TriggerSender {
    /// For these addresses.
    ///
    /// # Errors
    /// When the system gives no socket.
    pub fn new(to: Vec<SocketAddr>) -> anyhow::Result<Self> {
        let socket = |wanted: bool, any: IpAddr| {
            let open = || -> io::Result<UdpSocket> {
                let socket = UdpSocket::bind((any, 0))?;
                // Nobody waits for a network card: what it cannot take is lost, and told.
                socket.set_nonblocking(true)?;
                if any.is_ipv4() {
                    socket.set_broadcast(true)?;
                }
                Ok(socket)
            };
            wanted.then(open).transpose().context("cannot open a socket for triggers")
        };
        let ipv4 = socket(to.iter().any(SocketAddr::is_ipv4), Ipv4Addr::UNSPECIFIED.into())?;
        let ipv6 = socket(to.iter().any(SocketAddr::is_ipv6), Ipv6Addr::UNSPECIFIED.into())?;
        Ok(Self { to, ipv4, ipv6 })
    }

    /// Sends one to all of them. Returns what could not be sent, a line each.
    #[must_use]
    pub fn send(&self, datagram: &[u8]) -> Vec<String> {
        let mut failed = Vec::new();
        for to in &self.to {
            let Some(socket) = (if to.is_ipv4() { &self.ipv4 } else { &self.ipv6 }) else {
                continue;
            };
            if let Err(error) = socket.send_to(datagram, to) {
                failed.push(format!("a trigger could not be sent to {to}: {error}"));
            }
        }
        failed
    }
}

/// Words at once.
const BURST: u32 = 5;

/// One more after so long.
const REFILL_INTERVAL: Duration = Duration::from_secs(10);

/// Lets a few words through, and counts the others: anybody can send a thousand datagrams a second.
#[derive(Debug)]
pub struct RateLimit {
    left: u32,
    since: Duration,
    held_back: u64,
}

impl Default for RateLimit {
    fn default() -> Self {
        Self { left: BURST, since: Duration::ZERO, held_back: 0 }
    }
}

impl RateLimit {
    /// The words, when it is time for them, with how many were held back since the last ones.
    pub fn admit(&mut self, message: &str, now: Duration) -> Option<String> {
        let earned = now.saturating_sub(self.since).as_secs() / REFILL_INTERVAL.as_secs();
        if earned > 0 {
            let earned = u32::try_from(earned).unwrap_or(u32::MAX);
            self.left = self.left.saturating_add(earned).min(BURST);
            self.since = now;
        }
        if self.left == 0 {
            self.held_back += 1;
            return None;
        }
        self.left -= 1;
        let held_back = std::mem::take(&mut self.held_back);
        Some(match held_back {
            0 => message.to_owned(),
            n => format!("{message}; {n} more were not told"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_becomes_a_few_words() {
        let mut rate_limit = RateLimit::default();
        let reason: Vec<String> =
            (0..60_000_u64).filter_map(|ms| rate_limit.admit("no", Duration::from_millis(ms))).collect();
        assert_eq!(reason.len(), 5 + 5, "{reason:?}");
        assert_eq!(reason[4], "no");
        assert!(reason[5].starts_with("no") && reason[5].contains("9995"), "{}", reason[5]);
        // What was silent for long may say a few again, and no more.
        let later = (0..100).filter(|_| rate_limit.admit("no", Duration::from_secs(86_400)).is_some());
        assert_eq!(later.count(), 5);
    }
}
