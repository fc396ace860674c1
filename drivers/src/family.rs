//! Device families, and the properties by which a family recognises a device before opening it.

use crate::{device::Protocol, uri::Location};

/// Devices that speak one protocol.
#[derive(Debug)]
pub struct Family {
    /// The family's name in `?driver=NAME`: lower-case ASCII letters and digits.
    pub name: &'static str,
    /// Rates a device by what is visible without opening it: location, USB ids and strings.
    pub claims: fn(&Candidate) -> Claim,
    /// Creates the protocol for a newly opened device at a location.
    pub protocol: fn(&Location) -> Box<dyn Protocol>,
}

/// How confident a family is that a device is one of its own. Ordered: a higher claim wins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Claim {
    /// Not a device of this family.
    No,
    /// Could be one; nothing rules it out (a bare serial port).
    Possible,
    /// The device's USB strings identify it.
    Certain,
}

/// A device as the operating system describes it, without opening it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// The serial port or USB address.
    pub location: Location,
    /// USB vendor and product ids; `None` for a serial port that is not on USB.
    pub usb_ids: Option<(u16, u16)>,
    /// Serial number from the USB descriptor.
    pub serial: Option<String>,
    /// Manufacturer string from the USB descriptor.
    pub manufacturer: Option<String>,
    /// Product string from the USB descriptor.
    pub product: Option<String>,
}

impl Candidate {
    /// A device known by its location only.
    #[must_use]
    pub fn at(location: Location) -> Self {
        Self { location, usb_ids: None, serial: None, manufacturer: None, product: None }
    }

    /// Whether `is_name` accepts the product or the manufacturer string, in lower case.
    pub(crate) fn name_matches(&self, is_name: impl Fn(&str) -> bool) -> bool {
        let strings = [&self.product, &self.manufacturer].into_iter().flatten();
        strings.map(|text| text.to_ascii_lowercase()).any(|text| is_name(&text))
    }

    pub(crate) fn is_serial(&self) -> bool {
        matches!(self.location, Location::Serial { .. })
    }
}
