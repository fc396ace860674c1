//! How many bytes the analog samples of C3D files need as blocks of sampled channels, compared with DEFLATE, as in
//! takes of earlier versions, and with `xz -9` of the same columns; and the processor time of both directions.
//!
//! `cargo run --release -p mocapd-take --example sampled_channels -- FOLDER [SECONDS [TOLERANCE]]`
//!
//! With a tolerance, such as `1count` or `EMG*=0.1%`, all columns are those of the samples that an import with
//! `--analog-tolerance` keeps.
//!
//! Blocks hold ten seconds, as in a take, or as many as are given, and are all key blocks. Every block is decoded and compared
//! bit for bit. Files of 16-bit integers count as float32 of the same values. Times are those of this thread, in MB of
//! float32 a second.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]

mod measure;

use std::{
    fs::{self, File},
    io::{self, Write},
    os::unix::fs::FileExt,
    path::Path,
    sync::Arc,
};

use flate2::{Compression, write::DeflateEncoder};
use mocapd_codec::{
    GROUP_CHANNELS,
    sampled::{SampledDecoder, SampledEncoder},
};
use mocapd_take::{
    foreign::{
        content::ScratchFile,
        tolerance::{AnalogTolerance, ChannelTolerance},
    },
    interchange::Format,
};

use self::measure::{Result, processor_s, xz};

/// Bytes of the header of a block of columns (docs/foreign.md).
const HEADER_BYTES: usize = 26;

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).ok_or("a folder of C3D files is needed")?;
    let block_s: f64 = std::env::args().nth(2).map_or(Ok(10.0), |seconds| seconds.parse())?;
    let tolerance: Option<ChannelTolerance> =
        std::env::args().nth(3).map(|tolerance| tolerance.parse()).transpose()?;
    let tolerance = AnalogTolerance(tolerance.into_iter().collect());
    let mut paths: Vec<_> = fs::read_dir(folder)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<io::Result<_>>()?;
    paths.retain(|path| {
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("c3d"))
    });
    paths.sort();
    println!(
        "| file | raw | deflate | xz -9 | blocks | deflate/blocks | xz/blocks | encode MB/s | decode MB/s |"
    );
    let (mut product, mut product_xz, mut n_files) = (1.0, 1.0, 0);
    for path in &paths {
        let Some(row) = measure(path, block_s, &tolerance)? else { continue };
        let (blocks, of) = (row.blocks as f64, |bytes: usize| bytes as f64 / row.blocks as f64);
        println!(
            "| {} | {} | {} | {} | {blocks} | {:.2} | {:.2} | {:.1} | {:.1} |",
            path.file_stem().unwrap_or_default().to_string_lossy(),
            row.raw,
            row.deflate,
            row.xz,
            of(row.deflate),
            of(row.xz),
            row.raw as f64 / 1e6 / row.encode_s,
            row.raw as f64 / 1e6 / row.decode_s,
        );
        product *= of(row.deflate);
        product_xz *= of(row.xz);
        n_files += 1;
    }
    let mean = |product: f64| product.powf(1.0 / f64::from(n_files));
    println!("geometric means: deflate {:.3}, xz -9 {:.3}", mean(product), mean(product_xz));
    Ok(())
}

/// Bytes and seconds of one file.
struct Row {
    raw: usize,
    deflate: usize,
    xz: usize,
    blocks: usize,
    encode_s: f64,
    decode_s: f64,
}

/// Measures a file in blocks of `block_s` seconds; `None` if it has no analog samples, or cannot be read.
fn measure(path: &Path, block_s: f64, tolerance: &AnalogTolerance) -> Result<Option<Row>> {
    let Ok(mut motion) = Format::C3d.read(&fs::read(path)?) else { return Ok(None) };
    tolerance.apply(&mut motion.info, scratch)?;
    let Some(part) = motion.info.foreign.iter().find(|part| part.kind == "c3d/analog") else {
        return Ok(None);
    };
    let content = part.data.to_vec(u64::MAX)?.ok_or("analog samples were not kept")?;
    let (channels, ratio) = columns(&content).ok_or("an unknown layout of analog samples")?;
    let n_samples = channels.first().map_or(0, Vec::len);
    if n_samples == 0 {
        return Ok(None);
    }
    let mut deflate = DeflateEncoder::new(Vec::new(), Compression::best());
    deflate.write_all(&content)?;
    let mut row = Row {
        raw: 4 * n_samples * channels.len(),
        deflate: deflate.finish()?.len(),
        xz: xz(&content)?,
        blocks: 0,
        encode_s: 0.0,
        decode_s: 0.0,
    };
    let block_rows = ((block_s * motion.info.rate_hz) as usize * ratio).max(1);
    for group in channels.chunks(GROUP_CHANNELS) {
        let (mut encoder, mut decoder) = (SampledEncoder::new(), SampledDecoder::new());
        for start in (0..n_samples).step_by(block_rows) {
            let end = (start + block_rows).min(n_samples);
            let slices: Vec<&[f32]> = group.iter().map(|channel| &channel[start..end]).collect();
            let mut block = Vec::new();
            let before_s = processor_s()?;
            encoder.encode(&slices, true, &mut block)?;
            let between_s = processor_s()?;
            let decoded = decoder.decode(&block, end - start, true)?;
            row.decode_s += processor_s()? - between_s;
            row.encode_s += between_s - before_s;
            row.blocks += block.len();
            let is_same =
                decoded.iter().zip(slices.concat()).all(|(a, b)| a.to_bits() == b.to_bits());
            if !is_same {
                return Err("a block that does not decode to its samples".into());
            }
        }
    }
    Ok(Some(row))
}

/// A temporary file for long parts.
#[derive(Debug)]
struct Temporary(File);

impl ScratchFile for Temporary {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.0.read_exact_at(bytes, at)
    }

    fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all_at(bytes, at)
    }
}

fn scratch() -> io::Result<Arc<dyn ScratchFile>> {
    Ok(Arc::new(Temporary(tempfile::tempfile()?)))
}

/// The columns of a block of columns as float32, and the number of samples in a frame.
fn columns(content: &[u8]) -> Option<(Vec<Vec<f32>>, usize)> {
    let (header, planes) = content.split_at_checked(HEADER_BYTES)?;
    let number =
        |at: usize| Some(u32::from_le_bytes(header.get(at..at + 4)?.try_into().ok()?) as usize);
    let (width, n_signals, ratio, n_frames) =
        (usize::from(*header.get(1)?), number(2)?, number(6)?, number(18)?);
    let n = ratio * n_frames;
    if n == 0 || n_signals == 0 {
        return Some((Vec::new(), ratio));
    }
    let column = |planes: &[u8]| {
        let mut last = 0_u32;
        let sample = |i: usize| {
            let zigzag =
                (0..width).fold(0_u32, |word, plane| word << 8 | u32::from(planes[plane * n + i]));
            last = last.wrapping_add(zigzag >> 1 ^ 0_u32.wrapping_sub(zigzag & 1));
            if width == 2 {
                return f32::from(last as u16 as i16);
            }
            f32::from_bits(if last >> 31 == 1 { last ^ 1 << 31 } else { !last })
        };
        (0..n).map(sample).collect()
    };
    Some((planes.chunks_exact(width * n).take(n_signals).map(column).collect(), ratio))
}
