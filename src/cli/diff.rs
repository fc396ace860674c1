//! `diff`: shows how two takes differ, or a take and a motion file.

use std::{
    fmt::Write,
    io::BufReader,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
};

use anyhow::{Context, bail};
use mocapd::outcome::{DataLostError, Outcome, UsageError};
use mocapd_acquire::files::{self, CountingFile};
use mocapd_take::{
    TakeFrames,
    compare::{
        ContentDifference, Difference, EventDifference, FieldDifference, TimesDifference, compare,
        compare_recorded, compare_times,
    },
    damage::Problem,
    motion::FrameSource,
};
use serde::Serialize;

use super::{
    cut::open_counted,
    motion_files::{MotionSource, open_motion, read_options},
    output::{Progress, notify, print, print_json},
    paths, remote,
};
use crate::cli::{
    output::plain,
    values::{count, thousands},
};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Exit codes: 0 no difference, 1 different or failed, 2 usage error, 3 a take is damaged or its end is missing, so that \
    not all of it was compared"
)]
pub(crate) struct Args {
    /// A take
    a: PathBuf,
    /// Another take; or a .c3d, .trc, .tsv or .csv file, of which only the motion is compared
    b: PathBuf,
    /// Compare the motion only: markers, frames, gaps and samples
    #[arg(long)]
    motion: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A take whose bytes are counted as they are read.
type Frames = TakeFrames<BufReader<CountingFile>>;

/// Times that each file is read: for its map, its frames and its times.
const PASSES: u64 = 3;

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    if !paths::is_take(&args.a) {
        let message = format!("{} is not a take: name a .take first", args.a.display());
        bail!(UsageError(message));
    }
    let is_motion_file = !paths::is_take(&args.b);
    if is_motion_file {
        paths::input_format(&args.b)?;
    }
    let report = if is_motion_file { of_motion_file(args)? } else { of_takes(args)? };
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
        report.problems().for_each(notify);
    }
    let (a, b) = (args.a.display(), args.b.display());
    if !report.is_whole() {
        bail!(DataLostError(format!("{a} and {b} could not be compared as a whole")));
    } else if !report.is_equal() {
        bail!("{a} and {b} differ");
    }
    Ok(Outcome::Done)
}

/// Opens a take and reads the content of its foreign parts, if they are `wanted`.
fn open_frames(path: &Path, read: &Arc<AtomicU64>, wanted: bool) -> anyhow::Result<Frames> {
    let reading = || format!("cannot read {}", path.display());
    let input = open_counted(path, read)?;
    TakeFrames::open_with(input, |_| wanted, files::scratch).with_context(reading)
}

fn compare_motion(
    args: &Args,
    a: &mut Frames,
    b: &mut dyn FrameSource,
) -> anyhow::Result<(Difference, MotionReport)> {
    let markers = if b.info().markers.len() > a.info().markers.len() { b.info() } else { a.info() };
    let labels = markers.labels();
    let comparing = || format!("cannot compare {} with {}", args.a.display(), args.b.display());
    let difference = compare(a, b).with_context(comparing)?;
    let report = MotionReport::new(&difference, &labels);
    Ok((difference, report))
}

/// Compares a take with a motion file, which is read as it was for the import.
fn of_motion_file(args: &Args) -> anyhow::Result<DiffReport> {
    let read = Arc::default();
    // The times of rows are not read.
    let passes = PASSES - 1;
    let _progress = Progress::follow(
        "comparing",
        &read,
        passes * (remote::len_bytes(&args.a)? + remote::len_bytes(&args.b)?),
    );
    let mut a = open_frames(&args.a, &read, false)?;
    let source = MotionSource::file(&args.b)?;
    let mut b = open_motion(&source, &read_options(&a), false, &read)?;
    let (_, found) = compare_motion(args, &mut a, &mut b)?;
    Ok(DiffReport::new(args, found, None, a.problems().iter().map(|p| (&args.a, p))))
}

fn of_takes(args: &Args) -> anyhow::Result<DiffReport> {
    let read = Arc::default();
    let _progress = Progress::follow(
        "comparing",
        &read,
        PASSES * (remote::len_bytes(&args.a)? + remote::len_bytes(&args.b)?),
    );
    let mut a = open_frames(&args.a, &read, !args.motion)?;
    let mut b = open_frames(&args.b, &read, !args.motion)?;
    let content = (!args.motion).then(|| {
        let of = |frames: &Frames| (frames.map().clone(), frames.info().foreign.clone());
        let ((one, one_parts), (other, other_parts)) = (of(&a), of(&b));
        ContentDifference::between((&one, &one_parts), (&other, &other_parts))
    });
    let (_, found) = compare_motion(args, &mut a, &mut b)?;
    let content = match content {
        Some(mut content) => {
            content.foreign.extend(recorded(args, &a, &b)?);
            Some((content, times(args, &a, &b, &read)?))
        }
        None => None,
    };
    let problems = a.problems().iter().map(|problem| (&args.a, problem));
    let others = b.problems().iter().map(|problem| (&args.b, problem));
    Ok(DiffReport::new(args, found, content, problems.chain(others)))
}

