//! Reads `mocapd.toml` into a checked [`Config`], key by key.
//!
//! The table of [`keys`] has the type, default and purpose of each key. The example file (`mocapd config example`), the
//! tables of docs/config.md and the error messages are generated from it.

mod key;
pub mod keys;
pub(crate) mod problem;
mod publishers;
mod read;

#[cfg(test)]
mod tests;

use std::{
    fmt::{self, Write},
    net::SocketAddr,
    path::{self, Path, PathBuf},
    time::Duration,
};

use anyhow::Context;
use mocapd_acquire::{
    files::FileId,
    setting::{self, Setting},
};
use mocapd_codec::Settings;
use mocapd_drivers::{
    registry::{AttachedDevice, Claim},
    uri::DeviceUri,
};
use mocapd_store::ObjectUrl;
use mocapd_take::motion::UpAxis;
use serde_json::Value as Json;

use self::keys::{KEYS, SECTIONS};
pub use self::{
    key::{DefaultValue, Key, ReloadPolicy, ValueType},
    keys::{example, table},
    problem::{ConfigError, ConfigProblem, PROBLEMS_MAX, SourceLocation},
    publishers::{FoxglovePublishConfig, LslPublishConfig, NatNetPublishConfig, QtmPublishConfig},
    read::{CONFIG_BYTES_MAX, CONFIG_PATH, Environment, Overrides},
};
pub use crate::take_name::{
    NAME_BYTES_MAX, NameParts, NameTemplate, is_refused_in_name, is_reserved_name,
};
use crate::{log::Level, subject::SubjectFiles, trigger::Network};

/// A configuration whose values are all valid, alone and together.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Name of the rig.
    pub rig_name: String,
    /// The device to record, and its settings.
    pub device: DeviceConfig,
    /// Where takes are written, and how.
    pub take: TakeConfig,
    /// The subject's files.
    pub subject: SubjectFiles,
    /// What is kept in memory between takes.
    pub arm: ArmConfig,
    /// Where finished takes are uploaded to.
    pub archive: ArchiveConfig,
    /// The HTTP interface.
    pub http: HttpConfig,
    /// Capture triggers.
    pub trigger: TriggerConfig,
    /// What is published live as QTM does.
    pub publish_qtm: QtmPublishConfig,
    /// What is published live as OptiTrack's Motive does.
    pub publish_natnet: NatNetPublishConfig,
    /// What is published live as streams of the Lab Streaming Layer.
    pub publish_lsl: LslPublishConfig,
    /// What is published live for Foxglove.
    pub publish_foxglove: FoxglovePublishConfig,
    /// How much is logged.
    pub log_level: Level,
}

/// The section `[device]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeviceConfig {
    /// The device to record.
    pub uri: DeviceChoice,
    /// Frame rate to set, in Hz; `None` keeps the device's own.
    pub rate_hz: Option<f64>,
    /// Whether every byte received while the device is armed is logged beside the takes.
    pub raw_log: bool,
}

/// The choice of the device.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The only attached device that a driver recognises: see [`auto_device`].
    #[default]
    Auto,
    /// The device at this URI.
    At(DeviceUri),
}

/// The section `[take]`.
#[derive(Debug, Clone, PartialEq)]
pub struct TakeConfig {
    /// The folder for new takes.
    pub directory: PathBuf,
    /// The names of new takes.
    pub name: NameTemplate,
    /// Resampler and tolerance.
    pub codec: Settings,
    /// Largest error of the rotations of rigid bodies, in degrees; `None` for the one that follows from the tolerance.
    pub angle_degrees: Option<f64>,
    /// Whether the residuals of markers are recorded.
    pub residuals: bool,
    /// The axis that points up, where the device states none.
    pub up_axis: UpAxis,
    /// Length of a stretch: a killed process loses at most one.
    pub stretch: Duration,
    /// Time between syncs: a power cut loses at most this time and one stretch.
    pub sync: Duration,
    /// Disk space to keep free, in bytes.
    pub keep_free_bytes: u64,
    /// How long a take waits for a device that has disconnected.
    pub reconnect: Duration,
    /// The length at which a take is closed.
    pub max_length: Option<Duration>,
    /// How long takes stay in the trash.
    pub trash_keep: Duration,
}

/// The section `[arm]`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ArmConfig {
    /// Whether the service arms itself at startup.
    pub at_start: bool,
    /// Length of the pre-roll.
    pub pre_roll: Duration,
    /// How much of it a start puts into its take by default.
    pub include_pre_roll: Duration,
    /// Memory limit of the pre-roll in bytes.
    pub memory_max_bytes: u64,
}

