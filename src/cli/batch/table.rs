//! The table at the end of a command over many files: how many had which result, and their sums.

use std::fmt::Write;

use mocapd::outcome::Outcome;

use super::{Figures, FileReport};
use crate::cli::values::{bytes, length_of_time, thousands};

/// The files with one result, and their sums.
#[derive(Debug, Default)]
struct Row {
    files: u64,
    sums: Figures,
}

/// The results of the files.
#[derive(Debug, Default)]
pub(super) struct Table {
    done: Row,
    unchanged: Row,
    lossy: Row,
    failed: Row,
    /// Other names of files that were read.
    repeated: Row,
}

impl Table {
    /// Counts a file whose report is complete.
    pub(super) fn add(&mut self, report: &FileReport) {
        let row = match (report.data_lost, report.figures.is_unchanged) {
            (true, _) => &mut self.lossy,
            (false, true) => &mut self.unchanged,
            (false, false) => &mut self.done,
        };
        row.files += 1;
        row.sums.add(&report.figures);
    }

    /// Counts a file, or a folder, that failed.
    pub(super) fn add_failure(&mut self) {
        self.failed.files += 1;
    }

    /// Counts another name of a file, such as a link to it, which is left out.
    pub(super) fn add_repeated(&mut self) {
        self.repeated.files += 1;
    }

    /// The outcome of all files together: the worst of them.
    pub(super) fn outcome(&self) -> Outcome {
        if self.failed.files > 0 { Outcome::Failed } else { Outcome::of(self.lossy.files > 0) }
    }

    /// The table as text; `done` is what was done, such as `imported`. With `has_ratio` it has the ratio
    /// of bytes read to bytes written.
    pub(super) fn text(&self, done: &str, has_ratio: bool) -> String {
        let rows = [
            (done, &self.done),
            ("unchanged", &self.unchanged),
            ("data lost", &self.lossy),
            ("failed", &self.failed),
            ("same file", &self.repeated),
        ];
        let writes = rows.iter().any(|(_, row)| row.sums.bytes_written > 0);
        let mut out =
            format!("{:<12}{:>8}{:>14}{:>14}{:>11}", "", "files", "frames", "length", "read");
        out += if writes { "    written" } else { "" };
        out += if writes && has_ratio { "   ratio\n" } else { "\n" };
        for (name, Row { files, sums }) in
            rows.into_iter().filter(|(name, row)| row.files > 0 || *name == done)
        {
            write!(out, "{name:<12}{:>8}", thousands(*files)).ok();
            if sums.bytes_read > 0 {
                let (frames, length) = (thousands(sums.frames), length_of_time(sums.seconds));
                write!(out, "{frames:>14}{length:>14}{:>11}", bytes(sums.bytes_read)).ok();
            }
            if sums.bytes_written > 0 {
                write!(out, "{:>11}", bytes(sums.bytes_written)).ok();
                if has_ratio {
                    let ratio = sums.bytes_read as f64 / sums.bytes_written as f64;
                    write!(out, "{ratio:>8.1}").ok();
                }
            }
            out.push('\n');
        }
        out
    }
}

impl Figures {
    fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.seconds += other.seconds;
        self.bytes_read += other.bytes_read;
        self.bytes_written += other.bytes_written;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(data_lost: bool, is_unchanged: bool) -> FileReport {
        let figures = Figures {
            frames: 600,
            seconds: 10.0,
            bytes_read: 36_000,
            bytes_written: 1_200,
            is_unchanged,
        };
        FileReport { data_lost, figures, ..FileReport::default() }
    }

    #[test]
    fn results_are_counted_and_summed_and_the_worst_decides() {
        let mut table = Table::default();
        (0..3).for_each(|_| table.add(&report(false, false)));
        assert_eq!(table.outcome(), Outcome::Done);
        table.add(&report(false, true));
        table.add(&report(true, false));
        assert_eq!(table.outcome(), Outcome::DataLost);
        table.add_repeated();
        assert_eq!(table.outcome(), Outcome::DataLost);
        table.add_failure();
        assert_eq!(table.outcome(), Outcome::Failed);
        assert_eq!(
            table.text("imported", true),
            "               files        frames        length       read    written   ratio\n\
             imported           3         1 800        30.0 s   108.0 kB    3 600 B    30.0\n\
             unchanged          1           600        10.0 s    36.0 kB    1 200 B    30.0\n\
             data lost          1           600        10.0 s    36.0 kB    1 200 B    30.0\n\
             failed             1\n\
             same file          1\n"
        );
    }
}
