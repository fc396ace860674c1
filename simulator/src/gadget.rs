//! The simulator as a USB device (gadget), on a machine with a USB device controller: a Raspberry Pi Zero beside the
//! rig, or any Linux machine with `dummy_hcd`.
//!
//! Linux programs define USB devices through configfs and `FunctionFS`, which the usb-gadget crate drives. [`Bulk`]
//! is the device of `docs/link-protocol.md` section 6, one vendor interface with a pair of bulk endpoints. [`Serial`]
//! is a CDC-ACM port.

use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use bytes::{Bytes, BytesMut};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use usb_gadget::function::Handle;
use usb_gadget::function::custom::{
    Custom, Endpoint, EndpointDirection, EndpointReceiver, EndpointSender, Event, Interface,
};
use usb_gadget::function::serial::{Serial as Function, SerialClass};
use usb_gadget::{Class, Config, Gadget, Id, RegGadget, Strings, Udc, registered, udcs};

use crate::line::Line;
use crate::pty::{or_nothing, wait_readable};

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
    #[error("invalid serial number '{found}': expected 1 to 32 letters, digits, '-', '_' or '.'")]
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
        let nodev = source.raw_os_error() == Some(Errno::NODEV.raw_os_error());
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

/// No system call reports how much the host has not read yet. The kernel buffers 8 KiB, which full speed carries in 10
/// ms: after this time the host either has it or does not read.
const UNREAD_TIMEOUT: Duration = Duration::from_millis(250);

/// The device's end of a CDC-ACM port.
#[derive(Debug)]
pub struct Serial {
    port: PathBuf,
    /// `None` after a hang-up, until it can be opened again.
    open: Option<OwnedFd>,
    serial: String,
    written: Instant,
    // After the port that it makes.
    _plugged: RegGadget,
}

impl Serial {
    /// Creates the gadget and plugs it in.
    ///
    /// # Errors
    /// When this machine has no free USB device controller, lacks kernel support, or the process lacks rights.
    pub fn plug_in(settings: &GadgetSettings) -> Result<Self, GadgetError> {
        let (function, handle) = Function::new(SerialClass::Acm);
        let plugged = plug_in(settings, SERIAL_PRODUCT_ID, handle)?;
        let port = function.tty().map_err(GadgetError::Make)?;
        let open = Some(open(&port).map_err(|error| GadgetError::Make(error.into()))?);
        Ok(Self {
            port,
            open,
            serial: settings.serial.clone(),
            written: Instant::now(),
            _plugged: plugged,
        })
    }

    /// The path under which a host with udev finds it.
    #[must_use]
    pub fn host_path(&self) -> PathBuf {
        format!("/dev/serial/by-id/usb-{MANUFACTURER}_{PRODUCT}_{}-if00", self.serial).into()
    }

    /// Closes a port that has hung up because the cable was pulled; it must be reopened.
    fn on_hang_up(&mut self, outcome: io::Result<usize>, may_be_empty: bool) -> io::Result<usize> {
        match outcome {
            Ok(0) if may_be_empty => Ok(0),
            Ok(0) | Err(_) => {
                self.open = None;
                Ok(0)
            }
            outcome => outcome,
        }
    }
}

fn open(port: &Path) -> Result<OwnedFd, Errno> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let fd = rustix::fs::open(port, flags, Mode::empty())?;
    let mut termios = tcgetattr(&fd)?;
    termios.make_raw();
    tcsetattr(&fd, OptionalActions::Now, &termios)?;
    Ok(fd)
}

