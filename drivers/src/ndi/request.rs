//! Requests: a name, a colon, arguments, four digits of checksum, a carriage return.

use super::crc::crc16;
use crate::transport::turns::Request;

/// A request with its checksum; `text` holds the colon.
///
/// Every text of this driver is a constant or has two digits added to one: they fit.
pub(super) fn checked(text: &str) -> Request {
    let wire = format!("{text}{:04X}\r", crc16(text.as_bytes()));
    Request::new(wire.as_bytes()).unwrap_or_default()
}

/// A request in the form that has no checksum: a name, a blank, options.
pub(super) fn plain(text: &str) -> Request {
    Request::new(format!("{text}\r").as_bytes()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_answers() {
        for (text, wire) in [
            ("INIT:", &b"INIT:E3A5\r"[..]),
            ("VER:0", b"VER:065EE\r"),
            ("PHSR:00", b"PHSR:0020FF\r"),
            ("PINIT:01", b"PINIT:0131EA\r"),
            ("GETINFO:Features.Firmware.Version", b"GETINFO:Features.Firmware.Version0492\r"),
        ] {
            assert_eq!(checked(text).as_bytes(), wire);
        }
        assert_eq!(plain("BX2 --6d=tools").as_bytes(), b"BX2 --6d=tools\r");
    }
}
