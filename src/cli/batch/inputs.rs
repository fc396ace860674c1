//! The files that a command reads: files, folders and standard input, as given on the command line.

use std::{
    collections::{HashMap, hash_map::Entry},
    fs::{self, File},
    io::{self, IsTerminal, Read},
    os::fd::AsRawFd,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail, ensure};
use mocapd::outcome::UsageError;
use mocapd_acquire::files::{self, FileError};
use mocapd_service::units;
use mocapd_store::{ObjectUrl, Store, is_url};
use mocapd_take::interchange::Format;

use crate::cli::{
    paths::{self, InputFormat},
    remote,
};

/// Which files of a folder a command reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FileKinds {
    /// Takes.
    Takes,
    /// Motion files of other tools.
    MotionFiles,
    /// Takes and motion files.
    Both,
}

impl FileKinds {
    fn includes(self, path: &Path) -> bool {
        let is_read = || Format::from_extension(path).is_some_and(Format::is_read);
        // The files of analog channels and force plates of an export have no markers.
        let is_motion_file = || is_read() && !paths::is_sampled(path);
        match self {
            Self::Takes => paths::is_take(path),
            Self::MotionFiles => is_motion_file(),
            Self::Both => paths::is_take(path) || is_motion_file(),
        }
    }

    /// The extensions of these files, as text.
    pub(crate) fn extensions(self) -> &'static str {
        match self {
            Self::Takes => ".take",
            Self::MotionFiles => ".c3d, .trc, .tsv or .csv",
            Self::Both => ".take, .c3d, .trc, .tsv or .csv",
        }
    }
}

// The options of every command that reads many files. (A doc comment would replace the texts of the commands, in which clap
// builds these options.)
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct InputArgs {
    /// With folders, also read the files in their subfolders
    #[arg(short, long)]
    pub(crate) recursive: bool,
    /// Size limit of standard input, which is copied to a temporary file: 500MB, 8GiB
    #[arg(long, value_name = "SIZE", default_value = "4GiB", value_parser = units::size_bytes)]
    pub(crate) max_input: u64,
}

/// A file to read.
#[derive(Debug)]
pub(crate) struct Input {
    /// Where it can be opened.
    pub(crate) path: PathBuf,
    /// Its name in messages and reports: the path as given or found, `-` for standard input.
    pub(crate) name: PathBuf,
    /// Its path below the folder that was given, which an output folder repeats; the file's name for a file.
    pub(crate) relative: PathBuf,
    /// Its format, if the extension does not show it.
    format: Option<InputFormat>,
    /// The temporary file behind `path`, for standard input.
    spool: Option<File>,
}

impl Input {
    fn file(path: PathBuf, relative: PathBuf) -> Self {
        Self { name: path.clone(), path, relative, format: None, spool: None }
    }

    /// Whether it is standard input.
    pub(crate) fn is_stdin(&self) -> bool {
        self.spool.is_some()
    }

    /// Checks that it is not a motion file of another tool, by its extension.
    ///
    /// # Errors
    /// A usage error that says how to import it.
    pub(crate) fn check_is_no_motion_file(&self) -> anyhow::Result<()> {
        if let (None, Ok(InputFormat::MotionFile(_))) = (self.format, InputFormat::of(&self.path)) {
            let name = self.name.display();
            bail!(UsageError(format!(
                "{name} is not a take: import it first: mocapd import {name}"
            )));
        }
        Ok(())
    }

    /// Its format: the one given with `--format`, else that of its extension.
    ///
    /// # Errors
    /// A usage error for an unknown extension.
    pub(crate) fn format(&self) -> anyhow::Result<InputFormat> {
        self.format.map_or_else(|| InputFormat::of(&self.path), Ok)
    }
}

/// The files that a command reads.
#[derive(Debug)]
pub(crate) struct Inputs {
    /// In the order of the arguments; the files of a folder are in the order of their names.
    pub(crate) files: Vec<Input>,
    /// Whether exactly one file was given, not a folder: the report is that of one file.
    pub(crate) is_single: bool,
    /// Folders that cannot be read, one message each.
    pub(crate) unreadable: Vec<String>,
    /// Names of files that are read under another name, as links are: the name that is left out, and that file.
    pub(crate) repeated: Vec<(PathBuf, PathBuf)>,
}