/// The section `[archive]`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ArchiveConfig {
    /// The folder in object storage that finished takes are uploaded to.
    pub url: Option<ObjectUrl>,
    /// Limit on the rate of uploads, in bytes per second.
    pub rate_max_bytes_per_s: u64,
    /// How long after its upload the local copy of a take is removed; `None` keeps it.
    pub remove_local_after: Option<Duration>,
}

/// The section `[http]`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HttpConfig {
    /// The Unix socket.
    pub socket: Option<PathBuf>,
    /// The TCP address.
    pub listen: Option<SocketAddr>,
    /// The file with the token for clients over TCP; required if other machines can connect.
    pub token_file: Option<PathBuf>,
    /// Host names, in lower case, under which clients may reach the service besides its addresses.
    pub allowed_hosts: Vec<String>,
    /// Limit on simultaneous connections.
    pub connections_max: usize,
}

/// The section `[trigger]`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TriggerConfig {
    /// The UDP address that receives triggers.
    pub listen: Option<SocketAddr>,
    /// The addresses that are sent triggers.
    pub send_to: Vec<SocketAddr>,
    /// The senders that are accepted; all if empty.
    pub allow_from: Vec<Network>,
    /// Longest delay that a trigger may ask for.
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

/// A key whose value has changed.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// The key, such as `arm.pre_roll`.
    pub key: &'static str,
    /// When the new value applies.
    pub when: ReloadPolicy,
    /// The old value; `None` if there was none.
    pub from: Option<Json>,
    /// The new value.
    pub to: Option<Json>,
}

impl Config {
    /// The keys whose values differ in `new`, in the order of the table. Values are compared as JSON, which is exact:
    /// the JSON of a value is parsed to the same value.
    #[must_use]
    pub fn changes(&self, new: &Self) -> Vec<Change> {
        let changed = |key: &'static Key| {
            let (from, to) = ((key.field.to_json)(self), (key.field.to_json)(new));
            (from != to).then_some(Change { key: key.path, when: key.when, from, to })
        };
        KEYS.iter().filter_map(changed).collect()
    }

    /// All keys that have a value, as a file that is parsed to this configuration in any environment.
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

    /// All keys with their values; `None` if a key has none.
    pub fn values(&self) -> impl Iterator<Item = (&'static str, Option<Json>)> + '_ {
        KEYS.iter().map(|key| (key.path, (key.field.to_json)(self)))
    }

    /// Warnings of `mocapd config check` and `mocapd run`, one line each: those of [`Config::notes`], and those about
    /// this machine.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.notes();
        if let Some(folder) = self.missing_socket_folder() {
            warnings.push(format!(
                "no Unix socket: its folder {} does not exist (systemd creates it for the unit); \
                 set http.socket to another path, or to \"\" for none",
                folder.display()
            ));
        }
        if let Err(error) = self.check_takes_folder() {
            warnings.push(format!("{error:#}"));
        }
        warnings
    }

    /// The folder of the Unix socket, if it does not exist and the service can continue with TCP alone.
    #[must_use]
    pub fn missing_socket_folder(&self) -> Option<&Path> {
        self.http.listen?;
        let folder = self.http.socket.as_deref()?.parent()?;
        (!folder.as_os_str().is_empty() && !folder.exists()).then_some(folder)
    }

    /// Tries whether this user can write to the takes' folder, or create it.
    ///
    /// # Errors
    /// It is not writable; the message says what to do.
    pub fn check_takes_folder(&self) -> anyhow::Result<()> {
        let directory = self.take.directory.as_path();
        let there = directory.ancestors().find(|folder| folder.exists());
        // A relative path without an existing folder is in the current one.
        let there = there.filter(|there| !there.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // A file without a name, which is gone at once: it finds a read-only or full disk, too.
        tempfile::tempfile_in(there).map(drop).with_context(|| {
            format!(
                "cannot write to the takes' folder {}: make it writable for the service's user, or set another take.directory",
                directory.display()
            )
        })
    }

    /// Why takes cannot be uploaded as configured: this build lacks the client, or the archive is the takes' folder.
    #[must_use]
    pub fn archive_problem(&self) -> Option<String> {
        let url = self.archive.url.as_ref()?;
        if let Err(error) = url.check_built() {
            return Some(format!("archive.url: {error}"));
        }
        let archive = place_of(&url.local_path()?)?;
        (place_of(&self.take.directory)? == archive).then(|| {
            format!("archive.url: {url} is the takes' folder itself, where an upload is no second copy: set it to a folder elsewhere")
        })
    }

    /// Warnings about the configuration itself, one line each.
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
                "trigger.allow_from is empty: ANYBODY who can reach {listen} over UDP can start and stop takes; \
                 list the allowed senders, such as allow_from = [\"192.168.10.0/24\"]"
            ));
        }
        if !self.trigger.allow_from.is_empty() && self.trigger.listen.is_none() {
            notes.push(
                "trigger.allow_from has no effect: trigger.listen is not set, so no triggers are received"
                    .to_owned(),
            );
        }
        if let (Some(listen), Some(_)) = (from_outside(self.http.listen), &self.http.token_file) {
            notes.push(format!(
                "http.listen is {listen}: the token is sent over the network unencrypted; \
                 use a network that you trust, or a tunnel"
            ));
        }
        let nobody_asks = self.http.socket.is_none() && self.http.listen.is_none();
        if nobody_asks && self.trigger.listen.is_none() {
            notes.push(
                "http.socket, http.listen and trigger.listen are all empty: nothing can start a take"
                    .to_owned(),
            );
        } else if nobody_asks {
            notes.push(
                "http.socket and http.listen are both empty: nothing can query the service"
                    .to_owned(),
            );
        }
        if self.archive.remove_local_after.is_some() && self.archive.url.is_none() {
            notes.push(
                "archive.remove_local_after has no effect: archive.url is not set, so no take is uploaded"
                    .to_owned(),
            );
        }
        notes.extend(self.publish_qtm.notes());
        notes.extend(self.publish_natnet.notes());
        notes.extend(self.publish_lsl.notes());
        notes.extend(self.publish_foxglove.notes());
        if self.device.raw_log {
            notes.push(
                "device.raw_log is on: every byte received while armed is logged, many times the size of the takes"
                    .to_owned(),
            );
        }
        notes
    }
}

