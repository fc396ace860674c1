//! The DVMC family: devices that speak the link protocol of `docs/link-protocol.md`.
//!
//! No wire specification of the DVMC-8820 is public. The protocol is ours, in the style of such a
//! rig, and the simulator speaks it.

use crate::{
    device::Protocol,
    link::HostLink,
    registry::{Candidate, Claim, Family},
    uri::Location,
};

/// The family.
#[derive(Debug)]
pub(crate) struct Dvmc;

impl Family for Dvmc {
    fn name(&self) -> &'static str {
        "dvmc"
    }

    fn description(&self) -> &'static str {
        "DVMC-style optical rigs and the mocapd simulator, over the mocapd link protocol"
    }

    fn claims(&self, candidate: &Candidate) -> Claim {
        let says_so =
            [&candidate.product, &candidate.manufacturer].into_iter().flatten().any(|text| {
                let text = text.to_ascii_lowercase();
                text.contains("dvmc") || text.contains("mocapd")
            });
        if says_so {
            Claim::Certain
        } else if matches!(candidate.location, Location::Serial { .. }) {
            // A rig behind a plain adapter cannot be told from anything else behind one.
            Claim::Possible
        } else {
            Claim::No
        }
    }

    fn protocol(&self, _: &Location) -> Box<dyn Protocol> {
        Box::new(HostLink::new())
    }
}
