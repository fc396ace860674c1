//! A minimal Protocol Buffers encoder (protobuf.dev, "Encoding").

use crate::varint;

/// An encoded message, built field by field.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Message(pub(super) Vec<u8>);

impl Message {
    /// The encoded message.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Adds an integer, a bool or an enum value.
    pub(super) fn int(mut self, field: u32, value: u64) -> Self {
        self.tag(field, 0);
        varint::put(&mut self.0, value);
        self
    }

    pub(super) fn float(self, field: u32, value: f32) -> Self {
        self.fixed32(field, value.to_bits())
    }

    pub(super) fn double(mut self, field: u32, value: f64) -> Self {
        self.tag(field, 1);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(super) fn fixed32(mut self, field: u32, value: u32) -> Self {
        self.tag(field, 5);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(super) fn bytes(mut self, field: u32, value: &[u8]) -> Self {
        self.tag(field, 2);
        varint::put(&mut self.0, value.len() as u64);
        self.0.extend_from_slice(value);
        self
    }

    pub(super) fn text(self, field: u32, value: &str) -> Self {
        self.bytes(field, value.as_bytes())
    }

    pub(super) fn message(self, field: u32, value: &Self) -> Self {
        self.bytes(field, &value.0)
    }

    fn tag(&mut self, field: u32, wire_type: u32) {
        varint::put(&mut self.0, u64::from(field << 3 | wire_type));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples of protobuf.dev, "Encoding".
    #[test]
    fn fields_are_encoded_as_specified() {
        let inner = Message::default().int(1, 150);
        assert_eq!(inner.0, [0x08, 0x96, 0x01]);
        let outer = Message::default().message(3, &inner).text(2, "testing");
        assert_eq!(outer.0[..5], [0x1a, 0x03, 0x08, 0x96, 0x01]);
        assert_eq!(outer.0[5..], [0x12, 7, b't', b'e', b's', b't', b'i', b'n', b'g']);
    }
}
