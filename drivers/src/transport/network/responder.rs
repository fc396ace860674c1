//! Answers the searches for servers that others broadcast, and limits how often machines are answered by UDP.

use std::{
    io::{self, ErrorKind},
    net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket},
    time::Instant,
};

use socket2::{Domain, Socket, Type};

/// Questions that are answered at once.
const QUESTIONS_MAX: usize = 16;

/// Machines whose questions are counted at the same time.
const MACHINES_MAX: usize = 64;

const SECOND_NS: u64 = 1_000_000_000;

/// How often machines are answered. The sender of a datagram can be forged, and an answer is longer than its question: without a
/// limit we would send a flood for others.
#[derive(Debug)]
pub(crate) struct AnswerLimit {
    /// Time that an answer takes of a machine's share, and of that of all.
    intervals_ns: [u64; 2],
    /// When the share of each machine is whole again, and that of all.
    machines: Vec<(IpAddr, u64)>,
    all_ns: u64,
}

impl AnswerLimit {
    /// So many answers a second to a machine, and to all together.
    pub(crate) fn new(per_machine: u32, per_second: u32) -> Self {
        let intervals_ns = [per_machine, per_second].map(|n| SECOND_NS / u64::from(n.max(1)));
        Self { intervals_ns, machines: Vec::new(), all_ns: 0 }
    }

    /// Whether a machine is answered now. Counts the answer.
    pub(crate) fn allows(&mut self, machine: IpAddr, now_ns: u64) -> bool {
        let [interval_ns, all_interval_ns] = self.intervals_ns;
        if self.machines.len() >= MACHINES_MAX {
            // Those whose share is whole have nothing that would be forgotten with them.
            self.machines.retain(|(_, whole_ns)| *whole_ns > now_ns);
        }
        let found = self.machines.iter().position(|(known, _)| *known == machine);
        let known = found.and_then(|at| self.machines.get(at));
        let whole_ns = known.map_or(0, |(_, whole_ns)| *whole_ns);
        let (Some(whole_ns), Some(all_ns)) =
            (taken(whole_ns, interval_ns, now_ns), taken(self.all_ns, all_interval_ns, now_ns))
        else {
            return false;
        };
        let is_full = self.machines.len() >= MACHINES_MAX;
        match found.and_then(|at| self.machines.get_mut(at)) {
            Some((_, of_machine)) => *of_machine = whole_ns,
            None if is_full => return false,
            None => self.machines.push((machine, whole_ns)),
        }
        self.all_ns = all_ns;
        true
    }
}

/// When a share is whole again, of which an answer takes this much time; `None` if less is left of its second.
fn taken(whole_ns: u64, interval_ns: u64, now_ns: u64) -> Option<u64> {
    let whole_ns = whole_ns.max(now_ns) + interval_ns;
    (whole_ns - now_ns <= SECOND_NS).then_some(whole_ns)
}

/// Searches of a machine, and of all, that are answered in a second: programs ask about twice.
const SEARCHES_PER_S: u32 = 50;
const ALL_SEARCHES_PER_S: u32 = 500;

/// Answers questions of others. Several servers of a machine may.
#[derive(Debug)]
pub struct Responder {
    socket: UdpSocket,
    opened: Instant,
    limit: AnswerLimit,
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
        let limit = AnswerLimit::new(SEARCHES_PER_S, ALL_SEARCHES_PER_S);
        Ok(Self { socket: socket.into(), opened: Instant::now(), limit })
    }

    /// Answers the questions that have come. `answer` returns the port of the asking machine and the answer, or nothing.
    pub fn serve(&mut self, mut answer: impl FnMut(IpAddr, &[u8]) -> Option<(u16, Vec<u8>)>) {
        let mut buffer = [0; 64];
        for _ in 0..QUESTIONS_MAX {
            match self.socket.recv_from(&mut buffer) {
                Ok((n, from)) => {
                    let now_ns = self.opened.elapsed().as_nanos() as u64;
                    let question = buffer.get(..n).unwrap_or_default();
                    if let Some((port, bytes)) = answer(from.ip(), question)
                        && self.limit.allows(from.ip(), now_ns)
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
    fn floods_are_answered_up_to_a_limit_for_each_machine_and_for_all() {
        let machine = |n: u32| IpAddr::from(Ipv4Addr::from_bits(n));
        let mut limit = AnswerLimit::new(50, 500);
        let mut count = |machines: std::ops::Range<u32>, times: u32, now_ns: u64| {
            let all = (0..times).flat_map(|_| machines.clone());
            all.filter(|n| limit.allows(machine(*n), now_ns)).count()
        };
        assert_eq!(count(0..1, 1000, SECOND_NS), 50);
        assert_eq!(count(0..1, 1000, SECOND_NS + 100_000_000), 5, "a tenth of a second later");
        assert_eq!(count(1..21, 100, 3 * SECOND_NS), 500);
        // Of more machines than are counted, none pushes out one that has had its share.
        assert_eq!(count(0..1, 1000, 5 * SECOND_NS), 50);
        assert!(count(1000..2000, 1, 5 * SECOND_NS) < MACHINES_MAX);
        assert_eq!(count(0..1, 1000, 5 * SECOND_NS), 0);
        assert_eq!(count(5000..5010, 1, 7 * SECOND_NS), 10, "their shares are whole again");
    }

    #[test]
    fn every_server_of_this_machine_answers_once() {
        // A port of this test alone.
        let port = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port();
        let mut servers = [1_u8, 2].map(|name| (name, Responder::open(port).unwrap()));
        let question = |reply_port: u16| reply_port.to_be_bytes().to_vec();
        let asking = std::thread::Builder::new().name("asking".to_owned());
        let ask_all = move || search(question, port, Duration::from_secs(2));
        let asking = asking.spawn(ask_all).unwrap();
        while !asking.is_finished() {
            for (name, server) in &mut servers {
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
