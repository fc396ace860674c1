//! The tagged sections of SUMMARY.

use crate::{TakeError, varint};

/// Appends a section: its tag, its length, its content.
pub(super) fn put_section(out: &mut Vec<u8>, tag: u64, section: &[u8]) {
    varint::put(out, tag);
    varint::put_prefixed(out, section);
}

/// Splits the version off the front of a section, and rejects all but `supported`.
pub(super) fn section_content<'a>(
    section: &'a [u8],
    what: &'static str,
    supported: u16,
    offset: u64,
) -> Result<&'a [u8], TakeError> {
    let Some((version, content)) = section.split_first_chunk::<2>() else {
        return Err(TakeError::corrupt(what, offset, "shorter than its version"));
    };
    match u16::from_le_bytes(*version) {
        found if found == supported => Ok(content),
        found => Err(TakeError::Unsupported { what, found, supported }),
    }
}
