//! `mocapd.toml`: what is written in it, checked key by key into a [`Config`] that nothing has to be asked of again.
//!
//! The table of [`keys`] says of each key what it takes, its default, its unit and why it is there; the example
//! (`mocapd config example`), docs/config.md and the messages come from it.

mod key;
pub mod keys;
mod name;
pub(crate) mod problem;
mod read;

#[cfg(test)]
mod tests;

use std::{
    fmt::{self, Write},
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::Context;
use mocapd_acquire::setting::{self, Setting};
use mocapd_codec::Settings;
use mocapd_drivers::{
    registry::{Claim, Listed},
    uri::DeviceUri,
};
use rustix::fs::{Access, access};
use serde_json::Value as Json;

use self::keys::{KEYS, SECTIONS};
pub use self::{
    key::{DefaultValue, Key, ValueType, When},
    keys::{example, table},
    name::{NAME_BYTES_MAX, NameParts, NameTemplate, is_refused_in_name},
    problem::{ConfigError, PROBLEMS_MAX, Place, Problem},
    read::{CONFIG_BYTES_MAX, CONFIG_PATH, Overrides, Surroundings},
};
use crate::{log::Level, subject::SubjectFiles, trigger::Network};

/// A configuration in which every value is possible, and all of them together.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// What the rig is called.
    pub rig_name: String,
    /// Which device, and how it runs.
    pub device: DeviceConfig,
    /// Where takes go, and how they are written.
    pub take: TakeConfig,
    /// Who is captured.
    pub subject: SubjectFiles,
    /// What is kept while no take is recorded.
    pub arm: ArmConfig,
    /// Who may ask and command the service, and where.
    pub http: HttpConfig,
    /// Capture triggers in and out.
    pub trigger: TriggerConfig,
    /// How much is said.
    pub log_level: Level,
}

/// `[device]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeviceConfig {
    /// Which one.
    pub uri: DeviceChoice,
    /// Its frame rate in Hz; `None` leaves it as it is.
    pub rate_hz: Option<f64>,
    /// Whether the bytes of its line are kept beside the takes, from when it is armed until it is not.
    pub raw_log: bool,
}

/// Which device.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The only one that is attached and that a driver claims: see [`choose`].
    #[default]
    Auto,
    /// This one.
    At(DeviceUri),
}

/// `[take]`.
#[derive(Debug, Clone, PartialEq)]
pub struct TakeConfig {
    /// Where takes are created.
    pub directory: PathBuf,
    /// How they are called there.
    pub name: NameTemplate,
    /// Resampler and tolerance.
    pub codec: Settings,
    /// Length of a stretch: a kill loses no more.
    pub stretch: Duration,
    /// Time between syncs: a power cut loses no more than this and a stretch.
    pub sync: Duration,
    /// Bytes of the disk that stay free.
    pub keep_free_bytes: u64,
    /// How long a take waits for a device that went away.
    pub reconnect: Duration,
    /// The longest take; it is closed then.
    pub max_length: Option<Duration>,
}

/// `[arm]`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ArmConfig {
    /// Whether the service arms itself when it starts.
    pub at_start: bool,
    /// What of the past is kept while armed.
    pub pre_roll: Duration,
    /// How much of it a plain start puts into its take.
    pub include_pre_roll: Duration,
    /// Bytes that the pre-roll may hold.
    pub memory_max_bytes: u64,
}

/// `[http]`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HttpConfig {
    /// The Unix socket.
    pub socket: Option<PathBuf>,
    /// The TCP address.
    pub listen: Option<SocketAddr>,
    /// Where the token is that callers over TCP must know; there is one whenever other machines can call.
    pub token_file: Option<PathBuf>,
    /// Names, in small letters, under which the service may be called beside its addresses.
    pub allowed_hosts: Vec<String>,
    /// Connections at once.
    pub connections_max: usize,
}