/// Compares the sampled channels of two recordings.
fn recorded(args: &Args, a: &Frames, b: &Frames) -> anyhow::Result<Vec<FieldDifference>> {
    if [a, b].iter().all(|frames| frames.map().sample_groups().next().is_none()) {
        return Ok(Vec::new());
    }
    let open = |path: &Path| remote::open(path).map(BufReader::new);
    let (mut one, mut other) = (open(&args.a)?, open(&args.b)?);
    Ok(compare_recorded((a.map(), &mut one), (b.map(), &mut other))?)
}

/// Compares the times of two recordings; an import has none.
fn times(
    args: &Args,
    a: &Frames,
    b: &Frames,
    read: &Arc<AtomicU64>,
) -> anyhow::Result<Option<TimesDifference>> {
    if a.map().header.device.is_none() || b.map().header.device.is_none() {
        return Ok(None);
    }
    let inputs = (open_counted(&args.a, read)?, open_counted(&args.b, read)?);
    Ok(Some(compare_times((inputs.0, a.map()), (inputs.1, b.map()))?))
}

/// Maximum number of labels, and of events, that the text lists; the JSON has all of them.
const LISTED_MAX: usize = 10;

#[derive(Debug, Serialize)]
struct DiffReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    a: PathBuf,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    b: PathBuf,
    equal: bool,
    problems: Vec<String>,
    motion: MotionReport,
    /// `None` if only the motion was compared.
    content: Option<ContentDifference>,
    /// `None` unless both are recordings.
    times: Option<TimesDifference>,
}

#[derive(Debug, Serialize)]
struct MotionReport {
    equal: bool,
    frames: u64,
    frames_missing: u64,
    frames_lost: u64,
    markers_differing: Vec<String>,
    samples: u64,
    samples_differing: u64,
    gaps_differing: u64,
    max_distance_mm: f64,
    rms_distance_mm: f64,
    farthest: Option<SamplePlace>,
    first: Option<SamplePlace>,
    notes: Vec<String>,
}

/// A sample of a marker.
#[derive(Debug, Serialize)]
struct SamplePlace {
    frame: u64,
    marker: String,
}

impl MotionReport {
    /// `labels` are those of the motion with more markers.
    fn new(found: &Difference, labels: &[String]) -> Self {
        let place = |frame: Option<u64>, marker: Option<usize>| {
            let marker = labels.get(marker?).cloned().unwrap_or_default();
            Some(SamplePlace { frame: frame?, marker })
        };
        let first = found.first_differing;
        Self {
            equal: found.is_none(),
            frames: found.frames,
            frames_missing: found.frames_missing,
            frames_lost: found.frames_lost,
            markers_differing: found.labels_differing.clone(),
            samples: found.samples,
            samples_differing: found.bits_differing,
            gaps_differing: found.gaps_differing,
            max_distance_mm: found.max_error_mm,
            rms_distance_mm: found.rms_error_mm,
            farthest: place(found.worst_frame, found.worst_marker),
            first: place(first.map(|(frame, _)| frame), first.map(|(_, marker)| marker)),
            notes: found.notes.clone(),
        }
    }

    fn text(&self, out: &mut String) {
        let (samples, frames) = (count(self.samples, "sample"), count(self.frames, "frame"));
        writeln!(out, "motion: {samples} of {frames} compared").ok();
        for note in &self.notes {
            writeln!(out, "  {}", plain(note)).ok();
        }
        if self.samples_differing > 0 {
            let samples = count(self.samples_differing, "sample");
            let (max_mm, rms_mm) = (self.max_distance_mm, self.rms_distance_mm);
            let at = self.farthest.as_ref().map_or_else(String::new, SamplePlace::text);
            writeln!(out, "  {samples} differ, by at most {max_mm:.4} mm{at}, rms {rms_mm:.4} mm")
                .ok();
        }
        for (n, what) in [(self.frames_missing, "frame"), (self.gaps_differing, "sample")] {
            if n > 0 {
                writeln!(out, "  {} in only one of the two", count(n, what)).ok();
            }
        }
        if self.frames_lost > 0 {
            let frames = count(self.frames_lost, "frame");
            writeln!(out, "  {frames} not compared: damaged in the first").ok();
        }
        if let Some(first) = &self.first {
            writeln!(out, "  first difference{}", first.text()).ok();
        }
        if !self.markers_differing.is_empty() {
            let n = self.markers_differing.len();
            let listed = self.markers_differing.iter().take(LISTED_MAX).cloned();
            let labels = listed.collect::<Vec<_>>().join(", ");
            let more = if n > LISTED_MAX {
                format!(" and {} more", n - LISTED_MAX)
            } else {
                String::new()
            };
            writeln!(out, "  markers differ: {}{more}", plain(&labels)).ok();
        }
        if self.equal {
            writeln!(out, "  no difference").ok();
        }
    }
}

