//! The simulator as a USB device (gadget), on a machine with a USB device controller: a Raspberry Pi Zero beside the
//! rig, or any Linux machine with `dummy_hcd`.
//!
//! Linux programs define USB devices through configfs and `FunctionFS`, which the usb-gadget crate drives. [`Bulk`]
//! is the device of `docs/link-protocol.md` section 6, one vendor interface with a pair of bulk endpoints. [`Serial`]
//! is a CDC-ACM port.

use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

pub use bulk::{Bulk, INTERFACE_PROTOCOL, INTERFACE_SUBCLASS};
pub use serial::Serial;
use usb_gadget::function::Handle;
use usb_gadget::{Class, Config, Gadget, Id, RegGadget, Strings, Udc, registered, udcs};

mod bulk;
mod serial;

/// The vendor id of pid.codes, whose product ids 0001 to 0010 are free to use for tests.
pub const VENDOR_ID: u16 = 0x1209;

/// Product id of the device with bulk endpoints.
pub const BULK_PRODUCT_ID: u16 = 0x0001;

/// Product id of the serial port.
pub const SERIAL_PRODUCT_ID: u16 = 0x0002;

/// String descriptors; udev builds device names from both.
const MANUFACTURER: &str = "mocapd";
const PRODUCT: &str = "mocapd-sim";

/// Serial number and controller of a gadget.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GadgetSettings {
    /// The serial number in its descriptors: 1 to 32 letters, digits, `-`, `_` and `.`.
    pub serial: String,
    /// The controller's name in `/sys/class/udc`; `None` for the first free one.
    pub controller: Option<String>,
}

/// Creates a gadget in configfs and binds it to its controller. Dropping it unplugs and removes it.
fn plug_in(
    settings: &GadgetSettings,
    product_id: u16,
    function: Handle,
) -> Result<RegGadget, GadgetError> {
    let serial = &settings.serial;
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    if !(1..=32).contains(&serial.len()) || !serial.bytes().all(is_name) {
        return Err(GadgetError::SerialNumber { found: serial.clone() });
    }
    let controller = free_controller(settings.controller.as_deref())?;
    let id = Id::new(VENDOR_ID, product_id);
    let strings = Strings::new(MANUFACTURER, PRODUCT, serial);
    let mut gadget = Gadget::new(Class::INTERFACE_SPECIFIC, id, strings)
        .with_config(Config::new("mocapd link").with_function(function));
    gadget.name = Some(gadget_name());
    let registration = gadget.register().map_err(GadgetError::from_io)?;
    registration.bind(Some(&controller)).map_err(|source| {
        let controller = controller.name().to_string_lossy().into_owned();
        GadgetError::Bind { controller, source }
    })?;
    Ok(registration)
}

/// Prefix of the simulator's gadgets in configfs; the process id follows.
const NAME_PREFIX: &str = "mocapd-sim-";

/// The controller called `name`, or the first free one in order of names.
fn free_controller(name: Option<&str>) -> Result<Udc, GadgetError> {
    let mut all = udcs().unwrap_or_default();
    if all.is_empty() {
        return Err(GadgetError::NoController);
    }
    remove_leftovers();
    all.sort_by_key(|udc| udc.name().to_owned());
    let names: Vec<_> = all.iter().map(|udc| udc.name().to_string_lossy()).collect();
    let found = names.join(", ");
    if let Some(name) = name
        && !names.iter().any(|known| known == name)
    {
        return Err(GadgetError::NoSuchController { name: name.to_owned(), found });
    }
    let has_name = |udc: &Udc| name.is_none_or(|name| udc.name() == name);
    let is_free = |udc: &Udc| udc.function().is_ok_and(|gadget| gadget.is_none());
    let free = all.iter().find(|udc| has_name(udc) && is_free(udc)).cloned();
    free.ok_or(GadgetError::ControllerBusy { found })
}

/// A new name for a gadget of this process.
fn gadget_name() -> String {
    static CREATED: AtomicU32 = AtomicU32::new(0);
    format!("{NAME_PREFIX}{}-{}", std::process::id(), CREATED.fetch_add(1, Ordering::Relaxed))
}

