//! Which rows have a sample, as alternating run lengths.

use crate::{
    CodecError,
    coding::bytes::{Bytes, write_varint},
};

/// Appends the lengths of runs, absent first (it may be 0), until all rows are covered.
pub(crate) fn write(present: &[bool], out: &mut Vec<u8>) {
    let mut rest = present;
    let mut state = false;
    while !rest.is_empty() {
        let run = rest.iter().position(|&p| p != state).unwrap_or(rest.len());
        write_varint(run as u64, out);
        rest = &rest[run..];
        state = !state;
    }
}

/// Most bytes for `n_rows`: every run but the first covers a row for each byte of its length.
pub(crate) fn max_bytes(n_rows: usize) -> usize {
    n_rows + 1
}

/// Fills `present`, whose length is the number of rows.
///
/// Both all-present and all-absent are refused: they are spelled without runs.
pub(crate) fn read(input: &mut Bytes<'_>, present: &mut [bool]) -> Result<(), CodecError> {
    let (mut at, mut state) = (0, false);
    let mut absent = 0;
    while at < present.len() {
        let run = usize::try_from(input.varint("the presence runs")?).unwrap_or(usize::MAX);
        if run == 0 && at > 0 {
            return Err(CodecError::Corrupt("an empty presence run"));
        }
        let run_rows = present
            .get_mut(at..)
            .and_then(|rest| rest.get_mut(..run))
            .ok_or(CodecError::Corrupt("presence runs beyond the block's rows"))?;
        // A first run of length 0 leaves `at` at 0: the next must not be empty as well.
        if run == 0 && state {
            return Err(CodecError::Corrupt("an empty presence run"));
        }
        run_rows.fill(state);
        if !state {
            absent += run;
        }
        at += run;
        state = !state;
    }
    if absent == 0 || absent == present.len() {
        return Err(CodecError::Corrupt("presence runs of a block that needs none"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pattern_of_ten_rows_round_trips() {
        for pattern in 1..(1 << 10) - 1_u32 {
            let present: Vec<bool> = (0..10).map(|i| pattern >> i & 1 == 1).collect();
            let mut out = Vec::new();
            write(&present, &mut out);
            assert!(out.len() <= max_bytes(10));
            let mut back = vec![false; 10];
            let mut input = Bytes::new(&out);
            read(&mut input, &mut back).unwrap();
            assert_eq!(back, present);
            assert!(input.is_empty());
        }
    }

    #[test]
    fn other_spellings_are_refused() {
        for bad in [&[0, 0, 4][..], &[1, 0, 3], &[5], &[1, 4], &[0, 4], &[4]] {
            let mut present = [false; 4];
            assert!(
                matches!(read(&mut Bytes::new(bad), &mut present), Err(CodecError::Corrupt(_))),
                "{bad:?}"
            );
        }
        assert!(matches!(
            read(&mut Bytes::new(&[1, 2]), &mut [false; 4]),
            Err(CodecError::Truncated(_))
        ));
    }
}
