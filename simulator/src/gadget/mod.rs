//! A USB device on a machine that can be one: a Raspberry Pi Zero beside the rig, or `dummy_hcd`.
//!
//! Linux gives a program its own device through configfs and `FunctionFS`, which the usb-gadget crate drives.
//! [`Bulk`] is the device of `docs/link-protocol.md` section 6: one vendor interface with a bulk pair. [`Serial`] is a
//! CDC-ACM port.

mod bulk;
mod controller;
mod error;
mod serial;

use usb_gadget::{Class, Config, Gadget, Id, RegGadget, Strings, function::Handle};

pub use bulk::{Bulk, INTERFACE_PROTOCOL, INTERFACE_SUBCLASS};
use controller::Controller;
pub use error::GadgetError;
pub use serial::Serial;

/// The vendor of pid.codes, whose products 0001 to 0010 anybody may use for tests.
pub const VENDOR_ID: u16 = 0x1209;

/// The product that is a bulk pair.
pub const BULK_PRODUCT_ID: u16 = 0x0001;

/// The product that is a serial port.
pub const SERIAL_PRODUCT_ID: u16 = 0x0002;

/// What the strings say; udev makes names of both.
const MANUFACTURER: &str = "mocapd";
const PRODUCT: &str = "mocapd-sim";

/// Which device to be, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GadgetSettings {
    /// The serial number in its descriptors: 1 to 32 letters, digits, `-`, `_` and `.`.
    pub serial: String,
    /// The controller's name in `/sys/class/udc`; `None` for the first that is free.
    pub controller: Option<String>,
}

/// A gadget in configfs, bound to its controller. Dropping it unplugs it and takes it away.
#[derive(Debug)]
struct Plugged {
    // The one is taken away before the other is free.
    _gadget: RegGadget,
    _controller: Controller,
}

impl Plugged {
    fn new(
        settings: &GadgetSettings,
        product_id: u16,
        function: Handle,
    ) -> Result<Self, GadgetError> {
        let serial = &settings.serial;
        let is_name = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
        if !(1..=32).contains(&serial.len()) || !serial.bytes().all(is_name) {
            return Err(GadgetError::SerialNumber { found: serial.clone() });
        }
        let controller = Controller::choose(settings.controller.as_deref())?;
        let id = Id::new(VENDOR_ID, product_id);
        let strings = Strings::new(MANUFACTURER, PRODUCT, serial);
        let mut gadget = Gadget::new(Class::INTERFACE_SPECIFIC, id, strings)
            .with_config(Config::new("mocapd link").with_function(function));
        gadget.name = Some(controller::gadget_name());
        let made = gadget.register().map_err(GadgetError::making)?;
        made.bind(Some(controller.udc()))
            .map_err(|source| GadgetError::Bind { controller: controller.name(), source })?;
        Ok(Self { _gadget: made, _controller: controller })
    }
}
