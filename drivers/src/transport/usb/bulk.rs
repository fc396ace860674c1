//! One bulk endpoint in each direction as a byte stream, with transfers queued ahead of the reader.

use std::{
    collections::VecDeque,
    fs,
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use nusb::{
    Endpoint, MaybeFuture,
    transfer::{Buffer, Bulk, Out, TransferError},
};

use super::{
    device::{UsbDevice, find, open_error},
    pair,
    queue::{CANCEL_WITHIN, PAUSE, Queue, TRANSFER_BYTES, TRANSFERS},
};
use crate::transport::{READ_TIMEOUT, Transport, TransportError, WRITE_TIMEOUT};

/// `ENOMEM`: the kernel's limit for transfers is used up.
const ENOMEM: u32 = 12;

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
        let address = fs::read_to_string(self.sysfs.join("devnum"));
        address.is_ok_and(|address| address == self.address)
    }

    fn is_gone(&self) -> TransportError {
        TransportError::Disconnected { device: self.name.clone() }
    }

    fn failure(&self, action: &'static str, error: TransferError) -> TransportError {
        match error {
            TransferError::Unknown(ENOMEM) => {
                TransportError::Unsupported(out_of_memory(&self.name, limit_mib()))
            }
            TransferError::Disconnected => self.is_gone(),
            _ => TransportError::Io { device: self.name.clone(), action, source: error.into() },
        }
    }

    fn stalled(&self) -> TransportError {
        TransportError::Unsupported(format!(
            "{} stalls again each time it is cleared: unplug it, plug it in again, and check its firmware",
            self.name
        ))
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
        let info = find(vid, pid, serial)?;
        let device = UsbDevice::from(&info);
        let name = device.location().to_string();
        let address = format!("{}\n", info.device_address());
        let failed = |error| open_error(&device, error);
        let opened = info.open().wait().map_err(failed)?;
        let configuration =
            opened.active_configuration().map_err(|error| strange(&device, &error.to_string()))?;
        let pair = pair::pair(&configuration).map_err(|found| strange(&device, &found))?;
        let interface = opened.detach_and_claim_interface(pair.interface).wait().map_err(failed)?;
        let rx = interface.endpoint(pair.device_to_host).map_err(failed)?;
        let tx = interface.endpoint(pair.host_to_device).map_err(failed)?;
        let received = Queue::start(rx)
            .ok_or_else(|| TransportError::Unsupported(out_of_memory(&name, limit_mib())))?;
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
                thread::sleep(PAUSE);
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
        match self.received.error.take() {
            // What came before the failure is read first; the next read meets it.
            Some(error) if n > 0 => self.received.error = Some(error),
            Some(error) => self.recover(error)?,
            None => {}
        }
        Ok(n)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        send(&mut self.tx, &self.device, bytes)
    }

    fn describe(&self) -> String {
        let (n, kib) = (self.received.transfers, TRANSFER_BYTES >> 10);
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

// Commands to the device.

/// Tries for one command: after a stall that was cleared, or noise.
const TRIES: u32 = 4;

fn send(tx: &mut Endpoint<Bulk, Out>, device: &Opened, bytes: &[u8]) -> Result<(), TransportError> {
    for part in bytes.chunks(TRANSFER_BYTES) {
        send_transfer(tx, device, part)?;
    }
    // Without a packet that is not full the device would wait for the rest of the transfer.
    let packet_bytes = tx.max_packet_size().max(1);
    if !bytes.is_empty() && bytes.len().is_multiple_of(packet_bytes) {
        send_transfer(tx, device, &[])?;
    }
    Ok(())
}

fn send_transfer(
    tx: &mut Endpoint<Bulk, Out>,
    device: &Opened,
    bytes: &[u8],
) -> Result<(), TransportError> {
    for left in (0..TRIES).rev() {
        let mut buffer = Buffer::new(bytes.len());
        buffer.extend_from_slice(bytes);
        tx.submit(buffer);
        let Some(done) = tx.wait_next_complete(WRITE_TIMEOUT) else {
            return Err(give_up(tx, device));
        };
        match done.status {
            Ok(()) => return Ok(()),
            Err(TransferError::Stall) if left > 0 => {
                tx.clear_halt().wait().map_err(|_| device.is_gone())?;
            }
            Err(TransferError::Stall) => return Err(device.stalled()),
            Err(TransferError::Fault | TransferError::Cancelled)
                if left > 0 && device.is_attached() =>
            {
                thread::sleep(PAUSE);
            }
            Err(TransferError::Fault | TransferError::Cancelled) => return Err(device.is_gone()),
            Err(error) => return Err(device.failure("writing", error)),
        }
    }
    Err(device.is_gone())
}

/// The device takes no bytes.
fn give_up(tx: &mut Endpoint<Bulk, Out>, device: &Opened) -> TransportError {
    tx.cancel_all();
    while tx.pending() > 0 {
        if tx.wait_next_complete(CANCEL_WITHIN).is_none() {
            return device.is_gone();
        }
    }
    TransportError::Stuck { device: device.name.clone() }
}

// The kernel's limit on what all USB transfers of all programs may hold in memory.

const PARAMETER: &str = "/sys/module/usbcore/parameters/usbfs_memory_mb";

/// The limit in MiB; `None` where there is none (0), or it cannot be read.
fn limit_mib() -> Option<u64> {
    parse_limit(&fs::read_to_string(PARAMETER).ok()?)
}

fn parse_limit(text: &str) -> Option<u64> {
    text.trim().parse().ok().filter(|mib| *mib > 0)
}

/// Why there is no memory for transfers, and what to type.
fn out_of_memory(device: &str, limit_mib: Option<u64>) -> String {
    let limit = limit_mib.map_or_else(String::new, |mib| format!(", {mib} MiB for all programs,"));
    let raised = limit_mib.unwrap_or(16).saturating_mul(4).max(64);
    format!(
        "no memory for USB transfers with {device}: the kernel's limit{limit} is used up, and {TRANSFERS} \
         transfers of {} KiB are needed; close other programs that use USB, or type \
         `echo {raised} | sudo tee {PARAMETER}`",
        TRANSFER_BYTES >> 10
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_kernels_parameter() {
        assert_eq!(parse_limit("16\n"), Some(16));
        assert_eq!(parse_limit("0\n"), None, "no limit");
        assert_eq!(parse_limit("many"), None);
    }

    #[test]
    fn says_what_to_type() {
        let words = out_of_memory("usb:1209:0001:A", Some(16));
        assert!(words.contains("usb:1209:0001:A") && words.contains("16 MiB"), "{words}");
        assert!(words.contains(&format!("`echo 64 | sudo tee {PARAMETER}`")), "{words}");
        assert!(out_of_memory("x", Some(u64::MAX)).contains("echo 1844"));
    }
}
