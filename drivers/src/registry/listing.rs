//! What is attached to this machine.

use std::path::Path;

use serialport::SerialPortType;

use super::{Candidate, Claim, family_of};
use crate::{
    transport::{
        Access, TransportError, access,
        usb::{self, UsbDevice},
    },
    uri::Location,
};

/// A device that is attached.
#[derive(Debug)]
pub struct Listed {
    /// What it says of itself.
    pub candidate: Candidate,
    /// The family that is surest of it, and how sure.
    pub family: Option<(&'static str, Claim)>,
    /// Whether it can be opened, and if not, what helps.
    pub access: Access,
}

/// Serial ports, then USB devices that are no serial port. None of them is opened.
///
/// # Errors
/// `Io` when the system's lists cannot be read.
pub fn devices() -> Result<Vec<Listed>, TransportError> {
    let serial = serial_candidates()?;
    let usb = usb::devices()?;
    let mut listed = Vec::new();
    for device in &usb {
        if !serial.iter().any(|port| is_port_of(port, device)) {
            listed.push(list(usb_candidate(device), usb::usb_access(device)));
        }
    }
    let ports = serial.into_iter().map(|candidate| {
        let access = match &candidate.location {
            Location::Serial { path, .. } => access(path),
            Location::Usb { .. } => Access::Accessible,
        };
        list(candidate, access)
    });
    Ok(ports.chain(listed).collect())
}

/// The serial ports, by name.
pub(super) fn serial_candidates() -> Result<Vec<Candidate>, TransportError> {
    const SYSFS: &str = "/sys/class/tty";
    // Without this folder serialport panics.
    if !Path::new(SYSFS).exists() {
        return Ok(Vec::new());
    }
    let mut ports = serialport::available_ports().map_err(|error| TransportError::Io {
        device: SYSFS.to_owned(),
        action: "listing serial ports",
        source: error.into(),
    })?;
    ports.sort_by(|a, b| a.port_name.cmp(&b.port_name));
    Ok(ports
        .into_iter()
        .map(|port| {
            let location = Location::Serial { path: port.port_name.into(), baud: None };
            match port.port_type {
                SerialPortType::UsbPort(usb) => Candidate {
                    location,
                    usb_ids: Some((usb.vid, usb.pid)),
                    serial: usb.serial_number,
                    manufacturer: usb.manufacturer,
                    product: usb.product,
                },
                _ => Candidate::at(location),
            }
        })
        .collect())
}

pub(super) fn usb_candidate(device: &UsbDevice) -> Candidate {
    let UsbDevice { vid, pid, serial, manufacturer, product, .. } = device.clone();
    Candidate {
        location: device.location(),
        usb_ids: Some((vid, pid)),
        serial,
        manufacturer,
        product,
    }
}

fn is_port_of(port: &Candidate, device: &UsbDevice) -> bool {
    port.usb_ids == Some((device.vid, device.pid)) && port.serial == device.serial
}

fn list(candidate: Candidate, access: Access) -> Listed {
    let family = family_of(&candidate).map(|(family, claim)| (family.name(), claim));
    Listed { candidate, family, access }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn listing_works_with_and_without_a_usb_stack() {
        for listed in devices().unwrap() {
            assert!(listed.candidate.location.to_string().contains(':'), "{listed:?}");
        }
    }

    #[test]
    fn an_adapter_is_listed_once() {
        let device = UsbDevice {
            vid: 0x0403,
            pid: 0x6001,
            serial: Some("A1".to_owned()),
            manufacturer: None,
            product: None,
            node: "/dev/bus/usb/001/002".into(),
            sysfs: "/sys/bus/usb/devices/1-1".into(),
        };
        let port = Candidate {
            location: Location::Serial { path: "/dev/ttyUSB0".into(), baud: None },
            ..usb_candidate(&device)
        };
        assert!(is_port_of(&port, &device));
        let other = UsbDevice { serial: Some("A2".to_owned()), ..device };
        assert!(!is_port_of(&port, &other));
    }
}
