//! What is possible and still may surprise: told by `mocapd config check` and when the service starts.

use std::net::SocketAddr;

use super::Config;

impl Config {
    /// One line each.
    #[must_use]
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let from_outside = |listen: Option<SocketAddr>| {
            listen.filter(|address| !address.ip().to_canonical().is_loopback())
        };
        if let Some(listen) = from_outside(self.trigger.listen)
            && self.trigger.allow_from.is_empty()
        {
            notes.push(format!(
                "trigger.allow_from is empty: ANYBODY who reaches {listen} over UDP can start and stop takes; \
                 name the machines that may, such as allow_from = [\"192.168.10.0/24\"]"
            ));
        }
        if !self.trigger.allow_from.is_empty() && self.trigger.listen.is_none() {
            notes.push(
                "trigger.allow_from is given, and trigger.listen is not: no trigger is heard"
                    .to_owned(),
            );
        }
        if let (Some(listen), Some(_)) = (from_outside(self.http.listen), &self.http.token_file) {
            notes.push(format!(
                "http.listen is {listen}: the token travels over the network as it is; \
                 use a network that you trust, or a tunnel"
            ));
        }
        let nobody_asks = self.http.socket.is_none() && self.http.listen.is_none();
        if nobody_asks && self.trigger.listen.is_none() {
            notes.push(
                "there is no http.socket, no http.listen and no trigger.listen: nobody can start a take"
                    .to_owned(),
            );
        } else if nobody_asks {
            notes.push(
                "there is no http.socket and no http.listen: nobody can ask how it is".to_owned(),
            );
        }
        if self.device.raw_log {
            notes.push(
                "device.raw_log is on: the line's bytes are kept for as long as it is armed, many times what its takes have"
                    .to_owned(),
            );
        }
        notes
    }
}
