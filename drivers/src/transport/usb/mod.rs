//! USB: listing devices, a bulk endpoint pair as a byte stream, and hotplug notification.

mod bulk;
mod pair;
mod watch;

use std::{
    fs,
    path::{Path, PathBuf},
};

use nusb::{DeviceInfo, ErrorKind, MaybeFuture};

use crate::{
    transport::{Access, TransportError, group_remedy},
    uri::Location,
};

pub use bulk::UsbTransport;
pub use bulk::{TRANSFER_BYTES, TRANSFERS};
pub use watch::UsbWatch;

const SYSFS: &str = "/sys/bus/usb/devices";

/// A USB device as its descriptors define it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsbDevice {
    /// Vendor id.
    pub vid: u16,
    /// Product id.
    pub pid: u16,
    /// Serial number: the identity that survives a replug.
    pub serial: Option<String>,
    /// Manufacturer string.
    pub manufacturer: Option<String>,
    /// Product string.
    pub product: Option<String>,
    /// Device file `/dev/bus/usb/BUS/ADDRESS`; a replug changes it.
    pub node: PathBuf,
    /// The device's directory in sysfs.
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
    /// The device's location in a URI.
    #[must_use]
    pub fn location(&self) -> Location {
        Location::Usb { vid: self.vid, pid: self.pid, serial: self.serial.clone() }
    }
}

/// Lists the attached devices. A machine without a USB stack (a container) has none.
///
/// # Errors
/// `Io` when the USB stack exists but cannot be read.
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

/// Finds the device that a URI selects.
///
/// # Errors
/// `NotFound`; `Unsupported` when several devices match; `Io`.
fn find(vid: u16, pid: u16, serial: Option<&str>) -> Result<DeviceInfo, TransportError> {
    let mut found = infos()?;
    found.retain(|info| (info.vendor_id(), info.product_id()) == (vid, pid));
    let devices: Vec<UsbDevice> = found.iter().map(UsbDevice::from).collect();
    let name = Location::Usb { vid, pid, serial: serial.map(str::to_owned) }.to_string();
    select(name, serial, &devices).map(|selected| found.swap_remove(selected))
}

/// Selects one of the devices with the same ids.
fn select(name: String, serial: Option<&str>, list: &[UsbDevice]) -> Result<usize, TransportError> {
    let is_match = |device: &UsbDevice| serial.is_none_or(|s| device.serial.as_deref() == Some(s));
    let mut matching = list.iter().enumerate().filter(|(_, device)| is_match(device));
    let names: Vec<_> = list.iter().map(|device| device.location().to_string()).collect();
    let names = names.join(", ");
    match (matching.next(), matching.next()) {
        (Some((index, _)), None) => Ok(index),
        (None, _) if list.is_empty() => Err(TransportError::NotFound { device: name }),
        (None, _) => Err(TransportError::NotFound {
            device: format!("{name} (attached with these ids: {names})"),
        }),
        (Some(_), Some(_)) if serial.is_some() => Err(TransportError::Unsupported(format!(
            "more than one device is {name}: unplug all but one"
        ))),
        (Some(_), Some(_)) => Err(TransportError::Unsupported(format!(
            "more than one device is {name}: add a serial number: {names}"
        ))),
    }
}

/// `EPERM`: a control group, not file permissions, denies the device.
const EPERM: u32 = 1;

/// Checks access to a device without opening it.
pub(crate) fn usb_access(device: &UsbDevice) -> Access {
    let name = device.location().to_string();
    if !device.node.exists() {
        return Access::Refused(TransportError::NotFound { device: name });
    }
    let want = rustix::fs::Access::READ_OK | rustix::fs::Access::WRITE_OK;
    if rustix::fs::access(&device.node, want).is_err() {
        let remedy = remedy(device);
        return Access::Refused(TransportError::PermissionDenied { device: name, remedy });
    }
    if is_claimed(&device.sysfs) {
        let holder = holder(&device.node);
        return Access::Refused(TransportError::Busy { device: name, holder });
    }
    Access::Accessible
}

fn open_error(device: &UsbDevice, error: nusb::Error) -> TransportError {
    let name = device.location().to_string();
    match (error.kind(), error.os_error()) {
        (ErrorKind::PermissionDenied, Some(EPERM)) => {
            let remedy = "add `DeviceAllow=char-usb_device rw` to the systemd unit".to_owned();
            TransportError::PermissionDenied { device: name, remedy }
        }
        (ErrorKind::PermissionDenied, _) => {
            TransportError::PermissionDenied { device: name, remedy: remedy(device) }
        }
        (ErrorKind::Busy, _) => TransportError::Busy { device: name, holder: holder(&device.node) },
        // Unplugged between listing and opening.
        (ErrorKind::Disconnected, _) => TransportError::NotFound { device: name },
        _ => TransportError::Io { device: name, action: "opening it", source: error.into() },
    }
}

/// The command to join the group that a udev rule grants the device to, or the rule to add if there is none.
fn remedy(device: &UsbDevice) -> String {
    group_remedy(&device.node).unwrap_or_else(|| {
        format!(
            "add the line `{}` to /etc/udev/rules.d/60-mocapd-rig.rules, type `sudo udevadm control \
             --reload; sudo usermod -aG dialout $USER`, log in again, and plug the device in again",
            udev_rule(device.vid, device.pid)
        )
    })
}

