//! Devices on the network that have no connection: commands and their replies are datagrams, and frames are datagrams to this
//! machine or to a multicast group.

use std::{
    io,
    net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::{
    connect,
    datagrams::{DatagramSocket, RECEIVE_BUFFER_BYTES},
    is_retry, multicast,
};
use crate::{
    transport::{Arrival, DatagramSource, READ_TIMEOUT, Transport, TransportError},
    uri::NetworkAddress,
};

/// The sockets of a device that is reached by datagrams.
#[derive(Debug)]
pub struct UdpTransport {
    device: String,
    target: SocketAddrV4,
    /// The address of this machine's interface.
    interface: Ipv4Addr,
    commands: DatagramSocket,
    /// The socket for frames that are not sent to that of the commands, and where it listens.
    frames: Option<(DatagramSocket, DatagramSource)>,
    arrival: Arrival,
    /// Whether the last read was of a frame: of two sockets with datagrams, the other one is next.
    was_frame: bool,
}

impl UdpTransport {
    /// Opens a socket on the interface that the address names, or on the one that leads to the device. Sends nothing.
    ///
    /// # Errors
    /// `Unreachable` with a remedy when the name does not resolve to an IPv4 address, no route leads there, or there is no
    /// such interface; `Io`.
    pub fn open(address: &NetworkAddress) -> Result<Self, TransportError> {
        let device = address.host_and_port();
        let unreachable =
            |remedy: String| TransportError::Unreachable { device: device.clone(), remedy };
        let found = connect::resolve(address).map_err(unreachable)?;
        let v4 = found.iter().find_map(|target| match target {
            SocketAddr::V4(target) => Some(*target),
            SocketAddr::V6(_) => None,
        });
        let target = v4.ok_or_else(|| {
            let family = address.family;
            unreachable(format!(
                "it has no IPv4 address, which this protocol needs: give {family}:192.168.0.10"
            ))
        })?;
        let interface = match &address.local {
            Some(local) => multicast::interface_address(local).map_err(unreachable)?,
            None => multicast::address_towards(target).map_err(|error| {
                unreachable(connect::remedy(&error, IpAddr::V4(*target.ip()), address, "UDP"))
            })?,
        };
        let peer = IpAddr::V4(*target.ip());
        let commands = UdpSocket::bind((interface, 0))
            .and_then(|socket| DatagramSocket::new(socket, peer))
            .map_err(|source| TransportError::Io {
                device: device.clone(),
                action: "opening a UDP socket",
                source,
            })?;
        let arrival = Arrival::default();
        Ok(Self { device, target, interface, commands, frames: None, arrival, was_frame: false })
    }

    /// An open session ends with any error: the interface or its address may be gone, and both are looked up again when the
    /// recorder comes back.
    fn lost(&self, action: &'static str, error: &io::Error) -> TransportError {
        let cause = format!("{action} on the interface {} failed ({error})", self.interface);
        TransportError::ConnectionLost { device: self.describe(), cause }
    }

    /// Waits up to [`READ_TIMEOUT`] for a datagram; whether commands and frames have one.
    fn wait(&self) -> io::Result<[bool; 2]> {
        let timeout = Timespec { tv_sec: 0, tv_nsec: i64::from(READ_TIMEOUT.subsec_nanos()) };
        let commands = PollFd::new(&self.commands, PollFlags::IN);
        let is_ready = |fd: &PollFd<'_>| !fd.revents().is_empty();
        match &self.frames {
            Some((socket, _)) => {
                let mut fds = [commands, PollFd::new(socket, PollFlags::IN)];
                poll(&mut fds, Some(&timeout))?;
                Ok([is_ready(&fds[0]), is_ready(&fds[1])])
            }
            None => {
                let mut fds = [commands];
                poll(&mut fds, Some(&timeout))?;
                Ok([is_ready(&fds[0]), false])
            }
        }
    }
}

/// Whether the system has no room for a datagram at the moment.
fn is_full(error: &io::Error) -> bool {
    rustix::io::Errno::from_io_error(error) == Some(rustix::io::Errno::NOBUFS)
}

impl Transport for UdpTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let [has_reply, has_frame] = match self.wait() {
            Ok(ready) => ready,
            Err(error) if is_retry(&error) => return Ok(0),
            Err(error) => return Err(self.lost("waiting for datagrams", &error)),
        };
        let takes_frame = has_frame && !(has_reply && self.was_frame);
        self.was_frame = takes_frame;
        let socket = match &mut self.frames {
            Some((socket, _)) if takes_frame => socket,
            _ if has_reply => &mut self.commands,
            _ => return Ok(0),
        };
        match socket.receive(buf) {
            Ok((n, host_ns)) => {
                self.arrival = Arrival { is_datagram: true, host_ns };
                Ok(n)
            }
            Err(error) if is_retry(&error) => Ok(0),
            Err(error) => Err(self.lost("receiving datagrams", &error)),
        }
    }

    /// Sends one datagram.
    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        match self.commands.send_to(bytes, self.target) {
            Ok(()) => Ok(()),
            // Lost on this machine, as a datagram can be on the way: who sent it asks again.
            Err(error) if is_retry(&error) || is_full(&error) => Ok(()),
            Err(error) => Err(self.lost("sending a datagram", &error)),
        }
    }

    fn listen(&mut self, source: DatagramSource) -> Result<(), TransportError> {
        if self.frames.as_ref().is_some_and(|(_, open)| *open == source) {
            return Ok(());
        }
        self.frames = None;
        let peer = IpAddr::V4(*self.target.ip());
        let opened = multicast::listening_socket(source.group, source.port, self.interface)
            .and_then(|socket| DatagramSocket::new(socket, peer));
        match opened {
            Ok(socket) => {
                self.frames = Some((socket.pin_port(), source));
                Ok(())
            }
            // Frames to the commands' socket need no other.
            Err(_) if source.group.is_none() => Ok(()),

            Err(error) => Err(TransportError::Unreachable {
                device: self.device.clone(),
                remedy: format!(
                    "frames of {source} cannot be received on the interface {} ({error}): name another one with local=, \
                     or end the program that has UDP port {} for itself",
                    self.interface, source.port
                ),
            }),
        }
    }

    fn stop_listening(&mut self) {
        self.frames = None;
    }

    fn arrival(&self) -> Arrival {
        self.arrival
    }

    fn datagram_port(&self) -> Option<u16> {
        Some(self.commands.port())
    }

    fn stranger(&self) -> Option<SocketAddrV4> {
        let frames = self.frames.as_ref().and_then(|(socket, _)| socket.stranger());
        match frames.or_else(|| self.commands.stranger())? {
            SocketAddr::V4(stranger) => Some(stranger),
            SocketAddr::V6(_) => None,
        }
    }

    fn remark(&self) -> Option<String> {
        let granted = self.commands.buffer_bytes();
        (granted < RECEIVE_BUFFER_BYTES).then(|| {
            format!(
                "the system holds {} KiB of datagrams for mocapd where {} KiB are wanted, so that a busy moment can lose \
                 frames: sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES}",
                granted >> 10,
                RECEIVE_BUFFER_BYTES >> 10
            )
        })
    }

    fn describe(&self) -> String {
        let interface = self.interface;
        match &self.frames {
            Some((_, source)) => format!("{} by UDP on {interface}, {source}", self.device),
            None => format!("{} by UDP on {interface}", self.device),
        }
    }
}
