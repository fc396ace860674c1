//! NDI Polaris and Vega systems over their Combined API on a serial line: `docs/ndi.md`.
//!
//! The device answers, and never speaks unasked. [`NdiHost`] therefore leaves requests on a
//! [desk](crate::transport::turns); who reads the line carries them out.

mod assign;
mod bauds;
mod bring_up;
mod bx;
mod carries;
mod crc;
mod cursor;
mod errors;
mod exchange;
mod gbf;
mod host;
mod identity;
mod pace;
mod reply;
mod request;
mod run;
mod seen;
mod strays;
mod tools;
mod tracking;

pub use bauds::{BAUD_AT_RESET, BAUDS};
pub use crc::crc16;
pub use host::{BAUD_MAX_DEFAULT, NdiHost};

use crate::{
    device::Protocol,
    registry::{Candidate, Claim, Family},
    transport::turns::desk,
    uri::Location,
};

/// The family.
#[derive(Debug)]
pub(crate) struct Ndi;

impl Family for Ndi {
    fn name(&self) -> &'static str {
        "ndi"
    }

    fn description(&self) -> &'static str {
        "NDI Polaris and Vega systems, over the Combined API on a serial line"
    }

    fn claims(&self, candidate: &Candidate) -> Claim {
        let says_so =
            [&candidate.product, &candidate.manufacturer].into_iter().flatten().any(|text| {
                let text = text.to_ascii_lowercase();
                text.contains("northern digital") || text.starts_with("ndi ")
            });
        match candidate.location {
            Location::Serial { .. } if says_so => Claim::Certain,
            Location::Serial { .. } => Claim::Possible,
            Location::Usb { .. } => Claim::No,
        }
    }

    fn protocol(&self, location: &Location) -> Box<dyn Protocol> {
        let asked_for = match location {
            Location::Serial { baud, .. } => *baud,
            Location::Usb { .. } => None,
        };
        // A desk for the time before there is a line: nobody takes its orders.
        let (desk, _) = desk();
        Box::new(NdiHost::new(desk, asked_for.unwrap_or(BAUD_MAX_DEFAULT)))
    }
}