impl SamplePlace {
    fn text(&self) -> String {
        format!(" at frame {} (from 0), {}", thousands(self.frame), plain(&self.marker))
    }
}

impl DiffReport {
    /// `content`: what else was compared, with the times of two recordings.
    fn new<'a>(
        args: &Args,
        motion: MotionReport,
        content: Option<(ContentDifference, Option<TimesDifference>)>,
        problems: impl Iterator<Item = (&'a PathBuf, &'a Problem)>,
    ) -> Self {
        let (content, times) =
            content.map_or((None, None), |(content, times)| (Some(content), times));
        let equal = motion.equal
            && content.as_ref().is_none_or(ContentDifference::is_none)
            && times.as_ref().is_none_or(TimesDifference::is_none);
        let problem =
            |(path, problem): (&PathBuf, &Problem)| format!("{}: {problem}", path.display());
        let (a, b) = (args.a.clone(), args.b.clone());
        Self { a, b, equal, problems: problems.map(problem).collect(), motion, content, times }
    }

    fn is_equal(&self) -> bool {
        self.equal
    }

    /// Whether all of both was compared.
    fn is_whole(&self) -> bool {
        self.problems.is_empty()
    }

    /// What is damaged or missing.
    fn problems(&self) -> impl Iterator<Item = &str> {
        self.problems.iter().map(String::as_str)
    }

    /// A section for the motion, and one for each other kind of difference; `<` has what the first states, `>` what the
    /// second does.
    fn text(&self) -> String {
        let mut out = String::new();
        self.motion.text(&mut out);
        if let Some(times) = &self.times {
            times_text(times, &mut out);
        }
        let Some(content) = &self.content else { return out };
        for (name, fields) in [
            ("header", &content.header),
            ("settings", &content.settings),
            ("subject", &content.subject),
            ("ledger", &content.ledger),
            ("foreign parts", &content.foreign),
        ] {
            fields_text(name, fields, &mut out);
        }
        events_text(&content.events, &mut out);
        out
    }
}

fn times_text(times: &TimesDifference, out: &mut String) {
    let TimesDifference {
        ticks_differing,
        arrivals_differing,
        timecodes_differing,
        losses_differing,
        first_frame,
    } = times;
    let Some(first) = first_frame else { return };
    writeln!(out, "times: the first difference is at frame {} (from 0)", thousands(*first)).ok();
    for (n, what) in [
        (ticks_differing, "different device ticks"),
        (arrivals_differing, "different arrivals"),
        (timecodes_differing, "different timecodes"),
        (losses_differing, "lost in only one of the two, or for different causes"),
    ] {
        if *n > 0 {
            writeln!(out, "  {}: {what}", count(*n, "frame")).ok();
        }
    }
}

fn fields_text(name: &str, fields: &[FieldDifference], out: &mut String) {
    if fields.is_empty() {
        return;
    }
    writeln!(out, "{name}").ok();
    for FieldDifference { field, a, b } in fields {
        for (side, value) in [('<', a), ('>', b)] {
            if let Some(value) = value {
                writeln!(out, "  {side} {}: {}", plain(field), plain(value)).ok();
            }
        }
    }
}

fn events_text(events: &[EventDifference], out: &mut String) {
    if events.is_empty() {
        return;
    }
    writeln!(out, "events").ok();
    for EventDifference { only_in, frame, kind, text } in events.iter().take(LISTED_MAX) {
        let side = if *only_in == "a" { '<' } else { '>' };
        writeln!(out, "  {side} frame {} (from 0): {kind} {}", thousands(*frame), plain(text)).ok();
    }
    if events.len() > LISTED_MAX {
        writeln!(out, "  and {} more", thousands((events.len() - LISTED_MAX) as u64)).ok();
    }
}
