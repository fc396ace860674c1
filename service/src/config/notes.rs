//! What is possible and still may surprise: `mocapd config check` and `mocapd run` warn of the same.

use std::{net::SocketAddr, path::Path};

use anyhow::Context;
use rustix::fs::{Access, access};

use super::Config;

impl Config {
    /// What `mocapd config check` and `mocapd run` warn of, one line each: [`Config::notes`], and what this machine adds.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.notes();
        if let Some(folder) = self.missing_socket_folder() {
            warnings.push(format!(
                "there is no Unix socket, because its folder {} does not exist: systemd makes it for the unit; \
                 set http.socket to another path, or to \"\" for none",
                folder.display()
            ));
        }
        if let Err(error) = self.check_takes_folder() {
            warnings.push(format!("{error:#}"));
        }
        warnings
    }

    /// The folder of the Unix socket, where it does not exist and the service goes on with TCP alone.
    #[must_use]
    pub fn missing_socket_folder(&self) -> Option<&Path> {
        self.http.listen?;
        let folder = self.http.socket.as_deref()?.parent()?;
        (!folder.as_os_str().is_empty() && !folder.exists()).then_some(folder)
    }

    /// Whether this user can write into the takes' folder, or make it.
    ///
    /// # Errors
    /// Why not, and what to do.
    pub fn check_takes_folder(&self) -> anyhow::Result<()> {
        let directory = self.take.directory.as_path();
        let there = directory.ancestors().find(|folder| folder.exists());
        // A relative path without a folder that exists is in this one.
        let there = there.filter(|there| !there.as_os_str().is_empty()).unwrap_or(Path::new("."));
        access(there, Access::WRITE_OK | Access::EXEC_OK).with_context(|| {
            format!(
                "cannot write into the takes' folder {}: give it to the user that the service runs as, or name another one",
                directory.display()
            )
        })
    }

    /// What the configuration itself says, one line each.
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
