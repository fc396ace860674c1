//! What the system says against opening a USB device, and what helps.

use std::{fs, path::Path};

use nusb::ErrorKind;

use super::UsbDevice;
use crate::transport::{Access, TransportError, access::group_remedy};

/// `EPERM`: a control group, not the file's permissions, keeps the device from us.
const EPERM: u32 = 1;

/// What opening would meet, found out without opening.
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

pub(super) fn open_error(device: &UsbDevice, error: nusb::Error) -> TransportError {
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
        // It went between the listing and the opening.
        (ErrorKind::Disconnected, _) => TransportError::NotFound { device: name },
        _ => TransportError::Io { device: name, action: "opening it", source: error.into() },
    }
}

/// The group to join where a rule gives the device to one; the rule where none does.
fn remedy(device: &UsbDevice) -> String {
    group_remedy(&device.node).unwrap_or_else(|| {
        format!(
            "put the line `{}` into /etc/udev/rules.d/60-mocapd-rig.rules, type `sudo udevadm control \
             --reload; sudo usermod -aG dialout $USER`, log in again, and plug the device in again",
            udev_line(device.vid, device.pid)
        )
    })
}

/// The rule that lets the group `dialout` open such a device, and whoever sits at the machine.
fn udev_line(vid: u16, pid: u16) -> String {
    format!(
        r#"SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vid:04x}", ATTR{{idProduct}}=="{pid:04x}", GROUP="dialout", MODE="0660", TAG+="uaccess""#
    )
}

/// Whether a program has claimed an interface: its driver is then `usbfs`.
fn is_claimed(sysfs: &Path) -> bool {
    let interfaces = fs::read_dir(sysfs).into_iter().flatten().flatten();
    interfaces
        .filter(|entry| entry.file_name().as_encoded_bytes().contains(&b':'))
        .filter_map(|entry| fs::read_link(entry.path().join("driver")).ok())
        .any(|driver| driver.ends_with("usbfs"))
}

/// A program that has the device's file open, as `name (process 1234)`; of other users' programs only
/// root can tell.
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

    fn device(node: &Path) -> UsbDevice {
        UsbDevice {
            vid: 0x1209,
            pid: 0x000a,
            serial: Some("A".to_owned()),
            manufacturer: None,
            product: None,
            node: node.to_owned(),
            sysfs: "/sys/bus/usb/devices/none".into(),
        }
    }

    #[test]
    fn a_device_that_no_rule_knows_gets_its_rule() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let remedy = remedy(&device(file.path()));
        let line = r#"`SUBSYSTEM=="usb", ATTR{idVendor}=="1209", ATTR{idProduct}=="000a", GROUP="dialout", MODE="0660", TAG+="uaccess"`"#;
        assert!(remedy.contains(line), "{remedy}");
    }

    #[test]
    fn a_device_that_is_gone_is_not_found() {
        let gone = device(Path::new("/dev/bus/usb/999/999"));
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
