//! One file, one setting: coded into memory, decoded, compared with what went in, and timed.

use std::{
    path::Path,
    sync::atomic::AtomicU64,
    time::{Duration, Instant},
};

use anyhow::ensure;
use mocapd_acquire::{inspect::Summary, pipeline::offline};
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

/// Codes, decodes and compares, then measures both `repeats` times, on one thread.
pub(super) fn measure(
    subject: &Subject<'_>,
    codec: &Settings,
    repeats: u8,
) -> anyhow::Result<Measured> {
    let header = header_of(subject.motion, subject.file, codec);
    let mut take = Vec::new();
    let encode = median_time(repeats, || {
        take.clear();
        offline::write_take(subject.motion, &header, 1, &AtomicU64::new(0), &mut take)?;
        Ok(())
    })?;
    let summary = Summary::read(&take[..])?;
    ensure!(summary.problems.is_empty(), "{}", summary.problems.join("; "));
    let mut worst_mm = 0.0_f64;
    let mut samples = 0;
    decode(&take, |decoder, first_row| {
        let (found, error_mm) = compare(decoder, subject.motion, first_row);
        samples += found;
        worst_mm = worst_mm.max(error_mm);
    })?;
    ensure!(
        samples as u64 == subject.samples(),
        "{samples} samples came back of {}",
        subject.samples()
    );
    let decode = median_time(repeats, || decode(&take, |_, _| ()))?;
    Ok(Measured::new(codec, &summary, take.len() as u64, worst_mm, (encode, decode)))
}

/// A measurement is at least so long: short against it are the clock's steps and the scheduler's.
const LEAST: Duration = Duration::from_millis(20);

/// The median of some measurements, each the mean of as many runs as it takes; after one that is not
/// measured.
fn median_time(
    repeats: u8,
    mut run: impl FnMut() -> anyhow::Result<()>,
) -> anyhow::Result<Duration> {
    let started = Instant::now();
    run()?;
    let first = started.elapsed().max(Duration::from_nanos(1));
    let runs = (LEAST.as_secs_f64() / first.as_secs_f64()).round().max(1.0) as u32;
    let mut times = Vec::new();
    for _ in 0..repeats.max(1) {
        let started = Instant::now();
        for _ in 0..runs {
            run()?;
        }
        times.push(started.elapsed() / runs);
    }
    times.sort_unstable();
    Ok(times[times.len() / 2])
}

/// Decodes a take from its bytes to float32; `found` is told the first row of each stretch.
fn decode(take: &[u8], mut found: impl FnMut(&StretchDecoder, usize)) -> anyhow::Result<()> {
    let mut decoder = None;
    read_events(take, |event| {
        match event {
            TakeEvent::Header(header) => decoder = Some(StretchDecoder::new(header.codec()?)),
            TakeEvent::Stretch(stretch) => {
                if let Some(decoder) = &mut decoder {
                    decoder.decode(&stretch)?;
                    found(decoder, stretch.span.first_row as usize);
                }
            }
            _ => {}
        }
        Ok(())
    })?;
    Ok(())
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