/// Finds the files that `arguments` name, for a command that does not read standard input.
///
/// # Errors
/// A usage error for `-`, or a folder without such files.
pub(crate) fn find_named(
    arguments: &[PathBuf],
    recursive: bool,
    kinds: FileKinds,
) -> anyhow::Result<Inputs> {
    if arguments.iter().any(|argument| paths::is_dash(argument)) {
        bail!(UsageError("this command does not read standard input: give files".to_owned()));
    }
    find(arguments, &InputArgs { recursive, max_input: 0 }, kinds, None)
}

/// Finds the files that `arguments` name. `format` is that of standard input and of the files that are named, not of those
/// in folders.
///
/// # Errors
/// A usage error for a folder without such files, `-` given twice, or without a format; an error of reading standard
/// input.
pub(crate) fn find(
    arguments: &[PathBuf],
    args: &InputArgs,
    kinds: FileKinds,
    format: Option<InputFormat>,
) -> anyhow::Result<Inputs> {
    let is_folder = |path: &PathBuf| -> anyhow::Result<bool> {
        Ok(remote::url_of(path)?.map_or_else(|| path.is_dir(), |url| url.is_folder()))
    };
    let is_single = matches!(arguments, [one] if !is_folder(one)?);
    let (files, unreadable, repeated) = (Vec::new(), Vec::new(), Vec::new());
    let mut inputs = Inputs { files, is_single, unreadable, repeated };
    let mut seen = HashMap::new();
    for argument in arguments {
        if paths::is_dash(argument) {
            ensure!(
                seen.insert(argument.clone(), argument.clone()).is_none(),
                UsageError("standard input can only be read once: give `-` once".to_owned())
            );
            inputs.files.push(spool(format, kinds, args.max_input)?);
        } else if is_folder(argument)? {
            let n_unreadable = inputs.unreadable.len();
            let found = match remote::url_of(argument)? {
                Some(url) => inputs.add_bucket(&url, args.recursive, kinds, &mut seen),
                None => inputs.add_folder(argument, args.recursive, kinds, &mut seen),
            };
            if found == 0 && inputs.unreadable.len() == n_unreadable {
                let hint =
                    if args.recursive { "" } else { "; --recursive includes its subfolders" };
                bail!(UsageError(format!(
                    "{} has no {} file{hint}",
                    argument.display(),
                    kinds.extensions()
                )));
            }
        } else if is_single && !is_url(argument) && argument.symlink_metadata().is_err() {
            // Before the output is checked: the input is missing.
            return Err(FileError::NotFound(argument.clone()).into());
        } else {
            let name = argument.file_name().unwrap_or(argument.as_os_str());
            inputs.add_file(argument.clone(), PathBuf::from(name), format, &mut seen);
        }
    }
    Ok(inputs)
}

impl Inputs {
    /// The files, for a command that needs all of them.
    ///
    /// # Errors
    /// If a folder cannot be read.
    pub(crate) fn all(&self) -> anyhow::Result<&[Input]> {
        match self.unreadable.first() {
            Some(message) => bail!("{message}"),
            None => Ok(&self.files),
        }
    }

    /// Adds the files of a folder that `seen` does not have. Returns how many files of these kinds it has. Hidden files
    /// and folders are left out, and links to folders are not followed, so that no folder is read twice.
    fn add_folder(
        &mut self,
        folder: &Path,
        recursive: bool,
        kinds: FileKinds,
        seen: &mut HashMap<PathBuf, PathBuf>,
    ) -> usize {
        let mut found = Vec::new();
        let mut folders = vec![folder.to_owned()];
        while let Some(at) = folders.pop() {
            let entries = fs::read_dir(&at).and_then(Iterator::collect::<io::Result<Vec<_>>>);
            let entries = match entries {
                Ok(entries) => entries,
                Err(error) => {
                    self.unreadable
                        .push(format!("cannot read the folder {}: {error}", at.display()));
                    continue;
                }
            };
            for entry in entries {
                if entry.file_name().as_encoded_bytes().starts_with(b".") {
                    continue;
                }
                let path = entry.path();
                let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
                if is_folder && recursive {
                    folders.push(path);
                } else if !is_folder && kinds.includes(&path) && !path.is_dir() {
                    found.push(path);
                }
            }
        }
        found.sort();
        let n_found = found.len();
        for path in found {
            let relative = path.strip_prefix(folder).unwrap_or(&path).to_owned();
            self.add_file(path, relative, None, seen);
        }
        n_found
    }

