//! Answers the searches for servers that others broadcast.

use std::{
    io::{self, ErrorKind},
    net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket},
};

use socket2::{Domain, Socket, Type};

/// Questions that are answered at once.
const QUESTIONS_MAX: usize = 16;

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
    use std::time::Duration;

    use super::*;
    use crate::transport::network::search;

    #[test]
    fn every_server_of_this_machine_answers_once() {
        // A port of this test alone.
        let port = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port();
        let servers = [1_u8, 2].map(|name| (name, Responder::open(port).unwrap()));
        let question = |reply_port: u16| reply_port.to_be_bytes().to_vec();
        let asking = std::thread::Builder::new().name("asking".to_owned());
        let ask_all = move || search(question, port, Duration::from_secs(2));
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
        let answers = asking.join().unwrap().unwrap();
        let of_local = answers.iter().filter(|(from, _)| from.ip().is_loopback());
        let mut names: Vec<_> = of_local.map(|(_, name)| name.clone()).collect();
        names.sort();
        assert_eq!(names, [[1], [2]]);
    }
}