impl Line for Serial {
    fn name(&self) -> &'static str {
        "USB serial gadget"
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(fd) = &self.open else { return Ok(0) };
        let outcome = or_nothing(rustix::io::write(fd, bytes));
        self.written = Instant::now();
        self.on_hang_up(outcome, true)
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let Some(fd) = &self.open else { return Ok(0) };
        match rustix::io::read(fd, buffer) {
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            outcome => self.on_hang_up(outcome.map_err(Into::into), false),
        }
    }

    fn wait(&mut self, at_most: Duration) -> io::Result<bool> {
        match &self.open {
            Some(fd) => wait_readable(fd.as_fd(), at_most),
            None => {
                std::thread::sleep(at_most);
                Ok(false)
            }
        }
    }

    /// Sleeps, because waiting for input would return immediately.
    fn wait_for_room(&mut self, at_most: Duration) -> io::Result<bool> {
        std::thread::sleep(at_most);
        Ok(true)
    }

    fn unread(&mut self) -> io::Result<u64> {
        // A port that has hung up holds no bytes.
        Ok(u64::from(self.open.is_some() && self.written.elapsed() < UNREAD_TIMEOUT))
    }

    fn maintain(&mut self) -> io::Result<()> {
        if self.open.is_none() {
            self.open = open(&self.port).ok();
        }
        Ok(())
    }
}

/// Subclass of the vendor interface: `M`.
pub const INTERFACE_SUBCLASS: u8 = 0x4d;

/// Protocol number of the vendor interface: the version of the link protocol.
pub const INTERFACE_PROTOCOL: u8 = 1;

/// Size of one transfer to the host: many packets, so that the overhead of each is small.
const TRANSFER_BYTES: usize = 16 << 10;

/// Transfers queued for the host: what high speed carries in 3 ms.
const SEND_TRANSFERS: u32 = 8;

/// Transfers queued for commands, and the size of each; a command has 16 bytes.
const RECEIVE_TRANSFERS: u32 = 4;
const RECEIVE_BYTES: usize = 4096;

/// How long the kernel may take to return cancelled transfers. `dummy_hcd` does so with its next frame, within 1 ms; a
/// busy emulated machine takes longer.
const CANCEL_TIMEOUT: Duration = Duration::from_millis(500);

/// Full speed has packets of 64 bytes, the others have multiples of it.
const PACKET_BYTES: usize = 64;

/// The device's end of the bulk endpoints.
#[derive(Debug)]
pub struct Bulk {
    // Declared, and so dropped, before the files that it uses.
    _plugged: RegGadget,
    custom: Custom,
    to_host: EndpointSender,
    from_host: EndpointReceiver,
    /// Whether the host has selected the configuration and the cable is in.
    enabled: bool,
    /// Bytes from the host that are not read yet.
    received: BytesMut,
    serial: String,
}

impl Bulk {
    /// Creates the gadget and plugs it in.
    ///
    /// # Errors
    /// When this machine has no free USB device controller, lacks kernel support, or the process lacks rights.
    pub fn plug_in(settings: &GadgetSettings) -> Result<Self, GadgetError> {
        let (from_host, from_direction) = EndpointDirection::host_to_device();
        let (to_host, to_direction) = EndpointDirection::device_to_host();
        let class = Class::vendor_specific(INTERFACE_SUBCLASS, INTERFACE_PROTOCOL);
        let interface = Interface::new(class, "mocapd link")
            .with_endpoint(Endpoint::bulk(to_direction.with_queue_len(SEND_TRANSFERS)))
            .with_endpoint(Endpoint::bulk(from_direction.with_queue_len(RECEIVE_TRANSFERS)));
        let (custom, handle) = Custom::builder().with_interface(interface).build();
        let plugged = plug_in(settings, BULK_PRODUCT_ID, handle)?;
        Ok(Self {
            _plugged: plugged,
            custom,
            to_host,
            from_host,
            enabled: false,
            received: BytesMut::new(),
            serial: settings.serial.clone(),
        })
    }

    /// The URI under which a host opens it.
    #[must_use]
    pub fn uri(&self) -> String {
        format!("usb:{:04x}:{BULK_PRODUCT_ID:04x}:{}", VENDOR_ID, self.serial)
    }

    /// Stalls the endpoint to the host, as a device with an internal error does, until the host clears it. Transfers in
    /// flight are lost.
    ///
    /// # Errors
    /// When no host is connected, or the controller cannot stall.
    pub fn stall(&mut self) -> io::Result<()> {
        self.to_host.cancel()?;
        let started = Instant::now();
        loop {
            match self.to_host.control()?.halt() {
                // FunctionFS reports success by EBADMSG.
                Err(error) if error.raw_os_error() == Some(Errno::BADMSG.raw_os_error()) => {
                    return Ok(());
                }
                // A cancelled transfer is not returned yet.
                Err(error)
                    if error.kind() == ErrorKind::WouldBlock
                        && started.elapsed() < CANCEL_TIMEOUT =>
                {
                    std::thread::sleep(Duration::from_millis(1));
                }
                outcome => return outcome,
            }
        }
    }

