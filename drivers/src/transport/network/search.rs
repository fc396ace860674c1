//! A search: one datagram to all machines of the networks of this one, and what they reply.

use std::{
    io::{self, ErrorKind},
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
    time::{Duration, Instant},
};

use super::multicast::interfaces;

/// Most replies that are kept: several times the systems of a building.
const REPLIES_MAX: usize = 64;

/// All programs of this machine that listen at every address, also if several use a port.
const LOOPBACK_BROADCAST: Ipv4Addr = Ipv4Addr::new(127, 255, 255, 255);

/// Sends `message(port of replies)` to a port of all machines on the networks of this one, and of this machine. Returns the
/// replies that arrive within this time, each of an address once.
///
/// # Errors
/// The system's, when no socket can be opened. A network that cannot be reached has no replies.
pub fn search(
    message: impl Fn(u16) -> Vec<u8>,
    port: u16,
    wait: Duration,
) -> io::Result<Vec<(SocketAddrV4, Vec<u8>)>> {
    let mut sockets = Vec::new();
    for interface in interfaces()? {
        // On this machine, servers listen at one address, or at all of them.
        let targets = match interface.address.is_loopback() {
            true => vec![Ipv4Addr::LOCALHOST, LOOPBACK_BROADCAST],
            false => interface.broadcast.into_iter().collect(),
        };
        let socket = UdpSocket::bind((interface.address, 0)).and_then(|socket| {
            socket.set_broadcast(true)?;
            socket.set_nonblocking(true)?;
            let message = message(socket.local_addr()?.port());
            for target in targets {
                socket.send_to(&message, (target, port))?;
            }
            Ok(socket)
        });
        // An interface that sends no broadcast has nobody to find.
        sockets.extend(socket);
    }
    let mut replies: Vec<(SocketAddrV4, Vec<u8>)> = Vec::new();
    let mut buffer = vec![0; 1 << 16];
    let began = Instant::now();
    while began.elapsed() < wait && replies.len() < REPLIES_MAX {
        let mut is_idle = true;
        for socket in &sockets {
            match socket.recv_from(&mut buffer) {
                Ok((n, SocketAddr::V4(from))) => {
                    is_idle = false;
                    let reply = (from, buffer.get(..n).unwrap_or_default().to_vec());
                    // Servers of one machine may answer from one port.
                    if !replies.contains(&reply) {
                        replies.push(reply);
                    }
                }
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                // Nobody listens at that port of this machine.
                Err(_) => {}
            }
        }
        if is_idle {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    Ok(replies)
}
