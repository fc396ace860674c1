//! NDI Polaris and Vega optical trackers over their Combined API on a serial line: `docs/ndi.md`.
//!
//! The device only replies to requests. [`NdiHost`] therefore sends
//! [line commands](crate::transport::polled), which the transport executes before the next read.

mod assignment;
mod bring_up;
mod exchange;
mod frame;
mod host;
mod message;
mod run;
mod strays;
mod tracking;

use crate::{
    device::{Claim, Family},
    transport::polled::line_command_channel,
    uri::Location,
};
pub use host::{BAUD_MAX_DEFAULT, NdiHost};
pub use message::{
    BAUD_AT_RESET, BAUDS, ReceivedRequest, RequestReader, code, crc16, put_binary, put_text,
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
        let baud = if let Location::Serial { baud, .. } = location { *baud } else { None };
        // A sender without a receiver, until `attach` connects the protocol to a line.
        let (sender, _) = line_command_channel();
        Box::new(NdiHost::new(sender, baud.unwrap_or(BAUD_MAX_DEFAULT)))
    },
};
