//! Codes trajectories that are already in memory on several threads: the import path.

mod jobs;

use std::{
    io::Write,
    sync::atomic::{AtomicU64, Ordering},
};

use anyhow::Context;
use mocapd_take::{
    motion::Motion,
    record::Header,
    whole::{Coded, Part, Plan, WholeWriter},
};

pub use self::jobs::in_order;
pub use mocapd_take::whole::stretch_rows;

use super::{Written, messages::PartReport};

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
    let plan = Plan::new(motion, header)?;
    let mut take = WholeWriter::new(&plan, header, out)
        .context("cannot write the take's header, or what is beside trajectories")?;
    let mut report = PartReport::default();
    let worker = || {
        let mut encoder = plan.encoder();
        move |part: &Part| {
            let coded = encoder.encode(*part)?;
            progress.fetch_add((part.n_rows * part.n_markers) as u64, Ordering::Relaxed);
            Ok(coded)
        }
    };
    in_order(plan.parts(), n_workers, worker, |part, coded: Coded| {
        coded.reports.iter().for_each(|channel| report.add_channel(channel));
        take.push(*part, &coded).context("cannot write a stretch")
    })?;
    let (ledger, out, file_bytes) = take.finish().context("cannot close the take")?;
    let PartReport { samples, kept, max_error_mm, .. } = report;
    let written = Written { ledger, file_bytes, samples, kept, max_error_mm, ..Written::default() };
    Ok((written, out))
}
