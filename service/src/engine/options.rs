//! The options of the engine.

use std::sync::Arc;

use anyhow::{Context, anyhow};
use jiff::Zoned;
use mocapd_drivers::{registry, uri::DeviceUri};
use mocapd_take::record::Subject;

use crate::config::{
    ArmConfig, Config, DeviceChoice, DeviceConfig, NameParts, TakeConfig, auto_device,
};

/// The engine's part of a configuration.
#[derive(Debug, Clone)]
pub struct EngineOptions {
    /// Name of the rig.
    pub rig: String,
    /// The device to record, and its settings.
    pub device: DeviceConfig,
    /// Where takes are written, and how.
    pub take: TakeConfig,
    /// The subject, stored in every take.
    pub subject: Option<Arc<Subject>>,
    /// What is kept in memory between takes.
    pub arm: ArmConfig,
}

impl EngineOptions {
    /// Takes the options from a configuration, and reads the subject's files.
    ///
    /// # Errors
    /// If a file of the subject is missing or invalid.
    pub fn load(config: &Config) -> anyhow::Result<Self> {
        Ok(Self {
            rig: config.rig_name.clone(),
            device: config.device.clone(),
            take: config.take.clone(),
            subject: config.subject.load().context("[subject]")?.map(Arc::new),
            arm: config.arm.clone(),
        })
    }

    /// The device to open: the configured one, or the one found automatically.
    pub(super) fn find_device(&self) -> anyhow::Result<DeviceUri> {
        match &self.device.uri {
            DeviceChoice::At(uri) => Ok(uri.clone()),
            auto @ DeviceChoice::Auto => {
                auto_device(auto, &registry::devices()?).map_err(|error| anyhow!(error))
            }
        }
    }

    /// A name for a take that was started without one; if it exists, the caller tries the next `count`.
    pub(super) fn name_take(&self, count: u32) -> String {
        let (begin, count) = (Zoned::now().datetime(), u64::from(count));
        self.take.name.fill(&NameParts { begin, rig: &self.rig, count })
    }
}
