//! The command line, its completions and its manual pages, and its output: results go to standard output, messages to
//! standard error, escaped so that no text from a file controls the terminal; files are handled as by the recorder: only
//! regular ones are read, none is overwritten, and a folder appears when it is complete.

mod generate;
mod serve;

use std::{
    fs::{self, File, OpenOptions},
    io::{self, ErrorKind, IsTerminal, Write},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow, bail};
use clap::{CommandFactory, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use mocapd_cli::{
    manual::{self, CompletionsArgs, ManArgs, UnknownCommand},
    usage::{self, ParseError, Parsed},
};
use mocapd_drivers::plain_file::{self, NotAFile};
use mocapd_take::escape::{visible, visible_json, visible_lines};
use rustix::{
    fs::{CWD, RenameFlags, renameat_with},
    io::Errno,
};
use serde::Serialize;

/// Simulate motion-capture devices that play recorded or generated motion
#[derive(Debug, Parser)]
#[command(
    name = "mocapd-sim",
    version,
    propagate_version = true,
    after_help = "Exit codes: 0 done, 1 failed, 2 usage error or invalid value"
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve a motion, or the log of a recording, as a device until Ctrl-C
    ///
    /// Prints one line on stdout: the path or URI for a host to open. The device sends frames once the host sends
    /// Start.
    #[command(after_help = serve::EXAMPLES)]
    Serve(Box<serve::ServeArgs>),
    /// Generate a data set of jumps: one C3D file per jump, and phases.csv with the phases of all jumps
    ///
    /// The default has the size of the data set of Shi et al. 2012: 326 standing long jumps by 10 subjects at 60 Hz.
    /// The folder appears when it is complete.
    Generate(generate::GenerateArgs),
    /// Print the script that completes commands and options in a shell
    #[command(after_help = COMPLETIONS_EXAMPLES)]
    Completions(CompletionsArgs),
    /// Print the manual page of a command, or write all pages into a folder
    #[command(after_help = MAN_EXAMPLES)]
    Man(ManArgs),
}

/// The error that ended the program, and its exit code.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: u8,
    pub(crate) error: anyhow::Error,
}

impl Failure {
    /// A usage error, or a value that is refused.
    fn usage(error: impl Into<anyhow::Error>) -> Self {
        Self { code: 2, error: error.into() }
    }

    /// A usage error with this message.
    fn usage_message(message: impl Into<String>) -> Self {
        Self::usage(anyhow::Error::msg(message.into()))
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { code: 1, error: error.into() }
    }
}

/// Parses the arguments; prints help and version if asked to.
pub(crate) fn parse() -> Result<Parsed<Cli>, Failure> {
    usage::parse().map_err(|error| match error {
        ParseError::Usage(message) => Failure::usage_message(message),
        failed @ ParseError::Output(_) => failed.into(),
    })
}

/// Runs the command that was given.
pub(crate) fn run(cli: Cli) -> Result<(), Failure> {
    match cli.command {
        Command::Serve(args) => serve::run(*args),
        Command::Generate(args) => generate::run(&args),
        Command::Completions(args) => completions(&args),
        Command::Man(args) => pages(&args),
    }
}

const COMPLETIONS_EXAMPLES: &str = "\
Install it, for new shells:
  mocapd-sim completions bash >~/.local/share/bash-completion/completions/mocapd-sim
  mocapd-sim completions fish >~/.config/fish/completions/mocapd-sim.fish
  mocapd-sim completions zsh >DIR/_mocapd-sim     DIR is a folder in $fpath

The Debian package already does this.";

const MAN_EXAMPLES: &str = "\
Examples:
  mocapd-sim man serve | man -l -
  mocapd-sim man --out ~/.local/share/man/man1     then: man mocapd-sim-serve

The Debian package installs the pages.";

/// The exit codes of every command.
const EXIT_STATUS: [(u8, &str); 3] = [
    (0, "Done; for serve also: ended by Ctrl-C."),
    (1, "Failed, with a message."),
    (2, "Usage error, or an invalid value."),
];

fn completions(args: &CompletionsArgs) -> Result<(), Failure> {
    Ok(print_exact(&manual::completions(args, Cli::command()))?)
}

fn pages(args: &ManArgs) -> Result<(), Failure> {
    let page = manual::pages(args, Cli::command(), &EXIT_STATUS).map_err(|error| {
        if error.is::<UnknownCommand>() { Failure::usage(error) } else { error.into() }
    })?;
    Ok(print_exact(&page)?)
}

