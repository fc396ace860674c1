//! `bench codec`: size, error and speed of every resampler on given files, and of their sampled channels.

use std::{
    fmt::Write,
    io::Cursor,
    path::{Path, PathBuf},
    sync::atomic::AtomicU64,
    time::Duration,
};

use anyhow::{bail, ensure};
use mocapd::outcome::Outcome;
use mocapd_acquire::{
    inspect::{Summary, size_ratio},
    pipeline::offline,
};
use mocapd_codec::{Effort, ResamplerKind, Settings, SplineVariant, Tolerance};
use mocapd_take::{
    ChannelOrder, TakeEvent, TakeMap, TakeWriter,
    foreign::ForeignPart,
    motion::{Foreign, Motion, is_gap},
    reader::read_events,
    record::{Header, Ledger},
    sampled::{GroupSamples, SampledPart, SpanEncoder},
    stretch::StretchDecoder,
};
use serde::Serialize;

use super::median_time;
use crate::cli::{
    batch::{self, FileKinds, Input},
    motion_files::{header_of, read_analog_info, read_motion, read_take},
    output::{notify, plain, print, print_json},
    paths,
    values::{self, count, thousands},
};

/// Default tolerances: those of the tables in docs/benchmarks.md.
const TOLERANCES_MM: [f64; 6] = [0.1, 0.5, 1.0, 5.0, 10.0, 20.0];

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// .c3d, .trc, .tsv (QTM) or .csv files, takes, or folders with such files: their marker trajectories and, of a .c3d
    /// file, its sampled channels are coded
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// With folders, also read the files in their subfolders
    #[arg(short, long)]
    recursive: bool,
    /// A resampler; can be repeated [default: dense, fast, lossless, lossless:predictive,
    /// spline, sync]
    #[arg(long = "resampler", value_name = "NAME", value_parser = values::resampler(), hide_possible_values = true)]
    resamplers: Vec<ResamplerKind>,
    /// A tolerance; can be repeated [default: 0.1 0.5 1 5 10 20 mm]
    #[arg(long = "tolerance", value_name = "LENGTH", value_parser = values::tolerance)]
    tolerances: Vec<Tolerance>,
    /// An effort of the resampler dense, 1 to 9; can be repeated [default: 1]
    #[arg(long = "effort", value_name = "N", value_parser = str::parse::<Effort>)]
    efforts: Vec<Effort>,
    /// Measurements of each speed, of at least 20 ms and one run each; the median is reported
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=20))]
    repeats: u8,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let mut report = CodecBenchReport::default();
    let mut is_damaged = false;
    let settings = all_settings(args)?;
    let inputs = batch::inputs::find_named(&args.files, args.recursive, FileKinds::Both)?;
    for Input { path: file, .. } in inputs.all()? {
        let (motion, foreign) = if paths::is_take(file) {
            let take = read_take(file)?;
            is_damaged |= !take.problems.is_empty();
            (take.motion, read_analog_info(file)?.foreign)
        } else {
            let mut motion = read_motion(file)?;
            let foreign = std::mem::take(&mut motion.info.foreign);
            (motion, foreign)
        };
        let input = BenchInput { file, motion: &motion };
        let mut about = CodecFileReport::new(&input);
        if let Some((codec, _)) = settings.first() {
            let header = header_of(&motion.info, file, codec);
            about.sampled = measure_samples(&header, &foreign, args.repeats)?;
        }
        if !args.json {
            print(&samples_table(&about.sampled))?;
            print(&about.head())?;
        }
        for (codec, effort) in &settings {
            // A motion too long for the exhaustive search does not end the benchmark.
            match measure(&input, codec, *effort, args.repeats) {
                Ok(result) => {
                    if !args.json {
                        print(&result.line())?;
                    }
                    about.results.push(result);
                }
                Err(error) => notify(&format!("{}: {}: {error:#}", file.display(), codec.kind)),
            }
        }
        report.files.push(about);
    }
    if args.json {
        print_json(&report)?;
    }
    Ok(Outcome::of(is_damaged))
}

