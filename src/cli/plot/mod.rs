//! `plot`: plots of takes, as SVG or PNG. `plot trajectory` draws one marker, in space and
//! against time; `plot quality` each marker's gaps, noise and error.

mod pose;
mod sampled;
mod sizes;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
    time::Duration,
};

use anyhow::{Context, bail};
use clap::Subcommand;
use fontdb::Database;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::files::Kept;
use mocapd_report::{
    column::{Column, distance},
    decoded::DecodedTake,
    plot::{QualityPlot, TrajectoryPlot, png, quality, trajectory},
};
use mocapd_service::units;
use mocapd_take::{interchange::column_labels, motion::frame_at};
use serde::Serialize;

use crate::cli::{
    batch::{self, Batch, Destination, Figures, FileKinds, FileReport, InputArgs, Job, outputs},
    motion_files::{Original, file_name, read_original, read_picture_source, write_new},
    output::{notify, plain_path},
    paths::{self, InputFormatName, ends_in},
    values::{TimeOrFormat, split_to, time_or_format},
};
use pose::up;

#[derive(Debug, Subcommand)]
pub(crate) enum Plot {
    /// Plot one marker: original samples, kept samples and the reconstruction, in space and against time
    Trajectory(TrajectoryArgs),
    /// Plot stick figures at several times, the original above and the reconstruction below
    Pose(pose::Args),
    /// Plot the size of the take against the tolerance, by resampler, one panel per take or file
    Sizes(sizes::Args),
    /// Plot the sampled channels of an imported C3D file or of a recording against time
    Analog(sampled::AnalogArgs),
    /// Plot the force plates of an imported C3D file or of a recording: forces and centres of pressure, beside the trajectory of a marker
    Forces(sampled::ForcesArgs),
    /// Plot the rigid bodies of a recording: position and rotation of each, under the trajectory of a marker
    Bodies(sampled::BodiesArgs),
    /// Plot each marker's gaps, noise and, with --against, error
    Quality(PictureArgs),
}

/// Most characters that a message names: enough to know the script.
const NAMED_CHARACTERS_MAX: usize = 3;

pub(crate) fn run(plot: &Plot) -> anyhow::Result<Outcome> {
    match plot {
        Plot::Trajectory(args) => draw_trajectory(args),
        Plot::Pose(args) => pose::run(args),
        Plot::Sizes(args) => sizes::run(args),
        Plot::Analog(args) => sampled::run_analog(args),
        Plot::Forces(args) => sampled::run_forces(args),
        Plot::Bodies(args) => sampled::run_bodies(args),
        Plot::Quality(args) => draw_quality(args),
    }
}

/// Checks that a picture can be created at `path`.
///
/// # Errors
/// A usage error for an extension other than .svg and .png; the errors of [`paths::check_output`].
pub(crate) fn check_output(path: &Path) -> anyhow::Result<()> {
    if !ends_in(path, "svg") && !ends_in(path, "png") {
        return Err(paths::unknown_ending(path, ".svg or .png"));
    }
    paths::check_output(path)
}

/// Writes a picture in the format of its extension.
///
/// # Errors
/// If it cannot be drawn or written.
pub(crate) fn write(path: &Path, svg: &str) -> anyhow::Result<()> {
    if !ends_in(path, "png") {
        return write_new(path, svg.as_bytes());
    }
    write_new(path, &rendered(svg, &|message| notify(&format!("{}: {message}", path.display())))?)
}

/// A picture as PNG; reports characters that no font has.
fn rendered(svg: &str, notify: &dyn Fn(&str)) -> anyhow::Result<Vec<u8>> {
    static INSTALLED: OnceLock<Arc<Database>> = OnceLock::new();
    let installed = || {
        let load = || {
            let mut fonts = Database::new();
            fonts.load_system_fonts();
            Arc::new(fonts)
        };
        Arc::clone(INSTALLED.get_or_init(load))
    };
    let picture = png(svg, installed)?;
    if let Some(message) = without_font(&picture.missing) {
        notify(&message);
    }
    Ok(picture.bytes)
}

/// What to do about characters that no font has.
fn without_font(missing: &[char]) -> Option<String> {
    let named = missing.iter().take(NAMED_CHARACTERS_MAX);
    let named: Vec<String> = named.map(|&c| format!("{c} (U+{:04X})", u32::from(c))).collect();
    let more = missing.len().checked_sub(named.len()).filter(|n| *n > 0);
    let more = more.map_or_else(String::new, |n| format!(" and {n} more"));
    (!missing.is_empty()).then(|| {
        format!(
            "no installed font has {}{more}, drawn as boxes: install one, such as Debian's fonts-noto-cjk for Chinese, Japanese and Korean, or fonts-noto-core for most others; or write .svg",
            named.join(", ")
        )
    })
}

