//! Attached devices, for `devices --json` and the API.

use std::{net::IpAddr, time::Duration};

use mocapd_drivers::{
    qtm::{DISCOVERY_BYTES_MAX, DISCOVERY_PORT, discovery_request, read_discovery_reply},
    registry::{self, AttachedDevice, Claim},
    transport::{Access, TransportError, network::discovery::ask},
    uri::{Location, NetworkAddress},
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

/// How long servers have to answer a search: on a local network they need some milliseconds.
const SEARCH_TIME: Duration = Duration::from_millis(300);

/// Searches the networks of this machine for QTM servers, by the broadcast that QTM documents. It connects to none of
/// them. Where the network cannot be asked, there are none.
#[must_use]
pub fn servers() -> Vec<ListedDevice> {
    let answers = ask(discovery_request, DISCOVERY_PORT, DISCOVERY_BYTES_MAX, SEARCH_TIME);
    let server = |(ip, answer): (IpAddr, Vec<u8>)| {
        let found = read_discovery_reply(&answer)?;
        let address = NetworkAddress {
            family: "qtm",
            host: ip.to_canonical().to_string(),
            port: found.port,
            datagrams: false,
        };
        Some(ListedDevice {
            device: Location::Network(address).to_string(),
            manufacturer: None,
            product: Some(found.info),
            serial: None,
            driver: Some("qtm".to_owned()),
            certain: true,
            problem: None,
        })
    };
    let mut servers: Vec<_> = answers.unwrap_or_default().into_iter().filter_map(server).collect();
    servers.sort_by(|a, b| a.device.cmp(&b.device));
    servers.dedup();
    servers
}

/// Lists the attached devices. It opens none of them.
///
/// # Errors
/// When the system cannot list its devices.
pub fn devices() -> Result<Vec<ListedDevice>, TransportError> {
    Ok(registry::devices()?.into_iter().map(ListedDevice::from).collect())
}
