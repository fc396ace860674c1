//! What the server is started with.

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use anyhow::{bail, ensure};

/// Bytes of a token at least: 16 random characters are beyond guessing over a network.
pub(super) const TOKEN_BYTES_MIN: usize = 16;

/// Connections at once, each on the Unix socket and on TCP, where nobody says: a studio's browsers and scripts, each
/// with a few, and room for those that never finish a request. Each costs 50 KB at most.
const CONNECTIONS_MAX: usize = 256;

/// Where the service is spoken to, and by whom.
#[derive(Clone)]
pub struct HttpOptions {
    /// The Unix socket. Who may open it may do everything; its mode is 0660.
    pub unix_socket: Option<PathBuf>,
    /// An address besides: loopback, or any with a token.
    pub tcp: Option<SocketAddr>,
    /// What clients on TCP must know. Without one everybody on this machine may do everything.
    pub token: Option<String>,
    /// Names by which the service is reached besides `localhost` and its addresses, without a port.
    pub allowed_hosts: Vec<String>,
    /// Connections at once, each on the Unix socket and on TCP. More are told so and closed.
    pub connections_max: usize,
    /// How long things may take.
    pub limits: TimeLimits,
}

impl Default for HttpOptions {
    fn default() -> Self {
        Self {
            unix_socket: None,
            tcp: None,
            token: None,
            allowed_hosts: Vec::new(),
            connections_max: CONNECTIONS_MAX,
            limits: TimeLimits::default(),
        }
    }
}

impl std::fmt::Debug for HttpOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("HttpOptions")
            .field("unix_socket", &self.unix_socket)
            .field("tcp", &self.tcp)
            // Debug output ends up in logs.
            .field("token", &self.token.as_ref().map(|_| "(hidden)"))
            .field("allowed_hosts", &self.allowed_hosts)
            .field("connections_max", &self.connections_max)
            .field("limits", &self.limits)
            .finish()
    }
}

/// How long a client may take.
#[derive(Debug, Clone, Copy)]
pub struct TimeLimits {
    /// For the head of a request, and between two requests on one connection.
    pub head: Duration,
    /// For the body of a request.
    pub body: Duration,
    /// To take in anything at all of an answer.
    pub stall: Duration,
    /// For the service to carry out a request. The work goes on; the client is told so.
    pub work: Duration,
    /// Between signs of life on a stream of events that has nothing to tell.
    pub keep_alive: Duration,
}

impl Default for TimeLimits {
    fn default() -> Self {
        Self {
            head: Duration::from_secs(10),
            body: Duration::from_secs(10),
            stall: Duration::from_secs(30),
            // A stop waits for a disk that may stall half a minute before anything is lost.
            work: Duration::from_secs(60),
            keep_alive: Duration::from_secs(15),
        }
    }
}

impl HttpOptions {
    /// Refuses what would be of no use, or open to everybody.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        ensure!(
            self.unix_socket.is_some() || self.tcp.is_some(),
            "the HTTP API has neither a socket nor an address: give one, or leave it out"
        );
        ensure!(self.connections_max > 0, "0 connections let nobody in: give 1 or more");
        if let Some(token) = &self.token {
            ensure!(
                token.len() >= TOKEN_BYTES_MIN && token.bytes().all(|byte| byte.is_ascii_graphic()),
                "the token has to be {TOKEN_BYTES_MIN} or more visible ASCII characters: \
                 try `openssl rand -hex 32`"
            );
        }
        if let Some(address) = self.tcp
            && !address.ip().is_loopback()
            && self.token.is_none()
        {
            bail!(
                "{address} is open to the network and there is no token: set one, or listen on \
                 127.0.0.1 and come through ssh -L"
            );
        }
        for host in &self.allowed_hosts {
            ensure!(
                !host.is_empty() && !host.contains(['/', '*', '@', ' ']) && !has_port(host),
                "'{host}' is no name of a host: give it as it stands in the browser, without scheme and port"
            );
        }
        Ok(())
    }
}

fn has_port(host: &str) -> bool {
    host.rsplit_once(':').is_some_and(|(name, _)| !name.contains(':'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on(address: &str, token: Option<&str>) -> HttpOptions {
        HttpOptions {
            tcp: Some(address.parse().unwrap()),
            token: token.map(str::to_owned),
            ..HttpOptions::default()
        }
    }

    #[test]
    fn the_network_needs_a_token() {
        let refused = on("0.0.0.0:7060", None).check().unwrap_err().to_string();
        assert!(refused.contains("no token"), "{refused}");
        assert!(on("[::]:7060", None).check().is_err());
        assert!(on("127.0.0.1:7060", None).check().is_ok());
        assert!(on("[::1]:7060", None).check().is_ok());
        assert!(on("0.0.0.0:7060", Some("0123456789abcde")).check().is_err(), "too short");
        assert!(on("0.0.0.0:7060", Some("0123456789abc def")).check().is_err(), "a blank");
        let open = on("0.0.0.0:7060", Some("0123456789abcdef"));
        assert!(open.check().is_ok());
        assert!(!format!("{open:?}").contains("0123456789"), "{open:?}");
    }

    #[test]
    fn hosts_are_names() {
        let with = |host: &str| {
            HttpOptions { allowed_hosts: vec![host.to_owned()], ..on("127.0.0.1:1", None) }.check()
        };
        assert!(with("rig.lab.example").is_ok() && with("::1").is_ok());
        for host in ["http://rig", "rig:80", "*.lab", "", "a b"] {
            assert!(with(host).is_err(), "{host}");
        }
        assert!(HttpOptions::default().check().is_err(), "nothing to listen on");
    }
}
