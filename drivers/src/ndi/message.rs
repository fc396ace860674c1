//! What goes over the line: requests, answers, their checksums, errors, and the speeds of the line.

use crate::transport::turns::Request;

/// The speed after power-on, a break, and `COMM:00000`.
pub const BAUD_AT_RESET: u32 = 9_600;

/// Speeds and their digits in `COMM`, slowest first.
pub const BAUDS: [(u32, char); 9] = [
    (9_600, '0'),
    (14_400, '1'),
    (19_200, '2'),
    (38_400, '3'),
    (57_600, '4'),
    (115_200, '5'),
    (230_400, 'A'),
    (921_600, '6'),
    (1_228_739, '7'),
];

/// Where a speed stands in [`BAUDS`]: itself, or the highest below it; the slowest below that.
pub(super) fn at_most(baud: u32) -> usize {
    BAUDS.iter().rposition(|(known, _)| *known <= baud).unwrap_or(0)
}

// CRC-16/ARC: x^16 + x^15 + x^2 + 1, reflected, from 0.

const TABLE: [u16; 256] = table();

const fn table() -> [u16; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = byte as u16;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xA001 } else { crc >> 1 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
}

/// The checksum of requests, of text answers, and of both parts of binary ones.
#[must_use]
pub fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc: u16, byte| crc >> 8 ^ TABLE[usize::from(crc as u8 ^ byte)])
}

/// Appends a text and its checksum: a request that holds a colon, or an answer.
pub fn put_text(text: &str, out: &mut Vec<u8>) {
    out.extend_from_slice(format!("{text}{:04X}\r", crc16(text.as_bytes())).as_bytes());
}

/// Appends a binary answer: a header, a block whose length fits into 16 bits, and the checksums of both.
pub fn put_binary(block: &[u8], out: &mut Vec<u8>) {
    let mut header = [BINARY[0], BINARY[1], 0, 0];
    header[2..].copy_from_slice(&(block.len() as u16).to_le_bytes());
    for part in [&header[..], block] {
        out.extend_from_slice(part);
        out.extend_from_slice(&crc16(part).to_le_bytes());
    }
}

/// A request with its checksum; `text` holds the colon.
///
/// Every text of this driver is a constant or has two digits added to one: they fit.
pub(super) fn checked(text: &str) -> Request {
    let mut wire = Vec::new();
    put_text(text, &mut wire);
    Request::new(&wire).unwrap_or_default()
}

/// A request in the form that has no checksum: a name, a blank, options.
pub(super) fn plain(text: &str) -> Request {
    Request::new(format!("{text}\r").as_bytes()).unwrap_or_default()
}

/// The longest request that a device takes: `PVWR` has 149 characters; the rest is room for options.
const REQUEST_BYTES_MAX: usize = 1024;

/// The device's end: bytes of the host until a carriage return.
#[derive(Debug, Default)]
pub struct RequestLine {
    bytes: Vec<u8>,
    too_long: bool,
}

/// A request, taken apart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedRequest {
    /// What stands before the colon or the blank.
    pub name: String,
    /// What stands behind it, without the checksum.
    pub args: String,
}

impl RequestLine {
    /// Takes one byte. Gives the request that it ends, or the [error](code) that it is.
    pub fn push(&mut self, byte: u8) -> Option<Result<ReceivedRequest, u8>> {
        if byte != b'\r' {
            self.too_long |= self.bytes.len() >= REQUEST_BYTES_MAX;
            if !self.too_long {
                self.bytes.push(byte);
            }
            return None;
        }
        let Self { bytes, too_long } = std::mem::take(self);
        match std::str::from_utf8(&bytes) {
            _ if too_long => Some(Err(code::TOO_LONG)),
            Ok("") => None,
            Ok(text) => Some(received(text)),
            Err(_) => Some(Err(code::INVALID_COMMAND)),
        }
    }
}

