//! How many bytes the positions of files need without loss: in blocks of `lossless` and of `lossless:predictive`,
//! compared with `xz -9` of the whole file; and the processor time of both directions of the latter.
//!
//! `cargo run --release -p mocapd-take --example lossless_positions -- FOLDER [SCALE_MM]...`
//!
//! With scales, each C3D file counts again for each of them with its positions rounded to multiples of it, as files of
//! 16-bit integers hold them (without the bounds of such integers). Blocks hold ten seconds, as the stretches of an import
//! do, and are all key blocks; every one is decoded and compared bit for bit. Times are those of this thread, in MB of
//! float32 a second.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]

mod measure;

use std::{collections::BTreeMap, fs, path::Path};

use mocapd_codec::{
    BlockReport, GROUP_CHANNELS, Position, ResamplerKind, Rows, Settings, Tolerance,
};
use mocapd_take::{
    interchange::Format,
    motion::{Motion, is_gap},
};

use self::measure::{Result, processor_s, xz};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("a folder of files is needed")?;
    let scales_mm =
        arguments.map(|scale| scale.parse()).collect::<std::result::Result<Vec<f64>, _>>()?;
    let mut paths: Vec<_> = fs::read_dir(folder)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<std::io::Result<_>>()?;
    paths.sort();
    println!(
        "| file | float32 | xz -9 of the file | lossless | predictive | ratio | encode MB/s | decode MB/s |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    // By kind of file: the sum of the logarithms of the ratios, and the number of files.
    let mut means = BTreeMap::<String, (f64, u32)>::new();
    for path in &paths {
        let Some(format) = Format::from_extension(path).filter(|format| format.is_read()) else {
            continue;
        };
        let content = fs::read(path)?;
        let Ok(motion) = format.read(&content) else { continue };
        let xz = xz(&content)?;
        let kind = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        report(path, &kind, xz, &measure(&motion)?, &mut means);
        for scale_mm in scales_mm.iter().filter(|_| format == Format::C3d) {
            let row = measure(&rounded(&motion, *scale_mm))?;
            report(path, &format!("{kind}, {scale_mm} mm"), 0, &row, &mut means);
        }
    }
    for (kind, (sum, n)) in means {
        println!("geometric mean of {n} {kind}: {:.3}", (sum / f64::from(n)).exp());
    }
    Ok(())
}

/// Bytes and seconds of the positions of one file.
#[derive(Default)]
struct Row {
    raw: usize,
    columns: usize,
    predicted: usize,
    encode_s: f64,
    decode_s: f64,
}

fn report(path: &Path, kind: &str, xz: usize, row: &Row, means: &mut BTreeMap<String, (f64, u32)>) {
    let ratio = row.columns as f64 / row.predicted as f64;
    let speed = |seconds: f64| row.raw as f64 / 1e6 / seconds;
    println!(
        "| {} ({kind}) | {} | {xz} | {} | {} | {ratio:.3} | {:.1} | {:.1} |",
        path.file_stem().unwrap_or_default().to_string_lossy(),
        row.raw,
        row.columns,
        row.predicted,
        speed(row.encode_s),
        speed(row.decode_s),
    );
    let mean = means.entry(kind.to_owned()).or_default();
    *mean = (mean.0 + ratio.ln(), mean.1 + 1);
}

/// The positions as multiples of a scale.
fn rounded(motion: &Motion, scale_mm: f64) -> Motion {
    let mut motion = motion.clone();
    for position in motion.positions_mm.iter_mut().filter(|position| !is_gap(**position)) {
        let stored = f64::from(scale_mm as f32);
        *position = position.map(|c| ((f64::from(c) / scale_mm).round() * stored) as f32);
    }
    motion
}

fn measure(motion: &Motion) -> Result<Row> {
    let (n_markers, n_frames) = (motion.info.markers.len(), motion.n_frames());
    let block_rows = ((10.0 * motion.info.rate_hz) as usize).max(1);
    let mut row = Row::default();
    for start in (0..n_frames).step_by(block_rows) {
        let frames = start..(start + block_rows).min(n_frames);
        let columns: Vec<(Vec<Position>, Vec<bool>)> = (0..n_markers)
            .map(|marker| {
                let positions = frames.clone().map(|frame| motion.frame(frame)[marker]);
                positions.map(|position| (position, !is_gap(position))).unzip()
            })
            .collect();
        for group in columns.chunks(GROUP_CHANNELS) {
            measure_group(group, &mut row)?;
        }
    }
    Ok(row)
}

fn measure_group(columns: &[(Vec<Position>, Vec<bool>)], row: &mut Row) -> Result<()> {
    let channels = columns
        .iter()
        .map(|(positions, present)| Rows::new(positions, present))
        .collect::<std::result::Result<Vec<_>, _>>()?;
    let n_rows = channels.first().map_or(0, Rows::len);
    let mut reports = vec![BlockReport::default(); channels.len()];
    let settings = |kind| {
        Ok::<_, mocapd_codec::CodecError>(Settings { kind, tolerance: Tolerance::from_mm(1.0)? })
    };
    let mut block = Vec::new();
    let columns = settings(ResamplerKind::Lossless)?;
    columns.encoder().encode(&channels, &[], true, &mut block, &mut reports)?;
    row.columns += block.len();
    row.raw += 12 * reports.iter().map(|report| report.samples as usize).sum::<usize>();
    block.clear();
    let predictive = settings(ResamplerKind::LosslessPredictive)?;
    let mut decoded = Vec::new();
    let before_s = processor_s()?;
    predictive.encoder().encode(&channels, &[], true, &mut block, &mut reports)?;
    let between_s = processor_s()?;
    predictive.decoder().decode(&block, &[], n_rows, true, &mut decoded)?;
    row.decode_s += processor_s()? - between_s;
    row.encode_s += between_s - before_s;
    row.predicted += block.len();
    for (channel, rows) in channels.iter().enumerate() {
        for index in 0..n_rows {
            let found = decoded.get(channel).filter(|rows| rows.present[index]);
            let found = found.map(|rows| rows.positions[index].map(f32::to_bits));
            if found != rows.get(index).map(|position| position.map(f32::to_bits)) {
                return Err("a block that does not decode to its samples".into());
            }
        }
    }
    Ok(())
}
