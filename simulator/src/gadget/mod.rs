//! A USB device on a machine that can be one: a Raspberry Pi Zero beside the rig, or `dummy_hcd`.
//!
//! Linux gives a program its own device through configfs and `FunctionFS`, which the usb-gadget crate drives.
//! [`Bulk`] is the device of `docs/link-protocol.md` section 6: one vendor interface with a bulk pair. [`Serial`] is a
//! CDC-ACM port.

use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

pub use bulk::{Bulk, INTERFACE_PROTOCOL, INTERFACE_SUBCLASS};
pub use serial::Serial;
use usb_gadget::function::Handle;
use usb_gadget::{Class, Config, Gadget, Id, RegGadget, Strings, Udc, registered, udcs};

mod bulk;
mod serial;

/// The vendor of pid.codes, whose products 0001 to 0010 anybody may use for tests.
pub const VENDOR_ID: u16 = 0x1209;

/// The product that is a bulk pair.
pub const BULK_PRODUCT_ID: u16 = 0x0001;

/// The product that is a serial port.
pub const SERIAL_PRODUCT_ID: u16 = 0x0002;

/// What the strings say; udev makes names of both.
const MANUFACTURER: &str = "mocapd";
const PRODUCT: &str = "mocapd-sim";

/// Which device to be, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GadgetSettings {
    /// The serial number in its descriptors: 1 to 32 letters, digits, `-`, `_` and `.`.
    pub serial: String,
    /// The controller's name in `/sys/class/udc`; `None` for the first that is free.
    pub controller: Option<String>,
}

/// A gadget in configfs, bound to its controller. Dropping it unplugs it and takes it away.
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
    let made = gadget.register().map_err(GadgetError::making)?;
    made.bind(Some(&controller)).map_err(|source| {
        let controller = controller.name().to_string_lossy().into_owned();
        GadgetError::Bind { controller, source }
    })?;
    Ok(made)
}

/// How gadgets of ours are called in configfs, before the process that made them.
const NAME: &str = "mocapd-sim-";

/// The controller of that name, or the first that is free, by name.
fn free_controller(wanted: Option<&str>) -> Result<Udc, GadgetError> {
    let mut all = udcs().unwrap_or_default();
    if all.is_empty() {
        return Err(GadgetError::NoController);
    }
    remove_leftovers();
    all.sort_by_key(|udc| udc.name().to_owned());
    let names: Vec<_> = all.iter().map(|udc| udc.name().to_string_lossy()).collect();
    let found = names.join(", ");
    if let Some(name) = wanted
        && !names.iter().any(|known| known == name)
    {
        return Err(GadgetError::NoSuchController { name: name.to_owned(), found });
    }
    let is_meant = |udc: &Udc| wanted.is_none_or(|name| udc.name() == name);
    let is_free = |udc: &Udc| udc.function().is_ok_and(|gadget| gadget.is_none());
    let free = all.iter().find(|udc| is_meant(udc) && is_free(udc)).cloned();
    free.ok_or(GadgetError::ControllerBusy { found })
}

/// A name for a gadget of this process.
fn gadget_name() -> String {
    static MADE: AtomicU32 = AtomicU32::new(0);
    format!("{NAME}{}-{}", std::process::id(), MADE.fetch_add(1, Ordering::Relaxed))
}

/// A simulator that was killed could not take its gadget away.
fn remove_leftovers() {
    for gadget in registered().unwrap_or_default() {
        let name = gadget.name().to_string_lossy().into_owned();
        let process = name.strip_prefix(NAME).and_then(|rest| rest.split('-').next());
        let is_left = process.is_some_and(|process| !Path::new("/proc").join(process).exists());
        if is_left && gadget.remove().is_err() {
            // Then its controller counts as taken, and the error says so.
        }
    }
}

/// What can go wrong with a gadget.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GadgetError {
    /// The machine cannot be a USB device.
    #[error(
        "this machine has no USB device controller: use one that has, such as a Raspberry Pi Zero \
         (docs/hardware-in-the-loop.md), or load a made-up one with `sudo modprobe dummy_hcd`"
    )]
    NoController,
    /// All of them are taken, or the one asked for is.
    #[error(
        "no USB device controller is free ({found}): stop the other gadget, or name another one with --udc"
    )]
    ControllerBusy {
        /// Their names.
        found: String,
    },
    /// There is none of that name.
    #[error("no USB device controller is called '{name}': this machine has {found}")]
    NoSuchController {
        /// As it was given.
        name: String,
        /// Their names.
        found: String,
    },
    /// Not a name.
    #[error("'{found}' is no serial number: give 1 to 32 letters, digits, '-', '_' or '.'")]
    SerialNumber {
        /// As it was given.
        found: String,
    },
    /// configfs belongs to root.
    #[error("only root may make a USB gadget: run it with sudo")]
    NotRoot,
    /// A kernel's part is not there.
    #[error("the kernel's USB gadget parts are not there: type `{remedy}`")]
    NotThere {
        /// What to type.
        remedy: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// The kernel did not take the gadget.
    #[error("making the USB gadget failed")]
    Make(#[source] io::Error),
    /// The controller did not take the gadget.
    #[error("the USB device controller {controller} does not take the gadget")]
    Bind {
        /// Its name.
        controller: String,
        /// What the system said.
        source: io::Error,
    },
}

impl GadgetError {
    /// Why configfs or `FunctionFS` did not do what was asked.
    pub(super) fn making(source: io::Error) -> Self {
        let says = |part: &str| source.to_string().contains(part);
        let remedy = match source.kind() {
            ErrorKind::PermissionDenied => return Self::NotRoot,
            ErrorKind::NotFound if says("configfs is not mounted") => {
                "sudo mount -t configfs none /sys/kernel/config"
            }
            ErrorKind::NotFound if says("usb_gadget") => "sudo modprobe libcomposite",
            // A function that no module knows, or a file system that no module knows.
            ErrorKind::NotFound => "sudo modprobe -a usb_f_fs usb_f_acm",
            _ if source.raw_os_error() == Some(rustix::io::Errno::NODEV.raw_os_error()) => {
                "sudo modprobe -a usb_f_fs usb_f_acm"
            }
            _ => return Self::Make(source),
        };
        Self::NotThere { remedy, source }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_missing_part_has_its_command() {
        let making = |kind, text| GadgetError::making(io::Error::new(kind, text));
        let command = |error: GadgetError| match &error {
            GadgetError::NotThere { remedy, .. } if error.to_string().contains(remedy) => *remedy,
            _ => panic!("{error:?}"),
        };
        let no_mount = making(ErrorKind::NotFound, "configfs is not mounted");
        assert!(command(no_mount).starts_with("sudo mount -t configfs "));
        let no_module = making(ErrorKind::NotFound, "usb_gadget not found in configfs");
        assert_eq!(command(no_module), "sudo modprobe libcomposite");
        let no_permission = making(ErrorKind::PermissionDenied, "");
        assert!(matches!(no_permission, GadgetError::NotRoot), "{no_permission:?}");
        let no_filesystem = GadgetError::making(io::Error::from_raw_os_error(19));
        assert_eq!(command(no_filesystem), "sudo modprobe -a usb_f_fs usb_f_acm");
        assert!(matches!(GadgetError::making(ErrorKind::OutOfMemory.into()), GadgetError::Make(_)));
    }
}
