//! Known answers of the checksum, and the fixed replies.

use mocapd_drivers::ndi::crc16;

use super::script::{crc, text};

#[test]
fn checksums_match_the_guide() {
    for (text, known) in [
        ("INIT:", 0xE3A5),
        ("OKAY", 0xA896),
        ("RESET", 0xBE6F),
        ("VER:0", 0x65EE),
        ("GETINFO:Features.Firmware.Version", 0x0492),
        ("PHSR:00", 0x20FF),
    ] {
        assert_eq!((crc16(text.as_bytes()), crc(text.as_bytes())), (known, known), "{text}");
    }
    assert_eq!(text("OKAY"), b"OKAYA896\r");
    assert_eq!(text("RESET"), b"RESETBE6F\r");
}

#[test]
fn checksums_match_the_documentation() {
    let page = include_str!("../../../docs/ndi.md");
    let section =
        page.split("### Known answers").nth(1).and_then(|rest| rest.split("\n## ").next());
    let mut n_checked = 0;
    for row in section.unwrap().lines().filter(|line| line.starts_with('|')) {
        for wire in row.split('`').skip(1).step_by(2) {
            let (request, digits) = wire.split_at(wire.len() - 4);
            assert_eq!(format!("{:04X}", crc16(request.as_bytes())), digits, "{wire}");
            n_checked += 1;
        }
    }
    assert_eq!(n_checked, 10);
}
