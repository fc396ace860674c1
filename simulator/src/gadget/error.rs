//! Why there is no gadget.

use std::io::{self, ErrorKind};

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
    /// It failed while it was served.
    #[error(transparent)]
    Line(#[from] crate::line::LineError),
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
        let words = |kind, text| GadgetError::making(io::Error::new(kind, text)).to_string();
        let no_mount = words(ErrorKind::NotFound, "configfs is not mounted");
        assert!(no_mount.contains("mount -t configfs"), "{no_mount}");
        let no_module = words(ErrorKind::NotFound, "usb_gadget not found in configfs");
        assert!(no_module.contains("modprobe libcomposite"), "{no_module}");
        assert!(words(ErrorKind::PermissionDenied, "").contains("sudo"));
        let no_filesystem = GadgetError::making(io::Error::from_raw_os_error(19)).to_string();
        assert!(no_filesystem.contains("usb_f_fs"), "{no_filesystem}");
        assert!(matches!(GadgetError::making(ErrorKind::OutOfMemory.into()), GadgetError::Make(_)));
    }
}
