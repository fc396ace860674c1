//! A pair of bulk endpoints as a byte stream: a queue of read transfers always has some pending, and returns their bytes in
//! order.

use std::{
    collections::VecDeque,
    fs,
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use TransferError::{Cancelled, Disconnected, Fault, Stall};
use nusb::{
    Endpoint, MaybeFuture,
    transfer::{Buffer, Bulk, Completion, In, Out, TransferError},
};

use super::{UsbDevice, find, open_error};
use crate::transport::usb;
use crate::transport::{READ_TIMEOUT, Transport, TransportError, WRITE_TIMEOUT};

/// `ENOMEM`: the kernel's memory limit for transfers is exhausted.
const ENOMEM: u32 = 12;

/// A device that stalls this often within [`STALL_WINDOW`] is not repaired by clearing the halt, even if
/// data arrive in between.
const STALLS_MAX: usize = 32;
const STALL_WINDOW: Duration = Duration::from_secs(10);

/// An open pair of bulk endpoints, claimed exclusively.
#[derive(Debug)]
pub struct UsbTransport {
    received: ReadQueue,
    tx: Endpoint<Bulk, Out>,
    device: Attached,
    stalls_cleared: u64,
    /// Times of the latest stalls, at most [`STALLS_MAX`].
    stalls: VecDeque<Instant>,
}

/// The open device, and how to check that it is still attached.
#[derive(Debug)]
struct Attached {
    name: String,
    sysfs: PathBuf,
    /// Bus address as the kernel formats it; a replug changes it.
    address: String,
}

impl Attached {
    /// Whether the device is still on the bus: a failed transfer can mean noise on the cable, or an unplugged one.
    fn is_attached(&self) -> bool {
        let address = fs::read_to_string(self.sysfs.join("devnum"));
        address.is_ok_and(|address| address == self.address)
    }

    fn gone(&self) -> TransportError {
        TransportError::Disconnected { device: self.name.clone() }
    }

    fn transfer_error(&self, action: &'static str, error: TransferError) -> TransportError {
        match error {
            TransferError::Unknown(ENOMEM) => out_of_memory(&self.name, limit_mib()),
            Disconnected => self.gone(),
            _ => TransportError::Io { device: self.name.clone(), action, source: error.into() },
        }
    }

    fn stall_error(&self) -> TransportError {
        TransportError::Unsupported(format!(
            "{} stalls again each time it is cleared: unplug it, plug it in again, and check its firmware",
            self.name
        ))
    }
}

impl UsbTransport {
    /// Finds a device, claims its first vendor interface with a bulk pair, and queues the reads. Detaches a
    /// kernel driver from the interface, which returns when the transport is dropped.
    ///
    /// # Errors
    /// `NotFound`, `Busy`, `PermissionDenied`; `Unsupported` for a device without a bulk pair, for an ambiguous
    /// URI, and when the kernel has no memory for transfers; `Io`.
    pub fn open(vid: u16, pid: u16, serial: Option<&str>) -> Result<Self, TransportError> {
        let info = find(vid, pid, serial)?;
        let device = UsbDevice::from(&info);
        let name = device.location().to_string();
        let address = format!("{}\n", info.device_address());
        let failed = |error| open_error(&device, error);
        let handle = info.open().wait().map_err(failed)?;
        let configuration =
            handle.active_configuration().map_err(|error| invalid(&device, &error.to_string()))?;
        let pair = usb::bulk_pair(&configuration).map_err(|found| invalid(&device, &found))?;
        let interface = handle.detach_and_claim_interface(pair.interface).wait().map_err(failed)?;
        let rx = interface.endpoint(pair.device_to_host).map_err(failed)?;
        let tx = interface.endpoint(pair.host_to_device).map_err(failed)?;
        let received = ReadQueue::start(rx).ok_or_else(|| out_of_memory(&name, limit_mib()))?;
        let stalls = VecDeque::with_capacity(STALLS_MAX);
        let device = Attached { name, sysfs: device.sysfs, address };
        Ok(Self { received, tx, device, stalls_cleared: 0, stalls })
    }

    /// Counts a stall; returns `true` when stalls are too frequent to continue.
    fn record_stall(&mut self) -> bool {
        let first = (self.stalls.len() == STALLS_MAX).then(|| self.stalls.pop_front()).flatten();
        self.stalls.push_back(Instant::now());
        first.is_some_and(|first| first.elapsed() < STALL_WINDOW)
    }

    /// Recovers from a failed transfer, or returns the error that ends the session.
    fn recover(&mut self, error: TransferError) -> Result<(), TransportError> {
        let retry = self.received.may_retry();
        match error {
            Stall if retry && !self.record_stall() => {
                // A device whose halt cannot be cleared is being disconnected.
                if !self.received.clear_halt() {
                    return Err(self.device.gone());
                }
                self.stalls_cleared += 1;
            }
            Stall => return Err(self.device.stall_error()),
            // An unplugged device causes any of these three errors; whether it is attached decides.
            Fault | Cancelled if retry && self.device.is_attached() => thread::sleep(RETRY_PAUSE),
            Fault | Cancelled | Disconnected => return Err(self.device.gone()),
            _ => return Err(self.device.transfer_error("reading", error)),
        }
        if self.received.refill() { Ok(()) } else { Err(self.device.gone()) }
    }
}

impl Transport for UsbTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let n = self.received.take(buf, READ_TIMEOUT);
        match self.received.error.take() {
            // Deliver the bytes that arrived before the failure; the next read handles it.
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

/// Invalid descriptors are the device's fault, and neither permission nor patience helps.
fn invalid(device: &UsbDevice, found: &str) -> TransportError {
    TransportError::Unsupported(format!(
        "{} is not a device that mocapd can read: {found}: check that it is the right one, and its firmware",
        device.location()
    ))
}

// Commands to the device.

/// Attempts to send a command, after cleared stalls or noise.
const ATTEMPTS: u32 = 4;

fn send(tx: &mut Endpoint<Bulk, Out>, device: &Attached, buf: &[u8]) -> Result<(), TransportError> {
    for part in buf.chunks(TRANSFER_BYTES) {
        send_transfer(tx, device, part)?;
    }
    // A transfer ends with a short packet; without one the device would wait for more.
    let packet_bytes = tx.max_packet_size().max(1);
    if !buf.is_empty() && buf.len().is_multiple_of(packet_bytes) {
        send_transfer(tx, device, &[])?;
    }
    Ok(())
}

fn send_transfer(
    tx: &mut Endpoint<Bulk, Out>,
    device: &Attached,
    bytes: &[u8],
) -> Result<(), TransportError> {
    for attempts_left in (0..ATTEMPTS).rev() {
        let mut buffer = Buffer::new(bytes.len());
        buffer.extend_from_slice(bytes);
        tx.submit(buffer);
        let Some(done) = tx.wait_next_complete(WRITE_TIMEOUT) else {
            return Err(cancel_write(tx, device));
        };
        match done.status {
            Ok(()) => return Ok(()),
            Err(Stall) if attempts_left > 0 => tx.clear_halt().wait().map_err(|_| device.gone())?,
            Err(Stall) => return Err(device.stall_error()),
            Err(Fault | Cancelled) if attempts_left > 0 && device.is_attached() => {
                thread::sleep(RETRY_PAUSE);
            }
            Err(Fault | Cancelled) => return Err(device.gone()),
            Err(error) => return Err(device.transfer_error("writing", error)),
        }
    }
    Err(device.gone())
}

/// Cancels a write that timed out, and returns the error.
fn cancel_write(tx: &mut Endpoint<Bulk, Out>, device: &Attached) -> TransportError {
    tx.cancel_all();
    while tx.pending() > 0 {
        if tx.wait_next_complete(CANCEL_TIMEOUT).is_none() {
            return device.gone();
        }
    }
    TransportError::Stuck { device: device.name.clone() }
}

// The kernel's limit on the memory of all USB transfers of all programs.

const PARAMETER: &str = "/sys/module/usbcore/parameters/usbfs_memory_mb";

/// The limit in MiB; `None` when it is 0, which means no limit, or cannot be read.
fn limit_mib() -> Option<u64> {
    parse_limit(&fs::read_to_string(PARAMETER).ok()?)
}

fn parse_limit(text: &str) -> Option<u64> {
    text.trim().parse().ok().filter(|mib| *mib > 0)
}

/// The error for exhausted transfer memory, with the command that raises the limit.
fn out_of_memory(device: &str, limit_mib: Option<u64>) -> TransportError {
    let limit = limit_mib.map_or_else(String::new, |mib| format!(", {mib} MiB for all programs,"));
    let raised = limit_mib.unwrap_or(16).saturating_mul(4).max(64);
    TransportError::Unsupported(format!(
        "no memory for USB transfers with {device}: the kernel's limit{limit} is exhausted, and {TRANSFERS} \
         transfers of {} KiB are needed; close other programs that use USB, or type \
         `echo {raised} | sudo tee {PARAMETER}`",
        TRANSFER_BYTES >> 10
    ))
}

/// Transfers in the queue: the controller fills the others while one is read.
pub const TRANSFERS: usize = 8;

/// Bytes of a transfer: a multiple of every packet size (at most 1024). Eight of them hold what high speed
/// delivers in 6 ms (40 MB/s), a scheduling delay. A device that ends a transfer after each frame is not
/// delayed until eight frames wait. Together they take 256 KiB, a 64th of the kernel's default limit.
pub const TRANSFER_BYTES: usize = 32 << 10;

/// Minimum number of transfers of a queue: one is filled while the other is read.
const TRANSFERS_MIN: usize = 2;

/// Consecutive failures that are retried: noise does not strike four times in 10 ms, and an unplugged cable
/// must be reported within 100 ms.
const FAILURES_MAX: u32 = 4;

/// Pause between a failure and the next attempt: some microframes.
const RETRY_PAUSE: Duration = Duration::from_millis(3);

/// Time-out of cancelled transfers; the kernel normally returns them immediately.
const CANCEL_TIMEOUT: Duration = Duration::from_millis(500);

/// The transfers of an endpoint: each is pending in the kernel, holds unread bytes, or is idle.
#[derive(Debug)]
struct ReadQueue {
    rx: Endpoint<Bulk, In>,
    /// Completed transfers with unread bytes, oldest first.
    filled: VecDeque<Buffer>,
    /// Bytes of the first one that are already read.
    n_read: usize,
    idle: Vec<Buffer>,
    /// Number of transfers.
    transfers: usize,
    failures: u32,
    /// The first failure that is not recovered from yet.
    pub(super) error: Option<TransferError>,
}

impl ReadQueue {
    /// Queues as many transfers as the kernel has memory for; `None` if these are too few for a queue.
    pub(super) fn start(rx: Endpoint<Bulk, In>) -> Option<Self> {
        // Kernel memory saves a copy. It counts against the limit from here on; when none is left, nusb
        // allocates user memory instead.
        let mut idle: Vec<Buffer> = (0..TRANSFERS).map(|_| rx.allocate(TRANSFER_BYTES)).collect();
        let from_kernel = idle.iter().filter(|buffer| buffer.is_zero_copy()).count();
        if from_kernel >= TRANSFERS_MIN {
            idle.retain(Buffer::is_zero_copy);
        }
        let transfers = idle.len();
        let filled = VecDeque::with_capacity(TRANSFERS);
        let mut queue = Self { rx, filled, n_read: 0, idle, transfers, failures: 0, error: None };
        queue.refill();
        (from_kernel > 0 || queue.has_memory()).then_some(queue)
    }

    /// Without kernel memory either the limit is exhausted, or the kernel has no such memory at all. The first
    /// transfer shows which: it fails at once when the limit is exhausted.
    fn has_memory(&mut self) -> bool {
        match self.rx.wait_next_complete(Duration::ZERO) {
            Some(done) if matches!(done.status, Err(TransferError::Unknown(_))) => false,
            Some(done) => {
                self.store(done);
                true
            }
            None => true,
        }
    }

    /// Reads available bytes, and waits up to `timeout` for the first.
    pub(super) fn take(&mut self, buf: &mut [u8], timeout: Duration) -> usize {
        let mut n = self.copy_to(buf);
        if n == 0 && self.error.is_none() && self.rx.pending() == 0 {
            // Cannot happen, but without a pending transfer every read would return immediately.
            self.submit_idle();
        }
        let mut wait = if n > 0 { Duration::ZERO } else { timeout };
        // No more rounds than transfers: a device that floods with empty packets must not keep the reader here.
        let mut rounds = self.transfers;
        while n < buf.len() && self.error.is_none() && self.rx.pending() > 0 && rounds > 0 {
            rounds -= 1;
            let Some(done) = self.rx.wait_next_complete(wait) else { break };
            wait = Duration::ZERO;
            let is_full = done.actual_len == TRANSFER_BYTES;
            self.store(done);
            n += self.copy_to(buf.get_mut(n..).unwrap_or_default());
            if is_full {
                // Return full transfers one by one: polling for another costs time, and only short ones are merged.
                break;
            }
        }
        n
    }

    /// Stores a completed transfer and its status. A failed one may hold packets that arrived before.
    fn store(&mut self, done: Completion) {
        match done.status {
            Ok(()) => self.failures = 0,
            // The first failure is the cause, the later ones its consequences.
            Err(error) => self.error = self.error.or(Some(error)),
        }
        if done.actual_len > 0 {
            self.filled.push_back(done.buffer);
        } else if done.status.is_ok() {
            // An empty packet only ends a transfer.
            self.rx.submit(done.buffer);
        } else {
            self.idle.push(done.buffer);
        }
    }

    fn copy_to(&mut self, buf: &mut [u8]) -> usize {
        let mut n = 0;
        while let Some(first) = self.filled.front() {
            let left = first.get(self.n_read..).unwrap_or_default();
            let (to, from) = (buf.get_mut(n..).unwrap_or_default(), left);
            let count = to.len().min(from.len());
            to[..count].copy_from_slice(&from[..count]);
            n += count;
            self.n_read += count;
            if count < left.len() {
                break;
            }
            self.n_read = 0;
            if let Some(read) = self.filled.pop_front() {
                self.idle.push(read);
            }
        }
        // Not to a failed endpoint: idle transfers wait for its recovery.
        if n > 0 && self.error.is_none() {
            self.submit_idle();
        }
        n
    }

    fn submit_idle(&mut self) {
        while let Some(mut buffer) = self.idle.pop() {
            buffer.clear();
            buffer.set_requested_len(TRANSFER_BYTES);
            self.rx.submit(buffer);
        }
    }

    /// Counts a failure, and returns whether another attempt is worthwhile.
    fn may_retry(&mut self) -> bool {
        self.failures += 1;
        self.failures <= FAILURES_MAX
    }

    /// Cancels all transfers and clears the endpoint's halt; `false` when that fails.
    fn clear_halt(&mut self) -> bool {
        self.cancel() && self.rx.clear_halt().wait().is_ok()
    }

    /// Queues all transfers again; `false` when the kernel kept one.
    fn refill(&mut self) -> bool {
        let all_back = self.cancel();
        // Later failures have the same cause, or come from cancelling.
        self.error = None;
        self.submit_idle();
        all_back
    }

    fn cancel(&mut self) -> bool {
        let give_up_at = Instant::now() + CANCEL_TIMEOUT;
        self.rx.cancel_all();
        while self.rx.pending() > 0 {
            let left = give_up_at.saturating_duration_since(Instant::now());
            let Some(done) = self.rx.wait_next_complete(left) else { return false };
            if done.actual_len > 0 {
                self.filled.push_back(done.buffer);
            } else {
                self.idle.push(done.buffer);
            }
        }
        true
    }
}

/// Waits for all transfers, so that the interface is free for the next program.
impl Drop for ReadQueue {
    fn drop(&mut self) {
        self.cancel();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_the_kernels_parameter() {
        assert_eq!(parse_limit("16\n"), Some(16));
        assert_eq!(parse_limit("0\n"), None, "no limit");
        assert_eq!(parse_limit("many"), None);
    }

    #[test]
    fn the_message_names_the_command_that_raises_the_limit() {
        let message = out_of_memory("usb:1209:0001:A", Some(16)).to_string();
        assert!(message.contains("usb:1209:0001:A") && message.contains("16 MiB"), "{message}");
        assert!(message.contains(&format!("`echo 64 | sudo tee {PARAMETER}`")), "{message}");
        assert!(out_of_memory("x", Some(u64::MAX)).to_string().contains("echo 1844"));
    }
}
