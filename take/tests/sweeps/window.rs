//! Files that claim more than they hold, and chunks longer than the reader's window: memory is limited by the window, a
//! file is read at most twice, and every valid chunk is found.

use std::{
    fs::File,
    io::{self, Cursor, Read, Seek, SeekFrom},
    os::unix::fs::FileExt,
    sync::Arc,
};

use mocapd_codec::{BlockReport, ResamplerKind, Rows, Settings, Tolerance};
use mocapd_take::{
    TakeError, TakeEvent, TakeFrames, TakeMap, TakeReader, TakeWriter,
    chunk::{self, CHUNK_HELD_MAX, WINDOW_BYTES, types},
    foreign::content::ScratchFile,
    motion::{Foreign, UpAxis},
    reader::{feed, read_events},
    record::{Channel, Header, Ledger},
    recovery::RecoveryScan,
    statistics::{BlockTally, StretchTally},
    stretch::{Span, StretchHeaderWriter, put_block},
    timeline::Timeline,
};

use mocapd_testkit::random::Random;

use crate::{counting::peak_bytes, take};

/// Memory of a reader: a window that grows to its full size, and tables of some MiB.
const HELD_MAX: usize = 2 * WINDOW_BYTES + (8 << 20);

const MIB: usize = 1 << 20;

/// A scratch file.
#[derive(Debug)]
pub(super) struct Scratch(pub(super) File);

impl ScratchFile for Scratch {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.0.read_exact_at(bytes, at)
    }

    fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all_at(bytes, at)
    }
}

/// A file that counts the bytes read.
struct Counted<'a> {
    file: Cursor<&'a [u8]>,
    read: usize,
}

impl Read for Counted<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read(bytes)?;
        self.read += n;
        Ok(n)
    }
}

impl Seek for Counted<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// The result of reading a file.
#[derive(Debug, Default, PartialEq)]
struct Found {
    stretches: Vec<Span>,
    foreign: Vec<(String, u64)>,
    skipped: Vec<u8>,
    damaged: Vec<(u64, u64)>,
    finished: bool,
}

fn found(take: &[u8]) -> Found {
    let mut found = Found::default();
    let mut input = Counted { file: Cursor::new(take), read: 0 };
    let memory = peak_bytes(|| {
        let mut reader = TakeReader::new();
        loop {
            match reader.next_event().unwrap() {
                Some(TakeEvent::Stretch(stretch)) => found.stretches.push(stretch.span),
                Some(TakeEvent::Foreign(part)) => {
                    found.foreign.push((part.kind.clone(), part.data_bytes()));
                }
                Some(TakeEvent::Skipped { kind }) => found.skipped.push(kind),
                Some(TakeEvent::Damaged { offset, len, .. }) => found.damaged.push((offset, len)),
                Some(TakeEvent::End { finished, bytes }) => {
                    found.finished = finished;
                    assert_eq!(bytes.sum(), take.len() as u64);
                    return;
                }
                Some(_) => {}
                None => feed(&mut input, &mut reader).unwrap(),
            }
        }
    });
    assert!(memory < HELD_MAX, "{memory} bytes held");
    // Twice, and after each long chunk the piece with its end.
    let read_max = 2 * take.len() + take.len() / 64;
    assert!(input.read <= read_max, "{} of {} bytes read", input.read, take.len());
    found
}

/// The chunks of a whole take.
fn chunks(take: &[u8]) -> Vec<&[u8]> {
    let mut rest = &take[chunk::MAGIC.len()..];
    let mut chunks = Vec::new();
    while let chunk::ChunkParse::Whole { len, .. } = chunk::parse(rest) {
        let (chunk, behind) = rest.split_at(len);
        chunks.push(chunk);
        rest = behind;
    }
    assert!(rest.is_empty());
    chunks
}

/// The take with `middle` after its first key stretches.
fn with(take: &[u8], middle: &[u8]) -> (Vec<u8>, u64) {
    let chunks = chunks(take);
    let mut damaged = chunk::MAGIC.to_vec();
    chunks[..25].iter().for_each(|chunk| damaged.extend_from_slice(chunk));
    let at = damaged.len() as u64;
    damaged.extend_from_slice(middle);
    chunks[25..].iter().for_each(|chunk| damaged.extend_from_slice(chunk));
    (damaged, at)
}

/// Type and length of a chunk.
fn head(kind: u8, len: u64) -> Vec<u8> {
    let mut head = vec![kind];
    let mut left = len;
    while left >= 0x80 {
        head.push(left as u8 | 0x80);
        left >>= 7;
    }
    head.push(left as u8);
    head
}

