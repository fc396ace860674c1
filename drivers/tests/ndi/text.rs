//! Known answers of the checksum, and of what is fixed.

use mocapd_drivers::ndi::crc16;

use super::script::{crc, text};

#[test]
fn the_guides_known_answers() {
    for (said, known) in [
        ("INIT:", 0xE3A5),
        ("OKAY", 0xA896),
        ("RESET", 0xBE6F),
        ("VER:0", 0x65EE),
        ("GETINFO:Features.Firmware.Version", 0x0492),
        ("PHSR:00", 0x20FF),
    ] {
        assert_eq!((crc16(said.as_bytes()), crc(said.as_bytes())), (known, known), "{said}");
    }
    assert_eq!(text("OKAY"), b"OKAYA896\r");
    assert_eq!(text("RESET"), b"RESETBE6F\r");
}
