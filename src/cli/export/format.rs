//! Which format, and what it needs to be told.

use std::path::Path;

use mocapd::outcome::UsageError;
use mocapd_take::interchange::{Format, bids};

use crate::cli::paths;

#[derive(Debug, clap::Args)]
pub(super) struct FormatArgs {
    /// The format, where the ending of the output does not tell it
    #[arg(long, value_name = "FORMAT")]
    format: Option<Name>,
    /// Rows of a CSV file: `wide`, one a frame; `long`, one a sample that is present
    #[arg(long, value_name = "LAYOUT", default_value = "wide")]
    layout: Layout,
    /// For csv: put an apostrophe before labels that a spreadsheet would calculate (=, +, -, @ at the beginning)
    #[arg(long)]
    for_spreadsheet: bool,
    /// Of Parquet a row a frame, with three columns a marker, instead of a row a sample
    #[arg(long)]
    wide: bool,
    /// For bids: whose motion it is, letters and digits [default: 01]
    #[arg(long, value_name = "LABEL")]
    subject: Option<String>,
    /// For bids: what was done, letters and digits [default: those of the take's name]
    #[arg(long, value_name = "LABEL")]
    task: Option<String>,
}

/// Formats by their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Name {
    C3d,
    Trc,
    Tsv,
    Csv,
    Npz,
    Xdf,
    Bids,
    Parquet,
    Mcap,
}

/// How a CSV file is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Layout {
    Wide,
    Long,
}

impl FormatArgs {
    /// The format of an output.
    ///
    /// # Errors
    /// A usage error when its ending does not tell, or an option is for another format.
    pub(super) fn of(&self, output: &Path) -> anyhow::Result<Format> {
        let format = match self.format {
            None => paths::output_format(output)?,
            Some(Name::C3d) => Format::C3d,
            Some(Name::Trc) => Format::Trc,
            Some(Name::Tsv) => Format::Tsv,
            Some(Name::Csv) => Format::Csv,
            Some(Name::Npz) => Format::Npz,
            Some(Name::Xdf) => Format::Xdf,
            Some(Name::Bids) => Format::Bids,
            Some(Name::Parquet) => Format::Parquet,
            Some(Name::Mcap) => Format::Mcap,
        };
        let usage = |words: &str| Err(UsageError(words.to_owned()).into());
        if format != Format::Bids && (self.subject.is_some() || self.task.is_some()) {
            return usage("--subject and --task are for --format bids: other formats hold neither");
        }
        if self.for_spreadsheet && format != Format::Csv {
            return usage("--for-spreadsheet is for csv: leave it out");
        }
        if self.wide && format != Format::Parquet {
            return usage("--wide is for .parquet: leave it out");
        }
        match (format, self.layout) {
            (Format::Parquet, Layout::Wide) if self.wide => Ok(Format::ParquetWide),
            (Format::Csv, Layout::Long) => Ok(Format::CsvLong),
            (_, Layout::Long) => usage("--layout long is for csv: other formats have one layout"),
            (format, Layout::Wide) => Ok(format),
        }
    }

    /// Whether labels are kept from being formulas.
    pub(super) fn is_for_spreadsheet(&self) -> bool {
        self.for_spreadsheet
    }

    /// What a BIDS dataset calls its files.
    ///
    /// # Errors
    /// A usage error when a label has anything but letters and digits.
    pub(super) fn names(&self, take: &Path) -> anyhow::Result<bids::Names> {
        let stem = take.file_stem().unwrap_or_default().to_string_lossy();
        let task = self.task.clone().unwrap_or_else(|| bids::Names::task_of(&stem));
        let subject = self.subject.as_deref().unwrap_or("01");
        bids::Names::new(subject, &task).map_err(|error| UsageError(error.to_string()).into())
    }
}
