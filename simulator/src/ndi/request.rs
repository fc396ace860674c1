//! Lines from the host: a name, a colon or a blank, arguments, and with a colon a checksum.

use mocapd_drivers::ndi::crc16;

/// The longest request: `PVWR` takes 149 characters; the rest is room for options.
const REQUEST_BYTES_MAX: usize = 1024;

/// Errors of the line, as `ERRORxx` has them.
pub(super) const INVALID: u8 = 0x01;
pub(super) const TOO_LONG: u8 = 0x02;
pub(super) const BAD_CRC: u8 = 0x04;

/// Takes bytes until a carriage return.
#[derive(Debug, Default)]
pub(super) struct Line {
    bytes: Vec<u8>,
    too_long: bool,
}

impl Line {
    /// One byte; the request that it ends, as name and arguments, or the error that it is.
    pub(super) fn push(&mut self, byte: u8) -> Option<Result<(String, String), u8>> {
        if byte != b'\r' {
            self.too_long |= self.bytes.len() >= REQUEST_BYTES_MAX;
            if !self.too_long {
                self.bytes.push(byte);
            }
            return None;
        }
        let too_long = std::mem::take(&mut self.too_long);
        let bytes = std::mem::take(&mut self.bytes);
        match std::str::from_utf8(&bytes) {
            _ if too_long => Some(Err(TOO_LONG)),
            Ok("") => None,
            Ok(text) => Some(parse(text)),
            Err(_) => Some(Err(INVALID)),
        }
    }

    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}

fn parse(text: &str) -> Result<(String, String), u8> {
    let owned = |(name, rest): (&str, &str)| (name.to_owned(), rest.to_owned());
    let Some(at) = text.find([':', ' ']) else { return Ok((text.to_owned(), String::new())) };
    if text.as_bytes().get(at) == Some(&b' ') {
        return text.split_once(' ').map(owned).ok_or(INVALID);
    }
    let covered = text.len().checked_sub(4).and_then(|at| text.split_at_checked(at));
    let Some((covered, digits)) = covered.filter(|(covered, _)| covered.len() > at) else {
        return Err(BAD_CRC);
    };
    if u16::from_str_radix(digits, 16) != Ok(crc16(covered.as_bytes())) {
        return Err(BAD_CRC);
    }
    covered.split_once(':').map(owned).ok_or(INVALID)
}