    /// Follows the host's connection. Its requests to the control endpoint are not supported and stall.
    fn handle_events(&mut self) -> io::Result<()> {
        while let Some(event) = self.custom.try_event()? {
            match event {
                Event::Enable => self.enabled = true,
                Event::Disable | Event::Unbind => self.enabled = false,
                _ => continue,
            }
            // Earlier transfers belong to an earlier connection.
            self.to_host.cancel()?;
            self.from_host.cancel()?;
        }
        Ok(())
    }

    /// Queues transfers that receive commands.
    fn queue_receives(&mut self) {
        while self.enabled && self.from_host.is_ready() {
            if self.from_host.try_recv(BytesMut::with_capacity(RECEIVE_BYTES)).is_err() {
                // The cable was just pulled; its event follows.
                return;
            }
        }
    }
}

/// How many of `pending` bytes go into the next transfer.
///
/// A transfer whose last packet is full does not end for the host, which waits for more: the last pending bytes must
/// go in a short packet.
fn transfer_bytes(pending: usize) -> usize {
    let bytes = pending.min(TRANSFER_BYTES);
    bytes - usize::from(bytes == pending && bytes > 1 && bytes.is_multiple_of(PACKET_BYTES))
}

impl Line for Bulk {
    fn name(&self) -> &'static str {
        "USB gadget"
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.handle_events()?;
        // Transfers fail only because the cable was pulled: their errors carry no information.
        while self.enabled && self.to_host.try_ready().is_err() {}
        if !self.enabled || !self.to_host.is_ready() {
            return Ok(0);
        }
        let part = bytes.get(..transfer_bytes(bytes.len())).unwrap_or_default();
        Ok(self.to_host.try_send(Bytes::copy_from_slice(part)).map_or(0, |()| part.len()))
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.received.is_empty() {
            // An error means that the cable was pulled.
            if let Ok(Some(bytes)) = self.from_host.try_fetch() {
                self.received = bytes;
            }
            self.queue_receives();
        }
        let count = self.received.len().min(buffer.len());
        let now = self.received.split_to(count);
        if let Some(to) = buffer.get_mut(..count) {
            to.copy_from_slice(&now);
        }
        Ok(count)
    }

    fn wait(&mut self, at_most: Duration) -> io::Result<bool> {
        self.handle_events()?;
        if !self.enabled {
            // Nothing can arrive before the host is connected.
            std::thread::sleep(at_most);
            self.handle_events()?;
        }
        self.queue_receives();
        if self.received.is_empty()
            && let Ok(Some(bytes)) = self.from_host.fetch_timeout(at_most)
        {
            self.received = bytes;
        }
        Ok(!self.received.is_empty())
    }

    fn wait_for_room(&mut self, at_most: Duration) -> io::Result<bool> {
        if !self.enabled {
            return self.wait(at_most);
        }
        // An error means that the cable was pulled or the time is over.
        let ready = self.to_host.ready_timeout(at_most);
        drop(ready);
        Ok(true)
    }

    fn unread(&mut self) -> io::Result<u64> {
        while self.enabled && self.to_host.try_ready().is_err() {}
        Ok(u64::from(!self.to_host.is_empty()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_missing_kernel_part_has_its_command() {
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

    #[test]
    fn pending_bytes_end_with_a_short_packet() {
        for pending in (1..5000).chain([16_383, 16_384, 16_385, 32_768, 100_000]) {
            let (mut left, mut last) = (pending, 0);
            while left > 0 {
                last = transfer_bytes(left);
                assert!((1..=TRANSFER_BYTES).contains(&last), "{pending}");
                left -= last;
            }
            assert!(!last.is_multiple_of(PACKET_BYTES), "{pending}: {last}");
        }
    }
}