/// `[trigger]`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TriggerConfig {
    /// The UDP address on which triggers are heard.
    pub listen: Option<SocketAddr>,
    /// Who is told of our starts and stops.
    pub send_to: Vec<SocketAddr>,
    /// Who is listened to; everybody when it is empty.
    pub allow_from: Vec<Network>,
    /// The longest delay that a trigger may ask for.
    pub delay_max: Duration,
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::At(uri) => uri.fmt(f),
        }
    }
}

/// A key with another value.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Which key, such as `arm.pre_roll`.
    pub key: &'static str,
    /// When the new value holds.
    pub when: When,
    /// Its value until then; `None` where it had none.
    pub from: Option<Json>,
    /// Its new one.
    pub to: Option<Json>,
}

impl Config {
    /// What `new` has otherwise, in the order of the table. Values are compared as they are written, which is
    /// exact: what is written is read as the same again.
    #[must_use]
    pub fn changes(&self, new: &Self) -> Vec<Change> {
        let changed = |key: &'static Key| {
            let (from, to) = ((key.field.to_json)(self), (key.field.to_json)(new));
            (from != to).then_some(Change { key: key.path, when: key.when, from, to })
        };
        KEYS.iter().filter_map(changed).collect()
    }

    /// Every key that has a value, as a file that is read as this configuration again, wherever mocapd runs.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut out = String::new();
        for (section, _) in SECTIONS {
            // Writing into a String does not fail.
            writeln!(out, "[{section}]").ok();
            for key in KEYS.iter().filter(|key| key.section() == *section) {
                if let Some(value) = (key.field.to_json)(self) {
                    // Texts, numbers, booleans and lists of texts are the same in JSON and TOML.
                    writeln!(out, "{} = {value}", key.name()).ok();
                }
            }
        }
        out
    }

    /// Every key with its value; `None` where it has none.
    pub fn values(&self) -> impl Iterator<Item = (&'static str, Option<Json>)> + '_ {
        KEYS.iter().map(|key| (key.path, (key.field.to_json)(self)))
    }

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

/// In one line, with the key that helps against a refusal.
pub(crate) fn message_with_keys(error: &anyhow::Error) -> String {
    setting::words(error, key_hint)
}

pub(crate) fn key_hint(setting: Setting) -> String {
    match setting {
        Setting::Rate(Some(rate_hz)) => format!("set device.rate_hz = {rate_hz}"),
        Setting::Rate(None) => "leave device.rate_hz out".to_owned(),
        Setting::KeepFree => "lower take.keep_free".to_owned(),
    }
}

/// Which device is meant, among those that `registry::devices` lists. Devices that say themselves what they are
/// come first; then adapters behind which one may be. A bare port of the machine is never meant: something else
/// may listen there, and nothing is written to a device that nobody asked for.
///
/// # Errors
/// That there is none, or more than one, and what to write.
pub fn auto_device(choice: &DeviceChoice, attached: &[Listed]) -> Result<DeviceUri, String> {
    if let DeviceChoice::At(uri) = choice {
        return Ok(uri.clone());
    }
    let claimed = |listed: &&Listed, claim: Claim| {
        listed.family.is_some_and(|(_, sure)| sure == claim)
            && (claim == Claim::Certain || listed.candidate.usb_ids.is_some())
    };
    let with = |claim| attached.iter().filter(move |listed| claimed(listed, claim));
    let mut found: Vec<&Listed> = with(Claim::Certain).collect();
    if found.is_empty() {
        found = with(Claim::Possible).collect();
    }
    match found[..] {
        [] => Err(
            "no device is attached that a driver claims: plug one in, or name one in device.uri; \
                   `mocapd devices` lists what is there"
                .to_owned(),
        ),
        [only] => Ok(DeviceUri { location: only.candidate.location.clone(), driver: None }),
        _ => {
            // A hub has no room for more than a line does.
            let names: Vec<String> =
                found.iter().take(8).map(|listed| listed.candidate.location.to_string()).collect();
            Err(format!(
                "{} devices are attached, and device.uri does not say which: write uri = \"{}\" under [device], \
                 or one of the others ({})",
                found.len(),
                names.first().map_or("", String::as_str),
                names.get(1..).unwrap_or_default().join(", ")
            ))
        }
    }
}
