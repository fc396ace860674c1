//! One bulk endpoint in each direction as a byte stream, with transfers queued ahead of the reader.

mod error;
mod queue;
mod sending;

use std::{
    collections::VecDeque,
    path::PathBuf,
    time::{Duration, Instant},
};

use nusb::{
    Endpoint, MaybeFuture,
    transfer::{Bulk, Out, TransferError},
};

use self::queue::Queue;
use super::{UsbDevice, find::find, memory, pair, words};
use crate::transport::{READ_TIMEOUT, Transport, TransportError};

/// Transfers that wait for the device: while one is read, the controller fills the others.
pub const TRANSFERS: usize = 8;

/// Bytes of one: a multiple of every packet size there is (1024 and less). Eight of them hold what high
/// speed carries in 6 ms (40 MB/s), a scheduler's delay; a device whose frames end a transfer each is not
/// held up before eight frames wait. Together 256 KiB, a 64th of the kernel's default limit.
pub const TRANSFER_BYTES: usize = 32 << 10;

/// Transfers without which there is no queue: one is filled while the other is read.
const TRANSFERS_MIN: usize = 2;

/// A device that stalls so often within that time is not mended by clearing, whatever comes in between.
const STALLS_MAX: usize = 32;
const STALLS_WITHIN: Duration = Duration::from_secs(10);

/// A USB device's bulk pair, open and claimed for us alone.
#[derive(Debug)]
pub struct UsbTransport {
    received: Queue,
    tx: Endpoint<Bulk, Out>,
    device: Opened,
    stalls_cleared: u64,
    /// When it stalled last, at most [`STALLS_MAX`] times.
    stalls: VecDeque<Instant>,
}

/// Which device is open, and how to see whether it still is there.
#[derive(Debug)]
struct Opened {
    name: String,
    sysfs: PathBuf,
    /// Its address on the bus, as the kernel writes it: another one after each replug.
    address: String,
}

impl Opened {
    /// A transfer that failed may be noise on the cable, or the first sign of a pulled one.
    fn is_attached(&self) -> bool {
        let address = std::fs::read_to_string(self.sysfs.join("devnum"));
        address.is_ok_and(|address| address == self.address)
    }

    fn is_gone(&self) -> TransportError {
        TransportError::Disconnected { device: self.name.clone() }
    }
}

impl UsbTransport {
    /// Finds a device, claims the first vendor interface that has a bulk pair, and queues the reads. A
    /// kernel driver that holds the interface is detached, and comes back when the transport is dropped.
    ///
    /// # Errors
    /// `NotFound`, `Busy`, `PermissionDenied`; `Unsupported` for a device without a bulk pair, for several
    /// that are meant alike, and where the kernel has no memory for transfers; `Io`.
    pub fn open(vid: u16, pid: u16, serial: Option<&str>) -> Result<Self, TransportError> {
        let (info, device) = find(vid, pid, serial)?;
        let name = device.location().to_string();
        let address = format!("{}\n", info.device_address());
        let failed = |error| words::open_error(&device, error);
        let opened = info.open().wait().map_err(failed)?;
        let configuration =
            opened.active_configuration().map_err(|error| strange(&device, &error.to_string()))?;
        let pair = pair::pair(&configuration).map_err(|found| strange(&device, &found))?;
        let interface = opened.detach_and_claim_interface(pair.interface).wait().map_err(failed)?;
        let rx = interface.endpoint(pair.device_to_host).map_err(failed)?;
        let tx = interface.endpoint(pair.host_to_device).map_err(failed)?;
        let received = Queue::start(rx).ok_or_else(|| {
            TransportError::Unsupported(memory::words(&name, memory::limit_mib()))
        })?;
        let device = Opened { name, sysfs: device.sysfs, address };
        Ok(Self {
            received,
            tx,
            device,
            stalls_cleared: 0,
            stalls: VecDeque::with_capacity(STALLS_MAX),
        })
    }

    fn stalls_too_often(&mut self) -> bool {
        let first = (self.stalls.len() == STALLS_MAX).then(|| self.stalls.pop_front()).flatten();
        self.stalls.push_back(Instant::now());
        first.is_some_and(|first| first.elapsed() < STALLS_WITHIN)
    }

    /// A transfer failed: mends what can be mended, and says what cannot.
    fn recover(&mut self, error: TransferError) -> Result<(), TransportError> {
        let again = self.received.failed_again();
        match error {
            TransferError::Stall if again && !self.stalls_too_often() => {
                // A device that does not let itself be cleared is on its way out.
                if !self.received.clear_halt() {
                    return Err(self.device.is_gone());
                }
                self.stalls_cleared += 1;
            }
            TransferError::Stall => return Err(self.device.stalled()),
            // A pulled plug comes as any of the three: looked for again, it is there or not.
            TransferError::Fault | TransferError::Cancelled
                if again && self.device.is_attached() =>
            {
                self.received.pause();
            }
            TransferError::Fault | TransferError::Cancelled | TransferError::Disconnected => {
                return Err(self.device.is_gone());
            }
            _ => return Err(self.device.failure("reading", error)),
        }
        if self.received.refill() { Ok(()) } else { Err(self.device.is_gone()) }
    }
}

impl Transport for UsbTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let n = self.received.take(buf, READ_TIMEOUT);
        match self.received.take_error() {
            // What came before the failure is read first; the next read meets it.
            Some(error) if n > 0 => self.received.put_error_back(error),
            Some(error) => self.recover(error)?,
            None => {}
        }
        Ok(n)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        sending::send(&mut self.tx, &self.device, bytes)
    }

    fn line_bytes_per_s(&self) -> Option<u64> {
        None
    }

    fn describe(&self) -> String {
        let (n, kib) = (self.received.transfers(), TRANSFER_BYTES >> 10);
        format!("USB device {}, {n} transfers of {kib} KiB", self.device.name)
    }

    fn stalls_cleared(&self) -> u64 {
        self.stalls_cleared
    }
}

/// Descriptors that make no sense: the device's fault, and nothing that permission or patience mends.
fn strange(device: &UsbDevice, found: &str) -> TransportError {
    TransportError::Unsupported(format!(
        "{} is no device that this build reads: {found}; check that it is the right one, and its firmware",
        device.location()
    ))
}
