//! The options for the line, and opening it.

use std::path::PathBuf;

use clap::Args;
use mocapd_simulator::line::Line;
use mocapd_simulator::pty::{PtyError, PtyLine};
use mocapd_simulator::source::is_motion;

use crate::cli::Failure;

/// The line between device and host.
#[derive(Debug, Args)]
pub(super) struct LineArgs {
    /// Serve on a pty; with PATH, also create a symbolic link PATH to it, whose name stays the same
    ///
    /// `--pty PATH` and `--pty=PATH` are the same. A file that can be played is never taken for the link:
    /// `--pty jump.c3d` plays jump.c3d on a pty without a link.
    #[arg(long, value_name = "PATH", num_args = 0..=1)]
    pub(super) pty: Option<Option<PathBuf>>,
    /// Act as a USB device with bulk endpoints; needs root and a USB device controller
    #[arg(long, conflicts_with_all = ["pty", "baud"])]
    usb_gadget: bool,
    /// Act as a USB serial port (CDC-ACM); needs root and a USB device controller
    #[arg(long, conflicts_with_all = ["pty", "usb_gadget"])]
    usb_serial: bool,
    /// With --protocol qtm, which implies it: listen on this TCP port of this machine only, by default on any free one
    #[arg(long, value_name = "PORT", num_args = 0..=1, conflicts_with_all = ["pty", "usb_gadget", "usb_serial", "udc", "baud"])]
    pub(super) tcp: Option<Option<u16>>,
    /// Name of the USB device controller in /sys/class/udc [default: the first free one]
    #[arg(long, value_name = "NAME", conflicts_with = "pty")]
    udc: Option<String>,
}

impl LineArgs {
    /// The value of `--pty`, if it is a file to play: it has the extension of a motion, or is a file already.
    pub(super) fn file_after_pty(&self) -> Option<PathBuf> {
        let path = self.pty.as_ref()?.as_ref()?;
        // A link to a pty is not a regular file, whether or not the pty still exists.
        (is_motion(path) || path.is_file()).then(|| path.clone())
    }

    /// Whether one was chosen that is not on the network.
    pub(super) fn is_chosen(&self) -> bool {
        self.pty.is_some() || self.usb_gadget || self.usb_serial
    }

    /// Whether a host finds the device again after its cable was pulled and plugged in.
    pub(super) fn has_stable_name(&self) -> bool {
        matches!(self.pty, Some(Some(_))) || self.tcp.is_some()
    }

    /// Opens the line; returns it with the path or URI that a host opens.
    pub(super) fn open(&self, serial: &str) -> Result<(Box<dyn Line>, String), Failure> {
        if self.usb_gadget || self.usb_serial {
            return self.plug_in(serial);
        }
        let line =
            PtyLine::open(self.pty.as_ref().and_then(Option::as_deref)).map_err(pty_failure)?;
        let path = line.path().display().to_string();
        Ok((Box::new(line), path))
    }

    #[cfg(target_os = "linux")]
    fn plug_in(&self, serial: &str) -> Result<(Box<dyn Line>, String), Failure> {
        use mocapd_simulator::gadget::{Bulk, GadgetSettings, Serial};

        let settings = GadgetSettings { serial: serial.to_owned(), controller: self.udc.clone() };
        if self.usb_gadget {
            let line = Bulk::plug_in(&settings).map_err(gadget_failure)?;
            let uri = line.uri();
            return Ok((Box::new(line), uri));
        }
        let line = Serial::plug_in(&settings).map_err(gadget_failure)?;
        let path = line.host_path().display().to_string();
        Ok((Box::new(line), path))
    }

    #[cfg(not(target_os = "linux"))]
    fn plug_in(&self, _serial: &str) -> Result<(Box<dyn Line>, String), Failure> {
        Err(anyhow::anyhow!("USB gadgets need Linux: use --pty").into())
    }
}

fn pty_failure(error: PtyError) -> Failure {
    match error {
        PtyError::LinkExists { .. } => Failure::usage(error),
        _ => Failure::from(error),
    }
}

#[cfg(target_os = "linux")]
fn gadget_failure(error: mocapd_simulator::gadget::GadgetError) -> Failure {
    use mocapd_simulator::gadget::GadgetError;

    match error {
        GadgetError::SerialNumber { .. } | GadgetError::NoSuchController { .. } => {
            Failure::usage(error)
        }
        _ => Failure::from(error),
    }
}
