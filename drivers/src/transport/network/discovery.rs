//! Search for servers by broadcast: asks on every network of this machine, or answers.

use std::{
    io::{self, ErrorKind},
    net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket},
    time::{Duration, Instant},
};

use nix::{ifaddrs::getifaddrs, net::if_::InterfaceFlags, sys::socket::SockaddrStorage};
use socket2::{Domain, Socket, Type};

/// Answers that are read: more servers than a network has, and a bound on what others can send.
const ANSWERS_MAX: usize = 64;

/// Questions that are answered at once.
const QUESTIONS_MAX: usize = 16;

/// An answer, and who sent it.
pub type Answer = (IpAddr, Vec<u8>);

/// Sends `question(reply port)` to a port of all machines on the networks of this one, and collects answers of up to
/// `bytes_max` for a while. A network that cannot be asked is left out.
///
/// # Errors
/// The system's, when no socket can be opened.
pub fn ask(
    question: impl Fn(u16) -> Vec<u8>,
    port: u16,
    bytes_max: usize,
    wait: Duration,
) -> io::Result<Vec<Answer>> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.set_broadcast(true)?;
    let question = question(socket.local_addr()?.port());
    for address in broadcast_addresses() {
        // An interface may be down.
        socket.send_to(&question, (address, port)).ok();
    }
    let until = Instant::now() + wait;
    let (mut answers, mut buffer) = (Vec::new(), vec![0; bytes_max]);
    while answers.len() < ANSWERS_MAX {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        socket.set_read_timeout(Some(left))?;
        match socket.recv_from(&mut buffer) {
            Ok((n, from)) => {
                let answer = (from.ip(), buffer.get(..n).unwrap_or_default().to_vec());
                // A server answers once for each network that leads to it.
                if !answers.contains(&answer) {
                    answers.push(answer);
                }
            }
            Err(error) if is_retry(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(answers)
}

fn is_retry(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

/// An IPv4 network that an interface of this machine is in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ipv4Network {
    /// Name of the interface.
    pub interface: String,
    /// The address of this machine.
    pub address: Ipv4Addr,
    /// The address of all machines.
    pub broadcast: Ipv4Addr,
    /// Whether it carries multicast.
    pub has_multicast: bool,
}

/// The networks of the interfaces that are up, without the loopback.
#[must_use]
pub fn networks() -> Vec<Ipv4Network> {
    let Ok(interfaces) = getifaddrs() else { return Vec::new() };
    let is_wanted = InterfaceFlags::IFF_UP | InterfaceFlags::IFF_BROADCAST;
    let interfaces = interfaces.filter(|interface| interface.flags.contains(is_wanted));
    let ip =
        |address: Option<&SockaddrStorage>| Some(Ipv4Addr::from(address?.as_sockaddr_in()?.ip()));
    let network = |interface: nix::ifaddrs::InterfaceAddress| {
        Some(Ipv4Network {
            address: ip(interface.address.as_ref())?,
            broadcast: ip(interface.broadcast.as_ref())?,
            has_multicast: interface.flags.contains(InterfaceFlags::IFF_MULTICAST),
            interface: interface.interface_name,
        })
    };
    interfaces.filter_map(network).collect()
}

/// The broadcast address of every network, the loopback among them.
fn broadcast_addresses() -> Vec<Ipv4Addr> {
    let mut found = vec![Ipv4Addr::new(127, 255, 255, 255)];
    for Ipv4Network { broadcast, .. } in networks() {
        if !found.contains(&broadcast) {
            found.push(broadcast);
        }
    }
    found
}

/// Answers questions of others. Several servers of a machine may.
#[derive(Debug)]
pub struct Responder {
    socket: UdpSocket,
}

impl Responder {
    /// Opens the port of questions.
    ///
    /// # Errors
    /// The system's: another program uses the port alone.
    pub fn open(port: u16) -> io::Result<Self> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, None)?;
        // Each of several sockets gets every broadcast.
        socket.set_reuse_address(true)?;
        socket.set_broadcast(true)?;
        socket.set_nonblocking(true)?;
        socket.bind(&SocketAddr::from((Ipv4Addr::UNSPECIFIED, port)).into())?;
        Ok(Self { socket: socket.into() })
    }

    /// Answers the questions that have come. `answer` returns the port of the asking machine and the answer, or nothing.
    pub fn serve(&self, mut answer: impl FnMut(IpAddr, &[u8]) -> Option<(u16, Vec<u8>)>) {
        let mut buffer = [0; 64];
        for _ in 0..QUESTIONS_MAX {
            match self.socket.recv_from(&mut buffer) {
                Ok((n, from)) => {
                    if let Some((port, bytes)) =
                        answer(from.ip(), buffer.get(..n).unwrap_or_default())
                    {
                        // Who does not get it asks again.
                        self.socket.send_to(&bytes, (from.ip(), port)).ok();
                    }
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_server_of_this_machine_answers_once() {
        // A port of this test alone.
        let port = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port();
        let servers = [1_u8, 2].map(|name| (name, Responder::open(port).unwrap()));
        let question = |reply_port: u16| reply_port.to_be_bytes().to_vec();
        let asking = std::thread::Builder::new().name("asking".to_owned());
        let ask_all = move || ask(question, port, 64, Duration::from_secs(2));
        let asking = asking.spawn(ask_all).unwrap();
        while !asking.is_finished() {
            for (name, server) in &servers {
                server.serve(|from, question| {
                    let reply_port = u16::from_be_bytes(question.try_into().ok()?);
                    from.is_loopback().then(|| (reply_port, vec![*name]))
                });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let mut answers = asking.join().unwrap().unwrap();
        answers.sort();
        let local = IpAddr::V4(Ipv4Addr::LOCALHOST);
        assert_eq!(answers, [(local, vec![1]), (local, vec![2])]);
    }
}
