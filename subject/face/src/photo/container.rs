//! What decoders do not say of a file: whether it is whole, animated, or made for print.

/// What the markers of a JPEG file say.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Jpeg {
    /// Of its frame: 1 is grey, 3 colour, 4 CMYK or YCCK.
    pub(super) components: u8,
    /// Its end-of-image marker is there. Decoders fill what is missing with grey, and a face may be half in it.
    pub(super) whole: bool,
}

impl Jpeg {
    /// Walks the markers (ITU-T T.81, B.1.1): segments by their length, entropy-coded data to the next marker that is
    /// neither stuffing nor a restart.
    pub(super) fn of(bytes: &[u8]) -> Self {
        let mut jpeg = Self::default();
        let mut at = 2;
        while let Some(&byte) = bytes.get(at) {
            let marker = bytes.get(at + 1).copied();
            at += 1;
            let (0xff, Some(marker)) = (byte, marker) else { continue };
            match marker {
                // Stuffing, fill bytes, TEM, restarts and a start: no length behind them.
                0x00 | 0xff | 0x01 | 0xd0..=0xd8 => {}
                0xd9 => {
                    jpeg.whole = true;
                    return jpeg;
                }
                _ => {
                    let (Some(&high), Some(&low)) = (bytes.get(at + 1), bytes.get(at + 2)) else {
                        return jpeg;
                    };
                    // Frames are SOF0 to SOF15 without DHT, JPG and DAC.
                    if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
                        jpeg.components = bytes.get(at + 8).copied().unwrap_or_default();
                    }
                    at += 1 + usize::from(u16::from_be_bytes([high, low])).max(2);
                }
            }
        }
        jpeg
    }
}

/// Whether a PNG file is animated: it has an `acTL` chunk in front of its first data.
pub(super) fn png_is_animated(bytes: &[u8]) -> bool {
    let mut at: usize = 8;
    while let Some(head) = bytes.get(at..at.saturating_add(8)) {
        let (length, kind) = head.split_at(4);
        match kind {
            b"acTL" => return true,
            b"IDAT" | b"IEND" => return false,
            _ => {}
        }
        let length = length.iter().fold(0usize, |sum, &byte| sum << 8 | usize::from(byte));
        // The chunk's head and its checksum are 12 bytes.
        at = at.saturating_add(length).saturating_add(12);
    }
    false
}
