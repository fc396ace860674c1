//! The UDP socket of a device: whole datagrams, each with the time at which the kernel received it.

use std::{
    io::{self, IoSliceMut},
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4, UdpSocket},
    os::fd::{AsFd, AsRawFd, BorrowedFd},
};

use nix::{
    cmsg_space,
    sys::{
        socket::{
            ControlMessageOwned, MsgFlags, SockaddrStorage, getsockopt, recvmsg, setsockopt,
            sockopt::{RcvBuf, ReceiveTimestampns},
        },
        time::TimeSpec,
    },
};
use rustix::time::{ClockId, clock_gettime};

/// Bytes that the kernel may hold for the reader, if the system allows so many: a second of 200 markers at 1000 Hz. Linux
/// grants `net.core.rmem_max` at most, 208 KiB by default.
pub(super) const RECEIVE_BUFFER_BYTES: usize = 4 << 20;

/// A stamp further from now than this is of a clock that was set in between: a reader that does not read for so long is
/// ended by its watchdog.
const STAMP_AGE_MAX_NS: i64 = 60_000_000_000;

/// The socket.
#[derive(Debug)]
pub(super) struct DatagramSocket {
    socket: UdpSocket,
    port: u16,
    /// Bytes that the kernel holds for the reader.
    buffer_bytes: usize,
    /// Datagrams of other machines are not the device's.
    peer: IpAddr,
    control: Vec<u8>,
    /// The device's port, if one of several programs on its machine is to be kept to: that of the first datagram, until it
    /// has been silent for [`SENDER_SILENT_NS`].
    pins_port: bool,
    sender_port: Option<u16>,
    /// The last sender of datagrams that are not the device's.
    stranger: Option<SocketAddr>,
    /// Arrival of the last datagram: the next one did not arrive before it.
    last_ns: u64,
    /// The monotonic clock less the wall clock, at the last datagram.
    offset_ns: Option<i64>,
    /// Whether the wall clock was set while datagrams waited: their stamps are of before or after that.
    distrusts_stamps: bool,
}

impl DatagramSocket {
    /// Opens a socket at the address at which this machine is known to the device.
    ///
    /// # Errors
    /// The system's.
    pub(super) fn open(mut local: SocketAddr, peer: IpAddr) -> io::Result<Self> {
        // The rest of the address stays: an IPv6 address may have a scope.
        local.set_port(0);
        Self::new(UdpSocket::bind(local)?, peer)
    }

    /// Receives a device's datagrams at a socket.
    ///
    /// # Errors
    /// The system's.
    pub(super) fn new(socket: UdpSocket, peer: IpAddr) -> io::Result<Self> {
        socket.set_nonblocking(true)?;
        // What the system refuses here costs room or precision: arrival is then the time of the read.
        setsockopt(socket.as_raw_fd(), RcvBuf, &RECEIVE_BUFFER_BYTES).ok();
        setsockopt(socket.as_raw_fd(), ReceiveTimestampns, &true).ok();
        let port = socket.local_addr()?.port();
        // Linux states twice the room, one half of it for its own accounts.
        let buffer_bytes = getsockopt(socket.as_raw_fd(), RcvBuf).map_or(0, |bytes| bytes / 2);
        let control = cmsg_space!(TimeSpec);
        Ok(Self {
            socket,
            port,
            buffer_bytes,
            peer: peer.to_canonical(),
            control,
            pins_port: false,
            sender_port: None,
            stranger: None,
            last_ns: 0,
            offset_ns: None,
            distrusts_stamps: false,
        })
    }

    /// The port to which the device sends.
    pub(super) fn port(&self) -> u16 {
        self.port
    }

    /// Keeps to the program that sends first.
    pub(super) fn pin_port(mut self) -> Self {
        self.pins_port = true;
        self
    }

    /// The last sender of datagrams that are not the device's.
    pub(super) fn stranger(&self) -> Option<SocketAddr> {
        self.stranger
    }

