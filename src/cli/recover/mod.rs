//! `recover`: writes a new take from what can be read of a truncated or damaged one.

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
use mocapd_take::recovery::{RecoveryScan, repair_start};

use self::report::RecoverReport;
use super::{
    output::{Progress, notify, print, print_json},
    paths,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The truncated or damaged take; it is not changed
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
    // The file is read twice: to scan it and to copy it.
    let progress = Progress::follow("recovering", &read, 2 * file_bytes);
    let (mut input, repaired) =
        repair_start(CountingReader { file, read: Arc::clone(&read) }).with_context(reading)?;
    let scan = RecoveryScan::read(&mut input).with_context(reading)?;
    let writing = || format!("cannot write {}", args.output.display());
    let mut output = NewFile::create(&args.output)?;
    let written =
        scan.write(&mut input, BufWriter::new(&mut output), SOFTWARE).with_context(writing)?;
    drop(progress);
    output.keep()?;

    let problems: Vec<String> =
        repaired.iter().chain(&scan.problems).map(ToString::to_string).collect();
    let report = RecoverReport::new(args, &scan, problems, file_bytes, written);
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
        for problem in &report.problems {
            notify(&format!("{name}: {problem}"));
        }
    }
    if scan.lost_anything() {
        notify(&format!("{name}: {}", scan.loss_summary()));
    }
    Ok(Outcome::of(scan.lost_anything()))
}

/// A file that counts the bytes read from it, for the progress bar.
#[derive(Debug)]
pub(super) struct CountingReader {
    pub(super) file: SparseFile,
    pub(super) read: Arc<AtomicU64>,
}

impl Read for CountingReader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read(bytes)?;
        self.read.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }
}

impl Seek for CountingReader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}
