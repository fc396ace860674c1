//! The options of an export: the format and its own options, labels that a spreadsheet would read as formulas, and with
//! `--from` and `--to` the frames of a take within a range of time.

use std::{
    io,
    ops::Range,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use anyhow::{bail, ensure};
use mocapd::outcome::UsageError;
use mocapd_codec::Tolerance;
use mocapd_take::{
    TakeMap,
    foreign::force_plates::Baseline,
    interchange::{
        Format, bids,
        page_motion::{ADDED_MM_MIN, Lattice},
    },
    motion::{FrameSource, MotionInfo, Position, frame_at},
};

use crate::cli::{paths, values::tolerance};

/// What a page adds to the error of a take whose own tolerance is smaller, in millimetres.
const ADDED_MM: f64 = 0.1;

#[derive(Debug, clap::Args)]
pub(super) struct FormatArgs {
    /// Format of the output [default: by its extension]
    #[arg(long, value_name = "FORMAT")]
    format: Option<FormatName>,
    /// Layout of a CSV file: `wide`, one row per frame; `long`, one row per sample present
    #[arg(long, value_name = "LAYOUT", default_value = "wide")]
    layout: CsvLayout,
    /// For csv: put an apostrophe before labels that a spreadsheet would take for a formula (starting with =, +, - or
    /// @)
    #[arg(long)]
    pub(super) for_spreadsheet: bool,
    /// For parquet: one row per frame, with three columns per marker, instead of one row per sample
    #[arg(long)]
    wide: bool,
    /// For mot: subtract the mean of each force plate channel over the frames that the C3D file declares unloaded
    /// (`FORCE_PLATFORM:ZERO`)
    #[arg(long)]
    subtract_baseline: bool,
    /// For c3d: resample the sampled channels of a recording that do not have a whole number of samples in each frame, or
    /// another one than others, with a low-pass (docs/formats.md); without it they are left out. For mot: the force plates
    /// of groups that are slower than others
    #[arg(long)]
    pub(super) resample: bool,
    /// For html: largest distance of a position from the original, that of the take included: 1mm, 500um [default: twice the
    /// tolerance of the take, at least 0.1mm]
    #[arg(long, value_name = "LENGTH", value_parser = tolerance, allow_hyphen_values = true)]
    tolerance: Option<Tolerance>,
    /// For bids: label of the subject, letters and digits [default: 01]
    #[arg(long, value_name = "LABEL")]
    subject: Option<String>,
    /// For bids: label of the session, letters and digits, if the subject has several
    #[arg(long, value_name = "LABEL")]
    session: Option<String>,
    /// For bids: number of the run, if the subject has several of the task
    #[arg(long, value_name = "NUMBER")]
    run: Option<String>,
    /// For bids: label of the task, letters and digits [default: the letters and digits of the take's name]
    #[arg(long, value_name = "LABEL")]
    task: Option<String>,
}

/// A format, by its name on the command line, which is also its extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum FormatName {
    C3d,
    Trc,
    Tsv,
    Csv,
    Npz,
    Xdf,
    Bids,
    Mot,
    Html,
    Parquet,
    Mcap,
}

/// The layout of a CSV file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum CsvLayout {
    Wide,
    Long,
}

impl FormatName {
    /// The extension of its files; empty for a folder.
    pub(super) fn extension(self) -> &'static str {
        match self {
            Self::C3d => "c3d",
            Self::Trc => "trc",
            Self::Tsv => "tsv",
            Self::Csv => "csv",
            Self::Npz => "npz",
            Self::Xdf => "xdf",
            Self::Bids => "",
            Self::Mot => "mot",
            Self::Html => "html",
            Self::Parquet => "parquet",
            Self::Mcap => "mcap",
        }
    }
}

impl FormatArgs {
    /// The format given with `--format`, or else `to`, given with `--to`.
    ///
    /// # Errors
    /// A usage error if both are given and differ.
    pub(super) fn name(&self, to: Option<FormatName>) -> anyhow::Result<Option<FormatName>> {
        match (self.format, to) {
            (Some(format), Some(to)) if format != to => {
                Err(UsageError("--format and --to name different formats: give one".to_owned())
                    .into())
            }
            (format, to) => Ok(format.or(to)),
        }
    }

