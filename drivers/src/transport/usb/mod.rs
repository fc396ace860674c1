//! USB: listing devices, a bulk endpoint pair as a byte stream, and hotplug notification.

mod bulk;
mod device;
mod pair;
mod queue;
mod watch;

pub use bulk::UsbTransport;
pub(crate) use device::usb_access;
pub use device::{UsbDevice, devices};
pub use queue::{TRANSFER_BYTES, TRANSFERS};
pub use watch::UsbWatch;
