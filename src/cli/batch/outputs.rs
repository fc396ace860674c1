//! The files that a command over many files writes: their names, decided and checked before any work starts.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::{self, Seek, Write},
    os::unix::ffi::OsStrExt,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use mocapd::outcome::UsageError;
use mocapd_acquire::files::{self, Kept, folder_of};
use mocapd_store::{is_url, without_secrets};
use mocapd_take::interchange::Format;

use super::inputs::{Input, Inputs};
use crate::cli::{output as stdout, paths, remote::OutputFile};

/// Where the outputs go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Destination {
    /// The only output has this path.
    File(PathBuf),
    /// Below this folder, each at the place of its input below the folder that was given.
    Folder(PathBuf),
    /// Beside each input.
    Beside,
    /// Standard output.
    Stdout,
}

impl Destination {
    /// The destination that `-o` names for these inputs.
    ///
    /// # Errors
    /// A usage error if several inputs have the name of a file as their output.
    pub(crate) fn of(output: Option<&Path>, inputs: &Inputs) -> anyhow::Result<Self> {
        let Some(output) = output else { return Ok(Self::Beside) };
        if paths::is_dash(output) {
            if !inputs.is_single {
                bail!(UsageError(
                    "standard output holds one file: give one input, or a folder with -o FOLDER/"
                        .to_owned()
                ));
            }
            return Ok(Self::Stdout);
        }
        let has_ending = paths::is_take(output) || Format::from_extension(output).is_some();
        let is_folder =
            output.as_os_str().as_bytes().ends_with(b"/") || (output.is_dir() && !has_ending);
        if inputs.is_single && !is_folder {
            return Ok(Self::File(output.to_owned()));
        }
        if !is_folder && (output.exists() || output.extension().is_some()) {
            bail!(UsageError(format!(
                "{} files cannot become one file: give a folder with -o {}/",
                inputs.files.len(),
                without_secrets(&output.with_extension("").to_string_lossy())
            )));
        }
        Ok(Self::Folder(output.to_owned()))
    }

    /// The take that each input becomes, checked before work starts.
    ///
    /// # Errors
    /// Those of [`paths`](Self::paths); a usage error if the output is not a new take, or standard output cannot take
    /// one.
    pub(crate) fn take_paths(&self, inputs: &Inputs, json: bool) -> anyhow::Result<Vec<PathBuf>> {
        let outputs = self.paths(inputs, "take")?;
        match self {
            Self::File(path) => paths::check_take_output(path)?,
            Self::Stdout => paths::check_stdout(json)?,
            Self::Folder(_) | Self::Beside => {}
        }
        Ok(outputs)
    }

    /// The output of each input, with this extension. Standard output has the path `-`.
    ///
    /// # Errors
    /// A usage error if two inputs have the same output, or an output is its own input.
    pub(crate) fn paths(&self, inputs: &Inputs, extension: &str) -> anyhow::Result<Vec<PathBuf>> {
        let mut taken: HashMap<PathBuf, &Input> = HashMap::new();
        let mut outputs = Vec::with_capacity(inputs.files.len());
        for input in &inputs.files {
            let output = match self {
                Self::File(path) => path.clone(),
                Self::Stdout => PathBuf::from("-"),
                Self::Folder(folder) => with_ending(&folder.join(&input.relative), extension),
                Self::Beside if input.is_stdin() => bail!(UsageError(
                    "standard input has no folder to write beside: give -o FILE, or -o - for standard output"
                        .to_owned()
                )),
                Self::Beside => with_ending(&input.path, extension),
            };
            // A file given with -o must not exist yet, so it cannot be the input.
            let is_named = matches!(self, Self::File(_) | Self::Stdout);
            if !is_named && paths::are_one(&output, &input.path) {
                bail!(UsageError(format!(
                    "{} would be written over its source: give another folder with -o FOLDER/",
                    output.display()
                )));
            }
            if let Some(other) = taken.insert(paths::resolved(&output), input) {
                bail!(UsageError(format!(
                    "{} and {} would both become {}: rename one, or convert them into different folders",
                    other.name.display(),
                    input.name.display(),
                    output.display()
                )));
            }
            outputs.push(output);
        }
        Ok(outputs)
    }
}

