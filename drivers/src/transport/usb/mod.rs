//! USB: listing devices, the choice of the bulk endpoint pair that carries the stream, from descriptors that may be wrong,
//! and hotplug notification through udev, where it runs.

mod bulk;

use std::{
    fs,
    path::{Path, PathBuf},
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, Wake, Waker},
    thread::{self, Thread},
    time::{Duration, Instant},
};

use futures_core::Stream;
use nusb::{
    DeviceInfo, ErrorKind, MaybeFuture,
    descriptors::{ConfigurationDescriptor, TransferType},
    hotplug::HotplugWatch,
    transfer::Direction,
};

use crate::{
    transport::{Access, TransportError, group_remedy},
    uri::Location,
};
pub use bulk::{TRANSFER_BYTES, TRANSFERS, UsbTransport};

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

/// Interface class for vendor-specific protocols.
const VENDOR_CLASS: u8 = 0xff;

/// Valid packet sizes of bulk endpoints: USB 2.0 section 5.8.3 (full speed 8 to 64, high speed
/// 512), USB 3.2 section 8.12.1 (1024).
const PACKET_BYTES: [usize; 6] = [8, 16, 32, 64, 512, 1024];

/// An endpoint as its descriptor defines it.
#[derive(Debug, Clone, Copy)]
struct EndpointInfo {
    interface: u8,
    class: u8,
    address: u8,
    is_in: bool,
    is_bulk: bool,
    packet_bytes: usize,
}

/// Two bulk endpoints of one interface, one per direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct BulkPair {
    interface: u8,
    device_to_host: u8,
    host_to_device: u8,
}

/// Finds the first vendor interface with a bulk pair.
///
/// # Errors
/// A message with what was found instead.
fn bulk_pair(configuration: &ConfigurationDescriptor<'_>) -> Result<BulkPair, String> {
    let interfaces = configuration.interface_alt_settings();
    let mut endpoints = Vec::new();
    for interface in interfaces.filter(|interface| interface.alternate_setting() == 0) {
        endpoints.extend(interface.endpoints().map(|endpoint| EndpointInfo {
            interface: interface.interface_number(),
            class: interface.class(),
            address: endpoint.address(),
            is_in: endpoint.direction() == Direction::In,
            is_bulk: endpoint.transfer_type() == TransferType::Bulk,
            packet_bytes: endpoint.max_packet_size(),
        }));
    }
    choose_pair(&endpoints)
}

fn choose_pair(endpoints: &[EndpointInfo]) -> Result<BulkPair, String> {
    let bulk = |first: &EndpointInfo, is_in: bool| {
        let of_pair = |other: &&EndpointInfo| {
            (other.interface, other.is_bulk, other.is_in) == (first.interface, true, is_in)
        };
        endpoints.iter().find(of_pair).copied()
    };
    let mut pairs = endpoints
        .iter()
        .filter(|endpoint| endpoint.class == VENDOR_CLASS)
        .filter_map(|endpoint| Some((bulk(endpoint, true)?, bulk(endpoint, false)?)));
    let Some((device_to_host, host_to_device)) = pairs.next() else {
        return Err(format!(
            "expected an interface of class ff with a bulk endpoint in each direction, found {}",
            describe(endpoints)
        ));
    };
    for endpoint in [device_to_host, host_to_device] {
        if !PACKET_BYTES.contains(&endpoint.packet_bytes) {
            return Err(format!(
                "expected packets of 8, 16, 32, 64, 512 or 1024 bytes, found {} at endpoint {:02x}",
                endpoint.packet_bytes, endpoint.address
            ));
        }
    }
    Ok(BulkPair {
        interface: device_to_host.interface,
        device_to_host: device_to_host.address,
        host_to_device: host_to_device.address,
    })
}

/// Describes the first few endpoints: a device may declare hundreds.
fn describe(endpoints: &[EndpointInfo]) -> String {
    const SHOWN: usize = 6;
    let one = |endpoint: &EndpointInfo| {
        let kind = if endpoint.is_bulk { "bulk" } else { "other" };
        format!("{kind} {:02x} in class {:02x}", endpoint.address, endpoint.class)
    };
    let shown: Vec<String> = endpoints.iter().take(SHOWN).map(one).collect();
    match endpoints.len() {
        0 => "no endpoint".to_owned(),
        n if n > SHOWN => format!("{} and {} more", shown.join(", "), n - SHOWN),
        _ => shown.join(", "),
    }
}

