//! A simulated Motive on the network: one thread that sleeps until the next frame or datagram.

use std::{
    io::{self, ErrorKind},
    net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket},
    num::NonZeroU64,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use mocapd_drivers::transport::network::multicast_sender;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::NatNetDevice;
use crate::{
    NetworkOptions,
    device::{FateLog, SentLog},
    line::host_ns,
};

/// The longest sleep, which bounds the reaction time to a stop.
const SLEEP_MAX: Duration = Duration::from_millis(20);

/// Size of one read: many times the longest command.
const READ_BYTES: usize = 4096;

/// Datagrams that are read between two frames: a flood of commands must not stop them.
const READS_MAX: usize = 64;

/// Networks that frames to a group cross: only the own one.
const HOPS: u32 = 1;

/// Why serving failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NatNetServeError {
    /// The port cannot be opened.
    #[error("cannot open UDP port {port} of this machine ({}): end the program that uses it, or give another port", source.kind())]
    Open {
        /// The port.
        port: u16,
        /// The system's error.
        source: io::Error,
    },
    /// A call to the system failed.
    #[error("{action} failed")]
    Network {
        /// The operation.
        action: &'static str,
        /// The system's error.
        source: io::Error,
    },
    /// The log of sent frames could not be written.
    #[error("cannot write the log of sent frames")]
    Log(#[source] io::Error),
}

/// A port of this machine, on the loopback interface: a simulator is for this machine's programs.
#[derive(Debug)]
pub struct NatNetListener {
    commands: UdpSocket,
    frames: UdpSocket,
    address: SocketAddr,
}

impl NatNetListener {
    /// Opens a port; 0 for any free one.
    ///
    /// # Errors
    /// When another program uses the port, or the system refuses it.
    pub fn open(port: u16) -> Result<Self, NatNetServeError> {
        let failed = |source| NatNetServeError::Open { port, source };
        let commands = UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).map_err(failed)?;
        commands.set_nonblocking(true).map_err(failed)?;
        let address = commands.local_addr().map_err(failed)?;
        let frames = multicast_sender(Ipv4Addr::LOCALHOST, HOPS)
            .and_then(|socket| socket.set_nonblocking(true).map(|()| socket))
            .map_err(|source| NatNetServeError::Network {
                action: "opening a socket for multicast",
                source,
            })?;
        Ok(Self { commands, frames, address })
    }

    /// Where clients send their commands.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The URI that a recorder opens.
    #[must_use]
    pub fn uri(&self) -> String {
        format!("natnet:{}", self.address)
    }

    /// Serves a device until `stop` is set.
    ///
    /// # Errors
    /// When the system fails to wait for datagrams, or the log fails.
    pub fn serve(
        self,
        device: &mut NatNetDevice,
        options: NetworkOptions,
        stop: &AtomicBool,
    ) -> Result<SentLog, NatNetServeError> {
        // As for a line: a sleep must not be 50 us late. If the kernel refuses, it stays.
        rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).ok();
        let mut log = FateLog::begin(options.log).map_err(NatNetServeError::Log)?;
        if log.is_kept() {
            device.keep_frame_log();
        }
        while !stop.load(Ordering::Relaxed) {
            let wake_ns = device.poll(host_ns());
            self.send(device);
            log.add(device.take_fates()).map_err(NatNetServeError::Log)?;
            if options.once && device.has_ended() {
                break;
            }
            self.wait(wake_ns)?;
            self.receive(device);
        }
        device.close();
        log.add(device.take_fates()).map_err(NatNetServeError::Log)?;
        log.finish().map_err(NatNetServeError::Log)?;
        Ok(device.log())
    }

    fn send(&self, device: &mut NatNetDevice) {
        // A datagram that the system does not take is lost, as on any network.
        device.send_datagrams(|datagram| {
            let is_group = match datagram.to.ip() {
                IpAddr::V4(ip) => ip.is_multicast(),
                IpAddr::V6(_) => false,
            };
            let socket = if is_group { &self.frames } else { &self.commands };
            socket.send_to(&datagram.bytes, datagram.to).is_ok()
        });
    }

    fn wait(&self, wake_ns: u64) -> Result<(), NatNetServeError> {
        let sleep = Duration::from_nanos(wake_ns.saturating_sub(host_ns())).min(SLEEP_MAX);
        let timeout = Timespec { tv_sec: 0, tv_nsec: i64::from(sleep.subsec_nanos()) };
        match poll(&mut [PollFd::new(&self.commands, PollFlags::IN)], Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(source) => Err(NatNetServeError::Network {
                action: "waiting for clients",
                source: source.into(),
            }),
        }
    }

    fn receive(&self, device: &mut NatNetDevice) {
        let mut buffer = [0; READ_BYTES];
        for _ in 0..READS_MAX {
            match self.commands.recv_from(&mut buffer) {
                Ok((n, from)) => {
                    let bytes = buffer.get(..n).unwrap_or_default();
                    device.on_datagram(from, bytes, host_ns());
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                // None waits, or a client of before is gone.
                Err(_) => return,
            }
        }
    }
}
