//! Numbers of the learned tables in `data/`, little-endian, read at compile time.

const fn bytes<const N: usize>(table: &[u8], at: usize) -> [u8; N] {
    let mut bytes = [0; N];
    let mut i = 0;
    while i < N {
        bytes[i] = table[at + i];
        i += 1;
    }
    bytes
}

macro_rules! numbers {
    ($name:ident, $type:ty) => {
        /// `N` numbers from byte `at` on.
        pub(crate) const fn $name<const N: usize>(table: &[u8], at: usize) -> [$type; N] {
            let mut numbers = [<$type>::from_le_bytes([0; size_of::<$type>()]); N];
            let mut i = 0;
            while i < N {
                numbers[i] = <$type>::from_le_bytes(bytes(table, at + i * size_of::<$type>()));
                i += 1;
            }
            numbers
        }
    };
}

numbers!(u8s, u8);
numbers!(u16s, u16);
numbers!(i16s, i16);
numbers!(i32s, i32);
numbers!(f32s, f32);
numbers!(f64s, f64);