/// Reads the original of a take; warns if the two do not match.
///
/// # Errors
/// If it cannot be read.
fn original(job: &Job<'_>, decoded: &DecodedTake, path: &Path) -> anyhow::Result<Original> {
    let (motion, settings) = read_original(&job.input.path, path)?;
    let take = job.input.name.display();
    if motion.info.labels() != decoded.motion.info.labels() {
        job.notify_of(path, &format!("its labels differ from those of {take}"));
    }
    let (n, n_decoded) = (motion.n_frames(), decoded.motion.n_frames());
    if n != n_decoded {
        let lengths = format!("has {n} frames, {take} has {n_decoded}");
        job.notify_of(path, &format!("{lengths}: plotted from the first frame of each"));
    }
    Ok((motion, settings))
}

/// The arguments that every plot of one take has.
#[derive(Debug, clap::Args)]
pub(crate) struct PictureArgs {
    /// Takes, or .c3d, .trc, .tsv or .csv files, or folders with such files; `-` reads standard input, with --format
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// The plot to write, .svg or .png, which must not exist; or the folder for the plots of several files, with --to;
    /// `-` writes to standard output [default: beside each file]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Format of the plots: svg or png [default: by the extension of the output, else svg]; or, for `trajectory`, `analog`,
    /// `forces` and `bodies`, a time: plot frames before it
    #[arg(long, value_name = "FORMAT|TIME", allow_hyphen_values = true, value_parser = time_or_format::<PictureFormat>(), hide_possible_values = true)]
    to: Vec<TimeOrFormat<PictureFormat>>,
    #[command(flatten)]
    input: InputArgs,
    /// Format of standard input, and of files whose extension does not show it
    #[arg(long, value_name = "FORMAT")]
    format: Option<InputFormatName>,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// Print one JSON document, or one per line for several files
    #[arg(long)]
    json: bool,
}

/// A format of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PictureFormat {
    Svg,
    Png,
}

impl PictureFormat {
    fn extension(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            Self::Png => "png",
        }
    }

    fn of(path: &Path) -> Option<Self> {
        let formats = [Self::Svg, Self::Png];
        formats.into_iter().find(|format| ends_in(path, format.extension()))
    }
}

/// A file to plot, read into memory.
pub(crate) struct Picture<'a> {
    /// The work on the file.
    pub(crate) job: &'a Job<'a>,
    /// Its name in the plot.
    pub(crate) name: String,
    /// Its content. A motion file has no knots.
    pub(crate) take: DecodedTake,
    /// Its original, with the settings of an original that is a take.
    pub(crate) original: Option<Original>,
    /// The time given with `--to`.
    pub(crate) end: Option<Duration>,
}

/// The part of the take that a plot can show: all of it, or a range of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TimeSpan {
    All,
    Range,
}

/// The report of a plot, documented in docs/json.md.
#[derive(Debug, Serialize)]
struct PlotReport {
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    file: PathBuf,
    #[serde(serialize_with = "mocapd_acquire::files::path_as_text")]
    output: PathBuf,
    /// Whether the output existed with the same content.
    unchanged: bool,
    problems: Vec<String>,
}

