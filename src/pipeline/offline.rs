//! Codes trajectories that are already in memory: the import path. Each channel is one worker's from
//! its first stretch to its last, so the bytes are the same for any number of threads.

use std::{
    collections::VecDeque,
    io::Write,
    sync::{
        Mutex,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    thread::Builder,
};

use anyhow::{Context, anyhow, ensure};
use mocapd_codec::{BlockReport, Position, Rows, Settings};
use mocapd_take::{
    TakeWriter,
    motion::{Motion, is_gap},
    record::{Header, Ledger},
    stretch::{FrontWriter, NUMBERS, ROWS_MAX, SAMPLES_MAX, Span, put_block},
    timeline::Timeline,
};

use super::Written;

/// Length of a stretch of an import, and so the distance of key stretches.
const STRETCH_S: f64 = 10.0;

/// Rows of a stretch of a take at `rate_hz`: whole takes for the resamplers that are not cut.
#[must_use]
pub fn stretch_rows(codec: &Settings, rate_hz: f64, n_rows: usize, n_markers: usize) -> usize {
    if codec.kind.is_live() {
        let held = SAMPLES_MAX as usize / n_markers.max(1);
        ((STRETCH_S * rate_hz) as usize).min(held).clamp(1, 1 << 17)
    } else {
        n_rows.max(1)
    }
}

/// One channel in memory, row by row.
struct Column {
    positions: Vec<Position>,
    present: Vec<bool>,
}

impl Column {
    fn of(motion: &Motion, marker: usize) -> Self {
        let stride = motion.info.markers.len();
        let positions: Vec<_> =
            motion.positions_mm.iter().skip(marker).step_by(stride).copied().collect();
        let present = positions.iter().map(|&p| !is_gap(p)).collect();
        Self { positions, present }
    }

    fn rows(&self, first: usize, n: usize) -> anyhow::Result<Rows<'_>> {
        let range = first..(first + n).min(self.positions.len());
        Ok(Rows::new(&self.positions[range.clone()], &self.present[range])?)
    }
}

/// Codes `motion` with the settings in `header` and writes a whole take. `progress` counts samples.
///
/// # Errors
/// When the codec refuses (`spline:exhaustive` on a long take), or writing fails.
pub fn write_take<W: Write>(
    motion: &Motion,
    header: &Header,
    n_workers: usize,
    progress: &AtomicU64,
    out: W,
) -> anyhow::Result<(Written, W)> {
    let codec = header.codec()?;
    let n_rows = motion.n_frames();
    let n_markers = motion.info.markers.len();
    let stretch_rows = stretch_rows(&codec, header.rate_hz, n_rows, n_markers);
    ensure!(
        stretch_rows as u64 <= ROWS_MAX && (stretch_rows * n_markers) as u64 <= SAMPLES_MAX,
        "{n_rows} frames of {n_markers} markers are more than {} can hold in one piece: \
         use dense, fast or lossless",
        codec.kind
    );
    let columns: Vec<Column> = (0..n_markers).map(|marker| Column::of(motion, marker)).collect();
    let shared = if codec.kind.is_live() {
        Vec::new()
    } else {
        let rows: Vec<_> = columns.iter().map(|c| c.rows(0, n_rows)).collect::<Result<_, _>>()?;
        codec.plan(&rows)?
    };
    let coded = encode_all(&columns, &codec, &shared, stretch_rows, n_workers, progress)?;

    let mut take = TakeWriter::new(out, header).context("cannot write the take's header")?;
    for part in &motion.info.foreign {
        take.foreign(part).with_context(|| format!("cannot keep {}", part.kind))?;
    }
    let mut written = Written::default();
    let mut blocks: Vec<VecDeque<Vec<u8>>> = Vec::with_capacity(n_markers);
    for channel in coded {
        for report in &channel.reports {
            written.samples += u64::from(report.samples);
            written.kept += u64::from(report.kept);
            written.max_error_mm = written.max_error_mm.max(report.max_error_mm);
            written.recoded += u64::from(report.recoded);
        }
        blocks.push(channel.blocks.into());
    }
    let mut payload = Vec::new();
    let mut front = FrontWriter::new(header.stretch_rows);
    for first in (0..n_rows).step_by(stretch_rows) {
        let n = stretch_rows.min(n_rows - first);
        let number = (first / stretch_rows % usize::from(NUMBERS)) as u8;
        let span = Span { first_row: first as u64, n_rows: n as u32, key: true, number };
        payload.clear();
        let alone = blocks.len() == 1;
        front.put(span, &Timeline::default(), &shared, alone, &mut payload);
        for channel in &mut blocks {
            put_block(&channel.pop_front().unwrap_or_default(), alone, &mut payload);
        }
        take.stretch(span, &payload).context("cannot write a stretch")?;
    }
    let announced = (n_rows * n_markers) as u64;
    written.ledger = Ledger {
        finished: true,
        frames_sent: n_rows as u64,
        recorded: n_rows as u64,
        samples_announced: announced,
        samples_present: written.samples,
        samples_occluded: announced - written.samples,
        ..Ledger::default()
    };
    let (out, file_bytes) = take.finish(&written.ledger).context("cannot close the take")?;
    written.file_bytes = file_bytes;
    Ok((written, out))
}

/// One channel's blocks, stretch by stretch.
#[derive(Default)]
struct Coded {
    blocks: Vec<Vec<u8>>,
    reports: Vec<BlockReport>,
}

fn encode_all(
    columns: &[Column],
    codec: &Settings,
    shared: &[u8],
    stretch_rows: usize,
    n_workers: usize,
    progress: &AtomicU64,
) -> anyhow::Result<Vec<Coded>> {
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<Option<Coded>>> = Mutex::new(columns.iter().map(|_| None).collect());
    let lost = || anyhow!("a resampler thread failed");
    std::thread::scope(|scope| {
        let work = || -> anyhow::Result<()> {
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                let Some(column) = columns.get(index) else { return Ok(()) };
                let coded = encode(column, codec, shared, stretch_rows)?;
                progress.fetch_add(column.positions.len() as u64, Ordering::Relaxed);
                done.lock().map_err(|_| lost())?[index] = Some(coded);
            }
        };
        let mut workers = Vec::new();
        for index in 0..n_workers.clamp(1, columns.len().max(1)) {
            let name = format!("mocapd-work-{index}");
            workers.push(Builder::new().name(name).spawn_scoped(scope, work)?);
        }
        workers.into_iter().try_for_each(|worker| worker.join().map_err(|_| lost())?)
    })?;
    done.into_inner().map_err(|_| lost())?.into_iter().map(|coded| coded.ok_or_else(lost)).collect()
}

fn encode(
    column: &Column,
    codec: &Settings,
    shared: &[u8],
    stretch_rows: usize,
) -> anyhow::Result<Coded> {
    let mut encoder = codec.encoder();
    let mut coded = Coded::default();
    for first in (0..column.positions.len()).step_by(stretch_rows) {
        let mut block = Vec::new();
        let rows = column.rows(first, stretch_rows)?;
        coded.reports.push(encoder.encode(rows, shared, true, &mut block)?);
        coded.blocks.push(block);
    }
    Ok(coded)
}
