//! Takes that claim many channels of few samples are repacked in memory in proportion to their samples.

use std::io::{self, Cursor};

use mocapd_codec::{BlockReport, GROUP_CHANNELS, ResamplerKind, Rows, Settings, Tolerance};
use mocapd_take::{
    TakeFrames, TakeWriter,
    edit::{EditContext, SourceTake, repack},
    motion::{FrameSource, GAP},
    record::{CODEC_VERSION, Channel, Header, ImportSource, Ledger},
    statistics::StretchTally,
    stretch::{Span, StretchHeaderWriter, put_block},
    timeline::Timeline,
};

use crate::counting::peak_bytes;

const N_GROUPS: usize = 32;
const N_ROWS: u32 = 4_096;

/// Stretches in which the first channel of each group has one sample, with the numbers of rows of a full stretch. The
/// others have none.
fn take(n_stretches: u8, stretch_rows: u32) -> Vec<u8> {
    let codec =
        Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(1.0).unwrap() };
    let channel = |i| Channel { marker_id: i as u16, label: format!("m{i}"), labelled: true };
    let mut header = Header {
        codec_version: CODEC_VERSION,
        rate_hz: 100.0,
        stretch_rows,
        channels: (0..N_GROUPS * GROUP_CHANNELS).map(channel).collect(),
        source: Some(ImportSource::default()),
        ..Header::default()
    };
    header.set_codec(&codec);
    let mut present = vec![false; N_ROWS as usize];
    present[0] = true;
    // No point decodes to -0, so the sample is stored, as by an edit.
    let positions = vec![[1.0, -0.0, 0.3]; N_ROWS as usize];
    let rows = [Rows::new(&positions, &present).unwrap()];
    let mut block = Vec::new();
    let mut reports = [BlockReport::default()];
    codec.encoder().encode_exact(&rows, 0.0, &mut block, &mut reports).unwrap();
    let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
    let mut front = StretchHeaderWriter::new(stretch_rows);
    for number in 0..n_stretches {
        let first_row = u64::from(number) * u64::from(N_ROWS);
        let span = Span { first_row, n_rows: N_ROWS, key: true, number };
        let mut payload = Vec::new();
        front.put(span, &Timeline::default(), &[], false, &mut payload);
        (0..N_GROUPS).for_each(|_| put_block(&block, false, &mut payload));
        take.stretch(span, &payload, &StretchTally::default()).unwrap();
    }
    take.finish(&Ledger::default()).unwrap().0
}

#[test]
fn channels_without_samples_take_no_memory() {
    // One stretch that no other can continue, one that waits for others, and three that are joined.
    for (n_stretches, stretch_rows, n_new, factor) in
        [(1, N_ROWS, 1, 1), (1, 4 * N_ROWS, 1, 2), (3, 4 * N_ROWS, 1, 6)]
    {
        let take = take(n_stretches, stretch_rows);
        let decoding = peak_bytes(|| {
            let mut frames = TakeFrames::open(Cursor::new(&take)).unwrap();
            let mut row = vec![GAP; frames.info().markers.len()];
            frames.next_frame(&mut row).unwrap();
        });
        let source = SourceTake::read(&mut Cursor::new(&take)).unwrap();
        let context = EditContext {
            software: "test",
            new_scratch: &|| Err(io::ErrorKind::Unsupported.into()),
            on_rows: &|_| {},
        };
        let repacking = peak_bytes(|| {
            let report = repack(&source, Cursor::new(&take), None, io::sink(), &context).unwrap();
            assert_eq!(report.stretches, [u64::from(n_stretches), n_new]);
        });
        let most = factor * decoding + decoding / 2;
        assert!(repacking <= most, "{n_stretches}: {repacking} bytes, {decoding} to decode it");
    }
}
