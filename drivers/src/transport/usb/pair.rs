//! Which two endpoints carry the stream, by what the device says of itself: descriptors may lie.

use nusb::descriptors::{ConfigurationDescriptor, TransferType};
use nusb::transfer::Direction;

/// The class of interfaces that no USB standard describes.
const VENDOR_CLASS: u8 = 0xff;

/// The packets that a bulk endpoint can have: USB 2.0 section 5.8.3 (full speed 8 to 64, high speed
/// 512), USB 3.2 section 8.12.1 (1024).
const PACKET_BYTES: [usize; 6] = [8, 16, 32, 64, 512, 1024];

/// One endpoint, as a descriptor has it.
#[derive(Debug, Clone, Copy)]
struct Said {
    interface: u8,
    class: u8,
    address: u8,
    is_in: bool,
    is_bulk: bool,
    packet_bytes: usize,
}

/// A bulk endpoint in each direction of one interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Pair {
    pub(super) interface: u8,
    pub(super) device_to_host: u8,
    pub(super) host_to_device: u8,
}

/// The first vendor interface with a bulk pair.
///
/// # Errors
/// What was found instead, in words.
pub(super) fn pair(configuration: &ConfigurationDescriptor<'_>) -> Result<Pair, String> {
    let interfaces = configuration.interface_alt_settings();
    let mut said = Vec::new();
    for interface in interfaces.filter(|interface| interface.alternate_setting() == 0) {
        said.extend(interface.endpoints().map(|endpoint| Said {
            interface: interface.interface_number(),
            class: interface.class(),
            address: endpoint.address(),
            is_in: endpoint.direction() == Direction::In,
            is_bulk: endpoint.transfer_type() == TransferType::Bulk,
            packet_bytes: endpoint.max_packet_size(),
        }));
    }
    choose(&said)
}

fn choose(said: &[Said]) -> Result<Pair, String> {
    let bulk = |first: &Said, is_in: bool| {
        let of_pair = |other: &&Said| {
            (other.interface, other.is_bulk, other.is_in) == (first.interface, true, is_in)
        };
        said.iter().find(of_pair).copied()
    };
    let mut pairs = said
        .iter()
        .filter(|endpoint| endpoint.class == VENDOR_CLASS)
        .filter_map(|endpoint| Some((bulk(endpoint, true)?, bulk(endpoint, false)?)));
    let Some((device_to_host, host_to_device)) = pairs.next() else {
        return Err(format!(
            "expected an interface of class ff with a bulk endpoint in each direction, found {}",
            in_words(said)
        ));
    };
    for endpoint in [device_to_host, host_to_device] {
        if !PACKET_BYTES.contains(&endpoint.packet_bytes) {
            return Err(format!(
                "expected packets of 8, 16, 32, 64, 512 or 1024 bytes, found {} at endpoint {:02x}",
                endpoint.packet_bytes, endpoint.address
            ));
        }
    }
    Ok(Pair {
        interface: device_to_host.interface,
        device_to_host: device_to_host.address,
        host_to_device: host_to_device.address,
    })
}

/// The first few endpoints: a device may claim hundreds.
fn in_words(said: &[Said]) -> String {
    const SHOWN: usize = 6;
    let one = |endpoint: &Said| {
        let kind = if endpoint.is_bulk { "bulk" } else { "other" };
        format!("{kind} {:02x} in class {:02x}", endpoint.address, endpoint.class)
    };
    let shown: Vec<String> = said.iter().take(SHOWN).map(one).collect();
    match said.len() {
        0 => "no endpoint".to_owned(),
        n if n > SHOWN => format!("{} and {} more", shown.join(", "), n - SHOWN),
        _ => shown.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IN: Said = Said {
        interface: 1,
        class: VENDOR_CLASS,
        address: 0x81,
        is_in: true,
        is_bulk: true,
        packet_bytes: 512,
    };
    const OUT: Said = Said { address: 0x02, is_in: false, ..IN };

    #[test]
    fn finds_the_pair_among_other_interfaces() {
        let keyboard = Said { interface: 0, class: 3, address: 0x83, is_bulk: false, ..IN };
        let storage =
            [Said { class: 8, interface: 0, ..IN }, Said { class: 8, interface: 0, ..OUT }];
        let pair = Pair { interface: 1, device_to_host: 0x81, host_to_device: 0x02 };
        assert_eq!(choose(&[keyboard, OUT, IN]), Ok(pair));
        assert_eq!(choose(&[storage[0], storage[1], IN, OUT]), Ok(pair));
    }

    #[test]
    fn a_pair_is_of_one_interface_and_of_bulk_endpoints() {
        for said in [
            vec![],
            vec![IN],
            vec![OUT],
            vec![IN, Said { interface: 2, ..OUT }],
            vec![IN, Said { is_bulk: false, ..OUT }],
            vec![Said { class: 8, ..IN }, Said { class: 8, ..OUT }],
            vec![Said { class: 3, is_bulk: false, ..IN }; 500],
        ] {
            let error = choose(&said).unwrap_err();
            assert!(error.contains("class ff") && error.len() < 300, "{error}");
        }
    }

    #[test]
    fn packets_of_a_size_that_no_bulk_endpoint_has_are_refused() {
        for packet_bytes in [0, 1, 24, 513, 2047] {
            let error = choose(&[IN, Said { packet_bytes, ..OUT }]).unwrap_err();
            let words: Vec<&str> = error.split([' ', ',']).collect();
            assert!(words.contains(&packet_bytes.to_string().as_str()), "{error}");
            assert!(error.contains("endpoint 02"), "{error}");
        }
    }
}
