//! `mocapd.toml`: what is written in it, checked key by key into a [`Config`] that nothing has to be asked of again.
//!
//! The table of [`keys`] says of each key what it takes, its default, its unit and why it is there; the example
//! (`mocapd config example`), docs/config.md and the messages come from it.

mod changes;
mod check;
mod choose;
mod example;
pub mod keys;
mod load;
mod name;
mod network;
mod notes;
mod problem;
mod reader;
mod render;
mod surroundings;
mod token;
mod value;
mod written;

#[cfg(test)]
mod tests;

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use mocapd_codec::Settings;
use mocapd_drivers::uri::DeviceUri;

pub use self::{
    changes::Change,
    choose::choose,
    example::{example, table},
    keys::When,
    load::{CONFIG_BYTES_MAX, CONFIG_PATH, Overrides},
    name::{NAME_BYTES_MAX, NameParts, NameTemplate, is_refused_in_name},
    network::Network,
    problem::{ConfigError, PROBLEMS_MAX, Place, Problem},
    surroundings::Surroundings,
    token::{Token, TokenError},
};
use crate::{log::Level, subject::SubjectFiles};

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
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceConfig {
    /// Which one.
    pub uri: DeviceChoice,
    /// Its frame rate in Hz; `None` leaves it as it is.
    pub rate_hz: Option<f64>,
    /// Whether the bytes of its line are kept beside each take.
    pub raw_log: bool,
}

/// Which device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The only one that is attached and that a driver claims: see [`choose`].
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
#[derive(Debug, Clone, PartialEq, Eq)]
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
#[derive(Debug, Clone, PartialEq, Eq)]
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
#[derive(Debug, Clone, PartialEq, Eq)]
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