/// All settings to measure: lossless once, every other resampler at every tolerance, dense with every effort.
fn all_settings(args: &Args) -> anyhow::Result<Vec<(Settings, Effort)>> {
    let mut resamplers = args.resamplers.clone();
    if resamplers.is_empty() {
        resamplers = vec![
            ResamplerKind::Dense,
            ResamplerKind::Fast,
            ResamplerKind::Lossless,
            ResamplerKind::LosslessPredictive,
            ResamplerKind::Spline(SplineVariant::WorstSample),
            ResamplerKind::Sync(SplineVariant::WorstSample),
        ];
    }
    let mut tolerances = args.tolerances.clone();
    if tolerances.is_empty() {
        tolerances = TOLERANCES_MM.into_iter().map(Tolerance::from_mm).collect::<Result<_, _>>()?;
    }
    let mut settings = Vec::new();
    for kind in resamplers {
        let n = if kind.is_lossless() { 1 } else { tolerances.len() };
        let efforts = match kind {
            ResamplerKind::Dense if !args.efforts.is_empty() => &args.efforts[..],
            _ => &[Effort::MIN],
        };
        for &tolerance in &tolerances[..n] {
            let codec = Settings { kind, tolerance };
            settings.extend(efforts.iter().map(|&effort| (codec, effort)));
        }
    }
    Ok(settings)
}

/// A motion to code, and the file it was read from.
#[derive(Debug, Clone, Copy)]
struct BenchInput<'a> {
    file: &'a Path,
    motion: &'a Motion,
}

impl BenchInput<'_> {
    /// The number of samples present.
    fn samples(&self) -> u64 {
        self.motion.positions_mm.iter().filter(|&&position| !is_gap(position)).count() as u64
    }
}

/// Encodes, decodes and compares, and measures both speeds `repeats` times, on one thread.
fn measure(
    input: &BenchInput<'_>,
    codec: &Settings,
    effort: Effort,
    repeats: u8,
) -> anyhow::Result<Measured> {
    let mut header = header_of(&input.motion.info, input.file, codec);
    header.set_effort(effort);
    let mut take = Vec::new();
    let encode = median_time(repeats, || {
        take.clear();
        offline::write_take(input.motion, &header, 1, &AtomicU64::new(0), &mut take)?;
        Ok(())
    })?;
    let summary = Summary::read(&take[..])?;
    if let Some(problem) = summary.take.problems.first() {
        bail!("{problem}");
    }
    let mut worst_mm = 0.0_f64;
    let mut samples = 0;
    decode(&take, |decoder, order, first_row| {
        let (found, error_mm) = compare(decoder, order, input.motion, first_row);
        samples += found;
        worst_mm = worst_mm.max(error_mm);
    })?;
    ensure!(
        samples as u64 == input.samples(),
        "{samples} of {} samples were decoded: please report this bug",
        input.samples()
    );
    let decode = median_time(repeats, || decode(&take, |_, _, _| ()))?;
    let measured = Measured::new(codec, &summary, take.len() as u64, worst_mm, (encode, decode));
    Ok(Measured { effort: effort.level(), ..measured })
}

/// Decodes a take from its bytes to float32; `found` gets each decoded stretch, the order of its channels and its first row.
fn decode(
    take: &[u8],
    mut found: impl FnMut(&StretchDecoder, &ChannelOrder, usize),
) -> anyhow::Result<()> {
    let (mut decoder, mut order) = (None, ChannelOrder::default());
    read_events(take, |event| {
        match event {
            TakeEvent::Header(header) => decoder = Some(StretchDecoder::new(header.codec()?)),
            TakeEvent::Order(stated) => order = stated,
            TakeEvent::Stretch(stretch) => {
                if let Some(decoder) = &mut decoder {
                    decoder.decode(&stretch)?;
                    found(decoder, &order, stretch.span.first_row as usize);
                }
            }
            _ => {}
        }
        Ok(())
    })?;
    Ok(())
}

