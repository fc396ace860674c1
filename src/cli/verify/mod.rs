//! `verify`: whether a take is what it says, and how far it lies from an original.

mod against;

use std::{
    io::BufReader,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use mocapd::{files, inspect::Summary, outcome::Outcome};
use mocapd_take::record::{Header, Ledger};
use serde::Serialize;

pub(super) use self::against::AgainstReport;
use self::against::against;
use super::{
    ledger::LedgerReport,
    numbers::count,
    output::{print, print_json, say},
    paths,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    take: PathBuf,
    intact: bool,
    ledger_closes: Option<bool>,
    problems: Vec<String>,
    frames: u64,
    samples: u64,
    tolerance_mm: f64,
    stated_max_error_mm: f64,
    against: Option<AgainstReport>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let reading = || format!("cannot read {}", args.take.display());
    if let Some(original) = args.against.as_ref().filter(|path| !paths::is_take(path)) {
        paths::input_format(original)?;
    }
    let summary = Summary::read(BufReader::new(files::open(&args.take)?)).with_context(reading)?;
    let header = summary.header.as_ref().with_context(reading)?;
    let mut report = Report::new(&args.take, &summary, header);
    if let Some(original) = &args.against {
        report.against = Some(against(&args.take, original, header.tolerance_mm)?);
    }
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.words())?;
        for problem in &report.problems {
            say(&format!("{}: {problem}", args.take.display()));
        }
    }
    if let Some(losses) = summary.ledger.as_ref().and_then(|l| LedgerReport::new(l).losses()) {
        say(&format!("{}: not in the take: {losses}", args.take.display()));
    }
    if let Some(original) = &args.against
        && !report.against.as_ref().is_some_and(AgainstReport::is_within)
    {
        bail!("{} differs from {}", args.take.display(), original.display());
    }
    let lost = summary.ledger.as_ref().is_some_and(Ledger::lost_anything);
    Ok(Outcome::of(lost || !report.intact))
}

impl Report {
    fn new(take: &Path, summary: &Summary, header: &Header) -> Self {
        let mut problems = summary.problems.clone();
        let ledger_closes = summary.ledger.as_ref().map(Ledger::closes);
        if ledger_closes == Some(false) {
            problems.push("the ledger does not close".to_owned());
        }
        if let Some(ledger) = &summary.ledger
            && summary.finished
            && ledger.samples_present != summary.samples()
        {
            problems.push(format!(
                "the ledger tells of {} samples, the take holds {}",
                ledger.samples_present,
                summary.samples()
            ));
        }
        Self {
            take: take.to_owned(),
            intact: problems.is_empty(),
            ledger_closes,
            problems,
            frames: summary.rows,
            samples: summary.samples(),
            tolerance_mm: header.tolerance_mm,
            stated_max_error_mm: summary.max_error_mm(),
            against: None,
        }
    }

    fn words(&self) -> String {
        let state = if self.intact { "intact" } else { "NOT INTACT" };
        let mut out = format!(
            "{}: {state}, {}, {}, every checksum and every block checked\n",
            self.take.display(),
            count(self.frames, "frame"),
            count(self.samples, "sample")
        );
        if let Some(against) = &self.against {
            out += &against.words(self.tolerance_mm);
        }
        out
    }
}
