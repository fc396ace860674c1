//! Encodes trajectories on several threads: the import path.

use std::{
    collections::VecDeque,
    io::{self, Write},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::atomic::{AtomicU64, Ordering},
    thread::Builder,
};

use anyhow::Context;
use crossbeam_channel::bounded;
pub use mocapd_take::motion_encoder::stretch_rows;
use mocapd_take::{
    ChannelOrder, TakeError,
    motion::{FrameSource, Motion, MotionFrames, MotionInfo},
    motion_encoder::{
        EncodePart, EncodeParts, EncodePlan, EncodedPart, MotionWriter,
        ordering::{self, EncodingThreads, HeldTake},
    },
    record::Header,
    sampled::{self, EncodedSpan, KeySpan, SpanEncoder},
};

use super::{TakeAccount, messages::PartReport};
use crate::threads::ResamplerFailed;

/// The source of the frames could not be read; writing the take did not fail.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct SourceFailed(pub io::Error);

/// Number of samples that [`write_frames`] encodes and counts: those of markers, missing ones included, and of sampled
/// channels.
///
/// # Errors
/// Those of the scratch file that a foreign part may be in.
pub fn sample_count(info: &MotionInfo) -> io::Result<u64> {
    let of_markers = info.n_frames.saturating_mul(info.markers.len() as u64);
    let mut of_parts = info.foreign.iter().map(sampled::sample_count);
    of_parts.try_fold(of_markers, |sum: u64, n| Ok(sum.saturating_add(n?)))
}

/// Encodes `motion` with the settings in `header` and writes a whole take. `progress` counts samples.
///
/// # Errors
/// Those of [`write_frames`].
pub fn write_take<W: Write>(
    motion: &Motion,
    header: &Header,
    n_workers: usize,
    progress: &AtomicU64,
    out: W,
) -> anyhow::Result<(TakeAccount, W)> {
    write_frames(&mut MotionFrames::new(motion), header, n_workers, progress, out)
}

/// Encodes all frames of a source with the settings in `header` and writes a whole take, in bounded memory unless the
/// resampler needs the whole take at once. `progress` counts samples, up to [`sample_count`].
///
/// # Errors
/// [`SourceFailed`] when the frames cannot be read; otherwise when the codec refuses (`spline:exhaustive` on a long
/// take), or writing fails.
pub fn write_frames<W: Write>(
    frames: &mut dyn FrameSource,
    header: &Header,
    n_workers: usize,
    progress: &AtomicU64,
    out: W,
) -> anyhow::Result<(TakeAccount, W)> {
    let (plan, parts) = EncodePlan::new(frames, header).map_err(of_source)?;
    let n_workers = n_workers.max(1);
    if plan.searches_order() {
        return write_ordered(&plan, parts, header, (n_workers, progress), out);
    }
    let info = parts.info();
    let mut take = begin(&plan, (info, header), ChannelOrder::default(), out)?;
    write_foreign(&mut take, info, n_workers, progress)?;
    let mut report = PartReport::default();
    let worker = || {
        let mut encoder = plan.encoder();
        move |part: &EncodePart| {
            let coded = encoder.encode(part)?;
            progress.fetch_add((part.n_rows * part.n_markers) as u64, Ordering::Relaxed);
            Ok(coded)
        }
    };
    let mut failed = None;
    let parts = parts.map_while(|part| part.map_err(|error| failed = Some(error)).ok());
    // Parts that continue each other are encoded by one worker.
    let n_workers = if plan.is_sequential() { 1 } else { n_workers };
    let queued_max = queued_parts_max(n_workers, plan.part_bytes());
    in_order_within(queued_max, parts, n_workers, worker, |part, coded: EncodedPart| {
        coded.reports.iter().for_each(|channel| report.add_channel(channel));
        take.push(part, &coded).context("cannot write a stretch")
    })?;
    if let Some(error) = failed {
        return Err(of_source(error));
    }
    finish(take, &report)
}

/// Encodes frames and writes a take like [`write_frames`], with its channels in the order in which they need the fewest
/// bytes. All frames are in memory.
fn write_ordered<W: Write>(
    plan: &EncodePlan,
    mut parts: EncodeParts<'_>,
    header: &Header,
    (n_workers, progress): (usize, &AtomicU64),
    out: W,
) -> anyhow::Result<(TakeAccount, W)> {
    let held: Vec<EncodePart> = parts.by_ref().collect::<Result<_, _>>().map_err(of_source)?;
    let info = parts.info();
    let held_take = HeldTake { plan, parts: &held, info, header };
    let (order, coded) = ordering::encode(held_take, &Threads(n_workers), progress)?;
    let mut take = begin(plan, (info, header), order, out)?;
    write_foreign(&mut take, info, n_workers, progress)?;
    let mut report = PartReport::default();
    for (part, coded) in held.iter().zip(&coded) {
        coded.reports.iter().for_each(|channel| report.add_channel(channel));
        take.push(part, coded).context("cannot write a stretch")?;
    }
    finish(take, &report)
}