    /// The format with this name, or else that of the extension of `output`.
    ///
    /// # Errors
    /// A usage error if the extension is unknown, or an option belongs to another format.
    pub(super) fn of(&self, name: Option<FormatName>, output: &Path) -> anyhow::Result<Format> {
        let format = match name {
            None => paths::output_format(output)?,
            Some(FormatName::C3d) => Format::C3d,
            Some(FormatName::Trc) => Format::Trc,
            Some(FormatName::Tsv) => Format::Tsv,
            Some(FormatName::Csv) => Format::Csv,
            Some(FormatName::Npz) => Format::Npz,
            Some(FormatName::Xdf) => Format::Xdf,
            Some(FormatName::Bids) => Format::Bids,
            Some(FormatName::Mot) => Format::Mot,
            Some(FormatName::Html) => Format::Html,
            Some(FormatName::Parquet) => Format::Parquet,
            Some(FormatName::Mcap) => Format::Mcap,
        };
        let usage = |message: &str| Err(UsageError(message.to_owned()).into());
        let labels = [&self.subject, &self.session, &self.run, &self.task];
        if format != Format::Bids && labels.into_iter().any(Option::is_some) {
            return usage(
                "--subject, --session, --task and --run are for --format bids: omit them",
            );
        }
        if self.subtract_baseline && format != Format::Mot {
            return usage("--subtract-baseline is for .mot: omit it");
        }
        if self.resample && !matches!(format, Format::C3d | Format::Mot) {
            return usage(
                "--resample is for .c3d and .mot: omit it, other formats have the samples and their times",
            );
        }
        if self.tolerance.is_some() && format != Format::Html {
            return usage(
                "--tolerance is for .html: omit it, other formats have the samples of the take",
            );
        }
        if self.for_spreadsheet && format != Format::Csv {
            return usage("--for-spreadsheet is for csv: omit it");
        }
        if self.wide && format != Format::Parquet {
            return usage("--wide is for .parquet: omit it");
        }
        match (format, self.layout) {
            (Format::Parquet, CsvLayout::Wide) if self.wide => Ok(Format::ParquetWide),
            (Format::Csv, CsvLayout::Long) => Ok(Format::CsvLong),
            (_, CsvLayout::Long) => usage("--layout long is for csv: omit it"),
            (format, CsvLayout::Wide) => Ok(format),
        }
    }

    /// What is subtracted from the channels of force plates.
    pub(super) fn baseline(&self) -> Baseline {
        if self.subtract_baseline { Baseline::Subtracted } else { Baseline::AsStored }
    }

    /// What coding for a page may add to the error of a take with this tolerance.
    ///
    /// # Errors
    /// A usage error if the requested tolerance leaves nothing for it.
    pub(super) fn lattice(&self, take_tolerance_mm: f64) -> anyhow::Result<Lattice> {
        let Some(tolerance) = self.tolerance else {
            return Ok(Lattice::within(take_tolerance_mm.max(ADDED_MM)));
        };
        let added_mm = tolerance.mm() - take_tolerance_mm;
        if added_mm >= ADDED_MM_MIN {
            return Ok(Lattice::within(added_mm));
        }
        Err(UsageError(format!(
            "--tolerance {} mm: the samples of the take are within {take_tolerance_mm} mm, and the page needs at least \
             {ADDED_MM_MIN} mm more",
            tolerance.mm()
        ))
        .into())
    }

    /// The labels in the file names of a BIDS dataset.
    ///
    /// # Errors
    /// A usage error if a label has other characters than letters and digits.
    pub(super) fn names(&self, take: &Path) -> anyhow::Result<bids::BidsLabels> {
        let stem = take.file_stem().unwrap_or_default().to_string_lossy();
        let task = self.task.clone().unwrap_or_else(|| bids::BidsLabels::task_of(&stem));
        let subject = self.subject.as_deref().unwrap_or("01");
        let (session, run) = (self.session.as_deref(), self.run.as_deref());
        bids::BidsLabels::new(subject, session, &task, run)
            .map_err(|error| UsageError(error.to_string()).into())
    }
}

/// Characters that begin a formula in a spreadsheet, full-width ones included, and the white space that some
/// spreadsheets skip before one.
const FORMULAS: [char; 10] = ['=', '+', '-', '@', '\t', '\r', '＝', '＋', '－', '＠'];

/// A source that puts an apostrophe before labels that would begin a formula; spreadsheets then read them as text.
pub(super) struct EscapedLabels<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
}

/// Puts an apostrophe before a label that would begin a formula.
pub(super) fn escape(label: &mut String) {
    if label.starts_with(FORMULAS) {
        label.insert(0, '\'');
    }
}

impl<'a> EscapedLabels<'a> {
    pub(super) fn new(frames: &'a mut dyn FrameSource) -> Self {
        let mut info = frames.info().clone();
        for marker in &mut info.markers {
            escape(&mut marker.label);
        }
        Self { frames, info }
    }
}

impl FrameSource for EscapedLabels<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        self.frames.next_frame(row)
    }

    fn stated_error_mm(&self, column: usize) -> Option<f64> {
        self.frames.stated_error_mm(column)
    }

    fn take(&self) -> Option<&TakeMap> {
        self.frames.take()
    }

    fn count_sampled(&self, n_frames: u64) {
        self.frames.count_sampled(n_frames);
    }
}

/// Maximum number of lost frames that are exported without `--to` if the take has fewer recorded ones: four hours at
/// 1000 Hz. A loss takes a few bytes in a take, but may state more frames than the disk can hold as gaps.
const LOST_FRAMES_MAX: u64 = 1 << 24;

