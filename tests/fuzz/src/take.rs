//! Arbitrary bytes as a take.

use std::io::{self, Cursor};

use mocapd_take::{
    TakeError, TakeEvent, TakeFrames, TakeReader, chunk, motion::FrameSource,
    recovery::RecoveryScan, stretch::StretchDecoder,
};

use crate::Input;

/// Maximum number of samples of a stretch that is decoded. More would take time without reaching other code.
const SAMPLES_MAX: usize = 1 << 13;

/// Maximum number of bytes of a part in memory: beyond them it goes into a file, which these targets do not have.
const PART_BYTES_MAX: u64 = 8 << 20;

/// Maximum number of frames read.
const FRAMES_MAX: usize = 1 << 10;

/// Reads a take's events, stretches and frames: gives errors or samples, and reaches an end. The first byte selects
/// whether the bytes are used unchanged, or as chunks that first get valid checksums, which a fuzzer cannot guess.
pub fn read_take(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let how = input.byte();
    let rest = input.take(usize::MAX);
    let take = if how & 1 == 1 { with_checksums(rest) } else { rest.to_vec() };
    let piece = match how >> 1 & 3 {
        0 => take.len().max(1),
        1 => 1,
        2 => 7,
        _ => 64,
    };
    let whole = events(&take, take.len().max(1));
    let in_pieces = events(&take, piece);
    assert_eq!(whole.is_ok(), in_pieces.is_ok(), "the pieces change what is read");
    if let (Ok(whole), Ok((n_events, small))) = (whole, in_pieces) {
        assert_eq!(whole, (n_events, small), "the pieces change what is read");
        if small {
            frames(&take);
        }
    }
}

/// Recovers a damaged take: the result is a valid take with everything that could be recovered.
///
/// Bits 3 to 7 of the first byte give the number of bytes that are changed in addition, spread over the file.
pub fn recover_take(bytes: &[u8]) {
    let take = damaged(bytes);
    if !events(&take, take.len().max(1)).is_ok_and(|(_, small)| small) {
        return;
    }
    let scan = RecoveryScan::read(&take[..]).expect("its events could be read");
    let mut new = Vec::new();
    match scan.write(Cursor::new(&take), &mut new, "fuzz") {
        Ok(_) => {}
        // A header of maximum size has no room for the name of the recovering program.
        Err(TakeError::InvalidArgument(_)) => return,
        Err(error) => panic!("{error}"),
    }
    let again = RecoveryScan::read(&new[..]).expect("a take");
    assert!(again.problems.is_empty() && !again.lost_anything(), "{:?}", again.problems);
    let samples = |scan: &RecoveryScan| scan.per_channel.iter().map(|c| c.samples).sum::<u64>();
    assert_eq!(samples(&scan), samples(&again), "other samples than were found");
    assert_eq!(scan.rows, again.rows, "other rows than were found");
    assert_eq!(scan.channels, again.channels, "other names than were found");
}

/// Converts a fuzzer's bytes to a damaged take.
fn damaged(bytes: &[u8]) -> Vec<u8> {
    let mut input = Input::new(bytes);
    let how = input.byte();
    let rest = input.take(usize::MAX);
    let mut take = if how & 1 == 1 { with_checksums(rest) } else { rest.to_vec() };
    let n = usize::from(how >> 3);
    for i in 0..n {
        let at = take.len() * (2 * i + 1) / (2 * n);
        if let Some(byte) = take.get_mut(at) {
            *byte ^= 0x55;
        }
    }
    take
}

/// Encodes a sequence of `{type, length in 2 bytes, payload}` as a take.
fn with_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut input = Input::new(bytes);
    let mut take = chunk::MAGIC.to_vec();
    while !input.is_empty() {
        let kind = input.byte();
        let len = input.pair();
        chunk::put(&mut take, kind, input.take(len)).expect("64 KiB at most");
    }
    take
}

/// Number of events, and whether all stretches are small enough to decode.
fn events(take: &[u8], piece: usize) -> Result<(usize, bool), TakeError> {
    let mut reader = TakeReader::new();
    let mut pieces = take.chunks(piece);
    let mut decoder = None;
    let (mut n_events, mut small) = (0, true);
    loop {
        // Every event except the end takes at least one byte.
        assert!(n_events <= take.len() + 1, "more events than bytes");
        let Some(event) = reader.next_event()? else {
            match pieces.next() {
                Some(piece) => reader.push(piece),
                None => reader.finish(),
            }
            continue;
        };
        n_events += 1;
        match event {
            TakeEvent::Header(header) => decoder = Some(StretchDecoder::new(header.codec()?)),
            TakeEvent::Stretch(stretch) => {
                let Some(decoder) = &mut decoder else { panic!("a stretch before the header") };
                let most_channels = mocapd_codec::GROUP_CHANNELS * stretch.blocks.len();
                if most_channels * stretch.span.n_rows as usize > SAMPLES_MAX {
                    small = false;
                    decoder.skip();
                } else if decoder.decode(&stretch).is_ok() {
                    let finite = |p: &[f32; 3]| p.iter().all(|coordinate| coordinate.is_finite());
                    for rows in decoder.rows().flatten() {
                        assert!(rows.positions.iter().all(finite));
                    }
                }
            }
            TakeEvent::Samples(chunk) => {
                // A group has at most 64 channels.
                small &= chunk.span.n < (SAMPLES_MAX / mocapd_codec::GROUP_CHANNELS) as u64;
            }
            TakeEvent::End { bytes, .. } => {
                let ends = [bytes.sum(), reader.offset()];
                assert_eq!(ends, [take.len() as u64; 2], "bytes are left, or not accounted for");
                return Ok((n_events, small));
            }
            _ => {}
        }
    }
}

fn frames(take: &[u8]) {
    // A large part has no place to go, which is an error.
    let no_scratch = || Err(io::ErrorKind::Unsupported.into());
    let opened = TakeFrames::open_with(Cursor::new(take), |_| true, no_scratch);
    let Ok(mut frames) = opened.or_else(|_| TakeFrames::open(Cursor::new(take))) else { return };
    for part in &frames.info().foreign {
        assert!(part.data.len() <= PART_BYTES_MAX, "a part that a few bytes claim");
    }
    let n_markers = frames.info().markers.len();
    let mut row = vec![[0.0; 3]; n_markers];
    for _ in 0..FRAMES_MAX {
        match frames.next_frame(&mut row) {
            Ok(true) => {}
            Ok(false) | Err(_) => break,
        }
    }
}
