//! The values behind the header, one after the other, as float64.

use super::header::Scalar;
use super::malformed;
use crate::read::{ReadError, text};

/// Where values come from.
pub(super) trait Source {
    /// The next value belongs to the next vertex, face or whatever.
    fn begin_row(&mut self) -> Result<(), ReadError>;
    /// The next value, which takes at least one byte of the file.
    fn value(&mut self, scalar: Scalar) -> Result<f64, ReadError>;
    /// Where the last value stood, for messages.
    fn place(&self) -> String;
}

/// A line a row, values between blanks.
pub(super) struct Text<'a> {
    lines: Box<dyn Iterator<Item = (usize, &'a [u8])> + 'a>,
    line: &'a [u8],
    number: usize,
}

impl<'a> Text<'a> {
    /// Behind a header of so many lines.
    pub(super) fn new(bytes: &'a [u8], n_lines: usize) -> Self {
        let lines = text::lines(bytes).map(move |(number, line)| (number + n_lines, line));
        Self { lines: Box::new(lines), line: &[], number: n_lines }
    }
}

impl Source for Text<'_> {
    fn begin_row(&mut self) -> Result<(), ReadError> {
        let mut filled = self.lines.by_ref().filter(|(_, line)| !line.trim_ascii().is_empty());
        let Some((number, line)) = filled.next() else {
            return Err(malformed(
                "end of file",
                "fewer lines than announced: cut off, export the scan again",
            ));
        };
        (self.number, self.line) = (number, line);
        Ok(())
    }

    fn value(&mut self, _: Scalar) -> Result<f64, ReadError> {
        let line = self.line.trim_ascii_start();
        let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
        let (word, rest) = line.split_at(end);
        self.line = rest;
        text::number(word).ok_or_else(|| {
            malformed(&self.place(), &format!("expected a number, found {}", text::quote(word)))
        })
    }

    fn place(&self) -> String {
        format!("line {}", self.number)
    }
}

/// Values side by side.
pub(super) struct Binary<'a> {
    rest: &'a [u8],
    /// Bytes of the whole file.
    len: usize,
    big_endian: bool,
}

impl<'a> Binary<'a> {
    /// Behind a header of so many bytes.
    pub(super) fn new(rest: &'a [u8], header_len: usize, big_endian: bool) -> Self {
        Self { rest, len: rest.len() + header_len, big_endian }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], ReadError> {
        let Some((&(mut bytes), rest)) = self.rest.split_first_chunk() else {
            return Err(malformed(
                &self.place(),
                "fewer values than announced: cut off, export the scan again",
            ));
        };
        self.rest = rest;
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }
}

impl Source for Binary<'_> {
    fn begin_row(&mut self) -> Result<(), ReadError> {
        Ok(())
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, ReadError> {
        Ok(match scalar {
            Scalar::I8 => i8::from_le_bytes(self.take()?).into(),
            Scalar::U8 => u8::from_le_bytes(self.take()?).into(),
            Scalar::I16 => i16::from_le_bytes(self.take()?).into(),
            Scalar::U16 => u16::from_le_bytes(self.take()?).into(),
            Scalar::I32 => i32::from_le_bytes(self.take()?).into(),
            Scalar::U32 => u32::from_le_bytes(self.take()?).into(),
            Scalar::F32 => f32::from_le_bytes(self.take()?).into(),
            Scalar::F64 => f64::from_le_bytes(self.take()?),
        })
    }

    fn place(&self) -> String {
        format!("byte {}", self.len - self.rest.len())
    }
}
