//! Motion files of other programs as a sequence of frames.

use std::{
    fmt,
    io::{self, Read, Seek},
    sync::{Arc, atomic::AtomicU64},
};

use super::{
    Format, ReadOptions, Result, c3d, csv, source_file::SourceFile, text_file::TextFile,
    text_frames::TextFrames, trc, tsv, unsupported,
};
use crate::{
    foreign::content::{NewScratch, PartStore, ScratchFile},
    motion::{FrameSource, GAP, Motion, MotionInfo, Position},
};

/// How a [`MotionReader`] reads, and what it reports.
pub struct ReaderSettings<'s> {
    /// A unit and an up axis that override the file's own.
    pub options: ReadOptions,
    /// Whether the content of foreign parts is wanted. Otherwise [`info`](FrameSource::info) lists their kinds, and
    /// they cannot be written.
    pub keeps_foreign: bool,
    /// Creates a scratch file. It is called if foreign parts, or the frames of a text file, have more than 8 MiB.
    pub new_scratch: &'s dyn Fn() -> io::Result<Arc<dyn ScratchFile>>,
    /// Counts the bytes read, again in each pass over the file.
    pub bytes_read: Arc<AtomicU64>,
}

impl fmt::Debug for ReaderSettings<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut debug = f.debug_struct("ReaderSettings");
        debug.field("options", &self.options).field("keeps_foreign", &self.keeps_foreign);
        debug.finish_non_exhaustive()
    }
}

/// The frames of a motion file of another program, in order.
///
/// A file of any size takes little memory. [`open`](Self::open) finds everything but the samples. A C3D file is read again
/// for its frames, a block at a time; the parsed frames of a text file are in a scratch file if they are large.
/// If the file changes meanwhile, reading fails.
#[derive(Debug)]
pub struct MotionReader<'a> {
    info: MotionInfo,
    source: SourceFile<'a>,
    frames: ReadFrames,
}

#[derive(Debug)]
enum ReadFrames {
    C3d(Box<c3d::C3dFrames>),
    Text(Box<TextFrames>),
}

/// Opens a text file.
type OpenText =
    fn(&mut TextFile<'_, '_>, &ReadOptions, NewScratch<'_>) -> Result<(MotionInfo, TextFrames)>;

impl<'a> MotionReader<'a> {
    /// Opens a file.
    ///
    /// # Errors
    /// `Malformed` if the file holds nothing usable; `Unsupported` for a format that is export only; `Io` if the file
    /// or the scratch file fails.
    pub fn open(
        format: Format,
        input: impl Read + Seek + 'a,
        settings: &ReaderSettings<'_>,
    ) -> Result<Self> {
        let mut source = SourceFile::new(input, Arc::clone(&settings.bytes_read))?;
        let (options, new_scratch) = (&settings.options, settings.new_scratch);
        let (info, frames) = match format {
            Format::C3d => {
                let mut store = PartStore::new(settings.keeps_foreign, new_scratch);
                let (info, frames) = c3d::open(&mut source, options, &mut store)?;
                (info, ReadFrames::C3d(Box::new(frames)))
            }
            Format::Trc | Format::Tsv | Format::Csv | Format::CsvLong => {
                let (name, open): (_, OpenText) = match format {
                    Format::Trc => ("trc", trc::open),
                    Format::Tsv => ("tsv", tsv::open),
                    _ => ("csv", csv::open),
                };
                let mut file = TextFile::new(name, &mut source);
                let (info, frames) = open(&mut file, options, new_scratch)?;
                (info, ReadFrames::Text(Box::new(frames)))
            }
            Format::Npz
            | Format::Xdf
            | Format::Bids
            | Format::Mot
            | Format::Html
            | Format::Parquet
            | Format::ParquetWide
            | Format::Mcap => {
                return unsupported("this format is export only: import c3d, trc, tsv or csv");
            }
        };
        Ok(Self { info, source, frames })
    }

    /// The description of the file, to be changed before an import: its subject, for example.
    pub fn info_mut(&mut self) -> &mut MotionInfo {
        &mut self.info
    }

    /// A reader of all bytes of the file, for a hash of it.
    pub fn bytes(&mut self) -> impl Read {
        self.source.reader()
    }

    /// Returns to the first frame.
    pub fn rewind(&mut self) {
        match &mut self.frames {
            ReadFrames::C3d(frames) => frames.rewind(),
            ReadFrames::Text(frames) => frames.rewind(),
        }
    }

    /// Reads all frames into memory.
    ///
    /// # Errors
    /// `Io` if the file cannot be read or has changed.
    pub fn into_motion(mut self) -> Result<Motion> {
        self.rewind();
        let n_markers = self.info.markers.len();
        // The file has as many.
        let n_frames = usize::try_from(self.info.n_frames).unwrap_or(usize::MAX);
        let mut positions_mm = vec![GAP; n_frames.saturating_mul(n_markers)];
        for row in positions_mm.chunks_exact_mut(n_markers.max(1)) {
            self.next_frame(row)?;
        }
        Ok(Motion { info: self.info, positions_mm })
    }
}

impl FrameSource for MotionReader<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        match &mut self.frames {
            ReadFrames::C3d(frames) => frames.next_frame(&mut self.source, row),
            ReadFrames::Text(frames) => frames.next_frame(row),
        }
    }
}
