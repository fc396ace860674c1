//! USB: what is attached, one bulk pair as a byte stream, and word of what is plugged in.

mod bulk;
mod find;
mod memory;
mod pair;
mod watch;
mod words;

pub use bulk::{TRANSFER_BYTES, TRANSFERS, UsbTransport};
pub use find::{UsbDevice, devices};
pub use watch::UsbWatch;
pub(crate) use words::usb_access;
