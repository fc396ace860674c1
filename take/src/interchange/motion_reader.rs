//! Motion files of other programs as a sequence of frames.

use std::{
    fmt,
    io::{self, Read, Seek},
    sync::{Arc, atomic::AtomicU64},
};

use super::{
    Format, ReadOptions, Result, c3d, csv, source_file::SourceFile, trc, tsv, unsupported,
};
use crate::{
    foreign::content::{PartStore, ScratchFile},
    motion::{FrameSource, GAP, Motion, MotionInfo, Position},
};

/// How a [`MotionReader`] reads, and what it reports.
pub struct ReaderSettings<'s> {
    /// A unit and an up axis that override the file's own.
    pub options: ReadOptions,
    /// Whether the content of foreign parts is wanted. Otherwise [`info`](FrameSource::info) lists their kinds, and
    /// they cannot be written.
    pub keeps_foreign: bool,
    /// Creates a scratch file. It is called if foreign parts have more than 8 MiB.
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
/// [`open`](Self::open) reads the file once, to find everything but the samples. A C3D file is read again for its
/// frames, a block at a time, so a file of any size takes little memory; the samples of text files are kept in memory.
/// If the file changes meanwhile, reading fails.
#[derive(Debug)]
pub struct MotionReader<'a> {
    info: MotionInfo,
    source: SourceFile<'a>,
    samples: Samples,
}

#[derive(Debug)]
enum Samples {
    C3d(Box<c3d::C3dFrames>),
    Memory { positions_mm: Vec<Position>, next: usize },
}

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
        let options = &settings.options;
        let read: fn(&[u8], &ReadOptions) -> Result<Motion> = match format {
            Format::C3d => {
                let mut store = PartStore::new(settings.keeps_foreign, settings.new_scratch);
                let (info, frames) = c3d::open(&mut source, options, &mut store)?;
                return Ok(Self { info, source, samples: Samples::C3d(Box::new(frames)) });
            }
            Format::Trc => trc::read,
            Format::Tsv => tsv::read,
            Format::Csv | Format::CsvLong => csv::read,
            Format::Npz
            | Format::Xdf
            | Format::Bids
            | Format::Mot
            | Format::Parquet
            | Format::ParquetWide
            | Format::Mcap => {
                return unsupported("this format is export only: import c3d, trc, tsv or csv");
            }
        };
        let mut bytes = Vec::new();
        source.reader().read_to_end(&mut bytes)?;
        let Motion { info, positions_mm } = read(&bytes, options)?;
        Ok(Self { info, source, samples: Samples::Memory { positions_mm, next: 0 } })
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
        match &mut self.samples {
            Samples::C3d(frames) => frames.rewind(),
            Samples::Memory { next, .. } => *next = 0,
        }
    }

    /// Reads all frames into memory.
    ///
    /// # Errors
    /// `Io` if the file cannot be read or has changed.
    pub fn into_motion(mut self) -> Result<Motion> {
        if let Samples::Memory { positions_mm, .. } = self.samples {
            return Ok(Motion { info: self.info, positions_mm });
        }
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
        match &mut self.samples {
            Samples::C3d(frames) => frames.next_frame(&mut self.source, row),
            Samples::Memory { positions_mm, next } => {
                if *next as u64 >= self.info.n_frames {
                    return Ok(false);
                }
                let start = *next * row.len();
                let frame = positions_mm.get(start..start + row.len());
                row.copy_from_slice(frame.unwrap_or_default());
                *next += 1;
                Ok(true)
            }
        }
    }
}