/// The number of samples of a decoded stretch, and the largest error, mm.
fn compare(
    decoder: &StretchDecoder,
    order: &ChannelOrder,
    motion: &Motion,
    first_row: usize,
) -> (usize, f64) {
    let n_markers = motion.info.markers.len();
    let (mut samples, mut worst_mm) = (0, 0.0_f64);
    for (channel, rows) in decoder.rows().enumerate().take(n_markers) {
        let Some(rows) = rows else { continue };
        let column = order.column_of(channel);
        for (row, &decoded) in rows.positions.iter().enumerate() {
            let original = motion.positions_mm[(first_row + row) * n_markers + column];
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

/// The JSON document.
#[derive(Debug, Default, Serialize)]
struct CodecBenchReport {
    files: Vec<CodecFileReport>,
}

/// The results for one file.
#[derive(Debug, Serialize)]
struct CodecFileReport {
    file: String,
    rate_hz: f64,
    frames: u64,
    markers: usize,
    samples: u64,
    raw_bytes: u64,
    sampled: Vec<MeasuredSamples>,
    results: Vec<Measured>,
}

/// The results of one setting on one file.
#[derive(Debug, Serialize)]
struct Measured {
    resampler: String,
    /// 1 for every resampler but dense.
    effort: u8,
    tolerance_mm: f64,
    /// Size of the whole take.
    bytes: u64,
    /// Size of its blocks and time line only.
    block_bytes: u64,
    kept: u64,
    ratio: f64,
    bits_per_scalar: f64,
    max_error_mm: f64,
    encode_mb_s: f64,
    decode_mb_s: f64,
}

impl CodecFileReport {
    fn new(input: &BenchInput<'_>) -> Self {
        let info = &input.motion.info;
        let samples = input.samples();
        Self {
            file: input.file.display().to_string(),
            rate_hz: info.rate_hz,
            frames: input.motion.n_frames() as u64,
            markers: info.markers.len(),
            samples,
            raw_bytes: 12 * samples,
            sampled: Vec::new(),
            results: Vec::new(),
        }
    }

    /// The heading of its table.
    fn head(&self) -> String {
        format!(
            "{}: {} markers, {} frames at {}, {} bytes of float32\n\
             {:20} {:>9} {:>10} {:>8} {:>7} {:>12} {:>10} {:>10}\n",
            plain(&self.file),
            self.markers,
            self.frames,
            values::rate(self.rate_hz),
            self.raw_bytes,
            "resampler",
            "tolerance",
            "bytes",
            "ratio",
            "bits",
            "max error",
            "encode",
            "decode"
        )
    }
}

impl Measured {
    fn new(
        codec: &Settings,
        summary: &Summary,
        bytes: u64,
        max_error_mm: f64,
        (encode, decode): (Duration, Duration),
    ) -> Self {
        let raw_bytes = summary.raw_bytes();
        let speed = |took: Duration| raw_bytes as f64 / 1e6 / took.as_secs_f64().max(1e-9);
        Self {
            resampler: codec.kind.to_string(),
            effort: Effort::MIN.level(),
            tolerance_mm: values::tolerance_mm(codec),
            bytes,
            block_bytes: summary.bytes.blocks + summary.bytes.lengths + summary.bytes.time_line,
            kept: summary.statistics.knots(),
            ratio: size_ratio(summary.samples(), bytes),
            bits_per_scalar: bytes as f64 * 8.0 / (3 * summary.samples()).max(1) as f64,
            max_error_mm,
            encode_mb_s: speed(encode),
            decode_mb_s: speed(decode),
        }
    }

    /// One line of the table.
    fn line(&self) -> String {
        let tolerance = format!("{} mm", self.tolerance_mm);
        let effort =
            if self.effort > 1 { format!(", effort {}", self.effort) } else { String::new() };
        let resampler = format!("{}{effort}", self.resampler);
        format!(
            "{:20} {:>9} {:>10} {:>8.2} {:>7.3} {:>9.4} mm {:>5.0} MB/s {:>5.0} MB/s\n",
            resampler,
            tolerance,
            self.bytes,
            self.ratio,
            self.bits_per_scalar,
            self.max_error_mm,
            self.encode_mb_s,
            self.decode_mb_s
        )
    }
}

/// The results for one foreign part with samples.
#[derive(Debug, Serialize)]
pub(super) struct MeasuredSamples {
    kind: String,
    channels: u64,
    /// Samples of each channel.
    samples: u64,
    raw_bytes: u64,
    /// Size of all its chunks in a take.
    bytes: u64,
    encode_mb_s: f64,
    decode_mb_s: f64,
}

/// Encodes and decodes the parts that have samples, and measures both speeds `repeats` times, on one thread.
fn measure_samples(
    header: &Header,
    parts: &[Foreign],
    repeats: u8,
) -> anyhow::Result<Vec<MeasuredSamples>> {
    let mut take = TakeWriter::new(Vec::new(), header)?;
    let mut encode_s = Vec::new();
    // Content that was not read, such as that of a take, is not measured.
    for part in parts.iter().filter(|part| !part.data.is_empty()) {
        let Some(plan) = take.plan_samples(part)? else {
            take.foreign(part)?;
            continue;
        };
        let mut encoder = SpanEncoder::default();
        let took = median_time(repeats, || {
            plan.spans().try_for_each(|span| encoder.encode(&span?).map(|_| ()))?;
            Ok(())
        })?;
        encode_s.push(took.as_secs_f64());
        plan.spans().try_for_each(|span| take.span(&encoder.encode(&span?)?))?;
    }
    let (take, _) = take.finish(&Ledger { finished: true, ..Ledger::default() })?;
    let map = TakeMap::scan(&mut Cursor::new(&take))?;
    let sampled = map.foreign.iter().filter_map(ForeignPart::sampled);
    let mut measured = Vec::new();
    for (part, encode_s) in sampled.zip(encode_s) {
        let decode = median_time(repeats, || {
            let undecodable = part.check(&mut Cursor::new(&take))?;
            ensure!(undecodable.is_empty(), "{undecodable:?} cannot be decoded: report this bug");
            Ok(())
        })?;
        measured.push(MeasuredSamples::new(part, encode_s, decode.as_secs_f64()));
    }
    Ok(measured)
}

impl MeasuredSamples {
    fn new(part: &SampledPart, encode_s: f64, decode_s: f64) -> Self {
        let groups = || part.groups().iter();
        let channels = groups().map(|found| found.group.channels.len() as u64).sum();
        let samples = groups().next().map_or(0, GroupSamples::n_samples);
        let raw_bytes = 4 * channels * samples;
        let speed = |seconds: f64| raw_bytes as f64 / 1e6 / seconds.max(1e-9);
        Self {
            kind: groups().next().map(|found| found.group.kind.clone()).unwrap_or_default(),
            channels,
            samples,
            raw_bytes,
            bytes: groups().map(|found| found.stored_bytes).sum(),
            encode_mb_s: speed(encode_s),
            decode_mb_s: speed(decode_s),
        }
    }
}

/// One line per part.
fn samples_table(measured: &[MeasuredSamples]) -> String {
    let mut out = String::new();
    for part in measured {
        let MeasuredSamples { channels, samples, raw_bytes, bytes, .. } = part;
        writeln!(
            out,
            "{}: {}, {} of each, {} bytes of float32, {} in a take ({:.2}:1), encode {:.1} MB/s, decode {:.1} MB/s",
            plain(&part.kind),
            count(*channels, "channel"),
            count(*samples, "sample"),
            thousands(*raw_bytes),
            thousands(*bytes),
            *raw_bytes as f64 / (*bytes).max(1) as f64,
            part.encode_mb_s,
            part.decode_mb_s,
        )
        .ok();
    }
    out
}
