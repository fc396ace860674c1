//! `device.uri = "auto"`: the only device that is attached and that a driver claims.

use mocapd_drivers::{
    registry::{Claim, Listed},
    uri::DeviceUri,
};

use super::DeviceChoice;

/// Which device is meant, among those that `registry::devices` lists. Devices that say themselves what they are
/// come first; then adapters behind which one may be. A bare port of the machine is never meant: something else
/// may listen there, and nothing is written to a device that nobody asked for.
///
/// # Errors
/// That there is none, or more than one, and what to write.
pub fn choose(choice: &DeviceChoice, attached: &[Listed]) -> Result<DeviceUri, String> {
    if let DeviceChoice::At(uri) = choice {
        return Ok(uri.clone());
    }
    let claimed = |listed: &&Listed, claim: Claim| {
        listed.family.is_some_and(|(_, sure)| sure == claim)
            && (claim == Claim::Certain || listed.candidate.usb_ids.is_some())
    };
    let with = |claim| attached.iter().filter(move |listed| claimed(listed, claim));
    let mut found: Vec<&Listed> = with(Claim::Certain).collect();
    if found.is_empty() {
        found = with(Claim::Possible).collect();
    }
    match found[..] {
        [] => Err(
            "no device is attached that a driver claims: plug one in, or name one in device.uri; \
                   `mocapd devices` lists what is there"
                .to_owned(),
        ),
        [only] => Ok(DeviceUri { location: only.candidate.location.clone(), driver: None }),
        _ => {
            // A hub has no room for more than a line does.
            let names: Vec<String> =
                found.iter().take(8).map(|listed| listed.candidate.location.to_string()).collect();
            Err(format!(
                "{} devices are attached, and device.uri does not say which: write uri = \"{}\" under [device], \
                 or one of the others ({})",
                found.len(),
                names.first().map_or("", String::as_str),
                names.get(1..).unwrap_or_default().join(", ")
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use mocapd_drivers::{registry::Candidate, transport::Access};

    use super::*;

    fn listed(uri: &str, usb_ids: Option<(u16, u16)>, claim: Claim) -> Listed {
        let uri: DeviceUri = uri.parse().unwrap();
        Listed {
            candidate: Candidate { usb_ids, ..Candidate::at(uri.location) },
            family: (claim != Claim::No).then_some(("dvmc", claim)),
            access: Access::Accessible,
        }
    }

    #[test]
    fn the_surest_and_only_one_is_meant() {
        let bare = || listed("serial:/dev/ttyS0", None, Claim::Possible);
        let adapter = |n: u8| {
            let uri = format!("serial:/dev/ttyUSB{n}");
            listed(&uri, Some((0x0403, 0x6001)), Claim::Possible)
        };
        let rig = |n: u8| {
            let uri = format!("usb:1209:0001:{n}");
            listed(&uri, Some((0x1209, 1)), Claim::Certain)
        };
        let mouse = || listed("usb:046d:c077", Some((0x046d, 0xc077)), Claim::No);
        let auto =
            |attached: &[Listed]| choose(&DeviceChoice::Auto, attached).map(|uri| uri.to_string());
        assert_eq!(auto(&[bare(), mouse(), rig(1), adapter(0)]).unwrap(), "usb:1209:0001:1");
        assert_eq!(auto(&[bare(), adapter(0)]).unwrap(), "serial:/dev/ttyUSB0");
        for none in [&[][..], &[bare()], &[mouse()]] {
            assert!(auto(none).unwrap_err().contains("`mocapd devices`"));
        }
        let two = auto(&[rig(1), rig(2), adapter(0)]).unwrap_err();
        assert!(two.starts_with("2 devices") && two.contains("uri = \"usb:1209:0001:1\""), "{two}");
        assert!(two.contains("usb:1209:0001:2") && !two.contains("ttyUSB0"), "{two}");
        assert!(auto(&[adapter(0), adapter(1)]).unwrap_err().contains("/dev/ttyUSB1"));
    }

    #[test]
    fn a_named_device_is_taken_as_it_is() {
        let uri: DeviceUri = "serial:/tmp/rig?driver=ndi".parse().unwrap();
        assert_eq!(choose(&DeviceChoice::At(uri.clone()), &[]), Ok(uri));
    }
}