/// So many threads.
struct Threads(usize);

impl EncodingThreads for Threads {
    type Error = anyhow::Error;

    fn run<J, T, W>(
        &self,
        jobs: impl IntoIterator<Item = J>,
        is_sequential: bool,
        worker: impl Fn() -> W + Sync,
        mut done: impl FnMut(&J, T) -> Result<(), TakeError>,
    ) -> anyhow::Result<()>
    where
        J: Send,
        T: Send,
        W: FnMut(&J) -> Result<T, TakeError>,
    {
        let n_workers = if is_sequential { 1 } else { self.0 };
        let worker = || {
            let mut work = worker();
            move |job: &J| Ok(work(job)?)
        };
        in_order(jobs, n_workers, worker, |job, result| Ok(done(job, result)?))
    }
}

fn begin<'p, W: Write>(
    plan: &'p EncodePlan,
    described: (&MotionInfo, &Header),
    order: ChannelOrder,
    out: W,
) -> anyhow::Result<MotionWriter<'p, W>> {
    let take = MotionWriter::begin_in(plan, described, order, out);
    take.context("cannot write the take's header")
}

fn finish<W: Write>(
    take: MotionWriter<'_, W>,
    report: &PartReport,
) -> anyhow::Result<(TakeAccount, W)> {
    let (ledger, out, file_bytes) = take.finish().context("cannot close the take")?;
    let &PartReport { samples, kept, max_error_mm, .. } = report;
    Ok((TakeAccount { ledger, file_bytes, samples, kept, max_error_mm, ..Default::default() }, out))
}

/// Encodes and writes everything except the trajectories.
fn write_foreign<W: Write>(
    take: &mut MotionWriter<'_, W>,
    info: &MotionInfo,
    n_workers: usize,
    progress: &AtomicU64,
) -> anyhow::Result<()> {
    let written = push_foreign(take, info, n_workers, progress);
    written.context("cannot write the take's data other than the trajectories")
}

fn push_foreign<W: Write>(
    take: &mut MotionWriter<'_, W>,
    info: &MotionInfo,
    n_workers: usize,
    progress: &AtomicU64,
) -> anyhow::Result<()> {
    for part in &info.foreign {
        let ordered = take.ordered(part)?;
        let part = ordered.as_ref().unwrap_or(part);
        let Some(plan) = take.push_foreign(part)? else { continue };
        let mut failed = None;
        let spans = plan.spans().map_while(|span| span.map_err(|error| failed = Some(error)).ok());
        let worker = || {
            let mut encoder = SpanEncoder::default();
            move |span: &KeySpan| {
                let encoded = encoder.encode(span)?;
                progress.fetch_add(span.n_samples(), Ordering::Relaxed);
                Ok(encoded)
            }
        };
        // One ahead of the workers: spans are larger than parts of trajectories, and take equally long.
        in_order_within(n_workers + 1, spans, n_workers, worker, |_, encoded: EncodedSpan| {
            Ok(take.push_span(&encoded)?)
        })?;
        if let Some(error) = failed {
            return Err(error.into());
        }
    }
    Ok(take.push_events(&info.events)?)
}

/// Wraps an I/O error of a frame source in [`SourceFailed`].
fn of_source(error: TakeError) -> anyhow::Error {
    match error {
        TakeError::Io(error) => SourceFailed(error).into(),
        other => other.into(),
    }
}

/// Parts per worker that are handed out before the oldest of them is done: enough to keep workers busy while one part
/// takes long, and the limit of what is in memory.
const QUEUED_PER_WORKER: usize = 4;

/// Memory for the samples of the parts that are handed out; each worker has one part in any case. Ten seconds of 64
/// markers at 240 Hz take 2 MiB.
const QUEUED_BYTES_MAX: usize = 64 << 20;

/// Maximum number of parts of `part_bytes` bytes that are handed out.
fn queued_parts_max(n_workers: usize, part_bytes: usize) -> usize {
    let by_memory = QUEUED_BYTES_MAX / part_bytes.max(1);
    by_memory.clamp(n_workers, QUEUED_PER_WORKER * n_workers)
}

