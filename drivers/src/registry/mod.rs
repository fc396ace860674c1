//! The device families, what is attached, and how to open it.

mod listing;
mod open;

use std::fmt::Debug;

pub use listing::{Listed, devices};
pub use open::{OpenError, OpenedDevice, find_again, open, open_again, open_through};

use crate::{device::Protocol, dvmc::Dvmc, ndi::Ndi, uri::Location};

/// Every family. A new one is a folder and a line here.
pub static FAMILIES: &[&dyn Family] = &[&Dvmc, &Ndi];

/// Devices that speak one protocol.
pub trait Family: Sync + Debug {
    /// What `?driver=` calls it.
    fn name(&self) -> &'static str;

    /// One line for people.
    fn description(&self) -> &'static str;

    /// Whether a device is one of these, by what can be seen without opening it.
    fn claims(&self, candidate: &Candidate) -> Claim;

    /// The protocol of a device at `location`, on which nothing was said yet.
    fn protocol(&self, location: &Location) -> Box<dyn Protocol>;
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
}

/// The family that is surest; of two that are equally sure, the first.
#[must_use]
pub fn family_of(candidate: &Candidate) -> Option<(&'static dyn Family, Claim)> {
    let mut surest: Option<(&'static dyn Family, Claim)> = None;
    for &family in FAMILIES {
        let claim = family.claims(candidate);
        if claim > surest.map_or(Claim::No, |(_, claim)| claim) {
            surest = Some((family, claim));
        }
    }
    surest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_fit_into_a_uri() {
        for (index, family) in FAMILIES.iter().enumerate() {
            assert!(
                family
                    .name()
                    .bytes()
                    .all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit())
            );
            assert!(FAMILIES[..index].iter().all(|other| other.name() != family.name()));
        }
    }

    #[test]
    fn a_device_that_names_itself_is_certain_and_a_bare_port_is_possible() {
        let port =
            Candidate::at("serial:/dev/ttyUSB0".parse::<crate::uri::DeviceUri>().unwrap().location);
        assert_eq!(family_of(&port).unwrap().1, Claim::Possible);
        let named = Candidate { product: Some("DVMC-8820".to_owned()), ..port.clone() };
        assert_eq!(family_of(&named).unwrap().1, Claim::Certain);
        let adapter = Candidate { product: Some("NDI Host USB Converter".to_owned()), ..named };
        let (family, claim) = family_of(&adapter).unwrap();
        assert_eq!((family.name(), claim), ("ndi", Claim::Certain));
        let mouse = Candidate {
            product: Some("Optical Mouse".to_owned()),
            ..Candidate::at(Location::Usb { vid: 0x046d, pid: 0xc077, serial: None })
        };
        assert!(family_of(&mouse).is_none());
    }
}