/// A path with the extension in place of its own.
fn with_ending(path: &Path, extension: &str) -> PathBuf {
    path.with_extension(extension)
}

/// An output that can seek.
pub(crate) trait SeekWrite: Write + Seek {
    /// Syncs what was written, for outputs that get their names together.
    ///
    /// # Errors
    /// When the disk fails.
    fn sync(&mut self) -> io::Result<()>;
}

impl SeekWrite for OutputFile {
    fn sync(&mut self) -> io::Result<()> {
        Self::sync(self)
    }
}

/// A temporary file without a name, to be copied to standard output.
impl SeekWrite for File {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes an output whole or not at all: a new file, or standard output. In an output folder, which is created if it is
/// missing, a file with the same content stays. Returns the result of `write`, and whether the file is new.
///
/// # Errors
/// The error of `write`; if the file exists or cannot be written.
pub(crate) fn write_whole<T>(
    output: &Path,
    in_folder: bool,
    write: impl FnOnce(&mut dyn SeekWrite) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Kept)> {
    if paths::is_dash(output) {
        let writing = "cannot write to standard output";
        let mut file = files::temporary()?;
        let written = write(&mut file)?;
        stdout::copy_to_stdout(&file).context(writing)?;
        return Ok((written, Kept::New));
    }
    if !in_folder {
        let mut file = OutputFile::create(output)?;
        let written = write(&mut file)?;
        file.keep()?;
        return Ok((written, Kept::New));
    }
    if !is_url(output) {
        let folder = folder_of(output);
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
    }
    let mut file = OutputFile::create_or_compare(output)?;
    let written = write(&mut file)?;
    Ok((written, file.keep_or_compare()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::batch::inputs::{FileKinds, InputArgs, find};

    fn found(arguments: &[PathBuf]) -> Inputs {
        let args = InputArgs { recursive: true, max_input: 1 };
        find(arguments, &args, FileKinds::MotionFiles, None).unwrap()
    }

    #[test]
    fn outputs_repeat_the_folders_and_names_that_clash_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir_all(path("in/day 1")).unwrap();
        for name in ["in/a.c3d", "in/day 1/b.trc"] {
            fs::write(path(name), b"").unwrap();
        }
        let inputs = found(&[path("in")]);
        let outputs = |inputs: &Inputs, output: Option<&Path>| {
            Destination::of(output, inputs).and_then(|to| to.paths(inputs, "take"))
        };
        let out = path("out");
        assert_eq!(
            outputs(&inputs, Some(&out)).unwrap(),
            [out.join("a.take"), out.join("day 1/b.take")]
        );
        assert_eq!(outputs(&inputs, None).unwrap(), [path("in/a.take"), path("in/day 1/b.take")]);
        fs::write(path("in/a.csv"), b"").unwrap();
        let clash = outputs(&found(&[path("in")]), None).unwrap_err();
        assert!(clash.is::<UsageError>() && clash.to_string().contains("a.csv"), "{clash}");
        let one = found(&[path("in/a.c3d")]);
        assert_eq!(outputs(&one, Some(&path("x.take"))).unwrap(), [path("x.take")]);
        assert_eq!(outputs(&one, Some(&path("in/"))).unwrap(), [path("in/a.take")]);
        let many = found(&[path("in/a.c3d"), path("in/a.csv")]);
        for (inputs, output) in [(&many, path("x.take")), (&many, PathBuf::from("-"))] {
            assert!(Destination::of(Some(&output), inputs).unwrap_err().is::<UsageError>());
        }
    }
}