fn received(text: &str) -> Result<ReceivedRequest, u8> {
    let request =
        |name: &str, args: &str| Ok(ReceivedRequest { name: name.into(), args: args.into() });
    let Some((name, rest)) = text.split_once([':', ' ']) else { return request(text, "") };
    if text.as_bytes().get(name.len()) == Some(&b' ') {
        return request(name, rest);
    }
    let args = rest.len().checked_sub(4).and_then(|end| rest.split_at_checked(end));
    let (args, digits) = args.ok_or(code::BAD_CRC)?;
    let covered = text.as_bytes().get(..text.len() - 4).unwrap_or_default();
    if u16::from_str_radix(digits, 16) != Ok(crc16(covered)) {
        return Err(code::BAD_CRC);
    }
    request(name, args)
}

/// The longest answer that is waited for: what a 16-bit length can say, with header and checksum.
/// 41 markers on tools and 255 strays need 5 kB.
pub(super) const REPLY_BYTES_MAX: usize = 6 + 0xFFFF + 2;

/// First two bytes of a binary answer, as they come, and of one whose length has 32 bits.
const BINARY: [u8; 2] = [0xC4, 0xA5];
const BINARY_LONG: [u8; 2] = [0xC8, 0xA5];

/// What has come of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Look<'a> {
    /// More must come.
    NotYet,
    /// The text, without its checksum.
    Text(&'a [u8]),
    /// The block, without its header and checksum.
    Binary(&'a [u8]),
    /// It is none: a checksum is wrong, or it is too long.
    Damaged,
}

/// Looks at the bytes since the request.
pub(super) fn look(reply: &[u8]) -> Look<'_> {
    match reply.get(..2) {
        Some(start) if start == BINARY => look_binary(reply, 2),
        Some(start) if start == BINARY_LONG => look_binary(reply, 4),
        // One byte may be the first of either.
        None if matches!(reply.first(), None | Some(0xC4 | 0xC8)) => Look::NotYet,
        _ => look_text(reply),
    }
}

fn look_binary(reply: &[u8], length_bytes: usize) -> Look<'_> {
    let head_bytes = 2 + length_bytes + 2;
    let Some((head, rest)) = reply.split_at_checked(head_bytes) else { return Look::NotYet };
    let Some(head) = without_crc(head) else { return Look::Damaged };
    let length = head.iter().skip(2).rev().fold(0, |n, byte| n << 8 | usize::from(*byte));
    if head_bytes + 2 > REPLY_BYTES_MAX.saturating_sub(length) {
        return Look::Damaged;
    }
    let Some((block, behind)) = rest.split_at_checked(length + 2) else { return Look::NotYet };
    match without_crc(block) {
        Some(block) if behind.is_empty() => Look::Binary(block),
        _ => Look::Damaged,
    }
}

fn look_text(reply: &[u8]) -> Look<'_> {
    let Some(end) = reply.iter().position(|byte| *byte == b'\r') else { return Look::NotYet };
    let (line, behind) = reply.split_at(end);
    let Some((text, digits)) = line.split_last_chunk::<4>() else { return Look::Damaged };
    let said = std::str::from_utf8(digits).ok().filter(|_| digits.is_ascii());
    let said = said.and_then(|digits| u16::from_str_radix(digits, 16).ok());
    if said == Some(crc16(text)) && behind == b"\r" { Look::Text(text) } else { Look::Damaged }
}

/// What stands before a checksum; `None` when that is wrong.
fn without_crc(bytes: &[u8]) -> Option<&[u8]> {
    let (covered, crc) = bytes.split_last_chunk::<2>()?;
    (u16::from_le_bytes(*crc) == crc16(covered)).then_some(covered)
}