/// Prints a one-line message on stderr, with the program's name before it.
pub(crate) fn notify(line: &str) {
    // A closed stderr is no reason to fail.
    drop(writeln!(io::stderr(), "mocapd-sim: {}", visible(line.trim_end())));
}

/// Prints lines for people on stdout.
fn print(text: &str) -> anyhow::Result<()> {
    print_exact(&visible_lines(text))
}

/// Prints a value as one indented JSON document and a line end on stdout.
fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    print_exact(&format!("{}\n", visible_json(&serde_json::to_string_pretty(value)?)))
}

/// Prints a value as a JSON document on one line: one of several documents.
fn print_json_line(value: &impl Serialize) -> anyhow::Result<()> {
    print_exact(&format!("{}\n", visible_json(&serde_json::to_string(value)?)))
}

/// Prints data for programs on stdout, unescaped. A closed pipe (`| head`) is not an error.
fn print_exact(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to standard output"),
    }
}

/// Work shorter than this shows no display.
const APPEARS_AFTER: Duration = Duration::from_secs(1);

/// A bar on stderr with the percentage and the time left, like those of `mocapd`. Nothing where stderr is not a
/// terminal.
#[derive(Debug)]
struct ProgressDisplay {
    message: &'static str,
    total: u64,
    begun: Instant,
    is_shown: bool,
    bar: Option<ProgressBar>,
}

impl ProgressDisplay {
    fn new(message: &'static str, total: u64) -> Self {
        let is_shown = io::stderr().is_terminal();
        Self { message, total, begun: Instant::now(), is_shown, bar: None }
    }

    /// Shows how much is done. Call it several times a second, so that the time left is current.
    fn update(&mut self, done: u64) {
        if !self.is_shown || self.begun.elapsed() < APPEARS_AFTER {
            return;
        }
        let bar = self.bar.get_or_insert_with(|| {
            let bar = ProgressBar::new(self.total)
                .with_message(self.message)
                .with_elapsed(self.begun.elapsed());
            match ProgressStyle::with_template("{msg} {wide_bar} {percent} % {eta}") {
                Ok(style) => bar.with_style(style),
                Err(_) => bar,
            }
        });
        bar.set_position(done);
    }
}

