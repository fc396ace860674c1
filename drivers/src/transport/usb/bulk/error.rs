//! A transfer's failure as the transport's error.

use nusb::transfer::TransferError;

use super::{super::memory, Opened};
use crate::transport::TransportError;

/// `ENOMEM`: the kernel's limit for transfers is used up.
const ENOMEM: u32 = 12;

impl Opened {
    pub(super) fn failure(&self, action: &'static str, error: TransferError) -> TransportError {
        match error {
            TransferError::Unknown(ENOMEM) => {
                TransportError::Unsupported(memory::words(&self.name, memory::limit_mib()))
            }
            TransferError::Disconnected => self.is_gone(),
            _ => TransportError::Io { device: self.name.clone(), action, source: error.into() },
        }
    }

    pub(super) fn stalled(&self) -> TransportError {
        TransportError::Unsupported(format!(
            "{} stalls again each time it is cleared: unplug it, plug it in again, and check its firmware",
            self.name
        ))
    }
}