/// Removes the gadgets of simulators that were killed.
fn remove_leftovers() {
    for gadget in registered().unwrap_or_default() {
        let name = gadget.name().to_string_lossy().into_owned();
        let process = name.strip_prefix(NAME_PREFIX).and_then(|rest| rest.split('-').next());
        let is_stale = process.is_some_and(|process| !Path::new("/proc").join(process).exists());
        if is_stale && gadget.remove().is_err() {
            // Its controller then counts as busy, which the error reports.
        }
    }
}

/// Errors of a USB gadget.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GadgetError {
    /// The machine has no USB device controller.
    #[error(
        "this machine has no USB device controller: use one that has, such as a Raspberry Pi Zero \
         (docs/hardware-in-the-loop.md), or load a virtual one with `sudo modprobe dummy_hcd`"
    )]
    NoController,
    /// The requested controller, or every controller, is busy.
    #[error(
        "no USB device controller is free ({found}): stop the other gadget, or name another one with --udc"
    )]
    ControllerBusy {
        /// Names of the controllers.
        found: String,
    },
    /// No controller has the requested name.
    #[error("no USB device controller is called '{name}': this machine has {found}")]
    NoSuchController {
        /// The requested name.
        name: String,
        /// Names of the controllers.
        found: String,
    },
    /// The serial number is malformed.
    #[error("bad serial number '{found}': expected 1 to 32 letters, digits, '-', '_' or '.'")]
    SerialNumber {
        /// The serial number.
        found: String,
    },
    /// configfs belongs to root.
    #[error("creating a USB gadget needs root: run it with sudo")]
    NotRoot,
    /// A kernel module or file system is missing.
    #[error("the kernel's USB gadget support is not loaded: run `{remedy}`")]
    NoSupport {
        /// The command to run.
        remedy: &'static str,
        /// The system's error.
        source: io::Error,
    },
    /// The kernel refused the gadget.
    #[error("cannot create the USB gadget")]
    Make(#[source] io::Error),
    /// The controller refused the gadget.
    #[error("the USB device controller {controller} refused the gadget")]
    Bind {
        /// Name of the controller.
        controller: String,
        /// The system's error.
        source: io::Error,
    },
}

impl GadgetError {
    /// The error for a failure of configfs or `FunctionFS`, with its remedy if known.
    pub(super) fn from_io(source: io::Error) -> Self {
        let nodev = source.raw_os_error() == Some(rustix::io::Errno::NODEV.raw_os_error());
        let mentions = |part: &str| source.to_string().contains(part);
        let remedy = match source.kind() {
            ErrorKind::PermissionDenied => return Self::NotRoot,
            ErrorKind::NotFound if mentions("configfs is not mounted") => {
                "sudo mount -t configfs none /sys/kernel/config"
            }
            ErrorKind::NotFound if mentions("usb_gadget") => "sudo modprobe libcomposite",
            // The module of a function or of a file system is missing.
            kind if kind == ErrorKind::NotFound || nodev => "sudo modprobe -a usb_f_fs usb_f_acm",
            _ => return Self::Make(source),
        };
        Self::NoSupport { remedy, source }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_missing_part_has_its_command() {
        let from_io = |kind, text| GadgetError::from_io(io::Error::new(kind, text));
        let command = |error: GadgetError| match &error {
            GadgetError::NoSupport { remedy, .. } if error.to_string().contains(remedy) => *remedy,
            _ => panic!("{error:?}"),
        };
        let no_mount = from_io(ErrorKind::NotFound, "configfs is not mounted");
        assert!(command(no_mount).starts_with("sudo mount -t configfs "));
        let no_module = from_io(ErrorKind::NotFound, "usb_gadget not found in configfs");
        assert_eq!(command(no_module), "sudo modprobe libcomposite");
        let no_permission = from_io(ErrorKind::PermissionDenied, "");
        assert!(matches!(no_permission, GadgetError::NotRoot), "{no_permission:?}");
        let no_filesystem = GadgetError::from_io(io::Error::from_raw_os_error(19));
        assert_eq!(command(no_filesystem), "sudo modprobe -a usb_f_fs usb_f_acm");
        let other = GadgetError::from_io(ErrorKind::OutOfMemory.into());
        assert!(matches!(other, GadgetError::Make(_)));
    }
}
