//! `doctor`: checks whether this machine can record, and shows how to fix what is in the way.

use std::path::PathBuf;

use anyhow::bail;
use mocapd::outcome::Outcome;
use mocapd_service::{
    doctor::{self, Finding, Verdict},
    units,
};
use serde::Serialize;

use super::{
    output::{plain, print, print_json},
    record::KEEP_FREE,
    values::count,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for takes; the disk test writes some megabytes there and removes them
    #[arg(long, value_name = "DIR", default_value = ".")]
    dir: PathBuf,
    /// Disk space to keep free, as for `record`
    #[arg(long, value_name = "SIZE", default_value = KEEP_FREE, value_parser = units::size_bytes, allow_hyphen_values = true)]
    keep_free: u64,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct FindingReport {
    what: String,
    verdict: &'static str,
    seen: String,
    remedy: Option<String>,
}

impl FindingReport {
    fn new(finding: Finding) -> Self {
        Self {
            what: finding.what,
            verdict: match finding.verdict {
                Verdict::Good => "good",
                Verdict::Note => "note",
                Verdict::Warning => "warning",
                Verdict::Failure => "failure",
            },
            seen: finding.seen,
            remedy: finding.remedy,
        }
    }

    /// One line for the finding, and a second one for its remedy.
    fn text(&self) -> String {
        let mut out =
            format!("{:<8} {:<24} {}\n", self.verdict, plain(&self.what), plain(&self.seen));
        if let Some(remedy) = &self.remedy {
            out += &format!("{:<8} {:<24} -> {}\n", "", "", plain(remedy));
        }
        out
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let (mut reports, mut printed) = (Vec::new(), Ok(()));
    let (mut failures, mut warnings) = (0, 0);
    doctor::examine(&args.dir, args.keep_free, &mut |finding| {
        failures += u64::from(finding.verdict == Verdict::Failure);
        warnings += u64::from(finding.verdict == Verdict::Warning);
        let report = FindingReport::new(finding);
        // The disk test takes a while, so each finding is printed as it comes.
        if !args.json && printed.is_ok() {
            printed = print(&report.text());
        }
        reports.push(report);
    });
    printed?;
    if args.json {
        print_json(&reports)?;
    } else if failures == 0 {
        print(&match warnings {
            0 => "this machine can record\n".to_owned(),
            n => format!("this machine can record; {}, see above\n", count(n, "warning")),
        })?;
    }
    if failures > 0 {
        bail!("this machine cannot record: {}, see above", count(failures, "failure"));
    }
    Ok(Outcome::Done)
}
