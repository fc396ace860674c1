//! Access to the frames of a file as stored, and the sorting of their points into markers and model outputs.

use std::{collections::HashSet, io, ops::Range};

use super::{columns::ordered, header::ByteOrder, layout::Layout, parameters::Parameters};
use crate::{interchange::source_file::SourceFile, motion::Marker, record::Channel};

/// Parameters of POINT that list model outputs: results that are stored as points without being positions.
const MODEL_OUTPUTS: [&str; 6] = ["ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS"];

/// Maximum number of parameters read as lists of model outputs. Texts of length 0 take no bytes, so a damaged file
/// could claim any number of them.
const MAX_LISTS: usize = 64;

/// The points of a file, sorted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Points {
    /// The markers in file order, each with its index among the points.
    pub(super) markers: Vec<(usize, Marker)>,
    /// Indices of the model outputs.
    pub(super) outputs: Vec<usize>,
}

/// Sorts `n_points` points into markers and model outputs.
pub(super) fn sort_points(
    parameters: &Parameters,
    n_points: usize,
    warnings: &mut Vec<String>,
) -> Points {
    let labels = parameters.texts("POINT", "LABELS");
    if labels.len() < n_points {
        warnings.push(format!(
            "POINT:LABELS has {} labels for {n_points} points; the other points are unlabelled.",
            labels.len()
        ));
    } else if labels.iter().skip(n_points).any(|label| !label.is_empty()) {
        warnings.push(format!("POINT:LABELS has {} labels for {n_points} points.", labels.len()));
    }
    let listed = listed_outputs(parameters);
    let mut points = Points { markers: Vec::new(), outputs: Vec::new() };
    for index in 0..n_points {
        let label = labels.get(index).map_or("", String::as_str);
        if !label.is_empty() && listed.contains(label) {
            points.outputs.push(index);
        } else {
            points.markers.push((index, point_marker(label, points.markers.len())));
        }
    }
    points
}

/// The marker of a label. Vicon's labels of unlabelled trajectories begin with `*`.
fn point_marker(label: &str, column: usize) -> Marker {
    if label.is_empty() {
        return Marker { label: Channel::unlabelled_name(column), labelled: false };
    }
    Marker { label: label.to_owned(), labelled: !label.starts_with('*') }
}

/// The labels of all model outputs: those in the parameters named by `MODEL_OUTPUTS` and by `POINT:TYPE_GROUPS`, whose
/// texts are pairs of such a name and the name of one of its points.
fn listed_outputs(parameters: &Parameters) -> HashSet<String> {
    let type_groups = parameters.texts("POINT", "TYPE_GROUPS");
    let named = type_groups.iter().step_by(2).map(String::as_str);
    let mut names: Vec<&str> = MODEL_OUTPUTS.into_iter().chain(named).collect();
    // MODELED_MARKERS are positions, and the labels of all points are not a list of model outputs.
    names.retain(|name| {
        let name = name.to_ascii_uppercase();
        !name.is_empty() && !name.contains("MARKER") && !name.starts_with("LABELS")
    });
    names.truncate(MAX_LISTS);
    names.sort_unstable();
    names.dedup();
    names
        .into_iter()
        .flat_map(|name| parameters.texts("POINT", name))
        .filter(|label| !label.is_empty())
        .collect()
}

/// Bytes of frames that are read at a time: they stay in the processor's cache with the data derived from them, and a
/// column of a scratch file is written in pieces of 1 kB if a frame has a thousand words.
const BLOCK_BYTES: usize = 1 << 20;
/// Minimum number of frames that are read at a time, unless they have more than [`LARGE_BLOCK_BYTES`]: with fewer, a
/// frame of hundreds of thousands of words would cost as many writes to its columns.
const BLOCK_FRAMES_MIN: usize = 64;
const LARGE_BLOCK_BYTES: usize = 1 << 25;

