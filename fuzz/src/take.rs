//! Bytes of anybody as a take.

use std::io::Cursor;

use mocapd_take::{
    TakeError, TakeEvent, TakeFrames, TakeReader, chunk, motion::FrameSource, recovery::Survey,
    stretch::StretchDecoder,
};

use crate::Input;

/// Most samples of a stretch that is decoded here. A reader takes more, which is time and no other code.
const SAMPLES_MAX: usize = 1 << 13;

/// Most frames that are looked at.
const FRAMES_MAX: usize = 1 << 10;

/// The first byte says how: as they are, or as chunks whose checksums are made good first, since a fuzzer
/// cannot guess them. Then events, stretches, frames: errors or samples, and an end.
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

/// The same bytes as a damaged take: what can be recovered of it makes a take that has lost nothing more.
///
/// Bits 3 to 7 of the first byte say how it is damaged beside: so many bytes of it, spread over the file, are changed.
pub fn recover_take(bytes: &[u8]) {
    let take = damaged(bytes);
    if !events(&take, take.len().max(1)).is_ok_and(|(_, small)| small) {
        return;
    }
    let survey = Survey::read(&take[..]).expect("its events could be read");
    let mut new = Vec::new();
    match survey.write(Cursor::new(&take), &mut new, "fuzz") {
        Ok(_) => {}
        // A header that is as large as it can be has no room for what recovered it.
        Err(TakeError::InvalidArgument(_)) => return,
        Err(error) => panic!("{error}"),
    }
    let again = Survey::read(&new[..]).expect("a take");
    assert!(again.problems.is_empty() && !again.lost_anything(), "{:?}", again.problems);
    let samples = |survey: &Survey| survey.per_channel.iter().map(|c| c.samples).sum::<u64>();
    assert_eq!(samples(&survey), samples(&again), "other samples than were found");
    assert_eq!(survey.rows, again.rows, "other rows than were found");
    assert_eq!(survey.channels, again.channels, "other names than were found");
}

/// A fuzzer's bytes as a damaged take.
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

/// `{type, length in 2 bytes, payload}` after each other as a take.
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

/// How many events there are, and whether all of it is quick to decode.
fn events(take: &[u8], piece: usize) -> Result<(usize, bool), TakeError> {
    let mut reader = TakeReader::new();
    let mut pieces = take.chunks(piece);
    let mut decoder = None;
    let (mut n_events, mut small) = (0, true);
    loop {
        // Every event takes at least a byte, but the end.
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
                    decoder.pass();
                } else if decoder.decode(&stretch).is_ok() {
                    let finite = |p: &[f32; 3]| p.iter().all(|coordinate| coordinate.is_finite());
                    for rows in decoder.rows().flatten() {
                        assert!(rows.positions.iter().all(finite));
                    }
                }
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
    let Ok(mut frames) = TakeFrames::open(Cursor::new(take)) else { return };
    let n_markers = frames.info().markers.len();
    let mut row = vec![[0.0; 3]; n_markers];
    for _ in 0..FRAMES_MAX {
        match frames.next_frame(&mut row) {
            Ok(true) => {}
            Ok(false) | Err(_) => break,
        }
    }
}