    /// Whether a datagram is the device's.
    fn is_own(&mut self, sender: Option<SocketAddr>) -> bool {
        let Some(sender) = sender else { return false };
        let now_ns = read(ClockId::Monotonic).map_or(0, i64::unsigned_abs);
        let is_kept = self.sender_port.is_some_and(|port| port != sender.port())
            && now_ns.saturating_sub(self.last_ns) < SENDER_SILENT_NS;
        if sender.ip() != self.peer || (self.pins_port && is_kept) {
            self.stranger = Some(sender);
            return false;
        }
        self.sender_port = Some(sender.port());
        true
    }

    /// Bytes that the kernel holds for the reader, at most [`RECEIVE_BUFFER_BYTES`].
    pub(super) fn buffer_bytes(&self) -> usize {
        self.buffer_bytes
    }

    /// Sends one datagram.
    ///
    /// # Errors
    /// The system's.
    pub(super) fn send_to(&self, bytes: &[u8], target: SocketAddrV4) -> io::Result<()> {
        self.socket.send_to(bytes, target).map(|_| ())
    }

    /// Receives one datagram of the device. Returns its size, and when it arrived on the host's monotonic clock.
    ///
    /// # Errors
    /// `WouldBlock` when none waits, or the one that waited was another machine's; the system's.
    pub(super) fn receive(&mut self, buf: &mut [u8]) -> io::Result<(usize, Option<u64>)> {
        let mut slices = [IoSliceMut::new(buf)];
        let received = recvmsg::<SockaddrStorage>(
            self.socket.as_raw_fd(),
            &mut slices,
            Some(&mut self.control),
            MsgFlags::empty(),
        );
        let message = match received {
            Ok(message) => message,
            Err(error) => {
                // Nothing waits: later datagrams have stamps of the clock as it is now.
                self.distrusts_stamps = false;
                return Err(error.into());
            }
        };
        let n = message.bytes;
        let sender = message.address.as_ref().and_then(address_of);
        let stamp = message.cmsgs().find_map(|control| match control {
            ControlMessageOwned::ScmTimestampns(stamp) => Some(stamp),
            _ => None,
        });
        if !self.is_own(sender) {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        let host_ns = stamp.and_then(|stamp| self.monotonic_ns(stamp));
        let host_ns = host_ns.map(|host_ns| host_ns.max(self.last_ns));
        self.last_ns = host_ns.unwrap_or(self.last_ns);
        Ok((n, host_ns))
    }
}

impl AsFd for DatagramSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

fn address_of(address: &SockaddrStorage) -> Option<SocketAddr> {
    let v4 = || {
        let v4 = address.as_sockaddr_in()?;
        Some((IpAddr::V4(Ipv4Addr::from(v4.ip())), v4.port()))
    };
    let v6 = || {
        let v6 = address.as_sockaddr_in6()?;
        Some((IpAddr::V6(Ipv6Addr::from(v6.ip().octets())), v6.port()))
    };
    let (ip, port) = v4().or_else(v6)?;
    Some(SocketAddr::new(ip.to_canonical(), port))
}

/// Another program of the device's machine may take its place after this silence: it has been restarted.
const SENDER_SILENT_NS: u64 = 1_000_000_000;

/// Time within which the two clocks are read; a thread that was interrupted in between reads them again.
const BOTH_CLOCKS_NS: i64 = 20_000;

/// Attempts at that, on a machine that interrupts again and again.
const ATTEMPTS_MAX: usize = 4;

/// A wall clock that moved by more than this against the monotonic one was set. It is slewed by 0.5 ms a second at most.
const CLOCK_SET_NS: i64 = 10_000_000;

fn in_ns(seconds: i64, ns: i64) -> Option<i64> {
    seconds.checked_mul(1_000_000_000)?.checked_add(ns)
}

fn read(clock: ClockId) -> Option<i64> {
    let now = clock_gettime(clock);
    in_ns(now.tv_sec, now.tv_nsec)
}

/// The monotonic clock less the wall clock.
fn clock_offset_ns() -> Option<i64> {
    let mut best: Option<(i64, i64)> = None;
    for _ in 0..ATTEMPTS_MAX {
        let (before_ns, wall_ns) = (read(ClockId::Monotonic)?, read(ClockId::Realtime)?);
        let took_ns = read(ClockId::Monotonic)? - before_ns;
        if best.is_none_or(|(took, _)| took_ns < took) {
            best = Some((took_ns, before_ns + took_ns / 2 - wall_ns));
        }
        if took_ns <= BOTH_CLOCKS_NS {
            break;
        }
    }
    best.map(|(_, offset_ns)| offset_ns)
}

impl DatagramSocket {
    /// Converts a stamp of the wall clock to the monotonic clock; `None` when the wall clock was set in between.
    fn monotonic_ns(&mut self, stamp: TimeSpec) -> Option<u64> {
        let offset_ns = clock_offset_ns()?;
        let before_ns = self.offset_ns.replace(offset_ns);
        self.distrusts_stamps |=
            before_ns.is_some_and(|before_ns| (offset_ns - before_ns).abs() > CLOCK_SET_NS);
        let host_ns = in_ns(stamp.tv_sec(), stamp.tv_nsec())?.checked_add(offset_ns)?;
        let age_ns = read(ClockId::Monotonic)? - host_ns;
        // As much may a stamp of just now lie in the future.
        let ages = -BOTH_CLOCKS_NS..STAMP_AGE_MAX_NS;
        let is_sure = ages.contains(&age_ns) && !self.distrusts_stamps;
        is_sure.then(|| u64::try_from(host_ns).ok()).flatten()
    }
}

#[cfg(test)]
mod tests {
    use std::{thread::sleep, time::Duration};