/// An incompressible foreign part, as an importer keeps it.
fn stored(kind: &str, data: &[u8]) -> Vec<u8> {
    let mut payload = head(kind.len() as u8, 0)[..1].to_vec();
    payload.extend_from_slice(kind.as_bytes());
    payload.extend_from_slice(&head(0, data.len() as u64)[1..]);
    let pieces = data.chunks(usize::from(u16::MAX));
    let last = pieces.len() - 1;
    for (i, piece) in pieces.enumerate() {
        payload.push(u8::from(i == last));
        payload.extend_from_slice(&(piece.len() as u16).to_le_bytes());
        payload.extend_from_slice(&(!(piece.len() as u16)).to_le_bytes());
        payload.extend_from_slice(piece);
    }
    let mut chunk = Vec::new();
    chunk::put(&mut chunk, types::FOREIGN, &payload).unwrap();
    chunk
}

#[test]
fn a_file_that_claims_more_than_it_holds_costs_a_window() {
    let take = take::take("dense");
    let whole = found(&take);
    for kind in [types::STRETCH, types::FOREIGN, types::EVENT, 0xff] {
        // A gigabyte after its head, mostly a hole or noise.
        let mut middle = head(kind, 1 << 30);
        middle.extend_from_slice(&[2, 1, 1, 1]);
        let first = middle.len();
        middle.resize(first + 30 * MIB, 0);
        middle[first + 2 * MIB..first + 3 * MIB].copy_from_slice(&Random::new(1).bytes(MIB));
        let (damaged, at) = with(&take, &middle);
        let read = found(&damaged);
        assert_eq!(read.damaged, [(at, middle.len() as u64)], "type {kind:02x}");
        assert_eq!(read.finished, whole.finished);
        // The following stretches continue one that may have been there, up to the next key.
        let keys = |found: &Found| found.stretches.iter().filter(|span| span.key).count();
        assert_eq!(keys(&read), keys(&whole), "type {kind:02x}");
        let cut = found(&damaged[..at as usize + 20 * MIB]);
        assert_eq!(cut.damaged, [(at, 20 * MIB as u64)]);
        assert!(!cut.finished);
    }
}

#[test]
fn false_heads_everywhere_cost_time_in_proportion() {
    let take = take::take("dense");
    let whole = found(&take);
    let claims: [Vec<u8>; 4] = [
        head(types::STRETCH, 3 << 20),
        head(types::STRETCH, 200 << 20),
        head(types::FOREIGN, 100 << 20),
        head(types::EVENT, 900 << 20),
    ];
    for claim in claims {
        let mut middle = Vec::new();
        while middle.len() < 20 * MIB {
            middle.extend_from_slice(&claim);
            middle.extend_from_slice(&[2, b'a', b'b', 9][..1 + middle.len() % 4]);
        }
        let (damaged, at) = with(&take, &middle);
        let read = found(&damaged);
        assert_eq!(read.damaged, [(at, middle.len() as u64)]);
        assert_eq!(read.stretches.last(), whole.stretches.last());
        assert_eq!(read.finished, whole.finished);
    }
}

#[test]
fn small_chunks_between_false_heads_cost_time_in_proportion() {
    let take = take::take("dense");
    let whole = found(&take);
    // Valid by its CRC, but not an event.
    let mut empty = Vec::new();
    chunk::put(&mut empty, types::EVENT, &[]).unwrap();
    for claimed in [64 << 10, 8 << 20] {
        let pair = [head(types::STRETCH, claimed), empty.clone()].concat();
        let n_pairs = (MIB / 2) / pair.len();
        let mut middle = pair.repeat(n_pairs);
        middle.resize(middle.len() + claimed as usize, 0);
        let (damaged, at) = with(&take, &middle);
        let read = found(&damaged);
        assert_eq!(read.damaged.len(), 2 * n_pairs + 1);
        assert_eq!(read.damaged[0], (at, (pair.len() - empty.len()) as u64));
        assert_eq!(read.stretches.last(), whole.stretches.last());
        assert_eq!(read.finished, whole.finished);
    }
}

