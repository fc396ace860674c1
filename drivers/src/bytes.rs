//! Little-endian encoding and decoding of numbers, text and plain structs.

/// Reads values from untrusted bytes. Every method returns `None` when the bytes do not have that layout.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    #[inline]
    pub(crate) fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }

    pub(crate) fn bytes(&mut self, n: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(head)
    }

    #[inline]
    pub(crate) fn get<T: WireValue>(&mut self) -> Option<T> {
        T::get(self)
    }

    /// Number of bytes that are left.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Reads the bytes in front of the next NUL, and the NUL.
    pub(crate) fn until_nul(&mut self) -> Option<&'a [u8]> {
        let n = self.0.iter().position(|byte| *byte == 0)?;
        let text = self.bytes(n)?;
        self.bytes(1)?;
        Some(text)
    }

    /// Reads a length byte and that many bytes of UTF-8 without control characters, at most `bytes_max`.
    pub(crate) fn text(&mut self, bytes_max: usize) -> Option<&'a str> {
        let n = usize::from(self.get::<u8>()?);
        let text = std::str::from_utf8(self.bytes(n)?).ok()?;
        (n <= bytes_max && !text.contains(char::is_control)).then_some(text)
    }

    /// Returns `Some(value)` when all bytes were read: a message with trailing bytes is invalid.
    pub(crate) fn end<T>(self, value: T) -> Option<T> {
        self.0.is_empty().then_some(value)
    }
}

/// A value with a fixed-size wire encoding.
pub(crate) trait WireValue: Sized {
    fn get(from: &mut Cursor<'_>) -> Option<Self>;
    fn put(self, out: &mut Vec<u8>);

    /// Decodes `bytes` as one value; `None` when they are too few or too many.
    fn decode(bytes: &[u8]) -> Option<Self> {
        let mut cursor = Cursor::new(bytes);
        let value = cursor.get()?;
        cursor.end(value)
    }
}

macro_rules! wire_numbers {
    ($($number:ty)+) => {$(
        impl WireValue for $number {
            #[inline]
            fn get(from: &mut Cursor<'_>) -> Option<Self> {
                from.array().map(Self::from_le_bytes)
            }

            fn put(self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
        }
    )+};
}

wire_numbers!(u8 u16 u32 u64 i16 i32 f32 f64);

/// A position in millimetres: x, y, z.
impl WireValue for [f32; 3] {
    fn get(from: &mut Cursor<'_>) -> Option<Self> {
        Some([from.get()?, from.get()?, from.get()?])
    }

    fn put(self, out: &mut Vec<u8>) {
        self.into_iter().for_each(|value| value.put(out));
    }
}

impl WireValue for () {
    fn get(_: &mut Cursor<'_>) -> Option<Self> {
        Some(())
    }

    fn put(self, _: &mut Vec<u8>) {}
}

/// Implements [`WireValue`] for a struct: its fields in the order given.
macro_rules! wire_struct {
    ($name:ident { $($field:ident),* }) => {
        impl $crate::bytes::WireValue for $name {
            fn get(from: &mut $crate::bytes::Cursor<'_>) -> Option<Self> {
                Some(Self { $($field: from.get()?),* })
            }

            fn put(self, out: &mut Vec<u8>) {
                $(self.$field.put(out);)*
            }
        }
    };
}

pub(crate) use wire_struct;

/// Whether a character is no control, and one that XML 1.0 can have: it has no way to write the others.
pub(crate) fn is_printable(c: char) -> bool {
    !c.is_control() && !matches!(c, '\u{fffe}' | '\u{ffff}')
}
