//! Choice of the bulk endpoint pair that carries the stream, from descriptors that may be wrong.

use nusb::descriptors::{ConfigurationDescriptor, TransferType};
use nusb::transfer::Direction;

/// Interface class for vendor-specific protocols.
const VENDOR_CLASS: u8 = 0xff;

/// Valid packet sizes of bulk endpoints: USB 2.0 section 5.8.3 (full speed 8 to 64, high speed
/// 512), USB 3.2 section 8.12.1 (1024).
const PACKET_BYTES: [usize; 6] = [8, 16, 32, 64, 512, 1024];

/// An endpoint as its descriptor defines it.
#[derive(Debug, Clone, Copy)]
struct EndpointInfo {
    interface: u8,
    class: u8,
    address: u8,
    is_in: bool,
    is_bulk: bool,
    packet_bytes: usize,
}

/// Two bulk endpoints of one interface, one per direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BulkPair {
    pub(super) interface: u8,
    pub(super) device_to_host: u8,
    pub(super) host_to_device: u8,
}

/// Finds the first vendor interface with a bulk pair.
///
/// # Errors
/// A message with what was found instead.
pub(super) fn bulk_pair(configuration: &ConfigurationDescriptor<'_>) -> Result<BulkPair, String> {
    let interfaces = configuration.interface_alt_settings();
    let mut endpoints = Vec::new();
    for interface in interfaces.filter(|interface| interface.alternate_setting() == 0) {
        endpoints.extend(interface.endpoints().map(|endpoint| EndpointInfo {
            interface: interface.interface_number(),
            class: interface.class(),
            address: endpoint.address(),
            is_in: endpoint.direction() == Direction::In,
            is_bulk: endpoint.transfer_type() == TransferType::Bulk,
            packet_bytes: endpoint.max_packet_size(),
        }));
    }
    choose_pair(&endpoints)
}

fn choose_pair(endpoints: &[EndpointInfo]) -> Result<BulkPair, String> {
    let bulk = |first: &EndpointInfo, is_in: bool| {
        let of_pair = |other: &&EndpointInfo| {
            (other.interface, other.is_bulk, other.is_in) == (first.interface, true, is_in)
        };
        endpoints.iter().find(of_pair).copied()
    };
    let mut pairs = endpoints
        .iter()
        .filter(|endpoint| endpoint.class == VENDOR_CLASS)
        .filter_map(|endpoint| Some((bulk(endpoint, true)?, bulk(endpoint, false)?)));
    let Some((device_to_host, host_to_device)) = pairs.next() else {
        return Err(format!(
            "expected an interface of class ff with a bulk endpoint in each direction, found {}",
            describe(endpoints)
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
    Ok(BulkPair {
        interface: device_to_host.interface,
        device_to_host: device_to_host.address,
        host_to_device: host_to_device.address,
    })
}

/// Describes the first few endpoints: a device may declare hundreds.
fn describe(endpoints: &[EndpointInfo]) -> String {
    const SHOWN: usize = 6;
    let one = |endpoint: &EndpointInfo| {
        let kind = if endpoint.is_bulk { "bulk" } else { "other" };
        format!("{kind} {:02x} in class {:02x}", endpoint.address, endpoint.class)
    };
    let shown: Vec<String> = endpoints.iter().take(SHOWN).map(one).collect();
    match endpoints.len() {
        0 => "no endpoint".to_owned(),
        n if n > SHOWN => format!("{} and {} more", shown.join(", "), n - SHOWN),
        _ => shown.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IN: EndpointInfo = EndpointInfo {
        interface: 1,
        class: VENDOR_CLASS,
        address: 0x81,
        is_in: true,
        is_bulk: true,
        packet_bytes: 512,
    };
    const OUT: EndpointInfo = EndpointInfo { address: 0x02, is_in: false, ..IN };

    #[test]
    fn finds_the_pair_among_other_interfaces() {
        let keyboard = EndpointInfo { interface: 0, class: 3, address: 0x83, is_bulk: false, ..IN };
        let storage = [
            EndpointInfo { class: 8, interface: 0, ..IN },
            EndpointInfo { class: 8, interface: 0, ..OUT },
        ];
        let pair = BulkPair { interface: 1, device_to_host: 0x81, host_to_device: 0x02 };
        assert_eq!(choose_pair(&[keyboard, OUT, IN]), Ok(pair));
        assert_eq!(choose_pair(&[storage[0], storage[1], IN, OUT]), Ok(pair));
    }

    #[test]
    fn a_pair_has_two_bulk_endpoints_of_one_interface() {
        for endpoints in [
            vec![],
            vec![IN],
            vec![OUT],
            vec![IN, EndpointInfo { interface: 2, ..OUT }],
            vec![IN, EndpointInfo { is_bulk: false, ..OUT }],
            vec![EndpointInfo { class: 8, ..IN }, EndpointInfo { class: 8, ..OUT }],
            vec![EndpointInfo { class: 3, is_bulk: false, ..IN }; 500],
        ] {
            let error = choose_pair(&endpoints).unwrap_err();
            assert!(error.contains("class ff") && error.len() < 300, "{error}");
        }
    }

    #[test]
    fn invalid_packet_sizes_are_refused() {
        for packet_bytes in [0, 1, 24, 513, 2047] {
            let error = choose_pair(&[IN, EndpointInfo { packet_bytes, ..OUT }]).unwrap_err();
            let words: Vec<&str> = error.split([' ', ',']).collect();
            assert!(words.contains(&packet_bytes.to_string().as_str()), "{error}");
            assert!(error.contains("endpoint 02"), "{error}");
        }
    }
}
