//! The channel table in HEADER and CHANNELS: labels share their beginnings with the one before.
//!
//! Labels of one take are alike (`L.Shoulder`, `L.Elbow`; `h00b00m0`, `h00b00m1`), and a short take is
//! little else: stored whole they would be a tenth of it. docs/take-format.md gives the bytes.

use super::{Channel, LIMIT_BYTES};
use crate::{
    stretch::CHANNELS_MAX,
    varint::{self, Cursor},
};

/// Most bytes that a label takes over from the one before: what a nibble can say.
const MAX_SHARED: usize = 15;
/// Suffix lengths that stand in the nibble; these two say what follows instead.
const LONG: u8 = 14;
const UNUSUAL: u8 = 15;
/// What an entry costs a reader beside its label.
const ENTRY_BYTES: usize = 32;

/// What the next entry is, where it does not say otherwise.
#[derive(Default)]
struct Before<'a> {
    label: &'a [u8],
    /// None before the first entry.
    marker_id: Option<u16>,
    unlabelled: bool,
}

impl<'a> Before<'a> {
    fn next_id(&self) -> u16 {
        self.marker_id.map_or(0, |id| id.wrapping_add(1))
    }

    fn follow(&mut self, marker_id: u16, label: &'a [u8], labelled: bool) {
        *self = Self { label, marker_id: Some(marker_id), unlabelled: !labelled };
    }
}

fn shared(a: &[u8], b: &[u8]) -> usize {
    a.iter().zip(b).take(MAX_SHARED).take_while(|(a, b)| a == b).count()
}

/// The bytes of a table.
pub(super) fn write(channels: &[Channel]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut before = Before::default();
    for Channel { marker_id, label, labelled } in channels {
        let label = label.as_bytes();
        let shared = shared(before.label, label);
        let suffix = &label[shared..];
        let usual = *marker_id == before.next_id() && *labelled != before.unlabelled;
        let short = u8::try_from(suffix.len()).ok().filter(|&n| n < LONG);
        let low = if usual { short.unwrap_or(LONG) } else { UNUSUAL };
        out.push((shared as u8) << 4 | low);
        if !usual {
            varint::put(&mut out, u64::from(*marker_id) << 1 | u64::from(*labelled));
        }
        if low >= LONG {
            varint::put(&mut out, suffix.len() as u64);
        }
        out.extend_from_slice(suffix);
        before.follow(*marker_id, label, *labelled);
    }
    out
}

const CUT: &str = "the channel table is cut short, or a number in it is longer than it needs to be";

/// A table from all of its bytes.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<Channel>, &'static str> {
    let mut bytes = Cursor::new(bytes);
    let mut channels: Vec<Channel> = Vec::new();
    let mut claimed = 0_u64;
    while !bytes.is_empty() {
        if channels.len() == CHANNELS_MAX {
            return Err("there are more than 65536 markers");
        }
        let before = match channels.last() {
            Some(last) => Before {
                label: last.label.as_bytes(),
                marker_id: Some(last.marker_id),
                unlabelled: !last.labelled,
            },
            None => Before::default(),
        };
        let head = bytes.byte().ok_or(CUT)?;
        let shared = usize::from(head >> 4);
        let (mut marker_id, mut labelled) = (before.next_id(), !before.unlabelled);
        if head & 15 == UNUSUAL {
            let both = bytes.varint().ok_or(CUT)?;
            labelled = both & 1 == 1;
            marker_id = u16::try_from(both >> 1).map_err(|_| "a marker id is beyond 65535")?;
        }
        let n = if head & 15 >= LONG { bytes.varint().ok_or(CUT)? } else { u64::from(head & 15) };
        let beginning = before.label.get(..shared).ok_or("a label begins like a shorter one")?;
        // Memory as the other records: a byte here must not buy more than the limit there.
        claimed = (claimed + (ENTRY_BYTES + shared) as u64).saturating_add(n);
        if claimed > LIMIT_BYTES as u64 {
            return Err("the channel table is larger than a take can hold");
        }
        let label = [beginning, bytes.take(n).ok_or(CUT)?].concat();
        let label = String::from_utf8(label).map_err(|_| "a label is not UTF-8")?;
        channels.push(Channel { marker_id, label, labelled });
    }
    Ok(channels)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(marker_id: u16, label: &str, labelled: bool) -> Channel {
        Channel { marker_id, label: label.to_owned(), labelled }
    }

    #[test]
    fn what_is_usual_takes_a_byte_and_what_is_new_in_the_label() {
        let table = [channel(0, "L.Elbow", true), channel(1, "L.Wrist", true)];
        assert_eq!(write(&table), b"\x07L.Elbow\x25Wrist");
        assert_eq!(read(&write(&table)).unwrap(), table);
    }

    #[test]
    fn any_table_comes_back() {
        let long = "ä".repeat(120);
        let table = [
            channel(7, "", false),
            channel(8, "u001", false),
            channel(8, "u001", false),
            channel(65535, &long, true),
            channel(0, &format!("{long}1"), true),
            channel(1, "ö", true),
        ];
        assert_eq!(read(&write(&table)).unwrap(), table);
        assert_eq!(read(&[]).unwrap(), []);
    }

    #[test]
    fn bad_bytes_are_errors() {
        // Shares with nothing; is cut; too long a number, twice; not UTF-8; an id beyond 16 bits.
        for bytes in [
            &b"\x11a"[..],
            b"\x05ab",
            b"\x0e\xff\xff\xff\x01",
            b"\x0e\x81\x00a",
            b"\x01\xff",
            b"\x0f\xff\xff\x7f\x00",
        ] {
            assert!(read(bytes).is_err(), "{bytes:?}");
        }
        // A byte an entry: no memory beyond the limit.
        assert!(read(&vec![0; LIMIT_BYTES]).is_err());
    }
}
