//! The vendor interface with its pair of bulk endpoints.

use std::io;
use std::time::{Duration, Instant};

use bytes::{Bytes, BytesMut};
use rustix::io::Errno;
use usb_gadget::function::custom::{
    Custom, Endpoint, EndpointDirection, EndpointReceiver, EndpointSender, Event, Interface,
};
use usb_gadget::{Class, RegGadget};

use super::{BULK_PRODUCT_ID, GadgetError, GadgetSettings, plug_in};
use crate::line::Line;

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
        format!("usb:{:04x}:{BULK_PRODUCT_ID:04x}:{}", super::VENDOR_ID, self.serial)
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
                    if error.kind() == io::ErrorKind::WouldBlock
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
