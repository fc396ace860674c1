//! Motion files of other programs as a sequence of frames.

use std::{
    fmt,
    io::{self, Read, Seek},
    sync::{Arc, atomic::AtomicU64},
};

use super::{
    Format, InterchangeError, ReadOptions, Result, c3d, csv,
    source_file::{SourceFile, TextFile},
    text::TextFrames,
    trc, tsv, unsupported,
};
use crate::{
    chunk::MAGIC,
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

/// Bytes at the beginning of a file by which its kind shows: more than every signature has, and a line or two of text.
const HEAD_BYTES: usize = 256;

/// What the beginning of a file looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ContentKind {
    /// A format that can be imported.
    Of(Format),
    /// One that cannot, by its name.
    Other(&'static str),
    Unknown,
}

impl ContentKind {
    fn of(head: &[u8]) -> Self {
        let text = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head);
        let is_utf_16 = head.starts_with(b"\xFF\xFE") || head.starts_with(b"\xFE\xFF");
        match head {
            _ if head.starts_with(&MAGIC) => Self::Other("a take: name it .take"),
            _ if is_utf_16 => Self::Other("text in UTF-16: save it as UTF-8"),
            [b'P', b'K', 3, 4, ..] => {
                Self::Other("a ZIP archive, such as a workbook of a spreadsheet: export it as text")
            }
            [0x1F, 0x8B, ..] => Self::Other("compressed with gzip: unpack it"),
            [b'X', b'D', b'F', b':', ..] => {
                Self::Other("an XDF recording, which mocapd only writes")
            }
            // The block of the parameters, which is one of the first in every known file, and the signature.
            [1..=9, 0x50, ..] if head.contains(&0) => Self::Of(Format::C3d),
            _ if text.starts_with(b"PathFileType") => Self::Of(Format::Trc),
            _ if text.starts_with(b"NO_OF_FRAMES") => Self::Of(Format::Tsv),
            _ if head.contains(&0) => Self::Other("binary data"),
            _ => Self::Unknown,
        }
    }

    /// Adds to an error of reading a file as one of `format` that it looks like something else.
    fn explain(self, format: Format, error: InterchangeError) -> InterchangeError {
        let InterchangeError::Malformed { format: name, place, message } = error else {
            return error;
        };
        let is_text = format != Format::C3d;
        let looks_like = match self {
            Self::Of(found) if found != format => format!(
                "the file looks like {0}: name it .{0}, or give --format {0}",
                match found {
                    Format::C3d => "c3d",
                    Format::Trc => "trc",
                    _ => "tsv",
                }
            ),
            Self::Other(kind) if is_text || kind != "binary data" => {
                format!("the file looks like {kind}")
            }
            Self::Of(_) | Self::Other(_) | Self::Unknown => {
                return InterchangeError::Malformed { format: name, place, message };
            }
        };
        // What a reader of text says of other bytes helps nobody.
        let message = match self {
            Self::Other(_) | Self::Of(Format::C3d) => looks_like,
            _ => format!("{message}; {looks_like}"),
        };
        InterchangeError::Malformed { format: name, place, message }
    }
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
        let mut head = [0; HEAD_BYTES];
        let n_head = source.read_some(0, &mut head)?;
        let kind = ContentKind::of(head.get(..n_head).unwrap_or_default());
        let read = Self::read_front(format, &mut source, settings);
        let (info, frames) = read.map_err(|error| kind.explain(format, error))?;
        Ok(Self { info, source, frames })
    }

    /// Reads everything but the samples.
    fn read_front(
        format: Format,
        source: &mut SourceFile<'_>,
        settings: &ReaderSettings<'_>,
    ) -> Result<(MotionInfo, ReadFrames)> {
        let (options, new_scratch) = (&settings.options, settings.new_scratch);
        Ok(match format {
            Format::C3d => {
                let mut store = PartStore::new(settings.keeps_foreign, new_scratch);
                let (info, frames) = c3d::open(source, options, &mut store)?;
                (info, ReadFrames::C3d(Box::new(frames)))
            }
            Format::Trc | Format::Tsv | Format::Csv | Format::CsvLong => {
                let (name, open): (_, OpenText) = match format {
                    Format::Trc => ("trc", trc::open),
                    Format::Tsv => ("tsv", tsv::open),
                    _ => ("csv", csv::open),
                };
                let mut file = TextFile::new(name, source);
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
        })
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
