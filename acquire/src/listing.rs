//! What is attached, as `devices --json` and the API tell it.

use mocapd_drivers::{
    registry::{self, Claim, Listed},
    transport::{Access, TransportError},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A device that is attached.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ListedDevice {
    /// What `record --device` takes.
    pub device: String,
    /// Who made it, as it says.
    pub manufacturer: Option<String>,
    /// What it calls itself.
    pub product: Option<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// The driver that claims it; none when none does.
    pub driver: Option<String>,
    /// The device itself says what it is; false for a bare serial port, behind which anything may be.
    pub certain: bool,
    /// Why it cannot be opened, and what to do.
    pub problem: Option<String>,
}

impl From<Listed> for ListedDevice {
    fn from(listed: Listed) -> Self {
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

/// What is attached. No device is opened for it.
///
/// # Errors
/// Of the system's listing.
pub fn devices() -> Result<Vec<ListedDevice>, TransportError> {
    Ok(registry::devices()?.into_iter().map(ListedDevice::from).collect())
}