/// Processes parts on `n_workers` threads, each with its own function from `worker`, and passes the
/// results to `done` on this thread, in the order of the parts.
///
/// # Errors
/// The first error of a worker or of `done`.
pub fn in_order<P, T, W>(
    parts: impl IntoIterator<Item = P>,
    n_workers: usize,
    worker: impl Fn() -> W + Sync,
    done: impl FnMut(&P, T) -> anyhow::Result<()>,
) -> anyhow::Result<()>
where
    P: Send,
    T: Send,
    W: FnMut(&P) -> anyhow::Result<T>,
{
    let n_workers = n_workers.max(1);
    in_order_within(QUEUED_PER_WORKER * n_workers, parts, n_workers, worker, done)
}

/// Processes parts like [`in_order`], with at most `queued_max` handed out. Parts are taken when they are handed out.
fn in_order_within<P, T, W>(
    queued_max: usize,
    parts: impl IntoIterator<Item = P>,
    n_workers: usize,
    worker: impl Fn() -> W + Sync,
    mut done: impl FnMut(&P, T) -> anyhow::Result<()>,
) -> anyhow::Result<()>
where
    P: Send,
    T: Send,
    W: FnMut(&P) -> anyhow::Result<T>,
{
    let mut parts = parts.into_iter();
    let lost = || anyhow::Error::from(ResamplerFailed);
    std::thread::scope(|scope| {
        // Created here, so that they are closed when this closure returns, and the threads end.
        let (jobs_in, jobs) = bounded::<(usize, P)>(queued_max);
        let (results_in, results) = bounded(queued_max);
        for index in 0..n_workers {
            let (jobs, results_in, worker) = (jobs.clone(), results_in.clone(), &worker);
            Builder::new().name(format!("mocapd-work-{index}")).spawn_scoped(scope, move || {
                let mut work = worker();
                while let Ok((number, part)) = jobs.recv() {
                    let result = catch_unwind(AssertUnwindSafe(|| work(&part)));
                    let result = result.unwrap_or_else(|_| Err(lost()));
                    if results_in.send((number, part, result)).is_err() {
                        return;
                    }
                }
            })?;
        }
        drop(results_in);
        // From the oldest part that is not done to the newest one handed out.
        let mut out: VecDeque<Option<(P, T)>> = VecDeque::with_capacity(queued_max);
        let mut n_done = 0;
        loop {
            while out.len() < queued_max
                && let Some(part) = parts.next()
            {
                jobs_in.send((n_done + out.len(), part)).map_err(|_| lost())?;
                out.push_back(None);
            }
            if out.is_empty() {
                return Ok(());
            }
            let (number, part, result) = results.recv().map_err(|_| lost())?;
            out[number - n_done] = Some((part, result?));
            while let Some(Some((part, result))) = out.front_mut().map(Option::take) {
                done(&part, result)?;
                out.pop_front();
                n_done += 1;
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use std::{io::Cursor, time::Duration};

    use anyhow::anyhow;
    use mocapd_codec::{Effort, ResamplerKind, Settings, Tolerance};
    use mocapd_take::{
        TakeMap,
        motion::{Foreign, Marker},
        read_motion,
    };

    use super::*;
    use crate::header;

    #[test]
    fn results_come_in_order_and_the_queue_is_bounded() {
        for n_workers in [1, 3, 8] {
            let mut next = 0;
            let worker = || {
                |part: &u64| {
                    std::thread::sleep(Duration::from_micros(part * 7919 % 300));
                    Ok(part * part)
                }
            };
            in_order(0..200, n_workers, worker, |part, square| {
                assert_eq!((*part, square), (next, next * next));
                next += 1;
                Ok(())
            })
            .unwrap();
            assert_eq!(next, 200);
        }
    }

    #[test]
    fn progress_counts_the_samples_of_sampled_channels() {
        // Three channels of 16-bit integers, ten samples in each of four frames.
        let mut data = vec![1, 2, 3, 0, 0, 0, 10, 0, 0, 0];
        data.extend([1_u64, 4].map(u64::to_le_bytes).concat());
        data.extend([0; 2 * 3 * 10 * 4]);
        let analog = Foreign::exact("c3d/analog", data);
        let info = MotionInfo {
            rate_hz: 100.0,
            n_frames: 4,
            markers: vec![Marker { label: "a".to_owned(), labelled: true }; 2],
            foreign: vec![analog],
            ..MotionInfo::default()
        };
        let motion = Motion { info, positions_mm: vec![[1.0, 2.0, 3.0]; 8] };
        let kind = ResamplerKind::Dense;
        let codec = Settings { kind, tolerance: Tolerance::from_mm(1.0).unwrap() };
        let mut header = header::of_import(&codec, 100.0);
        header.channels = header::channels(&motion.info.markers);
        header.stretch_rows = 4;
        let progress = AtomicU64::new(0);
        write_take(&motion, &header, 2, &progress, Vec::new()).unwrap();
        assert_eq!(progress.into_inner(), 2 * 4 + 3 * 10 * 4);
        assert_eq!(sample_count(&motion.info).unwrap(), 2 * 4 + 3 * 10 * 4);
    }

    /// Markers on limbs that swing with some noise, those of a limb far apart in the table.
    fn limbs() -> Motion {
        let n_rows = 150;
        let position = |row: usize, marker: usize| {
            let (limb, place, t) = (marker % 4, marker / 4, row as f32 / 20.0);
            let noise = |axis: usize| ((row * 7919 + marker * 104_729 + axis * 31) % 211) as f32;
            let swing = [t.sin(), (1.3 * t + limb as f32).cos(), (0.7 * t * limb as f32).sin()];
            std::array::from_fn(|axis| {
                swing[axis] * 90.0 * (limb + place) as f32 + noise(axis) / 50.0
            })
        };
        let marker = |marker| Marker { label: format!("m{marker}"), labelled: true };
        let info = MotionInfo {
            rate_hz: 60.0,
            n_frames: n_rows as u64,
            markers: (0..12).map(marker).collect(),
            ..MotionInfo::default()
        };
        let rows = (0..n_rows).flat_map(|row| (0..12).map(move |marker| position(row, marker)));
        Motion { info, positions_mm: rows.collect() }
    }

    #[test]
    fn the_greatest_effort_finds_the_same_smaller_order_with_any_threads() {
        let motion = limbs();
        let codec =
            Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(1.0).unwrap() };
        let mut header = header::of_import(&codec, 60.0);
        header.channels = header::channels(&motion.info.markers);
        header.stretch_rows = 600;
        header.set_effort(Effort::MAX);
        let written = [1, 3].map(|n_workers| {
            let progress = AtomicU64::new(0);
            let written = write_take(&motion, &header, n_workers, &progress, Vec::new());
            assert_eq!(progress.into_inner(), sample_count(&motion.info).unwrap());
            written.unwrap().1
        });
        assert!(written[0] == written[1]);
        let mut frames = MotionFrames::new(&motion);
        let alone = mocapd_take::import::write(&mut frames, &header, Vec::new(), || Ok(()));
        assert!(written[0] == alone.unwrap().0, "without threads");
        let map = TakeMap::open(&mut Cursor::new(&written[0])).unwrap();
        assert!(!map.order.is_identity(), "an order was found");
        assert_eq!(map.channels, header.channels);
        // The take in its own order.
        let mut frames = MotionFrames::new(&motion);
        let (plan, parts) = EncodePlan::new(&mut frames, &header).unwrap();
        let mut own = MotionWriter::new(&plan, &motion.info, &header, Vec::new()).unwrap();
        for part in parts {
            let part = part.unwrap();
            own.push(&part, &plan.encoder().encode(&part).unwrap()).unwrap();
        }
        let own = own.finish().unwrap().1;
        assert!(written[0].len() < own.len(), "{} of {} bytes", written[0].len(), own.len());
        let (found, problems) = read_motion(Cursor::new(&written[0])).unwrap();
        assert_eq!(problems, []);
        for (found, wanted) in found.positions_mm.iter().zip(&motion.positions_mm) {
            let apart = found.iter().zip(wanted).map(|(a, b)| f64::from(a - b).powi(2));
            assert!(apart.sum::<f64>().sqrt() <= 1.0);
        }
        // Summary and samples agree, in the order of the source.
        let summary = crate::inspect::Summary::read(&written[0]).unwrap();
        assert_eq!(summary.contradictions(), [] as [String; 0]);
        assert_eq!(Some(&summary.statistics), map.statistics.as_ref());
        assert_eq!(summary.health(), crate::ledger::TakeHealth::Complete);
    }

    #[test]
    fn an_error_and_a_panic_end_it() {
        for bad in [0, 5, 199] {
            let refuse = || {
                move |part: &u64| {
                    if *part == bad { Err(anyhow!("part {part}")) } else { Ok(()) }
                }
            };
            let error = in_order(0..200, 2, refuse, |_, ()| Ok(())).unwrap_err();
            assert_eq!(error.to_string(), format!("part {bad}"));
            let panicking = || {
                move |part: &u64| {
                    assert_ne!(*part, bad);
                    Ok(())
                }
            };
            let error = in_order(0..200, 2, panicking, |_, ()| Ok(())).unwrap_err();
            assert!(error.is::<ResamplerFailed>(), "{error}");
        }
        let full = |part: &u64, ()| if *part == 9 { Err(anyhow!("full")) } else { Ok(()) };
        let worker = || |_: &u64| Ok(());
        assert_eq!(in_order(0..200, 2, worker, full).unwrap_err().to_string(), "full");
    }
}