/// Errors of devices, as `ERRORxx` has them; `advice` knows more of them.
#[expect(
    missing_docs,
    reason = "the vendor's guide has a line for each, and `advice` says what helps"
)]
pub mod code {
    pub const INVALID_COMMAND: u8 = 0x01;
    pub const TOO_LONG: u8 = 0x02;
    pub const BAD_CRC: u8 = 0x04;
    pub const COMM_FAILED: u8 = 0x06;
    pub const PARAMETERS: u8 = 0x07;
    pub const INVALID_PORT: u8 = 0x08;
    pub const INVALID_PRIORITY: u8 = 0x09;
    /// It does not fit the mode the device is in: it tracks, or it does not.
    pub const WRONG_MODE: u8 = 0x0C;
    pub const NO_TOOL: u8 = 0x0D;
    pub const PORT_NOT_INITIALIZED: u8 = 0x0E;
    /// Everything after a reset.
    pub const NOT_INITIALIZED: u8 = 0x10;
    pub const OUT_OF_RANGE: u8 = 0x23;
    pub const NO_SUCH_HANDLE: u8 = 0x2B;
    pub const ALL_PORTS_TAKEN: u8 = 0x2D;
}

/// In words: what the code says, and what to do. The codes are those of the vendor's guide; a code
/// that is not in it is given by its number.
pub(super) fn advice(code: u8) -> &'static str {
    match code {
        0x01 => "it does not know the command: its firmware is too old for this driver, update it",
        0x02 | 0x03 | 0x07 => "the command does not fit its firmware: update it",
        0x04 => "the command arrived damaged: check the cable, or use a lower baud rate",
        0x05 => "it timed out inside: switch it off and on again",
        0x06 => "it cannot run its line at that speed: give a lower baud rate",
        0x08 => "the port handle is not valid: plug the tool in again",
        0x09 => "it cannot track this tool: its definition is for another kind of system",
        0x0C => "it is in another mode than expected: is another program using it?",
        0x0D => "no tool is assigned to the port: plug the tool in again",
        0x0E => "the port is not initialized: plug the tool in again",
        0x0F => "the port is not enabled: plug the tool in again",
        0x10 => "it is not initialized: switch it off and on again",
        0x11 => "it cannot stop tracking: switch it off and on again",
        0x12 => "it cannot start tracking: look at its error light, and switch it off and on again",
        0x13 => "it cannot initialize the tool: unplug the tool, or repair its definition",
        0x14 | 0x22 | 0x24 => {
            "its calibration does not fit the tool or the volume: choose another volume"
        }
        0x15 => "it cannot initialize itself: switch it off and on again",
        0x18 | 0xF1 => "too much infrared light around it: remove the lamp or the sunlight",
        0x19 | 0x25 | 0x29 => "its firmware cannot be read: have it serviced",
        0x1A => "an internal error: switch it off and on again",
        0x1D..=0x20 => "it cannot read the tool's memory: clean the tool's plug",
        0x21 => "the tool draws a wrong current: have the tool repaired",
        0x23 => "a value is out of its range: its firmware is too old for this driver",
        0x28 => "its hardware changed while it ran: switch it off and on again",
        0x2A => "it has no memory left: unplug tools, and switch it off and on again",
        0x2B | 0x2C => "the tool is gone: plug it in again",
        0x2D => "all its ports are taken: switch it off and on again to free them",
        0xF4..=0xF6 => "its flash memory fails: have it serviced",
        _ => "see its user's guide for the code",
    }
}

/// The code in `ERRORxx`.
pub(super) fn error_code(text: &str) -> Option<u8> {
    let digits = text.strip_prefix("ERROR")?;
    (digits.len() == 2).then(|| u8::from_str_radix(digits, 16).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_answers() {
        for (text, crc) in [
            ("INIT:", 0xE3A5),
            ("OKAY", 0xA896),
            ("RESET", 0xBE6F),
            ("VER:0", 0x65EE),
            ("GETINFO:Features.Firmware.Version", 0x0492),
            ("GET:Device.*", 0x722D),
            ("PHSR:00", 0x20FF),
            ("PINIT:01", 0x31EA),
            ("SFLIST:03", 0x500F),
            ("123456789", 0xBB3D),
            ("", 0),
        ] {
            assert_eq!(crc16(text.as_bytes()), crc, "{text}");
        }
    }

    #[test]
    fn known_requests() {
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
