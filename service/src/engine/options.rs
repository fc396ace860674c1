//! What the engine has to know.

use std::sync::Arc;

use anyhow::{Context, anyhow};
use jiff::Zoned;
use mocapd_drivers::{registry, uri::DeviceUri};
use mocapd_take::record::Subject;

use crate::config::{ArmConfig, Config, DeviceChoice, DeviceConfig, NameParts, TakeConfig, auto_device};

/// The engine's part of a configuration.
#[derive(Debug, Clone)]
pub struct EngineOptions {
    /// Name of the rig.
    pub rig: String,
    /// Which device, and how it runs.
    pub device: DeviceConfig,
    /// Where takes go, and how they are written.
    pub take: TakeConfig,
    /// Who is captured: stands in every take.
    pub subject: Option<Arc<Subject>>,
    /// What is kept while no take is recorded.
    pub arm: ArmConfig,
}

impl EngineOptions {
    /// As a configuration has them; who is captured is read from its files.
    ///
    /// # Errors
    /// What is wrong with these files.
    pub fn load(config: &Config) -> anyhow::Result<Self> {
        Ok(Self {
            rig: config.rig_name.clone(),
            device: config.device.clone(),
            take: config.take.clone(),
            subject: config.subject.load().context("[subject]")?.map(Arc::new),
            arm: config.arm.clone(),
        })
    }

    /// Which device it is now.
    pub(super) fn find_device(&self) -> anyhow::Result<DeviceUri> {
        match &self.device.uri {
            DeviceChoice::At(uri) => Ok(uri.clone()),
            auto @ DeviceChoice::Auto => {
                auto_device(auto, &registry::devices()?).map_err(|error| anyhow!(error))
            }
        }
    }

    /// The name of a take that was started without one; where it exists, the next `count` is tried.
    pub(super) fn name_take(&self, count: u32) -> String {
        let (begin, count) = (Zoned::now().datetime(), u64::from(count));
        self.take.name.fill(&NameParts { begin, rig: &self.rig, count })
    }
}
