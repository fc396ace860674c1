//! Attached devices, for `devices --json` and the API.

use std::time::Duration;

use mocapd_drivers::{
    registry::{self, AttachedDevice, Claim},
    transport::{
        Access, TransportError,
        lsl::{self, FoundStream},
    },
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

/// How long streams have to answer: LSL's own limit for answers by multicast.
const STREAMS_WAIT: Duration = Duration::from_millis(500);

/// The streams of the Lab Streaming Layer that answer; none where the system gives no network.
fn streams() -> Vec<ListedDevice> {
    let found = lsl::streams(STREAMS_WAIT).unwrap_or_default();
    found.iter().map(|stream| listed_stream(stream, &found)).collect()
}

fn listed_stream(stream: &FoundStream, all: &[FoundStream]) -> ListedDevice {
    let of = &stream.description;
    let uri = stream.uri_among(all);
    let problem = uri.is_none().then(|| {
        "another stream has the same name, type and source id: give them different source ids"
            .to_owned()
    });
    ListedDevice {
        device: uri.unwrap_or_else(|| format!("lsl:{}", of.name)),
        manufacturer: Some(of.hostname.clone()),
        product: Some(of.kind.clone()),
        serial: Some(of.source_id.clone()).filter(|id| !id.is_empty()),
        driver: Some("lsl".to_owned()),
        certain: true,
        problem,
    }
}

/// Lists the attached devices. It opens none of them.
///
/// # Errors
/// When the system cannot list its devices.
pub fn devices() -> Result<Vec<ListedDevice>, TransportError> {
    Ok(registry::devices()?.into_iter().map(ListedDevice::from).collect())
}

/// Searches the networks of this machine for servers of motion-capture systems and for streams. It connects to none of them. Where the
/// network cannot be asked, there are none.
#[must_use]
pub fn servers() -> Vec<ListedDevice> {
    registry::network_devices().into_iter().map(ListedDevice::from).chain(streams()).collect()
}
