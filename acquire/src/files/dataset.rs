//! Recordings that are added to a BIDS dataset, whole or not at all.
//!
//! Files are written without names, so a killed program leaves none. They get their names within milliseconds, once all
//! are complete: for a new data set in a hidden folder that is then renamed; in an existing one they are linked into
//! their folders from a [`Staging`], with which the next export undoes what a killed one left.

use std::{
    collections::BTreeSet,
    fs::{File, OpenOptions},
    io::{self, BufWriter, Read, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
};

use anyhow::{Context, anyhow, bail};
use mocapd_drivers::plain_file;
use mocapd_take::interchange::bids::{self, BidsLabels, DatasetFolder};
use rustix::fs::{AtFlags, CWD, FlockOperation, OFlags, flock, linkat};

use super::{
    cannot_create, folder_of,
    new_file::unnamed_file,
    proc_link,
    staging::{self, PARTICIPANTS, Staging, rename_new},
    sync_name,
};

/// File that makes a folder a data set.
const DESCRIPTION: &str = "dataset_description.json";
/// Longest `dataset_description.json` or `participants.tsv` that is read: 1 MiB, a table of 40 000
/// participants.
const TABLE_BYTES_MAX: usize = 1 << 20;

/// Why a recording cannot be added to a data set.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The data set has a file of that name.
    #[error(
        "{} exists already: give another --run or --session (or --subject, --task) to add a recording",
        .0.display()
    )]
    Exists(PathBuf),
    /// The folder is not a dataset.
    #[error("cannot add a recording to {}: {reason}; name a BIDS dataset of raw data, or a new folder", .path.display())]
    NotADataset {
        /// The folder.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

/// A recording that becomes part of a data set when it is complete. Dropping it earlier leaves no trace.
#[derive(Debug)]
pub struct NewRecording {
    dataset: PathBuf,
    labels: BidsLabels,
    files: Vec<WrittenFile>,
    staging: Option<Staging>,
}

#[derive(Debug)]
struct WrittenFile {
    /// Its path in the data set.
    path: String,
    /// Whether it describes the whole data set.
    is_common: bool,
    file: File,
}

impl NewRecording {
    /// Begins a recording in the data set `dataset`, or in a new one. Removes what killed programs left there.
    ///
    /// # Errors
    /// [`DatasetError`] if the recording exists, or `dataset` is not a data set; if nothing can be created.
    pub fn begin(dataset: &Path, labels: &BidsLabels) -> anyhow::Result<Self> {
        let Some(name) = dataset.file_name() else {
            bail!("{} is not a folder name", dataset.display())
        };
        staging::remove_leftovers(folder_of(dataset), &staging::prefix(Some(name)), dataset);
        if dataset.symlink_metadata().is_ok() {
            staging::remove_leftovers(dataset, &staging::prefix(None), dataset);
            check(dataset)?;
            for path in labels.paths() {
                refuse_existing(&dataset.join(path))?;
            }
        }
        let (dataset, labels) = (dataset.to_owned(), labels.clone());
        let mut staged_addition = Self { dataset, labels, files: Vec::new(), staging: None };
        staged_addition.check_writable()?;
        Ok(staged_addition)
    }

    /// Makes the recording part of the data set, once its content is on disk.
    ///
    /// # Errors
    /// Those of [`begin`](Self::begin); if the disk fails.
    pub fn keep(mut self) -> anyhow::Result<()> {
        let writing = || format!("cannot write {}", self.dataset.display());
        for written in &self.files {
            written.file.sync_all().with_context(writing)?;
        }
        if self.dataset.symlink_metadata().is_err() && self.publish_new()? {
            return Ok(());
        }
        self.publish_into()
    }

    /// Where files can be created on the data set's disk.
    fn folder(&self) -> &Path {
        if self.dataset.is_dir() { &self.dataset } else { folder_of(&self.dataset) }
    }

    /// Fails early if nothing can be created.
    fn check_writable(&mut self) -> anyhow::Result<()> {
        if unnamed_file(&self.folder().join(DESCRIPTION))?.is_none() {
            self.staging()?;
        }
        Ok(())
    }

    fn staging(&mut self) -> anyhow::Result<&mut Staging> {
        let staging = match self.staging.take() {
            Some(staging) => staging,
            None => Staging::create(self.folder(), &self.dataset)
                .map_err(|error| cannot_create(&self.dataset, &error))?,
        };
        Ok(self.staging.insert(staging))
    }

    /// Names all files within the staging folder.
    fn stage(&mut self) -> anyhow::Result<()> {
        let writing = format!("cannot write {}", self.dataset.display());
        self.staging()?;
        let Some(staging) = &self.staging else { return Ok(()) };
        let content = staging.content();
        for written in &self.files {
            let path = content.join(&written.path);
            if path.symlink_metadata().is_ok() {
                continue; // It had a name from the start.
            }
            staging.create_folder_of(Path::new(&written.path)).with_context(|| writing.clone())?;
            linkat(CWD, proc_link(&written.file), CWD, &path, AtFlags::SYMLINK_FOLLOW)
                .with_context(|| writing.clone())?;
            sync_name(&path);
        }
        Ok(())
    }

    /// Publishes a new data set. `false` if one appeared there meanwhile.
    fn publish_new(&mut self) -> anyhow::Result<bool> {
        self.stage()?;
        let dataset = self.dataset.clone();
        let content = self.staging()?.content();
        match rename_new(&content, &dataset) {
            Ok(()) => {}
            // Something appeared there.
            Err(_) if dataset.symlink_metadata().is_ok() => return Ok(false),
            Err(error) => {
                return Err(error).with_context(|| format!("cannot name {}", dataset.display()));
            }
        }
        sync_name(&dataset);
        self.staging()?.commit();
        Ok(true)
    }

    /// Adds the recording to an existing data set. Other exports to it wait meanwhile.
    fn publish_into(&mut self) -> anyhow::Result<()> {
        let _lock = lock(&self.dataset);
        check(&self.dataset)?;
        for written in self.files.iter().filter(|written| !written.is_common) {
            refuse_existing(&self.dataset.join(&written.path))?;
        }
        self.stage()?;
        let dataset = self.dataset.clone();
        let writing = || format!("cannot write {}", dataset.display());
        let participants = dataset.join(PARTICIPANTS);
        let has_participants = participants.symlink_metadata().is_ok();
        let row = if has_participants { self.participant_row(&participants)? } else { None };
        let is_added = |written: &&WrittenFile| {
            let is_missing = || dataset.join(&written.path).symlink_metadata().is_err();
            !written.is_common || written.path.starts_with("participants.") && is_missing()
        };
        let paths: Vec<String> =
            self.files.iter().filter(is_added).map(|written| written.path.clone()).collect();
        let staging = self.staging()?;
        staging.publish(&paths).map_err(|(path, error)| match error.kind() {
            io::ErrorKind::AlreadyExists => DatasetError::Exists(path).into(),
            _ => anyhow::Error::from(error).context(writing()),
        })?;
        if let Some(row) = row {
            staging.append(&participants, row.as_bytes()).with_context(writing)?;
        }
        staging.commit();
        // The names of the files, and those of new folders.
        let names: BTreeSet<&Path> =
            paths.iter().flat_map(|path| Path::new(path).ancestors()).collect();
        names.iter().filter(|name| name.parent().is_some()).for_each(|name| {
            sync_name(&dataset.join(name));
        });
        Ok(())
    }

    /// The row that `participants.tsv` lacks; `None` if it has the subject.
    fn participant_row(&self, participants: &Path) -> anyhow::Result<Option<String>> {
        let table = super::read_bounded(participants, TABLE_BYTES_MAX)?;
        let table = String::from_utf8(table)
            .map_err(|_| anyhow!("{} is not UTF-8", participants.display()))?;
        bids::participant_row(&table, self.labels.subject())
            .with_context(|| participants.display().to_string())
    }

    fn create(&mut self, path: &str, is_common: bool) -> io::Result<Box<dyn Write + '_>> {
        if self.files.iter().any(|written| written.path == path) {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        let unnamed = unnamed_file(&self.folder().join(DESCRIPTION)).map_err(io::Error::other)?;
        let file = match unnamed {
            Some(file) => file,
            None => {
                let staging = self.staging().map_err(io::Error::other)?;
                staging.create_folder_of(Path::new(path))?;
                let named = staging.content().join(path);
                OpenOptions::new().write(true).create_new(true).open(named)?
            }
        };
        let written = file.try_clone()?;
        self.files.push(WrittenFile { path: path.to_owned(), is_common, file });
        Ok(Box::new(BufWriter::new(written)))
    }
}

impl DatasetFolder for NewRecording {
    fn file(&mut self, path: &str) -> io::Result<Box<dyn Write + '_>> {
        self.create(path, false)
    }

    fn common_file(&mut self, path: &str) -> io::Result<Box<dyn Write + '_>> {
        self.create(path, true)
    }
}

