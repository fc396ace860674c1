//! `recover`: a take again of what can be read of one that was cut off or damaged.

mod report;

use std::{
    io::{self, BufWriter, Read, Seek, SeekFrom},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use anyhow::Context;
use mocapd::outcome::Outcome;
use mocapd_acquire::{
    files::{NewFile, SparseFile},
    header::SOFTWARE,
};
use mocapd_take::recovery::{Survey, mend_start};

use self::report::Report;
use super::{
    output::Progress,
    output::{print, print_json, say},
    paths,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take that was cut off or damaged; it is only read
    take: PathBuf,
    /// The take to write; it must not exist
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    paths::check_take_output(&args.output)?;
    let name = args.take.display();
    let reading = || format!("cannot read {name}");
    let file = SparseFile::open(&args.take)?;
    let file_bytes = file.len_bytes().with_context(reading)?;
    let read = Arc::new(AtomicU64::new(0));
    // Once to look, once to copy.
    let progress = Progress::follow("recovering", &read, 2 * file_bytes);
    let (mut input, mended) =
        mend_start(Counted { file, read: Arc::clone(&read) }).with_context(reading)?;
    let survey = Survey::read(&mut input).with_context(reading)?;
    let writing = || format!("cannot write {}", args.output.display());
    let mut output = NewFile::create(&args.output)?;
    let written =
        survey.write(&mut input, BufWriter::new(&mut output), SOFTWARE).with_context(writing)?;
    drop(progress);
    output.keep()?;

    let problems: Vec<String> =
        mended.iter().chain(&survey.problems).map(ToString::to_string).collect();
    let report = Report::new(args, &survey, problems, file_bytes, written);
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.words())?;
        for problem in report.problems() {
            say(&format!("{name}: {problem}"));
        }
    }
    if survey.lost_anything() {
        say(&format!("{name}: {}", survey.losses_in_words()));
    }
    Ok(Outcome::of(survey.lost_anything()))
}

/// A file, and how much of it was read.
#[derive(Debug)]
struct Counted {
    file: SparseFile,
    read: Arc<AtomicU64>,
}

impl Read for Counted {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read(bytes)?;
        self.read.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }
}

impl Seek for Counted {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}