#[test]
fn a_long_record_is_damaged_and_unknown_chunks_are_skipped() {
    let take = take::take("dense");
    for kind in types::ALL.into_iter().chain([0x7f, 0xf1]) {
        let mut long = Vec::new();
        chunk::put(&mut long, kind, &vec![0; 9 * MIB]).unwrap();
        let (with_long, at) = with(&take, &long);
        let read = found(&with_long);
        let is_skipped = [types::MODEL, types::INDEX, 0xf1].contains(&kind);
        let (damaged, skipped) = match is_skipped {
            true => (vec![], vec![kind]),
            false => (vec![(at, long.len() as u64)], vec![]),
        };
        assert_eq!((read.damaged, read.skipped), (damaged, skipped), "type {kind:02x}");

        // A copied index would give the offsets of another file.
        let scan = RecoveryScan::read(&with_long).unwrap();
        let mut recovered = Vec::new();
        scan.write(Cursor::new(&with_long), &mut recovered, "sweeps").unwrap();
        let is_copied = is_skipped && kind != types::INDEX;
        let again = found(&recovered);
        assert_eq!(again.damaged, [], "type {kind:02x}");
        assert_eq!(again.skipped.len(), usize::from(is_copied), "type {kind:02x}");
        assert!(again.finished);
    }
}

#[test]
fn the_cut_off_is_reported_after_any_number_of_problems() {
    let take = take::take("dense");
    let mut empty = Vec::new();
    chunk::put(&mut empty, types::EVENT, &[]).unwrap();
    let mut cut = chunk::MAGIC.to_vec();
    chunks(&take)[..5].iter().for_each(|chunk| cut.extend_from_slice(chunk));
    let last = |take: &[u8]| RecoveryScan::read(take).unwrap().problems.last().cloned();
    let expected = last(&cut);
    assert!(expected.is_some());
    cut.extend(empty.repeat(10_100));
    assert_eq!(last(&cut), expected);
}

#[test]
fn a_valid_long_chunk_is_skipped_and_found_after_damage() {
    let take = take::take("dense");
    let data = Random::new(2).bytes(20 * MIB);
    let long = stored("c3d/analog", &data);
    assert!(long.len() as u64 > CHUNK_HELD_MAX);
    let mut unknown = Vec::new();
    chunk::put(&mut unknown, 0xf1, &data[..9 * MIB]).unwrap();
    // A whole take inside the chunk is not part of this take.
    let inner = stored("c3d/analog", &[&data[..7 * MIB], &take[..], &data[..7 * MIB]].concat());
    let middle = [&long[..], &unknown[..], &long[..], &inner[..]].concat();
    let (with_long, at) = with(&take, &middle);
    let read = found(&with_long);
    let part = ("c3d/analog".to_owned(), data.len() as u64);
    let inner_bytes = (14 * MIB + take.len()) as u64;
    let parts = vec![part.clone(), part, ("c3d/analog".to_owned(), inner_bytes)];
    assert_eq!((read.damaged.as_slice(), read.skipped.as_slice()), (&[][..], &[0xf1][..]));
    assert_eq!(read.foreign, parts);
    assert_eq!(read.stretches, found(&take).stretches);

    // Noise before it, a wrong byte in the first of them, and a wrong length.
    for (what, change) in [(0, 0), (1, 5 * MIB), (2, 2)] {
        let mut hurt = with_long.clone();
        if what == 0 {
            let mut noise = Random::new(3).bytes(100_000);
            noise[0] = 0;
            hurt.splice(at as usize..at as usize, noise);
        } else {
            hurt[at as usize + change] ^= 1;
        }
        let read = found(&hurt);
        let n_parts = if what == 0 { 3 } else { 2 };
        assert_eq!(read.foreign, parts[3 - n_parts..], "change {what}");
        assert_eq!(read.damaged.len(), 1, "change {what}: {:?}", read.damaged);
        assert_eq!(read.damaged[0].0, at);
        assert!(read.finished);
    }

    // Its content can be read, and a recovery copies it.
    let scratch = || Ok(Arc::new(Scratch(tempfile::tempfile()?)) as Arc<dyn ScratchFile>);
    let frames = TakeFrames::open_with(Cursor::new(&with_long[..]), |_| true, scratch).unwrap();
    let kept = &mocapd_take::motion::FrameSource::info(&frames).foreign;
    assert_eq!(kept[0], Foreign::exact("c3d/analog", data));
    let mut recovered = Vec::new();
    let scan = RecoveryScan::read(&with_long).unwrap();
    scan.write(Cursor::new(&with_long), &mut recovered, "sweeps").unwrap();
    assert!(!scan.lost_anything());
    assert!(recovered.windows(long.len()).step_by(1).take(10_000).any(|part| part == long));
    let again = found(&recovered);
    assert_eq!((again.foreign, again.finished), (parts, true));
    let mut changed = with_long.clone();
    changed[at as usize + MIB] ^= 1;
    let error = scan.write(Cursor::new(&changed), Vec::new(), "sweeps").unwrap_err();
    assert!(matches!(error, TakeError::Corrupt { .. }), "{error}");
}