fn refuse_existing(path: &Path) -> Result<(), DatasetError> {
    if path.symlink_metadata().is_ok() {
        return Err(DatasetError::Exists(path.to_owned()));
    }
    Ok(())
}

/// Checks that a folder is a data set that recordings can be added to.
fn check(dataset: &Path) -> Result<(), DatasetError> {
    let not = |reason: String| DatasetError::NotADataset { path: dataset.to_owned(), reason };
    if !dataset.is_dir() {
        return Err(not("it is not a folder".to_owned()));
    }
    let mut description = Vec::new();
    let opened = plain_file::open(&dataset.join(DESCRIPTION));
    let read =
        opened.and_then(|file| file.take(TABLE_BYTES_MAX as u64).read_to_end(&mut description));
    read.map_err(|error| not(format!("{DESCRIPTION}: {error}")))?;
    bids::check_description(&description).map_err(|reason| not(format!("{DESCRIPTION}: {reason}")))
}

/// Waits until no other program adds to the data set, and keeps others out until dropped; `None` on file systems
/// without locks, where two exports at once may lose a participant's row.
fn lock(dataset: &Path) -> Option<File> {
    let path = dataset.join(DESCRIPTION);
    // Network file systems lock only files that are open for writing.
    let options = || {
        let mut options = OpenOptions::new();
        options.read(true).custom_flags(OFlags::NONBLOCK.bits() as i32);
        options
    };
    let file = options().write(true).open(&path).or_else(|_| options().open(&path)).ok()?;
    flock(&file, FlockOperation::LockExclusive).ok()?;
    Some(file)
}

#[cfg(test)]
mod tests;
