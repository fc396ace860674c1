//! Which USB devices are attached, and which of them is meant.

use std::path::{Path, PathBuf};

use nusb::{DeviceInfo, MaybeFuture};

use crate::{transport::TransportError, uri::Location};

const SYSFS: &str = "/sys/bus/usb/devices";

/// A USB device, as it describes itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsbDevice {
    /// Vendor.
    pub vid: u16,
    /// Product.
    pub pid: u16,
    /// Serial number: the identity that lasts across replugs.
    pub serial: Option<String>,
    /// Who made it.
    pub manufacturer: Option<String>,
    /// What it is.
    pub product: Option<String>,
    /// The file that opens it, `/dev/bus/usb/BUS/ADDRESS`; another one after each replug.
    pub node: PathBuf,
    /// The kernel's folder for it.
    pub sysfs: PathBuf,
}

impl From<&DeviceInfo> for UsbDevice {
    fn from(device: &DeviceInfo) -> Self {
        let (bus, address) = (device.busnum(), device.device_address());
        Self {
            vid: device.vendor_id(),
            pid: device.product_id(),
            serial: device.serial_number().map(str::to_owned),
            manufacturer: device.manufacturer_string().map(str::to_owned),
            product: device.product_string().map(str::to_owned),
            node: format!("/dev/bus/usb/{bus:03}/{address:03}").into(),
            sysfs: device.sysfs_path().to_owned(),
        }
    }
}

impl UsbDevice {
    /// What a URI calls it.
    #[must_use]
    pub fn location(&self) -> Location {
        Location::Usb { vid: self.vid, pid: self.pid, serial: self.serial.clone() }
    }
}

/// What is attached. A machine without a USB stack (a container) has no devices.
///
/// # Errors
/// `Io` when the stack is there and cannot be read.
pub fn devices() -> Result<Vec<UsbDevice>, TransportError> {
    Ok(infos()?.iter().map(UsbDevice::from).collect())
}

fn infos() -> Result<Vec<DeviceInfo>, TransportError> {
    if !Path::new(SYSFS).exists() {
        return Ok(Vec::new());
    }
    let found = nusb::list_devices().wait().map_err(|error| TransportError::Io {
        device: SYSFS.to_owned(),
        action: "listing USB devices",
        source: error.into(),
    })?;
    Ok(found.collect())
}

/// The one device that is meant.
///
/// # Errors
/// `NotFound`; `Unsupported` where several are meant alike; `Io`.
pub(super) fn find(
    vid: u16,
    pid: u16,
    serial: Option<&str>,
) -> Result<(DeviceInfo, UsbDevice), TransportError> {
    let kind =
        infos()?.into_iter().filter(|info| (info.vendor_id(), info.product_id()) == (vid, pid));
    let mut kind: Vec<_> = kind.map(|info| (UsbDevice::from(&info), info)).collect();
    let seen: Vec<UsbDevice> = kind.iter().map(|(device, _)| device.clone()).collect();
    let chosen = choose(&Wanted { vid, pid, serial }, &seen)?;
    let (device, info) = kind.swap_remove(chosen);
    Ok((info, device))
}

struct Wanted<'a> {
    vid: u16,
    pid: u16,
    serial: Option<&'a str>,
}

/// Which of the devices of one kind is meant.
fn choose(wanted: &Wanted<'_>, kind: &[UsbDevice]) -> Result<usize, TransportError> {
    let &Wanted { vid, pid, serial } = wanted;
    let name = Location::Usb { vid, pid, serial: serial.map(str::to_owned) };
    let is_meant = |device: &UsbDevice| serial.is_none_or(|s| device.serial.as_deref() == Some(s));
    let mut meant = kind.iter().enumerate().filter(|(_, device)| is_meant(device));
    let names = || {
        let names: Vec<_> = kind.iter().map(|device| device.location().to_string()).collect();
        names.join(", ")
    };
    match (meant.next(), meant.next()) {
        (Some((index, _)), None) => Ok(index),
        (None, _) if kind.is_empty() => Err(TransportError::NotFound { device: name.to_string() }),
        (None, _) => Err(TransportError::NotFound {
            device: format!("{name} (attached of its kind: {})", names()),
        }),
        (Some(_), Some(_)) if serial.is_some() => Err(TransportError::Unsupported(format!(
            "more than one device calls itself {name}: unplug all but one"
        ))),
        (Some(_), Some(_)) => Err(TransportError::Unsupported(format!(
            "more than one device is {name}: name one with its serial number: {}",
            names()
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(serial: Option<&str>) -> UsbDevice {
        UsbDevice {
            vid: 0x1209,
            pid: 1,
            serial: serial.map(str::to_owned),
            manufacturer: None,
            product: None,
            node: "/dev/bus/usb/001/002".into(),
            sysfs: "/sys/bus/usb/devices/1-1".into(),
        }
    }

    fn chosen(serial: Option<&str>, kind: &[UsbDevice]) -> Result<usize, String> {
        choose(&Wanted { vid: 0x1209, pid: 1, serial }, kind).map_err(|error| error.to_string())
    }

    #[test]
    fn one_is_chosen_by_its_serial_number_or_because_it_is_alone() {
        let two = [device(Some("A")), device(Some("B"))];
        assert_eq!(chosen(Some("B"), &two), Ok(1));
        assert_eq!(chosen(None, &two[..1]), Ok(0));
        let error = chosen(None, &two).unwrap_err();
        assert!(error.contains("usb:1209:0001:A, usb:1209:0001:B"), "{error}");
        let error = chosen(Some("A"), &[device(Some("A")), device(Some("A"))]).unwrap_err();
        assert!(error.contains("unplug all but one"), "{error}");
    }

    #[test]
    fn a_device_with_another_serial_number_is_named() {
        let error = chosen(Some("A"), &[device(Some("B"))]).unwrap_err();
        assert!(error.contains("usb:1209:0001:A"), "{error}");
        assert!(error.contains("attached of its kind: usb:1209:0001:B"), "{error}");
        let error = chosen(Some("A"), &[]).unwrap_err();
        assert!(error.contains("mocapd devices") && !error.contains("kind"), "{error}");
    }
}