/// Where a folder is or would be created, by whatever path or link: the last folder above it that exists, and the names
/// from there.
fn place_of(folder: &Path) -> Option<(FileId, PathBuf)> {
    let folder = path::absolute(folder).ok()?;
    folder.ancestors().find_map(|there| {
        let found = FileId::of(&there.metadata().ok()?);
        Some((found, folder.strip_prefix(there).ok()?.to_owned()))
    })
}

/// An error as one line, with the configuration key that helps.
pub(crate) fn message_with_keys(error: &anyhow::Error) -> String {
    setting::message(error, key_hint)
}

pub(crate) fn key_hint(setting: Setting) -> String {
    match setting {
        Setting::Rate(Some(rate_hz)) => format!("set device.rate_hz = {rate_hz}"),
        Setting::Rate(None) => "remove device.rate_hz".to_owned(),
        Setting::KeepFree => "lower take.keep_free".to_owned(),
    }
}

/// Selects the device among those listed by `registry::devices`: devices that identify themselves first, then USB
/// adapters that may have one behind them. A bare serial port is never selected: something else may be connected to it,
/// and nothing is written to a device without a request.
///
/// # Errors
/// There is no device, or more than one; the message says what to write.
pub fn auto_device(
    choice: &DeviceChoice,
    attached: &[AttachedDevice],
) -> Result<DeviceUri, String> {
    if let DeviceChoice::At(uri) = choice {
        return Ok(uri.clone());
    }
    let claimed = |listed: &&AttachedDevice, claim: Claim| {
        listed.family.is_some_and(|(_, sure)| sure == claim)
            && (claim == Claim::Certain || listed.candidate.usb_ids.is_some())
    };
    let with = |claim| attached.iter().filter(move |listed| claimed(listed, claim));
    let mut found: Vec<&AttachedDevice> = with(Claim::Certain).collect();
    if found.is_empty() {
        found = with(Claim::Possible).collect();
    }
    match found[..] {
        [] => Err("no device found that a driver recognises: connect one, or set device.uri; \
                   `mocapd devices` lists what is attached"
            .to_owned()),
        [only] => Ok(DeviceUri { location: only.candidate.location.clone(), driver: None }),
        _ => {
            // Bounded, so that a large hub does not fill the screen.
            let names: Vec<String> =
                found.iter().take(8).map(|listed| listed.candidate.location.to_string()).collect();
            Err(format!(
                "{} devices are attached: choose one with uri = \"{}\" under [device], \
                 or one of the others ({})",
                found.len(),
                names.first().map_or("", String::as_str),
                names.get(1..).unwrap_or_default().join(", ")
            ))
        }
    }
}
