//! Who may connect to a publisher.

use std::{
    cell::RefCell,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    time::{Duration, Instant},
};

use mocapd_drivers::transport::network::interfaces;

use super::PublisherName;
use crate::trigger::Network;

/// Time between two looks at the addresses of this machine.
const ADDRESSES_AGE_MAX: Duration = Duration::from_secs(5);

/// The addresses of this machine: a program on it that asks an address of a network asks from that address.
#[derive(Debug, Default)]
struct OwnAddresses {
    all: Vec<Ipv4Addr>,
    looked_at: Option<Instant>,
}

impl OwnAddresses {
    fn contains(&mut self, ip: IpAddr) -> bool {
        if self.looked_at.is_none_or(|at| at.elapsed() >= ADDRESSES_AGE_MAX) {
            self.looked_at = Some(Instant::now());
            let found = interfaces().unwrap_or_default();
            self.all = found.into_iter().map(|interface| interface.address).collect();
        }
        self.all.iter().any(|own| *own == ip)
    }
}

/// Which clients a publisher accepts: this machine's and those of `allow_from`, up to `clients_max`.
#[derive(Debug)]
pub(super) struct ClientLimits {
    name: PublisherName,
    allow_from: Vec<Network>,
    own: RefCell<OwnAddresses>,
    clients_max: usize,
    refused: u64,
    news: Vec<String>,
}

/// Why a client is not accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NotAccepted {
    /// Its address is not allowed.
    Address,
    /// There are as many as there may be.
    Full,
}

impl ClientLimits {
    pub(super) fn new(name: PublisherName, allow_from: &[Network], clients_max: usize) -> Self {
        let allow_from = allow_from.to_vec();
        let own = RefCell::default();
        Self { name, allow_from, own, clients_max, refused: 0, news: Vec::new() }
    }

    /// Whether this machine's clients, or those of another, may connect.
    pub(super) fn is_allowed(&self, ip: IpAddr) -> bool {
        let ip = ip.to_canonical();
        ip.is_loopback()
            || self.allow_from.iter().any(|network| network.contains(ip))
            || self.own.try_borrow_mut().is_ok_and(|mut own| own.contains(ip))
    }

    /// Checks a client that connects while there are `n_clients` others, and counts and reports one that is refused.
    pub(super) fn check(&mut self, peer: SocketAddr, n_clients: usize) -> Result<(), NotAccepted> {
        let PublisherName { id, title } = self.name;
        let (refusal, why) = match self.is_allowed(peer.ip()) {
            false => (NotAccepted::Address, format!("it is not in publish.{id}.allow_from")),
            true if n_clients >= self.clients_max => {
                (NotAccepted::Full, format!("publish.{id}.clients_max are connected already"))
            }
            true => return Ok(()),
        };
        self.refused += 1;
        self.news.push(format!("{title} client {} refused: {why}", peer.ip().to_canonical()));
        Err(refusal)
    }

    /// Limit on simultaneous clients.
    pub(super) fn clients_max(&self) -> usize {
        self.clients_max
    }

    /// Number of clients that were refused.
    pub(super) fn refused(&self) -> u64 {
        self.refused
    }

    /// The messages about refused clients since the last call.
    pub(super) fn take_news(&mut self) -> Vec<String> {
        std::mem::take(&mut self.news)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clients_of_this_machine_and_of_allowed_networks_connect_up_to_the_limit() {
        let name = PublisherName { id: "lsl", title: "LSL" };
        let networks = ["10.1.0.0/16".parse().unwrap()];
        let mut limits = ClientLimits::new(name, &networks, 2);
        let at = |ip: &str| SocketAddr::new(ip.parse().unwrap(), 5000);
        for ip in ["127.0.0.1", "::1", "10.1.2.3", "::ffff:10.1.2.3"] {
            assert_eq!(limits.check(at(ip), 1), Ok(()));
        }
        assert_eq!(limits.check(at("10.2.0.1"), 0), Err(NotAccepted::Address));
        assert_eq!(limits.check(at("::ffff:127.0.0.1"), 2), Err(NotAccepted::Full));
        assert_eq!((limits.refused(), limits.clients_max()), (2, 2));
        let news = limits.take_news();
        assert_eq!(news[0], "LSL client 10.2.0.1 refused: it is not in publish.lsl.allow_from");
        assert!(news[1].contains("127.0.0.1") && news[1].contains("publish.lsl.clients_max"));
        assert!(limits.take_news().is_empty());
        // A program of this machine that asks an address of a network.
        for interface in interfaces().unwrap() {
            assert!(limits.is_allowed(interface.address.into()), "{interface:?}");
        }
    }
}