/// Reads successive frames.
#[derive(Debug, Default)]
pub(super) struct FrameBuffer {
    bytes: Vec<u8>,
    samples: Vec<f32>,
}

impl FrameBuffer {
    /// The ranges of frames to read one after another, from frame `first` on.
    pub(super) fn ranges_from(
        layout: &Layout,
        first: usize,
    ) -> impl Iterator<Item = Range<usize>> + use<> {
        let n_frames = layout.n_frames;
        let within = |n_bytes: usize| n_bytes / layout.stride.frame_bytes().max(1);
        let n_block = within(BLOCK_BYTES).max(within(LARGE_BLOCK_BYTES).clamp(1, BLOCK_FRAMES_MIN));
        (first..n_frames).step_by(n_block).map(move |first| first..n_frames.min(first + n_block))
    }

    /// Reads a range of frames.
    ///
    /// # Errors
    /// Those of the file.
    pub(super) fn read<'b>(
        &'b mut self,
        source: &mut SourceFile<'_>,
        layout: &'b Layout,
        range: &Range<usize>,
    ) -> io::Result<Frames<'b>> {
        let frame_bytes = layout.stride.frame_bytes();
        self.bytes.resize(range.len() * frame_bytes, 0);
        let at = layout.stride.data_start + range.start * frame_bytes;
        source.read_at(at as u64, &mut self.bytes)?;
        self.samples.clear();
        let order = layout.order;
        if !layout.stride.float {
            let words = self.bytes.as_chunks().0.iter();
            self.samples.extend(words.map(|&bytes| f32::from(order.word(bytes) as i16)));
        } else if order == ByteOrder::Intel {
            self.samples
                .extend(self.bytes.as_chunks().0.iter().map(|&word| f32::from_le_bytes(word)));
        } else {
            self.samples.extend(self.bytes.as_chunks().0.iter().map(|&word| order.float(word)));
        }
        Ok(self.held(layout))
    }

    /// Frames that were read before.
    pub(super) fn held<'b>(&'b self, layout: &'b Layout) -> Frames<'b> {
        Frames { samples: &self.samples, layout }
    }
}

/// The words of a point as stored: three coordinates and the fourth word.
pub(super) type StoredWords = [f32; 4];

/// Successive frames as stored, counted from the first of them. Integers are floats of the same value.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frames<'a> {
    samples: &'a [f32],
    pub(super) layout: &'a Layout,
}

impl<'a> Frames<'a> {
    /// Number of frames.
    pub(super) fn len(&self) -> usize {
        self.samples.len().checked_div(self.layout.stride.frame_words()).unwrap_or(0)
    }

    /// The points of a frame.
    pub(super) fn points(&self, frame: usize) -> &'a [StoredWords] {
        let stride = &self.layout.stride;
        let start = frame * stride.frame_words();
        self.samples.get(start..start + 4 * stride.n_points).unwrap_or_default().as_chunks().0
    }

    /// A word of a frame: four for each point, then the analog samples.
    pub(super) fn word(&self, frame: usize, word: usize) -> f32 {
        let at = frame * self.layout.stride.frame_words() + word;
        self.samples.get(at).copied().unwrap_or_default()
    }

    /// A word of a frame as columns store it: a float mapped by [`ordered`], or an integer.
    pub(super) fn column_word(&self, frame: usize, word: usize) -> u32 {
        let value = self.word(frame, word);
        if self.layout.stride.float {
            ordered(value.to_bits())
        } else {
            u32::from(value as i16 as u16)
        }
    }
}

/// Whether the fourth word of a point marks it as missing: it is a 16-bit integer, negative for a missing point. Some
/// software writes -1 in float files as the unsigned 65535.0. Residual and camera mask never reach 32768, so that range
/// is missing, too. A point at the origin with another fourth word is a position, as in the field's other readers.
#[inline]
pub(super) fn is_missing(fourth: f32) -> bool {
    fourth < 0.0 || (32_768.0..65_536.0).contains(&fourth)
}