/// The udev rule that lets the group `dialout`, and the local user, open such a device.
fn udev_rule(vid: u16, pid: u16) -> String {
    format!(
        r#"SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vid:04x}", ATTR{{idProduct}}=="{pid:04x}", GROUP="dialout", MODE="0660", TAG+="uaccess""#
    )
}

/// Whether a program has claimed an interface, whose driver is then `usbfs`.
fn is_claimed(sysfs: &Path) -> bool {
    let interfaces = fs::read_dir(sysfs).into_iter().flatten().flatten();
    interfaces
        .filter(|entry| entry.file_name().as_encoded_bytes().contains(&b':'))
        .filter_map(|entry| fs::read_link(entry.path().join("driver")).ok())
        .any(|driver| driver.ends_with("usbfs"))
}

/// A program that has the device file open, as `name (process 1234)`. Only root can see other users'
/// programs.
fn holder(node: &Path) -> Option<String> {
    let processes = fs::read_dir("/proc").ok()?.flatten();
    let own = std::process::id();
    for process in processes {
        let name = process.file_name();
        let Some(id) = name.to_str().and_then(|name| name.parse::<u32>().ok()) else { continue };
        let files = fs::read_dir(process.path().join("fd")).into_iter().flatten().flatten();
        if id != own && files.into_iter().any(|file| is_link_to(&file.path(), node)) {
            let comm = fs::read_to_string(process.path().join("comm")).unwrap_or_default();
            return Some(format!("{} (process {id})", comm.trim()));
        }
    }
    None
}

fn is_link_to(link: &Path, node: &Path) -> bool {
    fs::read_link(link).is_ok_and(|target| target == node)
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

    fn selected(serial: Option<&str>, found: &[UsbDevice]) -> Result<usize, TransportError> {
        let name = Location::Usb { vid: 0x1209, pid: 1, serial: serial.map(str::to_owned) };
        select(name.to_string(), serial, found)
    }

    fn several(serial: Option<&str>, found: &[UsbDevice]) -> String {
        match selected(serial, found) {
            Err(TransportError::Unsupported(words)) => words,
            other => panic!("{other:?}"),
        }
    }

    fn not_found(serial: Option<&str>, found: &[UsbDevice]) -> String {
        match selected(serial, found) {
            Err(TransportError::NotFound { device }) => device,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_device_is_selected_by_serial_number_or_as_the_only_one() {
        let two = [device(Some("A")), device(Some("B"))];
        assert_eq!(selected(Some("B"), &two).unwrap(), 1);
        assert_eq!(selected(None, &two[..1]).unwrap(), 0);
        let error = several(None, &two);
        assert!(error.contains("usb:1209:0001:A, usb:1209:0001:B"), "{error}");
        // A serial number does not help any more, so none is suggested.
        let error = several(Some("A"), &[device(Some("A")), device(Some("A"))]);
        assert_eq!(error.matches("usb:1209:0001:A").count(), 1, "{error}");
    }

    #[test]
    fn a_device_with_another_serial_number_is_named() {
        let device = not_found(Some("A"), &[device(Some("B"))]);
        assert!(
            device.contains("usb:1209:0001:A") && device.contains("usb:1209:0001:B"),
            "{device}"
        );
        assert_eq!(not_found(Some("A"), &[]), "usb:1209:0001:A");
    }

    fn at(node: &Path) -> UsbDevice {
        UsbDevice {
            pid: 0x000a,
            node: node.to_owned(),
            sysfs: "/sys/bus/usb/devices/none".into(),
            ..device(Some("A"))
        }
    }

    #[test]
    fn a_device_without_a_rule_gets_its_rule() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let remedy = remedy(&at(file.path()));
        let line = r#"`SUBSYSTEM=="usb", ATTR{idVendor}=="1209", ATTR{idProduct}=="000a", GROUP="dialout", MODE="0660", TAG+="uaccess"`"#;
        assert!(remedy.contains(line), "{remedy}");
    }

    #[test]
    fn a_device_that_is_gone_is_not_found() {
        let gone = at(Path::new("/dev/bus/usb/999/999"));
        let Access::Refused(error) = usb_access(&gone) else { panic!("accessible") };
        assert!(matches!(error, TransportError::NotFound { .. }), "{error}");
    }

    #[test]
    fn interfaces_that_a_program_holds_are_seen() {
        let folder = tempfile::tempdir().unwrap();
        let interface = folder.path().join("1-1:1.0");
        fs::create_dir(&interface).unwrap();
        assert!(!is_claimed(folder.path()));
        let driver = interface.join("driver");
        std::os::unix::fs::symlink("/sys/bus/usb/drivers/cdc_acm", &driver).unwrap();
        assert!(!is_claimed(folder.path()), "a kernel driver gives way");
        fs::remove_file(&driver).unwrap();
        std::os::unix::fs::symlink("/sys/bus/usb/drivers/usbfs", &driver).unwrap();
        assert!(is_claimed(folder.path()));
    }
}
