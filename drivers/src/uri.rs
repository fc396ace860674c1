//! Device URIs: `serial:PATH[@BAUD]` or `usb:VID:PID[:SERIAL]`, with an optional `?driver=NAME`.

use std::{fmt, path::PathBuf, str::FromStr};

/// The port or USB address of a device.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Location {
    /// A serial port.
    Serial {
        /// The device file, or a link to it.
        path: PathBuf,
        /// Baud rate; `None` for [`BAUD_DEFAULT`](crate::transport::serial::BAUD_DEFAULT).
        baud: Option<u32>,
    },
    /// A USB device.
    Usb {
        /// Vendor id.
        vid: u16,
        /// Product id.
        pid: u16,
        /// Serial number, needed where several devices share the ids.
        serial: Option<String>,
    },
}

/// Location of a device, and optionally the family whose protocol it speaks.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct DeviceUri {
    /// Serial port or USB address.
    pub location: Location,
    /// Name of the family; `None` selects the family that claims the device.
    pub driver: Option<String>,
}

/// Error of parsing a device URI.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "invalid device URI '{text}': {reason}: write serial:PATH[@BAUD] or usb:VID:PID[:SERIAL], with ?driver=NAME where needed"
)]
pub struct UriError {
    text: String,
    reason: String,
}

impl FromStr for DeviceUri {
    type Err = UriError;

    fn from_str(text: &str) -> Result<Self, UriError> {
        parse(text).map_err(|reason| UriError { text: text.to_owned(), reason })
    }
}

fn parse(text: &str) -> Result<DeviceUri, String> {
    let (base, query) = text.split_once('?').map_or((text, None), |(base, q)| (base, Some(q)));
    let driver = query.map(parse_query).transpose()?;
    let location = match base.split_once(':') {
        Some(("serial", rest)) => parse_serial(rest),
        Some(("usb", rest)) => parse_usb(rest),
        _ if base.starts_with('/') => Err(format!("a path needs a scheme: serial:{base}")),
        Some((scheme, _)) => Err(format!("unknown scheme '{scheme}', expected serial or usb")),
        None => Err("the scheme is missing".to_owned()),
    };
    Ok(DeviceUri { location: location?, driver })
}

fn parse_query(query: &str) -> Result<String, String> {
    match query.split_once('=') {
        Some(("driver", name)) if !name.is_empty() => Ok(name.to_owned()),
        _ => Err(format!("expected driver=NAME after '?', found '{query}'")),
    }
}

fn parse_serial(rest: &str) -> Result<Location, String> {
    // The last '@' that no '/' follows: udev's by-path links contain '@' too.
    let (path, baud) = match rest.rsplit_once('@') {
        Some((path, baud)) if !baud.contains('/') => (path, Some(parse_baud(baud)?)),
        _ => (rest, None),
    };
    if path.is_empty() {
        return Err("the path is missing".to_owned());
    }
    Ok(Location::Serial { path: path.into(), baud })
}

fn parse_baud(baud: &str) -> Result<u32, String> {
    match baud.parse() {
        Ok(0) | Err(_) => Err(format!("'{baud}' is not a baud rate")),
        Ok(baud) => Ok(baud),
    }
}

fn parse_usb(rest: &str) -> Result<Location, String> {
    let mut parts = rest.splitn(3, ':');
    let mut hex = |what| {
        let part = parts.next().unwrap_or_default();
        if part.len() == 4 && part.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return u16::from_str_radix(part, 16).map_err(|error| error.to_string());
        }
        Err(format!("expected four hexadecimal digits as the {what} id, found '{part}'"))
    };
    let (vid, pid) = (hex("vendor")?, hex("product")?);
    match parts.next() {
        Some("") => Err("the serial number after the last ':' is missing".to_owned()),
        serial => Ok(Location::Usb { vid, pid, serial: serial.map(str::to_owned) }),
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { path, baud } => {
                write!(f, "serial:{}", path.display())?;
                baud.map_or(Ok(()), |baud| write!(f, "@{baud}"))
            }
            Self::Usb { vid, pid, serial } => {
                write!(f, "usb:{vid:04x}:{pid:04x}")?;
                serial.as_ref().map_or(Ok(()), |serial| write!(f, ":{serial}"))
            }
        }
    }
}

impl fmt::Display for DeviceUri {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.location)?;
        self.driver.as_ref().map_or(Ok(()), |driver| write!(f, "?driver={driver}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn serial(path: &str, baud: Option<u32>) -> Location {
        Location::Serial { path: path.into(), baud }
    }

    #[test]
    fn every_form_round_trips() {
        let usb = |serial: Option<&str>| Location::Usb {
            vid: 0x0403,
            pid: 0x6abc,
            serial: serial.map(str::to_owned),
        };
        for (text, location, driver) in [
            ("serial:/dev/ttyUSB0", serial("/dev/ttyUSB0", None), None),
            ("serial:/dev/ttyUSB0@921600", serial("/dev/ttyUSB0", Some(921_600)), None),
            ("serial:/dev/by-path/a@b/port", serial("/dev/by-path/a@b/port", None), None),
            ("serial:rel/pty@9600?driver=dvmc", serial("rel/pty", Some(9600)), Some("dvmc")),
            ("usb:0403:6abc", usb(None), None),
            ("usb:0403:6abc:A:1?driver=dvmc", usb(Some("A:1")), Some("dvmc")),
        ] {
            let uri: DeviceUri = text.parse().unwrap();
            assert_eq!(uri.location, location, "{text}");
            assert_eq!(uri.driver.as_deref(), driver, "{text}");
            assert_eq!(uri.to_string(), text);
        }
    }

    #[test]
    fn errors_name_the_invalid_part() {
        for (text, reason) in [
            ("/dev/ttyUSB0", "serial:/dev/ttyUSB0"),
            ("tcp:host:1", "'tcp'"),
            ("serial:/dev/ttyUSB0@fast", "'fast'"),
            ("serial:/dev/ttyUSB0@0", "'0'"),
            ("serial:/dev/ttyUSB0@4294967296", "'4294967296'"),
            ("usb:403:6abc", "'403'"),
            ("usb:0403", "''"),
            ("usb:0403:+abc", "'+abc'"),
            ("usb:0403:6abc:", "':'"),
            ("serial:/dev/ttyUSB0?baud=1", "'baud=1'"),
            ("serial:/dev/ttyUSB0?driver=", "'driver='"),
        ] {
            let error = text.parse::<DeviceUri>().unwrap_err();
            assert!(error.reason.contains(reason), "{text}: {error}");
            let message = error.to_string();
            for form in ["serial:PATH[@BAUD]", "usb:VID:PID[:SERIAL]", "?driver=NAME"] {
                assert!(message.contains(form), "{message}");
            }
        }
    }

    #[test]
    fn errors_name_the_missing_part() {
        let reason = |text: &str| text.parse::<DeviceUri>().unwrap_err().reason;
        let (no_scheme, no_path) = (reason(""), reason("serial:"));
        assert_eq!(reason("ttyUSB0"), no_scheme);
        assert_eq!(reason("serial:@9600"), no_path);
        assert_ne!(no_scheme, no_path);
        let (vendor, product) = (reason("usb:403:6abc"), reason("usb:0403:403"));
        assert_ne!(vendor, product, "which of the two");
    }
}
