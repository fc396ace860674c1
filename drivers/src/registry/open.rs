//! From a URI to bytes and what they mean.

use super::{Candidate, FAMILIES, Family, family_of, listing};
use crate::{
    device::Protocol,
    transport::{
        Transport, TransportError,
        serial::SerialTransport,
        usb::{self, UsbTransport},
    },
    uri::{DeviceUri, Location},
};

/// A device, open, and what it speaks.
#[derive(Debug)]
pub struct OpenedDevice {
    /// Its bytes.
    pub transport: Box<dyn Transport>,
    /// Their meaning.
    pub protocol: Box<dyn Protocol>,
    /// The family's name.
    pub family: &'static str,
    /// Which device it is, to be found again by after a replug.
    pub identity: Candidate,
}

/// Why a device was not opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// `?driver=` names no family.
    #[error("no driver is called '{name}': use one of {}", family_names())]
    UnknownDriver {
        /// The name.
        name: String,
    },
    /// No family claims the device.
    #[error(
        "no driver claims {location}: if you know what it speaks, add ?driver=NAME with one of {}",
        family_names()
    )]
    Unclaimed {
        /// The device.
        location: String,
    },
    /// The transport could not be opened.
    #[error(transparent)]
    Transport(#[from] TransportError),
}

/// Opens a device. Nothing is written to it.
///
/// # Errors
/// `UnknownDriver`, `Unclaimed`, and why the transport could not be opened.
pub fn open(uri: &DeviceUri) -> Result<OpenedDevice, OpenError> {
    open_through(uri, &mut |_, line| line)
}

/// The same, with something between the line and the protocol: `wrap` gets the family's name and the line.
///
/// # Errors
/// As [`open`].
pub fn open_through(
    uri: &DeviceUri,
    wrap: &mut dyn FnMut(&'static str, Box<dyn Transport>) -> Box<dyn Transport>,
) -> Result<OpenedDevice, OpenError> {
    let named = uri.driver.as_deref().map(family_named).transpose()?;
    let transport = open_transport(&uri.location)?;
    let identity = candidate_at(&uri.location);
    let unclaimed = || OpenError::Unclaimed { location: uri.location.to_string() };
    let family = match named {
        Some(family) => family,
        None => family_of(&identity).ok_or_else(unclaimed)?.0,
    };
    let mut protocol = family.protocol(&uri.location);
    let transport = protocol.attach(wrap(family.name(), transport));
    Ok(OpenedDevice { transport, protocol, family: family.name(), identity })
}

/// Opens a device that went away, wherever it is now: a replug may give a port another name.
///
/// # Errors
/// Why its transport could not be opened.
pub fn open_again(
    uri: &DeviceUri,
    identity: &Candidate,
) -> Result<Box<dyn Transport>, TransportError> {
    open_transport(&place_now(&uri.location, identity))
}

/// Where a device is now that was seen before.
#[must_use]
pub fn find_again(uri: &DeviceUri, identity: &Candidate) -> DeviceUri {
    DeviceUri { location: place_now(&uri.location, identity), driver: uri.driver.clone() }
}

/// A USB device is the one with its serial number, whatever else of its kind is attached by now.
fn place_now(location: &Location, identity: &Candidate) -> Location {
    match location {
        Location::Usb { vid, pid, serial } => {
            let serial = identity.serial.clone().or_else(|| serial.clone());
            Location::Usb { vid: *vid, pid: *pid, serial }
        }
        Location::Serial { path, baud } if identity.serial.is_some() && !path.exists() => {
            let ports = listing::serial_candidates().unwrap_or_default().into_iter();
            let mut same = ports.filter(|port| is_same(port, identity));
            match (same.next().map(|port| port.location), same.next()) {
                (Some(Location::Serial { path, .. }), None) => {
                    Location::Serial { path, baud: *baud }
                }
                _ => location.clone(),
            }
        }
        Location::Serial { .. } => location.clone(),
    }
}

fn is_same(port: &Candidate, identity: &Candidate) -> bool {
    (port.usb_ids, &port.serial) == (identity.usb_ids, &identity.serial)
}

fn family_named(name: &str) -> Result<&'static dyn Family, OpenError> {
    let found = FAMILIES.iter().find(|family| family.name().eq_ignore_ascii_case(name));
    found.copied().ok_or_else(|| OpenError::UnknownDriver { name: name.to_owned() })
}

fn family_names() -> String {
    FAMILIES.iter().map(|family| family.name()).collect::<Vec<_>>().join(", ")
}

fn open_transport(location: &Location) -> Result<Box<dyn Transport>, TransportError> {
    match location {
        Location::Serial { path, baud } => Ok(Box::new(SerialTransport::open(path, *baud)?)),
        Location::Usb { vid, pid, serial } => {
            Ok(Box::new(UsbTransport::open(*vid, *pid, serial.as_deref())?))
        }
    }
}

/// What is known of the device at a place: a link to a port is the port.
fn candidate_at(location: &Location) -> Candidate {
    let unknown = || Candidate::at(location.clone());
    let path = match location {
        Location::Serial { path, .. } => path,
        Location::Usb { vid, pid, serial } => {
            let same = usb::devices().unwrap_or_default().into_iter().find(|device| {
                (device.vid, device.pid) == (*vid, *pid)
                    && (serial.is_none() || device.serial == *serial)
            });
            return same.as_ref().map_or_else(unknown, listing::usb_candidate);
        }
    };
    let Ok(real_path) = path.canonicalize() else {
        return unknown();
    };
    let ports = listing::serial_candidates().unwrap_or_default();
    let is_here = |port: &&Candidate| matches!(&port.location, Location::Serial { path, .. } if *path == real_path);
    let Some(mut found) = ports.iter().find(is_here).cloned() else { return unknown() };
    if ports.iter().filter(|port| is_same(port, &found)).count() > 1 {
        // The ports of one adapter, or adapters that were never numbered: the serial number tells nothing.
        found.serial = None;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error_of(uri: &str) -> String {
        open(&uri.parse().unwrap()).unwrap_err().to_string()
    }

    #[test]
    fn says_what_to_do() {
        assert!(error_of("serial:/dev/null?driver=vicon").contains("use one of dvmc"));
        // A name in capitals is found: what is wrong is the port.
        assert!(error_of("serial:/dev/null?driver=NDI").starts_with("/dev/null"));
        assert!(error_of("usb:1209:0001:none").contains("mocapd devices"));
        assert!(error_of("serial:/dev/mocapd-none").contains("mocapd devices"));
        assert!(error_of("serial:/etc/hostname").contains("no serial port"));
        assert!(error_of("serial:/dev/null").starts_with("/dev/null"));
    }
}
