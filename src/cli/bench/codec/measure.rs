//! One file, one setting: coded into memory, decoded, compared with what went in, and timed.

use std::{
    path::Path,
    sync::atomic::AtomicU64,
    time::{Duration, Instant},
};

use anyhow::ensure;
use mocapd::{inspect::Summary, pipeline::offline};
use mocapd_codec::Settings;
use mocapd_take::{
    TakeEvent,
    motion::{Motion, is_gap},
    reader::read_events,
    stretch::StretchDecoder,
};

use super::report::Measured;
use crate::cli::import::header_of;

/// What is coded.
#[derive(Debug, Clone, Copy)]
pub(super) struct Subject<'a> {
    pub(super) file: &'a Path,
    pub(super) motion: &'a Motion,
}

impl Subject<'_> {
    /// Samples present.
    pub(super) fn samples(&self) -> u64 {
        self.motion.positions_mm.iter().filter(|&&position| !is_gap(position)).count() as u64
    }
}

/// Codes, decodes and compares, `repeats` times, on one thread.
pub(super) fn measure(
    subject: &Subject<'_>,
    codec: &Settings,
    repeats: u8,
) -> anyhow::Result<Measured> {
    let header = header_of(subject.motion, subject.file, codec);
    let (mut encode, mut decode) = (Duration::MAX, Duration::MAX);
    let mut take = Vec::new();
    let mut worst_mm = 0.0;
    for _ in 0..repeats {
        take.clear();
        let started = Instant::now();
        offline::write_take(subject.motion, &header, 1, &AtomicU64::new(0), &mut take)?;
        encode = encode.min(started.elapsed());
        let (took, error_mm) = decode_and_compare(&take, subject.motion)?;
        decode = decode.min(took);
        worst_mm = error_mm;
    }
    let summary = Summary::read(&take[..])?;
    ensure!(summary.problems.is_empty(), "{}", summary.problems.join("; "));
    Ok(Measured::new(codec, &summary, take.len() as u64, worst_mm, (encode, decode)))
}

/// The time that decoding took, and the largest error found.
fn decode_and_compare(take: &[u8], motion: &Motion) -> anyhow::Result<(Duration, f64)> {
    let mut decoder = None;
    let mut decoding = Duration::ZERO;
    let mut worst_mm = 0.0_f64;
    let mut samples = 0;
    read_events(take, |event| {
        match event {
            TakeEvent::Header(header) => decoder = Some(StretchDecoder::new(header.codec()?)),
            TakeEvent::Stretch(stretch) => {
                if let Some(decoder) = &mut decoder {
                    let started = Instant::now();
                    decoder.decode(&stretch)?;
                    decoding += started.elapsed();
                    let first_row = stretch.span.first_row as usize;
                    let (found, error_mm) = compare(decoder, motion, first_row);
                    samples += found;
                    worst_mm = worst_mm.max(error_mm);
                }
            }
            _ => {}
        }
        Ok(())
    })?;
    let expected = motion.positions_mm.iter().filter(|&&position| !is_gap(position)).count();
    ensure!(samples == expected, "{samples} samples came back of {expected}");
    Ok((decoding, worst_mm))
}

/// Samples of a decoded stretch that were there, and the largest error.
fn compare(decoder: &StretchDecoder, motion: &Motion, first_row: usize) -> (usize, f64) {
    let n_markers = motion.info.markers.len();
    let (mut samples, mut worst_mm) = (0, 0.0_f64);
    for (channel, rows) in decoder.rows().enumerate().take(n_markers) {
        let Some(rows) = rows else { continue };
        for (row, &decoded) in rows.positions.iter().enumerate() {
            let original = motion.positions_mm[(first_row + row) * n_markers + channel];
            if rows.present[row] && !is_gap(original) {
                samples += 1;
                let square =
                    |axis: usize| (f64::from(decoded[axis]) - f64::from(original[axis])).powi(2);
                worst_mm = worst_mm.max((square(0) + square(1) + square(2)).sqrt());
            }
        }
    }
    (samples, worst_mm)
}
