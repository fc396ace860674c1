//! Numbers and texts in bytes, little-endian, in both directions.

/// What is left of bytes that somebody else wrote. `None` from any call means that the layout is wrong.
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
    pub(crate) fn get<T: Wire>(&mut self) -> Option<T> {
        T::get(self)
    }

    /// A length byte and that much UTF-8 without control characters.
    pub(crate) fn text(&mut self, bytes_max: usize) -> Option<&'a str> {
        let n = usize::from(self.get::<u8>()?);
        let text = std::str::from_utf8(self.bytes(n)?).ok()?;
        (n <= bytes_max && !text.contains(char::is_control)).then_some(text)
    }

    /// `Some(value)` when nothing is left: a message with bytes to spare is not ours.
    pub(crate) fn end<T>(self, value: T) -> Option<T> {
        self.0.is_empty().then_some(value)
    }
}

/// A value of a fixed size on the wire.
pub(crate) trait Wire: Sized {
    fn get(from: &mut Cursor<'_>) -> Option<Self>;
    fn put(self, out: &mut Vec<u8>);

    /// The value that `bytes` are, all of them.
    fn whole(bytes: &[u8]) -> Option<Self> {
        let mut cursor = Cursor::new(bytes);
        let value = cursor.get()?;
        cursor.end(value)
    }
}

macro_rules! numbers {
    ($($number:ty)+) => {$(
        impl Wire for $number {
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

numbers!(u8 u16 u32 u64 i16 f32);

/// A position, millimetres.
impl Wire for [f32; 3] {
    fn get(from: &mut Cursor<'_>) -> Option<Self> {
        Some([from.get()?, from.get()?, from.get()?])
    }

    fn put(self, out: &mut Vec<u8>) {
        self.into_iter().for_each(|value| value.put(out));
    }
}

impl Wire for () {
    fn get(_: &mut Cursor<'_>) -> Option<Self> {
        Some(())
    }

    fn put(self, _: &mut Vec<u8>) {}
}

/// A struct of values, in the order in which they stand on the wire.
macro_rules! record {
    ($record:ident { $($field:ident),* }) => {
        impl $crate::bytes::Wire for $record {
            fn get(from: &mut $crate::bytes::Cursor<'_>) -> Option<Self> {
                Some(Self { $($field: from.get()?),* })
            }

            fn put(self, out: &mut Vec<u8>) {
                $(self.$field.put(out);)*
            }
        }
    };
}

pub(crate) use record;
