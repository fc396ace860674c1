//! Access to the frames of a file as stored, and the sorting of their points into markers and model outputs.

use std::{collections::HashSet, io, ops::Range};

use super::{columns::ordered, layout::Layout, parameters::Parameters};
use crate::{interchange::source_file::SourceFile, motion::Marker, record::Channel};

/// Parameters of POINT that list model outputs: results that are stored as points without being positions.
const MODEL_OUTPUTS: [&str; 6] = ["ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS"];

/// Most parameters read as lists of model outputs. Texts of length 0 take no bytes, so a damaged file could claim any
/// number of them.
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
    // MODELED_MARKERS are positions, and the labels of all points are no list of model outputs.
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

/// Bytes of frames that are read at a time: they stay in the processor's cache, and a column of a scratch file is written
/// in pieces of about 2 kB if a frame has a thousand words.
const BLOCK_BYTES: usize = 1 << 21;
/// Fewest frames that are read at a time, unless they have more than [`LARGE_BLOCK_BYTES`]: with fewer, a frame of
/// hundreds of thousands of words would cost as many writes to its columns.
const BLOCK_FRAMES_MIN: usize = 64;
const LARGE_BLOCK_BYTES: usize = 1 << 25;

/// Reads successive frames.
#[derive(Debug, Default)]
pub(super) struct FrameBuffer {
    bytes: Vec<u8>,
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
        Ok(Frames { bytes: &self.bytes, layout })
    }

    /// Frames that were read before.
    pub(super) fn held<'b>(&'b self, layout: &'b Layout) -> Frames<'b> {
        Frames { bytes: &self.bytes, layout }
    }
}

/// Successive frames as stored, counted from the first of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frames<'a> {
    bytes: &'a [u8],
    pub(super) layout: &'a Layout,
}

impl<'a> Frames<'a> {
    /// Number of frames.
    pub(super) fn len(&self) -> usize {
        self.bytes.len().checked_div(self.layout.stride.frame_bytes()).unwrap_or(0)
    }

    /// The words of a frame: four for each point, then the analog samples.
    fn frame(&self, index: usize) -> &'a [u8] {
        let n_bytes = self.layout.stride.frame_bytes();
        self.bytes.get(index * n_bytes..(index + 1) * n_bytes).unwrap_or(&[])
    }

    /// A word of `bytes` as a float; integers keep their value.
    fn word_of(&self, bytes: &[u8], word: usize) -> f32 {
        let order = self.layout.order;
        if self.layout.stride.float {
            order.float_at(bytes, 4 * word).unwrap_or(0.0)
        } else {
            f32::from(order.word_at(bytes, 2 * word).unwrap_or(0) as i16)
        }
    }

    /// A word of a frame as a float; integers keep their value.
    pub(super) fn word(&self, frame: usize, word: usize) -> f32 {
        self.word_of(self.frame(frame), word)
    }

    /// A word of a frame as columns store it: a float mapped by [`ordered`], or an integer.
    pub(super) fn column_word(&self, frame: usize, word: usize) -> u32 {
        if self.layout.stride.float {
            ordered(self.word(frame, word).to_bits())
        } else {
            u32::from(self.layout.order.word_at(self.frame(frame), 2 * word).unwrap_or(0))
        }
    }

    /// The stored coordinates and the fourth word of a point.
    pub(super) fn point(&self, frame: usize, point: usize) -> ([f64; 3], f32) {
        let n_bytes = 4 * self.layout.stride.word_bytes();
        let sample = self.frame(frame).get(n_bytes * point..n_bytes * (point + 1));
        let sample = sample.unwrap_or(&[]);
        let [x, y, z, fourth] = [0, 1, 2, 3].map(|word| self.word_of(sample, word));
        ([x, y, z].map(f64::from), fourth)
    }
}

/// Whether the fourth word of a point marks it as missing: it is a 16-bit integer, negative for a missing point. Some
/// software writes -1 in float files as the unsigned 65535.0. Residual and camera mask never reach 32768, so that range
/// is missing, too. A point at the origin with another fourth word is a position, as in the field's other readers.
pub(super) fn is_missing(fourth: f32) -> bool {
    fourth < 0.0 || (32_768.0..65_536.0).contains(&fourth)
}
