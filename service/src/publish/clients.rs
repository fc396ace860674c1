//! Who may connect to a publisher.

use std::net::{IpAddr, SocketAddr};

use super::PublisherName;
use crate::trigger::Network;

/// Which clients a publisher accepts: this machine's and those of `allow_from`, up to `clients_max`.
#[derive(Debug)]
pub(super) struct ClientLimits {
    name: PublisherName,
    allow_from: Vec<Network>,
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
        Self { name, allow_from, clients_max, refused: 0, news: Vec::new() }
    }

    /// Whether this machine's clients, or those of another, may connect.
    pub(super) fn is_allowed(&self, ip: IpAddr) -> bool {
        let ip = ip.to_canonical();
        ip.is_loopback() || self.allow_from.iter().any(|network| network.contains(ip))
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
    }
}