/// The next frames of a source, up to the end of a range; counts them as they are read.
pub(super) struct CroppedFrames<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
    remaining: u64,
    counter: Arc<AtomicU64>,
}

/// The frames of a take at or after `from` and before `to`; its stretches hold `n_sampled_rows` frames.
///
/// # Errors
/// If the take has no frames; a usage error if none is in the range, or if `to` is missing and lost frames outnumber
/// both the recorded ones and [`LOST_FRAMES_MAX`].
pub(super) fn range(
    info: &MotionInfo,
    n_sampled_rows: u64,
    from: Option<Duration>,
    to: Option<Duration>,
) -> anyhow::Result<Range<u64>> {
    ensure!(info.n_frames > 0, "the take has no frames: nothing to export");
    let first = from.map_or(0, |time| frame_at(time, info.rate_hz));
    let end = to.map_or(info.n_frames, |time| frame_at(time, info.rate_hz)).min(info.n_frames);
    if first >= end {
        let length_s = info.n_frames as f64 / info.rate_hz;
        bail!(UsageError(format!(
            "no frames between --from and --to: the take is {length_s:.3} s long"
        )));
    }
    let lost = info.n_frames.saturating_sub(n_sampled_rows);
    if to.is_none() && lost > LOST_FRAMES_MAX.max(n_sampled_rows) {
        bail!(UsageError(format!(
            "{lost} of the {} frames are empty, and each would be a row of gaps: give --to to limit the export",
            info.n_frames
        )));
    }
    Ok(first..end)
}

impl<'a> CroppedFrames<'a> {
    /// The frames of `range`; the next frame of the source must be the first of them.
    pub(super) fn new(
        frames: &'a mut dyn FrameSource,
        range: &Range<u64>,
        counter: Arc<AtomicU64>,
    ) -> Self {
        let mut info = frames.info().clone();
        info.cut(range.start, range.end);
        Self { frames, remaining: info.n_frames, info, counter }
    }
}

impl FrameSource for CroppedFrames<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        if self.remaining == 0 {
            return Ok(false);
        }
        self.remaining -= 1;
        self.counter.fetch_add(1, Ordering::Relaxed);
        self.frames.next_frame(row)
    }

    fn take(&self) -> Option<&TakeMap> {
        self.frames.take()
    }

    fn is_lost(&self) -> bool {
        self.frames.is_lost()
    }

    fn count_sampled(&self, n_frames: u64) {
        self.counter.fetch_add(n_frames, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use mocapd_codec::{Settings, Tolerance};
    use mocapd_take::{
        TakeFrames, TakeWriter,
        record::{Header, Ledger},
        statistics::StretchTally,
        stretch::{Span, StretchHeaderWriter},
        timeline::Timeline,
    };

    use super::*;

    /// A take of 600 empty rows, `lost` lost ones, and 600 more empty rows.
    fn take(lost: u64) -> Vec<u8> {
        let mut header = Header {
            software: String::new(),
            take_id: [0; 16],
            created_unix_ms: 0,
            resampler: String::new(),
            codec_version: 0,
            tolerance_mm: 1.0,
            rate_hz: 60.0,
            up_axis: mocapd_take::motion::UpAxis::Unknown,
            device: None,
            source: None,
            channels: Vec::new(),
            stretch_rows: 600,
            settings: Vec::new(),
        };
        let settings = Settings {
            kind: "dense".parse().unwrap(),
            tolerance: Tolerance::from_mm(1.0).unwrap(),
        };
        header.set_codec(&settings);
        let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
        let mut front = StretchHeaderWriter::new(600);
        for (first_row, number) in [(0, 0), (600 + lost, 1)] {
            let span = Span { first_row, n_rows: 600, key: true, number };
            let mut payload = Vec::new();
            front.put(span, &Timeline::default(), &[], true, &mut payload);
            take.stretch(span, &payload, &StretchTally::default()).unwrap();
        }
        take.finish(&Ledger::default()).unwrap().0
    }

    #[test]
    fn hours_of_lost_frames_are_exported_only_with_an_end() {
        let part = |lost: u64, to_s: Option<u64>| {
            let frames = TakeFrames::open(Cursor::new(take(lost))).unwrap();
            range(
                frames.info(),
                frames.map().n_sampled_rows.unwrap_or_default(),
                None,
                to_s.map(Duration::from_secs),
            )
            .map(|range| range.end - range.start)
            .map_err(|error| error.to_string())
        };
        assert_eq!(part(LOST_FRAMES_MAX - 1200, None), Ok(LOST_FRAMES_MAX));
        let refused = part(1 << 31, None).unwrap_err();
        assert!(refused.starts_with("2147484848 of the 2147484848 frames are empty"), "{refused}");
        assert_eq!(part(1 << 31, Some(10)), Ok(600));
        assert_eq!(part(1 << 31, Some(1_000_000)), Ok(60_000_000));
    }
}