impl Drop for ProgressDisplay {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Opens a file for reading.
fn open_file(path: &Path) -> anyhow::Result<File> {
    plain_file::open(path).map_err(|error| cannot_read(path, error))
}

/// Why a file cannot be read, and what to do.
fn cannot_read(path: &Path, error: io::Error) -> anyhow::Error {
    let name = path.display();
    match (NotAFile::why(&error), error.kind()) {
        (Some(what), _) => anyhow!("{name} is {what}"),
        (None, ErrorKind::NotFound) => anyhow!("{name} does not exist"),
        (None, ErrorKind::PermissionDenied) => {
            anyhow!("no permission to read {name}: check it with ls -l")
        }
        (None, _) => anyhow::Error::new(error).context(format!("cannot read {name}")),
    }
}

/// Creates a file that must not exist yet.
fn create_file(path: &Path) -> anyhow::Result<File> {
    let created = OpenOptions::new().write(true).create_new(true).open(path);
    created.map_err(|error| cannot_create(path, error))
}

fn cannot_create(path: &Path, error: io::Error) -> anyhow::Error {
    let name = path.display();
    match error.kind() {
        ErrorKind::AlreadyExists => {
            anyhow!("{name} exists already: choose another name or move it")
        }
        ErrorKind::NotFound => {
            anyhow!("the folder {} does not exist: create it first", folder_of(path).display())
        }
        ErrorKind::PermissionDenied => {
            anyhow!("no permission to create {name}: choose a folder that you may write to")
        }
        _ => anyhow::Error::new(error).context(format!("cannot create {name}")),
    }
}

fn folder_of(path: &Path) -> &Path {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

/// A folder that gets its name only when it is complete. Dropping it earlier removes it with its content.
#[derive(Debug)]
struct NewFolder {
    /// Its temporary name, until it is kept.
    hidden: Option<PathBuf>,
    path: PathBuf,
}

impl NewFolder {
    /// Creates a hidden folder beside `path`, which must not exist.
    fn create(path: &Path) -> anyhow::Result<Self> {
        if path.symlink_metadata().is_ok() {
            return Err(cannot_create(path, ErrorKind::AlreadyExists.into()));
        }
        let Some(name) = path.file_name() else { bail!("{} is not a folder name", path.display()) };
        let name = format!(".{}.{}.part", name.display(), std::process::id());
        let hidden = path.with_file_name(name);
        fs::create_dir(&hidden).map_err(|error| cannot_create(path, error))?;
        Ok(Self { hidden: Some(hidden), path: path.to_owned() })
    }

    /// Writes a file into it.
    fn write(&self, name: &str, content: &[u8]) -> anyhow::Result<()> {
        let Some(hidden) = &self.hidden else { return Ok(()) };
        let written =
            create_file(&hidden.join(name)).and_then(|mut file| Ok(file.write_all(content)?));
        written.with_context(|| format!("cannot write {}", self.path.join(name).display()))
    }

    /// Gives the folder its name. A folder that appeared there meanwhile is not overwritten.
    fn keep(mut self) -> anyhow::Result<()> {
        let Some(hidden) = &self.hidden else { return Ok(()) };
        let named = match renameat_with(CWD, hidden, CWD, &self.path, RenameFlags::NOREPLACE) {
            // Some network file systems do not support this rename. The plain one refuses folders that are not empty.
            Err(Errno::INVAL | Errno::NOSYS) if self.path.symlink_metadata().is_err() => {
                fs::rename(hidden, &self.path)
            }
            other => other.map_err(io::Error::from),
        };
        named.map_err(|error| cannot_create(&self.path, error))?;
        self.hidden = None;
        Ok(())
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if let Some(hidden) = &self.hidden {
            // What cannot be removed has a name that says what it is.
            fs::remove_dir_all(hidden).ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn every_subcommand_has_a_page_with_its_options() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        run(Cli::parse_from(["mocapd-sim", "man", "--out", out])).unwrap();
        let command = Cli::command();
        let mut names: Vec<_> = command
            .get_subcommands()
            .map(|sub| format!("mocapd-sim-{}.1", sub.get_name()))
            .collect();
        names.push("mocapd-sim.1".to_owned());
        names.sort();
        let found = fs::read_dir(folder.path()).unwrap();
        let mut found: Vec<_> =
            found.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        found.sort();
        assert_eq!(found, names);
        for sub in command.get_subcommands() {
            let page = folder.path().join(format!("mocapd-sim-{}.1", sub.get_name()));
            let page = fs::read_to_string(page).unwrap().replace('\\', "");
            for option in sub.get_opts().filter(|option| !option.is_hide_set()) {
                let name = format!("--{}", option.get_long().unwrap());
                assert!(page.contains(&name), "the page of {} has no {name}", sub.get_name());
            }
        }
    }

    #[test]
    fn an_unknown_command_is_a_usage_error() {
        let failure = run(Cli::parse_from(["mocapd-sim", "man", "frob"])).unwrap_err();
        assert_eq!(failure.code, 2);
        assert_eq!(
            failure.error.to_string(),
            "'mocapd-sim' has no command 'frob'; its commands: serve, generate, completions, man"
        );
    }

    #[test]
    fn a_folder_appears_whole_or_not_at_all() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("jumps");
        let dropped = NewFolder::create(&path).unwrap();
        dropped.write("a.c3d", b"half").unwrap();
        drop(dropped);
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);

        let kept = NewFolder::create(&path).unwrap();
        kept.write("a.c3d", b"whole").unwrap();
        assert!(kept.write("a.c3d", b"again").is_err());
        kept.keep().unwrap();
        assert_eq!(fs::read(path.join("a.c3d")).unwrap(), b"whole");
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
        let refused = NewFolder::create(&path).unwrap_err().to_string();
        assert!(refused.ends_with("exists already: choose another name or move it"), "{refused}");
    }

    #[test]
    fn a_folder_that_appeared_meanwhile_stays() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("jumps");
        let late = NewFolder::create(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(late.keep().unwrap_err().to_string().contains("exists already"));
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
    }

    #[test]
    fn messages_say_what_to_do() {
        let place = tempfile::tempdir().unwrap();
        let nowhere = place.path().join("none/a.csv");
        let message = create_file(&nowhere).unwrap_err().to_string();
        assert!(message.ends_with("none does not exist: create it first"), "{message}");
        let message = open_file(&nowhere).unwrap_err().to_string();
        assert!(message.ends_with("none/a.csv does not exist"), "{message}");
        let message = open_file(place.path()).unwrap_err().to_string();
        assert!(message.ends_with(&format!("is {}", NotAFile::Folder)), "{message}");
    }
}
