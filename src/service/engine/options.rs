//! What the engine has to know.

use std::{fmt, path::PathBuf, sync::Arc, time::Duration};

use mocapd_codec::Settings;
use mocapd_drivers::uri::DeviceUri;

/// Which device it is, looked up whenever it is opened.
pub type FindDevice = Arc<dyn Fn() -> anyhow::Result<DeviceUri> + Send + Sync>;

/// Names a take that nobody named; of names that exist, the next is asked for.
pub type NameTake = Arc<dyn Fn(u32) -> String + Send + Sync>;

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
    /// The takes' folder.
    pub directory: PathBuf,
    /// Names of takes that nobody named.
    pub name_take: NameTake,
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

impl fmt::Debug for EngineOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("EngineOptions")
            .field("rig", &self.rig)
            .field("device", &self.device)
            .field("directory", &self.directory)
            .finish_non_exhaustive()
    }
}