impl PictureArgs {
    /// Plots every file: `draw` makes the SVG of one.
    ///
    /// # Errors
    /// A usage error, or for a single file why it cannot be plotted.
    fn run(
        &self,
        span: TimeSpan,
        draw: impl Fn(&Picture<'_>) -> anyhow::Result<String> + Sync,
    ) -> anyhow::Result<Outcome> {
        let (end, to) = split_to(&self.to)?;
        if end.is_some() && span == TimeSpan::All {
            bail!(UsageError(
                "--to is the format of this plot, svg or png: omit the time".to_owned()
            ));
        }
        let format = self.format.map(Into::into);
        let inputs = batch::inputs::find(&self.files, &self.input, FileKinds::Both, format)?;
        if self.against.is_some() && !inputs.is_single {
            bail!(UsageError("--against is for one take: plot the others without it".to_owned()));
        }
        let destination = Destination::of(self.output.as_deref(), &inputs)?;
        match &destination {
            Destination::File(path) => check_output(path)?,
            Destination::Stdout => paths::check_stdout(self.json)?,
            Destination::Folder(_) | Destination::Beside => {}
        }
        let by_extension = self.output.as_deref().and_then(PictureFormat::of);
        if let (Destination::File(path), Some(to), Some(named)) = (&destination, to, by_extension)
            && to != named
        {
            bail!(UsageError(format!(
                "{} and --to {} name different formats: give one",
                path.display(),
                to.extension()
            )));
        }
        let picture = to.or(by_extension).unwrap_or(PictureFormat::Svg);
        let paths_of_outputs = destination.paths(&inputs, picture.extension())?;
        let in_folder = matches!(destination, Destination::Folder(_) | Destination::Beside);
        let batch = Batch {
            inputs: &inputs,
            outputs: &paths_of_outputs,
            json: self.json,
            text_to_stderr: true,
            lines_to_stderr: false,
            threads: batch::thread_count(None),
            doing: "plotting",
            done: "plotted",
            is_compression: false,
        };
        batch::run(&batch, |job| self.plot(job, (picture, end), in_folder, &draw))
    }

    fn plot(
        &self,
        job: &Job<'_>,
        (format, end): (PictureFormat, Option<Duration>),
        in_folder: bool,
        draw: &impl Fn(&Picture<'_>) -> anyhow::Result<String>,
    ) -> anyhow::Result<FileReport> {
        let output = job.output.context("no output name: please report this bug")?;
        let (take, bytes_read) = read_picture_source(job)?;
        let original = self.against.as_ref().map(|path| original(job, &take, path)).transpose()?;
        let picture = Picture { job, name: file_name(&job.input.name), take, original, end };
        let svg = draw(&picture)?;
        let bytes = match format {
            PictureFormat::Png => rendered(&svg, &|message| job.notify_of(output, message))?,
            PictureFormat::Svg => svg.into_bytes(),
        };
        let ((), kept) = outputs::write_whole(output, in_folder, |out| {
            out.write_all(&bytes).with_context(|| format!("cannot write {}", output.display()))
        })?;
        let take = &picture.take;
        let report = PlotReport {
            file: job.input.name.clone(),
            output: output.to_owned(),
            unchanged: kept == Kept::Unchanged,
            problems: take.problems.iter().map(ToString::to_string).collect(),
        };
        let frames = take.motion.n_frames() as u64;
        Ok(FileReport {
            // The plot of a damaged take shows only what could be read.
            data_lost: !take.problems.is_empty(),
            line: format!("{}\n", plain_path(output)),
            json: job.json(&report)?,
            figures: Figures {
                frames,
                seconds: frames as f64 / take.motion.info.rate_hz,
                bytes_read,
                bytes_written: bytes.len() as u64,
                is_unchanged: report.unchanged,
            },
            ..FileReport::default()
        })
    }
}

fn draw_quality(args: &PictureArgs) -> anyhow::Result<Outcome> {
    args.run(TimeSpan::All, |picture| {
        let original = picture.original.as_ref();
        Ok(quality(&QualityPlot {
            name: &picture.name,
            take: &picture.take,
            original: original.map(|(motion, _)| motion),
            original_settings: original.and_then(|(_, settings)| *settings),
        })?)
    })
}

#[derive(Debug, clap::Args)]
pub(crate) struct TrajectoryArgs {
    #[command(flatten)]
    picture: PictureArgs,
    /// Label of the marker [default: the marker with the longest path]
    #[arg(long, value_name = "LABEL")]
    marker: Option<String>,
    /// Plot frames from this time on: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
}

fn draw_trajectory(args: &TrajectoryArgs) -> anyhow::Result<Outcome> {
    args.picture.run(TimeSpan::Range, |picture| draw(args, picture))
}

fn draw(args: &TrajectoryArgs, picture: &Picture<'_>) -> anyhow::Result<String> {
    let decoded = &picture.take;
    let motion = &decoded.motion;
    let (n_frames, rate_hz) = (motion.n_frames(), motion.info.rate_hz);
    let row = |time: Duration| usize::try_from(frame_at(time, rate_hz)).unwrap_or(usize::MAX);
    let rows = (args.from.map_or(0, row), picture.end.map_or(n_frames, row));
    if rows.0 >= rows.1.min(n_frames) {
        let length_s = n_frames as f64 / rate_hz;
        anyhow::bail!(UsageError(format!(
            "no frames between --from and --to: the take has {n_frames} frames, {length_s:.3} s"
        )));
    }
    Ok(trajectory(&TrajectoryPlot {
        name: &picture.name,
        take: decoded,
        original: picture.original.as_ref().map(|(motion, _)| motion),
        marker: marker(decoded, args.marker.as_deref())?,
        rows,
        up: up(motion),
    })?)
}

/// The column of the marker with this label, or of the one with the longest path.
fn marker(decoded: &DecodedTake, label: Option<&str>) -> anyhow::Result<usize> {
    let markers = &decoded.motion.info.markers;
    if let Some(label) = label {
        // As in exports: if several markers share a label, the second is `LABEL#2`.
        let names = column_labels(&decoded.motion.info);
        let named = names.iter().position(|name| name == label);
        let labelled = || markers.iter().position(|marker| marker.label == label);
        return named.or_else(labelled).ok_or_else(|| {
            let wanted = label.to_lowercase();
            let likeness = |name: &str| strsim::jaro_winkler(&name.to_lowercase(), &wanted);
            let nearest = names.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
            let hint = nearest.map_or_else(String::new, |name| format!("; did you mean '{name}'?"));
            UsageError(format!("no marker has the label '{label}'{hint}")).into()
        });
    }
    let path_mm = |marker: usize| {
        let samples: Vec<_> = Column::of(&decoded.motion, marker).0.into_iter().flatten().collect();
        samples.windows(2).map(|pair| distance(pair[0], pair[1])).sum::<f64>()
    };
    // An unlabelled one may be several reflections in turn: its path is long for that alone.
    let labelled = || (0..markers.len()).filter(|&marker| markers[marker].labelled);
    let candidates: Vec<usize> = if labelled().next().is_some() {
        labelled().collect()
    } else {
        (0..markers.len()).collect()
    };
    let longest = candidates.into_iter().max_by(|&a, &b| path_mm(a).total_cmp(&path_mm(b)));
    Ok(longest.unwrap_or(0))
}