    /// Adds the objects of a folder in a store, as [`add_folder`](Self::add_folder) does the files of one.
    fn add_bucket(
        &mut self,
        folder: &ObjectUrl,
        recursive: bool,
        kinds: FileKinds,
        seen: &mut HashMap<PathBuf, PathBuf>,
    ) -> usize {
        let listed = match Store::of(folder).and_then(|store| store.list(folder, recursive)) {
            Ok(listed) => listed,
            Err(error) => {
                self.unreadable.push(error.to_string());
                return 0;
            }
        };
        let prefix = folder.key();
        let mut n_found = 0;
        for object in listed {
            let path = PathBuf::from(object.url.to_string());
            if kinds.includes(&path) {
                let key = object.url.key();
                let relative = key.strip_prefix(prefix).unwrap_or(key);
                self.add_file(path, PathBuf::from(relative), None, seen);
                n_found += 1;
            }
        }
        n_found
    }

    /// Adds a file, unless `seen` has it: its real path, with the name under which it is read.
    fn add_file(
        &mut self,
        path: PathBuf,
        relative: PathBuf,
        format: Option<InputFormat>,
        seen: &mut HashMap<PathBuf, PathBuf>,
    ) {
        let real = path.canonicalize().unwrap_or_else(|_| path.clone());
        match seen.entry(real) {
            Entry::Vacant(place) => {
                place.insert(path.clone());
                self.files.push(Input { format, ..Input::file(path, relative) });
            }
            Entry::Occupied(other) => self.repeated.push((path, other.get().clone())),
        }
    }
}

/// Copies standard input to a temporary file without a name: every reader here seeks.
fn spool(format: Option<InputFormat>, kinds: FileKinds, bytes_max: u64) -> anyhow::Result<Input> {
    let only_takes = (kinds == FileKinds::Takes).then_some(InputFormat::Take);
    let Some(format) = format.or(only_takes) else {
        bail!(UsageError("`-` reads standard input: give its format with --format".to_owned()));
    };
    let stdin = io::stdin();
    if stdin.is_terminal() {
        bail!(UsageError(
            "`-` reads standard input, which is this terminal: redirect a file or a pipe to it"
                .to_owned()
        ));
    }
    let mut file = files::temporary()?;
    let copied = io::copy(&mut stdin.lock().take(bytes_max.saturating_add(1)), &mut file)
        .context("cannot copy standard input to a temporary file")?;
    ensure!(
        copied <= bytes_max,
        "standard input has more than {bytes_max} bytes: raise --max-input, or give the file by its name"
    );
    // Every open of this path begins at the start of the file.
    let path = PathBuf::from(format!("/proc/self/fd/{}", file.as_raw_fd()));
    let name = PathBuf::from("-");
    let relative = PathBuf::from("standard-input");
    Ok(Input { path, name, relative, format: Some(format), spool: Some(file) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(recursive: bool) -> InputArgs {
        InputArgs { recursive, max_input: 1 << 20 }
    }

    fn names(inputs: &Inputs) -> Vec<String> {
        inputs.files.iter().map(|input| input.relative.display().to_string()).collect()
    }

    #[test]
    fn folders_give_their_files_in_order_and_each_file_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir_all(path("b/deep")).unwrap();
        fs::create_dir(path(".hidden")).unwrap();
        for name in
            ["c.take", "a.TAKE", "b/x.take", "b/deep/y.take", "n.txt", ".h.take", ".hidden/z.take"]
        {
            fs::write(path(name), b"").unwrap();
        }
        std::os::unix::fs::symlink(folder.path(), path("b/loop")).unwrap();
        let find = |arguments: &[PathBuf], recursive| {
            find(arguments, &args(recursive), FileKinds::Takes, None)
        };
        let flat = find(&[folder.path().to_owned()], false).unwrap();
        assert_eq!(names(&flat), ["a.TAKE", "c.take"]);
        assert!(!flat.is_single);
        let deep = find(&[path("c.take"), folder.path().to_owned()], true).unwrap();
        assert_eq!(deep.repeated, [(path("c.take"), path("c.take"))]);
        assert_eq!(names(&deep), ["c.take", "a.TAKE", "b/deep/y.take", "b/x.take"]);
        let one = find(&[path("n.txt")], false).unwrap();
        assert!(one.is_single, "a file is read whatever its extension");
        let none = find(&[path("b/deep"), path("b")], false).unwrap();
        assert_eq!(names(&none), ["y.take", "x.take"]);
        fs::create_dir(path("empty")).unwrap();
        let empty = find(&[path("empty")], true).unwrap_err();
        assert!(empty.is::<UsageError>(), "{empty}");
    }
}
