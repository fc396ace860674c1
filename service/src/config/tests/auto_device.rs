//! `device.uri = "auto"`.

use mocapd_drivers::{registry::Candidate, transport::Access};

use super::*;

fn listed(uri: &str, usb_ids: Option<(u16, u16)>, claim: Claim) -> AttachedDevice {
    let uri: DeviceUri = uri.parse().unwrap();
    AttachedDevice {
        candidate: Candidate { usb_ids, ..Candidate::at(uri.location) },
        family: (claim != Claim::No).then_some(("dvmc", claim)),
        access: Access::Accessible,
    }
}

#[test]
fn auto_selects_the_only_most_certain_device() {
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
    let auto = |attached: &[AttachedDevice]| {
        auto_device(&DeviceChoice::Auto, attached).map(|uri| uri.to_string())
    };
    assert_eq!(auto(&[bare(), mouse(), rig(1), adapter(0)]).unwrap(), "usb:1209:0001:1");
    assert_eq!(auto(&[bare(), adapter(0)]).unwrap(), "serial:/dev/ttyUSB0");
    for none in [&[][..], &[bare()], &[mouse()]] {
        assert!(auto(none).unwrap_err().contains("`mocapd devices`"));
    }
    let two = auto(&[rig(1), rig(2), adapter(0)]).unwrap_err();
    assert!(two.contains("2 devices") && two.contains("uri = \"usb:1209:0001:1\""), "{two}");
    assert!(two.contains("usb:1209:0001:2") && !two.contains("ttyUSB0"), "{two}");
    assert!(auto(&[adapter(0), adapter(1)]).unwrap_err().contains("/dev/ttyUSB1"));
}

#[test]
fn a_named_device_is_used_unchanged() {
    let uri: DeviceUri = "serial:/tmp/rig?driver=ndi".parse().unwrap();
    assert_eq!(auto_device(&DeviceChoice::At(uri.clone()), &[]), Ok(uri));
}