/// Waits for USB devices to be plugged in or unplugged.
///
/// The events come from udev. In a container, or where udev does not run, none arrive, and there is no
/// error either: callers must also poll the list of devices occasionally.
pub struct UsbWatch {
    watch: Option<HotplugWatch>,
    waker: Waker,
}

impl std::fmt::Debug for UsbWatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("UsbWatch").field("is_watching", &self.watch.is_some()).finish()
    }
}

/// Wakes the waiting thread.
struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

impl Default for UsbWatch {
    fn default() -> Self {
        Self::new()
    }
}

impl UsbWatch {
    /// Starts to watch, for the calling thread. List the attached devices afterwards, not before, so that no
    /// device is missed in between.
    #[must_use]
    pub fn new() -> Self {
        Self {
            watch: nusb::watch_devices().ok(),
            waker: Waker::from(Arc::new(Unpark(thread::current()))),
        }
    }

    /// Waits for a hotplug event: `true` when there was one, `false` after `timeout`.
    pub fn wait(&mut self, timeout: Duration) -> bool {
        let until = Instant::now() + timeout;
        loop {
            if self.drain_events() {
                return true;
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            thread::park_timeout(left);
        }
    }

    /// Drains all pending events, and returns whether there were any.
    fn drain_events(&mut self) -> bool {
        let mut had_event = false;
        let mut context = Context::from_waker(&self.waker);
        while let Some(watch) = &mut self.watch {
            match Pin::new(watch).poll_next(&mut context) {
                Poll::Ready(Some(_)) => had_event = true,
                Poll::Ready(None) => self.watch = None,
                Poll::Pending => break,
            }
        }
        had_event
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

    const IN: EndpointInfo = EndpointInfo {
        interface: 1,
        class: VENDOR_CLASS,
        address: 0x81,
        is_in: true,
        is_bulk: true,
        packet_bytes: 512,
    };
    const OUT: EndpointInfo = EndpointInfo { address: 0x02, is_in: false, ..IN };

    #[test]
    fn finds_the_pair_among_other_interfaces() {
        let keyboard = EndpointInfo { interface: 0, class: 3, address: 0x83, is_bulk: false, ..IN };
        let storage = [
            EndpointInfo { class: 8, interface: 0, ..IN },
            EndpointInfo { class: 8, interface: 0, ..OUT },
        ];
        let pair = BulkPair { interface: 1, device_to_host: 0x81, host_to_device: 0x02 };
        assert_eq!(choose_pair(&[keyboard, OUT, IN]), Ok(pair));
        assert_eq!(choose_pair(&[storage[0], storage[1], IN, OUT]), Ok(pair));
    }

    #[test]
    fn a_pair_has_two_bulk_endpoints_of_one_interface() {
        for endpoints in [
            vec![],
            vec![IN],
            vec![OUT],
            vec![IN, EndpointInfo { interface: 2, ..OUT }],
            vec![IN, EndpointInfo { is_bulk: false, ..OUT }],
            vec![EndpointInfo { class: 8, ..IN }, EndpointInfo { class: 8, ..OUT }],
            vec![EndpointInfo { class: 3, is_bulk: false, ..IN }; 500],
        ] {
            let error = choose_pair(&endpoints).unwrap_err();
            assert!(error.contains("class ff") && error.len() < 300, "{error}");
        }
    }

    #[test]
    fn invalid_packet_sizes_are_refused() {
        for packet_bytes in [0, 1, 24, 513, 2047] {
            let error = choose_pair(&[IN, EndpointInfo { packet_bytes, ..OUT }]).unwrap_err();
            let words: Vec<&str> = error.split([' ', ',']).collect();
            assert!(words.contains(&packet_bytes.to_string().as_str()), "{error}");
            assert!(error.contains("endpoint 02"), "{error}");
        }
    }

    #[test]
    fn a_wait_without_events_times_out() {
        let started = Instant::now();
        let wait = Duration::from_millis(30);
        let had_event = UsbWatch::new().wait(wait);
        assert!(had_event || started.elapsed() >= wait);
    }
}
