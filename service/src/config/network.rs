//! An address, or all addresses of a network: `192.168.10.0/24`.

use std::{fmt, net::IpAddr, str::FromStr};

use super::value::short;

/// A network; a single address is one of all its bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Network {
    address: IpAddr,
    prefix_bits: u8,
}

impl Network {
    /// Whether an address is in it. An IPv4 address that came over IPv6 is the IPv4 address.
    #[must_use]
    pub fn contains(&self, address: IpAddr) -> bool {
        match (self.address, address.to_canonical()) {
            (IpAddr::V4(own), IpAddr::V4(other)) => {
                let behind = u32::MAX.checked_shr(self.prefix_bits.into()).unwrap_or(0);
                (own.to_bits() ^ other.to_bits()) & !behind == 0
            }
            (IpAddr::V6(own), IpAddr::V6(other)) => {
                let behind = u128::MAX.checked_shr(self.prefix_bits.into()).unwrap_or(0);
                (own.to_bits() ^ other.to_bits()) & !behind == 0
            }
            _ => false,
        }
    }

    fn bits(address: IpAddr) -> u8 {
        if address.is_ipv4() { 32 } else { 128 }
    }

    /// Its first address: the one without bits behind the prefix.
    fn first(self) -> IpAddr {
        match self.address {
            IpAddr::V4(own) => {
                let behind = u32::MAX.checked_shr(self.prefix_bits.into()).unwrap_or(0);
                IpAddr::V4((own.to_bits() & !behind).into())
            }
            IpAddr::V6(own) => {
                let behind = u128::MAX.checked_shr(self.prefix_bits.into()).unwrap_or(0);
                IpAddr::V6((own.to_bits() & !behind).into())
            }
        }
    }
}

impl FromStr for Network {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (address, prefix) = match text.split_once('/') {
            Some((address, prefix)) => (address, Some(prefix)),
            None => (text, None),
        };
        let no_address = |_| "it is no address and no network".to_owned();
        let address: IpAddr = address.parse().map_err(no_address)?;
        if address != address.to_canonical() {
            return Err(format!("write it as the IPv4 address {}", address.to_canonical()));
        }
        let bits = Self::bits(address);
        let prefix_bits = match prefix {
            None => bits,
            Some(text) => text
                .parse()
                .ok()
                .filter(|prefix| *prefix <= bits && text.bytes().all(|b| b.is_ascii_digit()))
                .ok_or_else(|| {
                    format!("its prefix '{}' is no number from 0 to {bits}", short(text))
                })?,
        };
        let network = Self { address, prefix_bits };
        if network.first() != address {
            return Err(format!(
                "it has bits behind its prefix: write {}/{prefix_bits}, or {address} for this one alone",
                network.first()
            ));
        }
        Ok(network)
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.prefix_bits == Self::bits(self.address) {
            return write!(f, "{}", self.address);
        }
        write!(f, "{}/{}", self.address, self.prefix_bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knows_its_own_and_no_others() {
        for (network, inside, outside) in [
            ("192.168.10.0/24", "192.168.10.255", "192.168.11.0"),
            ("192.168.10.7", "192.168.10.7", "192.168.10.6"),
            ("10.0.0.0/8", "::ffff:10.1.2.3", "11.0.0.0"),
            ("0.0.0.0/0", "8.8.8.8", "::1"),
            ("fe80::/10", "febf::1", "fec0::1"),
            ("::1", "::1", "::2"),
            ("::/0", "fe80::1", "127.0.0.1"),
        ] {
            let parsed: Network = network.parse().unwrap();
            assert!(parsed.contains(inside.parse().unwrap()), "{network}");
            assert!(!parsed.contains(outside.parse().unwrap()), "{network}");
            assert_eq!(parsed.to_string(), network);
        }
    }

    #[test]
    fn what_is_none_says_why() {
        for (text, why) in [
            ("lab", "no address"),
            ("", "no address"),
            ("192.168.1.7/24", "write 192.168.1.0/24, or 192.168.1.7 for"),
            ("10.0.0.0/33", "0 to 32"),
            ("10.0.0.0/", "0 to 32"),
            ("10.0.0.0/+8", "0 to 32"),
            ("::/129", "0 to 128"),
            ("::ffff:10.0.0.1", "write it as the IPv4 address 10.0.0.1"),
        ] {
            let said = text.parse::<Network>().unwrap_err();
            assert!(said.contains(why), "{text}: {said}");
        }
    }
}
