//! Attached devices, for `devices --json` and the API.

use mocapd_drivers::{
    registry::{self, AttachedDevice, Claim},
    transport::{Access, TransportError},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// An attached device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ListedDevice {
    /// The value for `record --device`.
    pub device: String,
    /// Its manufacturer, as the device states it.
    pub manufacturer: Option<String>,
    /// Its product name, as the device states it.
    pub product: Option<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// The driver for it; null when there is none.
    pub driver: Option<String>,
    /// Whether the device identified itself; false for a bare serial port, which may have anything behind it.
    pub certain: bool,
    /// Why it cannot be opened, and what to do.
    pub problem: Option<String>,
}

impl From<AttachedDevice> for ListedDevice {
    fn from(listed: AttachedDevice) -> Self {
        Self {
            device: listed.candidate.location.to_string(),
            manufacturer: listed.candidate.manufacturer,
            product: listed.candidate.product,
            serial: listed.candidate.serial,
            driver: listed.family.map(|family| family.0.to_owned()),
            certain: listed.family.is_some_and(|family| family.1 == Claim::Certain),
            problem: match listed.access {
                Access::Accessible => None,
                Access::Refused(error) => Some(error.to_string()),
            },
        }
    }
}

/// Lists the attached devices. It opens none of them.
///
/// # Errors
/// When the system cannot list its devices.
pub fn devices() -> Result<Vec<ListedDevice>, TransportError> {
    Ok(registry::devices()?.into_iter().map(ListedDevice::from).collect())
}

/// Searches the networks of this machine for servers of motion-capture systems. It connects to none of them. Where the
/// network cannot be asked, there are none.
#[must_use]
pub fn servers() -> Vec<ListedDevice> {
    registry::network_devices().into_iter().map(ListedDevice::from).collect()
}
