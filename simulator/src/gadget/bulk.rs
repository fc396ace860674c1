//! The vendor interface with its bulk pair.

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

/// What the vendor interface says it speaks: `M`.
pub const INTERFACE_SUBCLASS: u8 = 0x4d;

/// The version of the link protocol.
pub const INTERFACE_PROTOCOL: u8 = 1;

/// Bytes of one transfer to the host: many packets, so that each costs little.
const TRANSFER_BYTES: usize = 16 << 10;

/// Transfers that wait for the host: what high speed carries in 3 ms.
const SENDS: u32 = 8;

/// Transfers that wait for commands, and the bytes of each: a command has 16.
const RECEIVES: u32 = 4;
const RECEIVE_BYTES: usize = 4096;

/// How long the kernel may take to take back transfers that were cancelled: `dummy_hcd` does so with its next frame, of a
/// millisecond; a busy emulated machine is late.
const CANCELLED_WITHIN: Duration = Duration::from_millis(500);

/// Full speed has packets of 64 bytes, the others have multiples of it.
const PACKET_BYTES: usize = 64;

/// The device's end of the pair.
#[derive(Debug)]
pub struct Bulk {
    // Before the files that it uses.
    _plugged: RegGadget,
    custom: Custom,
    to_host: EndpointSender,
    from_host: EndpointReceiver,
    /// Between the host's choice of the configuration and the pulled plug.
    enabled: bool,
    /// What the host said and nobody read yet.
    heard: BytesMut,
    serial: String,
}

impl Bulk {
    /// Plugs it in.
    ///
    /// # Errors
    /// When this machine cannot be a USB device, or not now.
    pub fn plug_in(settings: &GadgetSettings) -> Result<Self, GadgetError> {
        let (from_host, from_direction) = EndpointDirection::host_to_device();
        let (to_host, to_direction) = EndpointDirection::device_to_host();
        let class = Class::vendor_specific(INTERFACE_SUBCLASS, INTERFACE_PROTOCOL);
        let interface = Interface::new(class, "mocapd link")
            .with_endpoint(Endpoint::bulk(to_direction.with_queue_len(SENDS)))
            .with_endpoint(Endpoint::bulk(from_direction.with_queue_len(RECEIVES)));
        let (custom, handle) = Custom::builder().with_interface(interface).build();
        let plugged = plug_in(settings, BULK_PRODUCT_ID, handle)?;
        Ok(Self {
            _plugged: plugged,
            custom,
            to_host,
            from_host,
            enabled: false,
            heard: BytesMut::new(),
            serial: settings.serial.clone(),
        })
    }

    /// What a host calls it.
    #[must_use]
    pub fn uri(&self) -> String {
        format!("usb:{:04x}:{BULK_PRODUCT_ID:04x}:{}", super::VENDOR_ID, self.serial)
    }

    /// Stalls, as a device does that cannot go on, until the host clears it. What it was sending is lost.
    ///
    /// # Errors
    /// When the host is not there, or the controller cannot stall.
    pub fn stall(&mut self) -> io::Result<()> {
        self.to_host.cancel()?;
        let asked = Instant::now();
        loop {
            match self.to_host.control()?.halt() {
                // How FunctionFS says that it did.
                Err(error) if error.raw_os_error() == Some(Errno::BADMSG.raw_os_error()) => {
                    return Ok(());
                }
                // A transfer that was cancelled is still being taken back.
                Err(error)
                    if error.kind() == io::ErrorKind::WouldBlock
                        && asked.elapsed() < CANCELLED_WITHIN =>
                {
                    std::thread::sleep(Duration::from_millis(1));
                }
                outcome => return outcome,
            }
        }
    }

    /// Sees the host come and go. Its requests to the control endpoint are not for us: they stall.
    fn follow(&mut self) -> io::Result<()> {
        while let Some(event) = self.custom.try_event()? {
            match event {
                Event::Enable => self.enabled = true,
                Event::Disable | Event::Unbind => self.enabled = false,
                _ => continue,
            }
            // Transfers of before are not for this host.
            self.to_host.cancel()?;
            self.from_host.cancel()?;
        }
        Ok(())
    }

    /// Waits for commands in a transfer that is there already.
    fn listen(&mut self) {
        while self.enabled && self.from_host.is_ready() {
            if self.from_host.try_recv(BytesMut::with_capacity(RECEIVE_BYTES)).is_err() {
                // The plug was pulled just now: its event follows.
                return;
            }
        }
    }
}

/// How much of `pending` goes into the next transfer.
///
/// A transfer that fills its last packet does not end for the host, which waits for more: the end of what
/// there is must be a packet that is not full.
fn transfer_bytes(pending: usize) -> usize {
    let bytes = pending.min(TRANSFER_BYTES);
    if bytes == pending && bytes > 1 && bytes.is_multiple_of(PACKET_BYTES) {
        bytes - 1
    } else {
        bytes
    }
}

impl Line for Bulk {
    fn name(&self) -> &'static str {
        "USB gadget"
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.follow()?;
        // Transfers that failed did so because the plug was pulled: their errors are of no use.
        while self.enabled && self.to_host.try_ready().is_err() {}
        if !self.enabled || !self.to_host.is_ready() {
            return Ok(0);
        }
        let part = bytes.get(..transfer_bytes(bytes.len())).unwrap_or_default();
        Ok(self.to_host.try_send(Bytes::copy_from_slice(part)).map_or(0, |()| part.len()))
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.heard.is_empty() {
            // An error is the pulled plug's.
            if let Ok(Some(bytes)) = self.from_host.try_fetch() {
                self.heard = bytes;
            }
            self.listen();
        }
        let count = self.heard.len().min(buffer.len());
        let now = self.heard.split_to(count);
        if let Some(to) = buffer.get_mut(..count) {
            to.copy_from_slice(&now);
        }
        Ok(count)
    }

    fn wait(&mut self, at_most: Duration) -> io::Result<bool> {
        self.follow()?;
        if !self.enabled {
            // Nothing can come before the host is there.
            std::thread::sleep(at_most);
            self.follow()?;
        }
        self.listen();
        if self.heard.is_empty()
            && let Ok(Some(bytes)) = self.from_host.fetch_timeout(at_most)
        {
            self.heard = bytes;
        }
        Ok(!self.heard.is_empty())
    }

    fn wait_for_room(&mut self, at_most: Duration) -> io::Result<bool> {
        if !self.enabled {
            return self.wait(at_most);
        }
        // An error is the pulled plug's, or the time is over.
        let room = self.to_host.ready_timeout(at_most);
        drop(room);
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
    fn everything_pending_ends_with_a_packet_that_is_not_full() {
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
