//! CRC-16/ARC: x^16 + x^15 + x^2 + 1, reflected, from 0.

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
}
