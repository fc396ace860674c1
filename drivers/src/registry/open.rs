//! From a URI to bytes and what they mean.

use super::{Candidate, FAMILIES, Family, family_of, listing};
use crate::{
    device::Protocol,
    transport::{Transport, TransportError, serial::SerialTransport},
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
    let named = uri.driver.as_deref().map(family_named).transpose()?;
    let transport = open_transport(&uri.location)?;
    let family = match named {
        Some(family) => family,
        None => {
            let candidate = candidate_at(&uri.location);
            let unclaimed = || OpenError::Unclaimed { location: uri.location.to_string() };
            family_of(&candidate).ok_or_else(unclaimed)?.0
        }
    };
    let mut protocol = family.protocol(&uri.location);
    let transport = protocol.attach(transport);
    Ok(OpenedDevice { transport, protocol, family: family.name() })
}

fn family_named(name: &str) -> Result<&'static dyn Family, OpenError> {
    let found = FAMILIES.iter().find(|family| family.name() == name);
    found.copied().ok_or_else(|| OpenError::UnknownDriver { name: name.to_owned() })
}

fn family_names() -> String {
    FAMILIES.iter().map(|family| family.name()).collect::<Vec<_>>().join(", ")
}

fn open_transport(location: &Location) -> Result<Box<dyn Transport>, TransportError> {
    match location {
        Location::Serial { path, baud } => Ok(Box::new(SerialTransport::open(path, *baud)?)),
        Location::Usb { .. } => Err(TransportError::Unsupported(format!(
            "{location} cannot be opened: this build has no USB bulk transport; \
             use the device's serial port"
        ))),
    }
}

/// What is known of the device at a place: a link to a port is the port.
fn candidate_at(location: &Location) -> Candidate {
    let unknown = || Candidate::at(location.clone());
    let Location::Serial { path, .. } = location else {
        return unknown();
    };
    let Ok(real_path) = path.canonicalize() else {
        return unknown();
    };
    let listed = listing::serial_candidates().unwrap_or_default().into_iter().find(
        |candidate| matches!(&candidate.location, Location::Serial { path, .. } if *path == real_path),
    );
    listed.unwrap_or_else(unknown)
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
        assert!(error_of("usb:1209:0001").contains("use the device's serial port"));
        assert!(error_of("serial:/dev/mocapd-none").contains("mocapd devices"));
        assert!(error_of("serial:/etc/hostname").contains("no serial port"));
        assert!(error_of("serial:/dev/null").starts_with("/dev/null"));
    }
}
