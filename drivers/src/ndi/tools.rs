//! Port handles, and the tools behind them.

use crate::device::MarkerInfo;

/// Handles in an answer to `PHSR`: a count, then a handle and a status each; `None` when it is none.
pub(super) fn handles(text: &str) -> Option<Vec<u8>> {
    let (count, mut rest) = hex_byte(text)?;
    let mut handles = Vec::with_capacity(usize::from(count));
    for _ in 0..count {
        let (handle, after) = hex_byte(rest)?;
        // Three digits of port status.
        rest = after.get(3..)?;
        handles.push(handle);
    }
    rest.is_empty().then_some(handles)
}

fn hex_byte(text: &str) -> Option<(u8, &str)> {
    let (digits, rest) = text.split_at_checked(2)?;
    Some((u8::from_str_radix(digits, 16).ok()?, rest))
}

/// A tool as a marker, from the answer to `PHINF:hh0005`: its part number, or its serial number
/// where it has none, or its port.
///
/// The answer: tool type (8), manufacturer (12), revision (3), serial number (8), port status (2),
/// part number (20).
pub(super) fn marker(handle: u8, info: &str, others: &[MarkerInfo]) -> MarkerInfo {
    let field = |from: usize, to: usize| {
        let field = info.get(from..to).unwrap_or_default();
        field.chars().filter(|c| !c.is_control()).collect::<String>().trim().to_owned()
    };
    let (serial, part) = (field(23, 31), field(33, 53));
    let port = format!("port {handle:02X}");
    let no_serial = serial.bytes().all(|byte| byte == b'0');
    let names = match (part.is_empty(), no_serial) {
        (false, false) => [part.clone(), format!("{part} {serial}"), format!("{part} {port}")],
        (false, true) => [part.clone(), format!("{part} {port}"), port],
        (true, false) => [serial.clone(), format!("{serial} {port}"), port],
        (true, true) => [port.clone(), port.clone(), port],
    };
    let is_new = |name: &&String| others.iter().all(|other| other.label != **name);
    let label = names.iter().find(is_new).unwrap_or(&names[2]).clone();
    MarkerInfo { id: u16::from(handle), label, labelled: true }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn handles_of_an_answer() {
        assert_eq!(handles("00"), Some(vec![]));
        assert_eq!(handles("020A00103010"), Some(vec![0x0A, 0x03]));
        for bad in ["", "0", "01", "010A", "010A0100", "xx", "ZZ0A001", "01\u{e9}A001"] {
            assert_eq!(handles(bad), None, "{bad}");
        }
    }

    #[test]
    fn tools_get_names_of_their_own() {
        let info =
            |serial: &str, part: &str| format!("02000000NDI         001{serial}31{part:<20}");
        let mut table: Vec<MarkerInfo> = Vec::new();
        for (handle, serial, part, label) in [
            (1, "00000000", "8700449", "8700449"),
            (2, "3A2B1C00", "8700449", "8700449 3A2B1C00"),
            (3, "3A2B1C00", "8700449", "8700449 port 03"),
            (4, "12345678", "", "12345678"),
            (5, "00000000", "", "port 05"),
        ] {
            let marker = marker(handle, &info(serial, part), &table);
            assert_eq!((marker.id, marker.label.as_str()), (u16::from(handle), label));
            table.push(marker);
        }
        assert_eq!(marker(0xFE, "UNOCCUPIED", &table).label, "port FE");
    }
}
