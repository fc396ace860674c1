//! What the engine has to know.

use std::{fmt, path::PathBuf, sync::Arc, time::Duration};

use anyhow::{Context, anyhow};
use jiff::Zoned;
use mocapd_codec::Settings;
use mocapd_drivers::{registry, uri::DeviceUri};
use mocapd_take::record::Subject;

use crate::config::{Config, DeviceChoice, NameParts, choose};

/// Which device it is, looked up whenever it is opened.
pub type FindDevice = Arc<dyn Fn() -> anyhow::Result<DeviceUri> + Send + Sync>;

/// Names a take that nobody named; of names that exist, the next is asked for.
pub(super) type NameTake = Arc<dyn Fn(u32) -> String + Send + Sync>;

/// The engine's part of a configuration.
#[derive(Clone)]
pub struct EngineOptions {
    /// Name of the rig.
    pub rig: String,
    /// In words, where the device is looked for.
    pub device: String,
    /// Which it is.
    pub find_device: FindDevice,
    /// The frame rate to set.
    pub rate_hz: Option<f64>,
    /// Whether the bytes of its line are kept, from when it is armed until it is not.
    pub raw_log: bool,
    /// The takes' folder.
    pub directory: PathBuf,
    /// Names of takes that nobody named.
    pub name_take: NameTake,
    /// Who is captured: stands in every take.
    pub subject: Option<Arc<Subject>>,
    /// Resampler and tolerance.
    pub codec: Settings,
    /// Length of a stretch.
    pub stretch: Duration,
    /// Time between syncs.
    pub sync: Duration,
    /// Bytes of the disk that stay free.
    pub keep_free_bytes: u64,
    /// How long a take waits for a device that went away.
    pub reconnect: Duration,
    /// The longest take.
    pub max_length: Option<Duration>,
    /// Whether it is armed when it starts.
    pub arm_at_start: bool,
    /// What of the past is kept while armed.
    pub pre_roll: Duration,
    /// How much of it a plain start puts into its take.
    pub include_pre_roll: Duration,
    /// Bytes that it may hold.
    pub memory_max_bytes: u64,
}

impl EngineOptions {
    /// As a configuration has them; who is captured is read from its files.
    ///
    /// # Errors
    /// What is wrong with these files.
    pub fn load(config: &Config) -> anyhow::Result<Self> {
        let subject = config.subject.load().context("[subject]")?.map(Arc::new);
        Ok(Self { subject, ..Self::of(config) })
    }

    /// As a configuration has them, without the subject.
    #[must_use]
    pub fn of(config: &Config) -> Self {
        let (choice, rig) = (config.device.uri.clone(), config.rig_name.clone());
        let (template, name) = (config.take.name.clone(), rig.clone());
        Self {
            rig,
            device: match &choice {
                DeviceChoice::Auto => "auto".to_owned(),
                DeviceChoice::At(uri) => uri.to_string(),
            },
            find_device: Arc::new(move || match &choice {
                DeviceChoice::At(uri) => Ok(uri.clone()),
                DeviceChoice::Auto => {
                    choose(&choice, &registry::devices()?).map_err(|e| anyhow!(e))
                }
            }),
            rate_hz: config.device.rate_hz,
            raw_log: config.device.raw_log,
            directory: config.take.directory.clone(),
            name_take: Arc::new(move |count| {
                let (begin, count) = (Zoned::now().datetime(), u64::from(count));
                template.fill(&NameParts { begin, rig: &name, count })
            }),
            subject: None,
            codec: config.take.codec,
            stretch: config.take.stretch,
            sync: config.take.sync,
            keep_free_bytes: config.take.keep_free_bytes,
            reconnect: config.take.reconnect,
            max_length: config.take.max_length,
            arm_at_start: config.arm.at_start,
            pre_roll: config.arm.pre_roll,
            include_pre_roll: config.arm.include_pre_roll,
            memory_max_bytes: config.arm.memory_max_bytes,
        }
    }
}

impl fmt::Debug for EngineOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("EngineOptions")
            .field("rig", &self.rig)
            .field("device", &self.device)
            .field("directory", &self.directory)
            .finish_non_exhaustive()
    }
}
