//! Codes trajectories that are already in memory: the import path. Every stretch is a key stretch, so
//! that groups of channels over stretches are coded on their own, whichever thread takes them, and the
//! bytes are the same for any number of threads.

mod columns;
mod jobs;

use std::{
    io::Write,
    sync::atomic::{AtomicU64, Ordering},
};

use anyhow::{Context, ensure};
use mocapd_codec::{GROUP_CHANNELS, Settings};
use mocapd_take::{
    TakeWriter,
    motion::Motion,
    record::{Header, Ledger},
    stretch::{FrontWriter, LIVE_ROWS_MAX, NUMBERS, ROWS_MAX, SAMPLES_MAX, Span, put_block},
    timeline::Timeline,
};

use self::{columns::Columns, jobs::in_order};
use super::{Written, messages::PartReport};

/// Length of a stretch of an import, and so the distance of key stretches.
const STRETCH_S: f64 = 10.0;

/// Rows of a stretch of a take at `rate_hz`: whole takes for the resamplers that are not cut.
#[must_use]
pub fn stretch_rows(codec: &Settings, rate_hz: f64, n_rows: usize, n_markers: usize) -> usize {
    if codec.kind.is_live() {
        let held = SAMPLES_MAX as usize / n_markers.max(1);
        ((STRETCH_S * rate_hz) as usize).min(held).clamp(1, LIVE_ROWS_MAX as usize)
    } else {
        n_rows.max(1)
    }
}

/// One group over one stretch.
#[derive(Debug, Clone, Copy)]
struct Part {
    first_row: usize,
    n_rows: usize,
    first_marker: usize,
    n_markers: usize,
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
    let shared = columns::plan(motion, &codec)?;
    let parts = (0..n_rows).step_by(stretch_rows).flat_map(|first_row| {
        // A take without markers has its stretches all the same.
        (0..n_markers.max(1)).step_by(GROUP_CHANNELS).map(move |first_marker| Part {
            first_row,
            n_rows: stretch_rows.min(n_rows - first_row),
            first_marker,
            n_markers: GROUP_CHANNELS.min(n_markers - first_marker),
        })
    });

    let mut take = TakeWriter::new(out, header).context("cannot write the take's header")?;
    for part in &motion.info.foreign {
        take.foreign(part).with_context(|| format!("cannot keep {}", part.kind))?;
    }
    let mut payload = Vec::new();
    let mut front = FrontWriter::new(header.stretch_rows);
    let mut report = PartReport::default();
    let alone = n_markers <= GROUP_CHANNELS;
    let worker = || {
        let (mut encoder, mut columns) = (codec.encoder(), Columns::default());
        let shared = &shared;
        move |part: &Part| {
            columns.fill(motion, *part);
            let mut block = Vec::new();
            let report = columns.encode(&mut *encoder, shared, &mut block)?;
            progress.fetch_add((part.n_rows * part.n_markers) as u64, Ordering::Relaxed);
            Ok((block, report))
        }
    };
    in_order(parts, n_workers, worker, |part, (block, of_part): (Vec<u8>, PartReport)| {
        let number = (part.first_row / stretch_rows % usize::from(NUMBERS)) as u8;
        let (first_row, n_rows) = (part.first_row as u64, part.n_rows as u32);
        let span = Span { first_row, n_rows, key: true, number };
        if part.first_marker == 0 {
            payload.clear();
            front.put(span, &Timeline::default(), &shared, alone, &mut payload);
        }
        put_block(&block, alone, &mut payload);
        report.add(&of_part);
        if part.first_marker + part.n_markers == n_markers {
            take.stretch(span, &payload).context("cannot write a stretch")?;
        }
        Ok(())
    })?;
    let announced = (n_rows * n_markers) as u64;
    let ledger = Ledger {
        finished: true,
        frames_sent: n_rows as u64,
        recorded: n_rows as u64,
        samples_announced: announced,
        samples_present: report.samples,
        samples_occluded: announced - report.samples,
        ..Ledger::default()
    };
    let (out, file_bytes) = take.finish(&ledger).context("cannot close the take")?;
    let PartReport { samples, kept, max_error_mm, .. } = report;
    let written = Written { ledger, file_bytes, samples, kept, max_error_mm, ..Written::default() };
    Ok((written, out))
}
