//! What a family of devices is, and what can be seen of a device from outside.

use crate::{device::Protocol, uri::Location};

/// Devices that speak one protocol.
#[derive(Debug)]
pub struct Family {
    /// What `?driver=` calls it.
    pub name: &'static str,
    /// Whether a device is one of these, by what can be seen without opening it.
    pub claims: fn(&Candidate) -> Claim,
    /// The protocol of a device at a place, on which nothing was said yet.
    pub protocol: fn(&Location) -> Box<dyn Protocol>,
}

/// How sure a family is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Claim {
    /// It is none of ours.
    No,
    /// It may be: nothing speaks against it.
    Possible,
    /// It says so itself.
    Certain,
}

/// A device, as it looks from outside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Where it is.
    pub location: Location,
    /// USB vendor and product, where it has them.
    pub usb_ids: Option<(u16, u16)>,
    /// Its serial number.
    pub serial: Option<String>,
    /// Who made it.
    pub manufacturer: Option<String>,
    /// What it calls itself.
    pub product: Option<String>,
}

impl Candidate {
    /// A device of which nothing is known but the place.
    #[must_use]
    pub fn at(location: Location) -> Self {
        Self { location, usb_ids: None, serial: None, manufacturer: None, product: None }
    }

    /// Whether the product or its maker is called so; `is_name` gets small letters.
    pub(crate) fn is_called(&self, is_name: impl Fn(&str) -> bool) -> bool {
        let texts = [&self.product, &self.manufacturer].into_iter().flatten();
        texts.map(|text| text.to_ascii_lowercase()).any(|text| is_name(&text))
    }

    pub(crate) fn is_serial(&self) -> bool {
        matches!(self.location, Location::Serial { .. })
    }
}
