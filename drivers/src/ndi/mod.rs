//! NDI Polaris and Vega systems over their Combined API on a serial line: `docs/ndi.md`.
//!
//! The device answers, and never speaks unasked. [`NdiHost`] therefore leaves requests on a
//! [desk](crate::transport::turns); who reads the line carries them out.

mod assignment;
mod bring_up;
mod exchange;
mod frame;
mod host;
mod message;
mod run;
mod strays;
mod tracking;

pub use host::{BAUD_MAX_DEFAULT, NdiHost};
pub use message::{
    BAUD_AT_RESET, BAUDS, ReceivedRequest, RequestLine, code, crc16, put_binary, put_text,
};

use crate::{
    family::{Claim, Family},
    transport::turns::desk,
    uri::Location,
};

pub(crate) const FAMILY: Family = Family {
    name: "ndi",
    claims: |candidate| {
        let is_ndi = |name: &str| name.contains("northern digital") || name.starts_with("ndi ");
        match (candidate.is_serial(), candidate.name_matches(is_ndi)) {
            (true, true) => Claim::Certain,
            (true, false) => Claim::Possible,
            (false, _) => Claim::No,
        }
    },
    protocol: |location| {
        let asked_for = match location {
            Location::Serial { baud, .. } => *baud,
            Location::Usb { .. } => None,
        };
        // A desk for the time before there is a line: nobody takes its orders.
        let (desk, _) = desk();
        Box::new(NdiHost::new(desk, asked_for.unwrap_or(BAUD_MAX_DEFAULT)))
    },
};
