//! Triggers on the network: a receiving thread, and a sender.

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

use super::{DATAGRAM_BYTES_MAX, Incoming, Listener, ReceivedTrigger, TriggerQueue};

/// Delay before trying again: a network that is down stays down for a while.
const RETRY_DELAY: Duration = Duration::from_millis(100);

/// The thread that receives triggers, until it is dropped.
#[derive(Debug)]
pub struct ListenerThread {
    stop: Option<OwnedFd>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for ListenerThread {
    fn drop(&mut self) {
        // Dropping this end makes the other one readable.
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has reported it already.
            drop(thread.join());
        }
    }
}

/// Queries of the receiving thread to the service.
pub struct TakeQueries {
    /// Whether a take of this name exists.
    pub exists: Box<dyn Fn(&str) -> bool + Send>,
    /// The name of the take being recorded.
    pub recording: Box<dyn Fn() -> Option<String> + Send>,
}

impl std::fmt::Debug for TakeQueries {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TakeQueries").finish_non_exhaustive()
    }
}

/// Binds the socket.
///
/// # Errors
/// The address cannot be used; the message says what to do.
pub fn bind(listen: SocketAddr) -> anyhow::Result<UdpSocket> {
    let socket = UdpSocket::bind(listen).map_err(|error| match error.kind() {
        io::ErrorKind::AddrInUse => anyhow!(
            "cannot receive triggers on {listen}: another program uses this port; `ss -ulpn` shows which one, or choose another port"
        ),
        io::ErrorKind::PermissionDenied => anyhow!(
            "cannot receive triggers on {listen}: ports below 1024 need CAP_NET_BIND_SERVICE; \
             grant it in the unit (AmbientCapabilities=), or choose another port"
        ),
        io::ErrorKind::AddrNotAvailable => anyhow!(
            "cannot receive triggers on {listen}: no interface has this address; `ip address` lists them, \
             or use 0.0.0.0:{}",
            listen.port()
        ),
        _ => anyhow!("cannot receive triggers on {listen}: {error}"),
    })?;
    // The thread polls it together with the stop signal; a read must not block, even if a datagram turns out to be
    // invalid.
    socket.set_nonblocking(true).context("cannot make the trigger socket non-blocking")?;
    Ok(socket)
}

/// Receives triggers on a new thread until the returned value is dropped. `report` gets messages about refused
/// datagrams, limited in number.
///
/// # Errors
/// The system refuses the thread or a pipe.
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
                    let heard = listener.receive(from.ip(), datagram, now, &queries.exists);
                    let accepted = heard.and_then(|heard| match heard {
                        Incoming::Repeat | Incoming::Own => Ok(()),
                        Incoming::Trigger(trigger) => {
                            let pushed = queue.push(ReceivedTrigger {
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
                    let Err(refusal) = accepted else { continue };
                    format!("refused a datagram from {from}: {refusal}")
                }
                Err(error) if is_idle(&error) => continue,
                Err(error) => {
                    std::thread::sleep(RETRY_DELAY);
                    format!("cannot receive triggers: {error}")
                }
            };
            if let Some(message) = rate_limit.admit(&message, now) {
                report(&message);
            }
        }
    })?;
    Ok(ListenerThread { stop: Some(stop), thread: Some(thread) })
}

/// Waits for a datagram. Returns `false` if the thread has to stop.
fn wait_readable(socket: &UdpSocket, stopped: &OwnedFd) -> bool {
    let mut fds = [PollFd::new(socket, PollFlags::IN), PollFd::new(stopped, PollFlags::IN)];
    match poll(&mut fds, None) {
        Ok(_) => fds[1].revents().is_empty(),
        Err(Errno::INTR) => true,
        // Out of memory: tried again, as after a network failure.
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

/// Sends datagrams, also to broadcast addresses.
#[derive(Debug)]
pub struct TriggerSender {
    to: Vec<SocketAddr>,
    ipv4: Option<UdpSocket>,
    ipv6: Option<UdpSocket>,
}

impl TriggerSender {
    /// A sender to these addresses.
    ///
    /// # Errors
    /// The system refuses a socket.
    pub fn new(to: Vec<SocketAddr>) -> anyhow::Result<Self> {
        let socket = |wanted: bool, any: IpAddr| {
            let open = || -> io::Result<UdpSocket> {
                let socket = UdpSocket::bind((any, 0))?;
                // A busy network card must not block: what it cannot take is lost, and reported.
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

    /// Sends a datagram to all addresses. Returns a message for each that failed.
    #[must_use]
    pub fn send(&self, datagram: &[u8]) -> Vec<String> {
        let mut failed = Vec::new();
        for to in &self.to {
            let Some(socket) = (if to.is_ipv4() { &self.ipv4 } else { &self.ipv6 }) else {
                continue;
            };
            if let Err(error) = socket.send_to(datagram, to) {
                failed.push(format!("cannot send a trigger to {to}: {error}"));
            }
        }
        failed
    }
}

/// Messages passed at once.
const BURST: u32 = 5;

/// Time after which one more is passed.
const REFILL_INTERVAL: Duration = Duration::from_secs(10);

/// A token bucket: passes a few messages and counts the others, since anybody can send a thousand datagrams a second.
#[derive(Debug)]
pub struct RateLimit {
    tokens: u32,
    since: Duration,
    suppressed: u64,
}

impl Default for RateLimit {
    fn default() -> Self {
        Self { tokens: BURST, since: Duration::ZERO, suppressed: 0 }
    }
}

impl RateLimit {
    /// Returns the message if it may be passed, with the number suppressed since the last one.
    pub fn admit(&mut self, message: &str, now: Duration) -> Option<String> {
        let earned = now.saturating_sub(self.since).as_secs() / REFILL_INTERVAL.as_secs();
        if earned > 0 {
            let earned = u32::try_from(earned).unwrap_or(u32::MAX);
            self.tokens = self.tokens.saturating_add(earned).min(BURST);
            self.since = now;
        }
        if self.tokens == 0 {
            self.suppressed += 1;
            return None;
        }
        self.tokens -= 1;
        let suppressed = std::mem::take(&mut self.suppressed);
        Some(match suppressed {
            0 => message.to_owned(),
            n => format!("{message}; {n} similar messages suppressed"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_becomes_a_few_messages() {
        let mut limit = RateLimit::default();
        let passed: Vec<String> =
            (0..60_000_u64).filter_map(|ms| limit.admit("no", Duration::from_millis(ms))).collect();
        assert_eq!(passed.len(), 5 + 5, "{passed:?}");
        assert_eq!(passed[4], "no");
        assert!(passed[5].starts_with("no") && passed[5].contains("9995"), "{}", passed[5]);
        // After a long silence a few may pass again, and no more.
        let later = (0..100).filter(|_| limit.admit("no", Duration::from_secs(86_400)).is_some());
        assert_eq!(later.count(), 5);
    }
}
