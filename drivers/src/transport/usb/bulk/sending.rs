//! Commands to the device.

use std::{thread, time::Duration};

use nusb::{
    Endpoint, MaybeFuture,
    transfer::{Buffer, Bulk, Out, TransferError},
};

use super::{Opened, TRANSFER_BYTES};
use crate::transport::{TransportError, WRITE_TIMEOUT};

/// Tries for one command: after a stall that was cleared, or noise.
const TRIES: u32 = 4;

/// Between two of them.
const PAUSE: Duration = Duration::from_millis(3);

/// How long a cancelled transfer may take to come back.
const CANCEL_WITHIN: Duration = Duration::from_millis(500);

pub(super) fn send(
    tx: &mut Endpoint<Bulk, Out>,
    device: &Opened,
    bytes: &[u8],
) -> Result<(), TransportError> {
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
