//! USB devices: who is attached. Bulk transfers are not part of this build.

use nusb::MaybeFuture;

use super::TransportError;

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
    pub node: std::path::PathBuf,
}

/// What is attached. A machine without a USB stack (a container) has no devices.
///
/// # Errors
/// `Io` when the stack is there and cannot be read.
pub fn devices() -> Result<Vec<UsbDevice>, TransportError> {
    const SYSFS: &str = "/sys/bus/usb/devices";
    if !std::path::Path::new(SYSFS).exists() {
        return Ok(Vec::new());
    }
    let found = nusb::list_devices().wait().map_err(|error| TransportError::Io {
        device: SYSFS.to_owned(),
        action: "listing USB devices",
        source: error.into(),
    })?;
    Ok(found
        .map(|device| UsbDevice {
            vid: device.vendor_id(),
            pid: device.product_id(),
            serial: device.serial_number().map(str::to_owned),
            manufacturer: device.manufacturer_string().map(str::to_owned),
            product: device.product_string().map(str::to_owned),
            node: format!("/dev/bus/usb/{:03}/{:03}", device.busnum(), device.device_address())
                .into(),
        })
        .collect())
}