/// An import with stretches longer than the window.
fn long_stretches() -> (Vec<u8>, Vec<u64>) {
    const ROWS: usize = 100_000;
    const CHANNELS: usize = 9;
    let tolerance = Tolerance::from_mm(1.0).unwrap();
    let settings = Settings { kind: ResamplerKind::Lossless, tolerance };
    let channel = |i| Channel { marker_id: i as u16, label: format!("m{i}"), labelled: true };
    let mut header = Header {
        software: "sweeps".to_owned(),
        take_id: [7; 16],
        created_unix_ms: 1,
        resampler: String::new(),
        codec_version: 0,
        tolerance_mm: 0.0,
        rate_hz: 10_000.0,
        up_axis: UpAxis::Z,
        device: None,
        source: None,
        channels: (0..CHANNELS).map(channel).collect(),
        stretch_rows: ROWS as u32,
        settings: Vec::new(),
    };
    header.set_codec(&settings);
    let mut random = Random::new(5);
    let mut value = || random.below(1 << 24) as f32 / 3.0;
    let path: Vec<_> = (0..ROWS).map(|_| [value(), value(), value()]).collect();
    let present = vec![true; ROWS];
    let rows = [Rows::new(&path, &present).unwrap(); CHANNELS];
    let (mut block, mut reports) = (Vec::new(), [BlockReport::default(); CHANNELS]);
    let mut encoder = settings.encoder();
    encoder.encode(&rows, &[], true, &mut block, &mut reports).unwrap();
    let tally = BlockTally::of_encoded(&block, &rows, &reports, encoder.kept_rows());
    let tally = StretchTally::of(&tally);
    let mut writer = TakeWriter::new(Vec::new(), &header).unwrap();
    let mut front = StretchHeaderWriter::new(ROWS as u32);
    let mut offsets = Vec::new();
    for number in 0..4 {
        let first_row = u64::from(number) * ROWS as u64;
        let span = Span { first_row, n_rows: ROWS as u32, key: true, number };
        let mut payload = Vec::new();
        front.put(span, &Timeline::default(), &[], true, &mut payload);
        put_block(&block, true, &mut payload);
        offsets.push(writer.bytes());
        writer.stretch(span, &payload, &tally).unwrap();
    }
    let n = 4 * ROWS as u64;
    let samples = n * CHANNELS as u64;
    let ledger = Ledger {
        finished: true,
        frames_sent: n,
        recorded: n,
        samples_announced: samples,
        samples_present: samples,
        ..Ledger::default()
    };
    (writer.finish(&ledger).unwrap().0, offsets)
}

#[test]
fn stretches_that_are_longer_than_the_window_are_read_and_each_is_found() {
    let (take, offsets) = long_stretches();
    assert!(offsets[1] - offsets[0] > CHUNK_HELD_MAX, "{offsets:?}");
    let read = found(&take);
    assert_eq!((read.stretches.len(), read.damaged.len(), read.finished), (4, 0, true));
    // In the second stretch, in its head, and between the second and the third.
    for at in [offsets[1] + 5 * MIB as u64, offsets[1] + 2, offsets[2] - 1] {
        let mut hurt = take.clone();
        hurt[at as usize] ^= 0x11;
        let read = found(&hurt);
        let numbers: Vec<u8> = read.stretches.iter().map(|span| span.number).collect();
        assert_eq!(numbers, [0, 2, 3], "byte {at}");
        assert_eq!(read.damaged, [(offsets[1], offsets[2] - offsets[1])]);
        let map = TakeMap::scan(&mut Cursor::new(&hurt)).unwrap();
        assert_eq!((map.n_rows, map.n_sampled_rows), (400_000, Some(300_000)));
    }
    let mut hurt = take.clone();
    hurt[offsets[1] as usize + 100] ^= 1;
    let scan = RecoveryScan::read(&hurt).unwrap();
    let mut recovered = Vec::new();
    scan.write(Cursor::new(&hurt), &mut recovered, "sweeps").unwrap();
    let mut n_stretches = 0;
    read_events(&recovered, |event| {
        assert!(!matches!(event, TakeEvent::Damaged { .. }));
        n_stretches += usize::from(matches!(event, TakeEvent::Stretch(_)));
        Ok(())
    })
    .unwrap();
    // And the one that replaces the lost one.
    assert_eq!(n_stretches, 4);
}