    use super::*;

    fn now_ns() -> u64 {
        let now = clock_gettime(ClockId::Monotonic);
        now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
    }

    #[test]
    fn arrival_is_the_kernels_time_and_not_that_of_the_read() {
        let local = IpAddr::V4(Ipv4Addr::LOCALHOST);
        let mut socket = DatagramSocket::open((local, 0).into(), local).unwrap();
        let sender = UdpSocket::bind((local, 0)).unwrap();
        // The kernel begins to stamp a moment after the first socket asks for it; until then a read stamps.
        let is_stamped = (0..50).any(|_| {
            let before_ns = now_ns();
            sender.send_to(b"first", (local, socket.port())).unwrap();
            sender.send_to(b"second!", (local, socket.port())).unwrap();
            let sent_ns = now_ns();
            sleep(Duration::from_millis(50));
            let mut buf = [0; 64];
            let (n, first_ns) = socket.receive(&mut buf).unwrap();
            assert_eq!(&buf[..n], b"first", "one datagram a read");
            let (n, second_ns) = socket.receive(&mut buf).unwrap();
            assert_eq!(&buf[..n], b"second!");
            let (first_ns, second_ns) = (first_ns.unwrap(), second_ns.unwrap());
            assert_eq!(socket.receive(&mut buf).unwrap_err().kind(), io::ErrorKind::WouldBlock);
            assert!(first_ns + 5_000_000 > before_ns && first_ns <= second_ns);
            // A tenth of the wait before the read, because two clocks are compared.
            second_ns < sent_ns + 5_000_000
        });
        assert!(is_stamped);
    }

    #[test]
    fn datagrams_of_other_machines_are_not_the_devices() {
        let local = IpAddr::V4(Ipv4Addr::LOCALHOST);
        let mut socket =
            DatagramSocket::open((local, 0).into(), "192.0.2.1".parse().unwrap()).unwrap();
        let sender = UdpSocket::bind((local, 0)).unwrap();
        sender.send_to(b"stranger", (local, socket.port())).unwrap();
        sleep(Duration::from_millis(10));
        let error = socket.receive(&mut [0; 64]).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::WouldBlock);
    }
}
