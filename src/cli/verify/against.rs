//! `verify --against`: a take compared with its original, as JSON (docs/json.md) and as text.

use std::{io::BufReader, path::Path, sync::Arc};

use anyhow::Context;
use mocapd_acquire::files::SparseFile;
use mocapd_take::{
    TakeFrames,
    compare::{Difference, compare},
    interchange::ReadOptions,
    motion::{Ambiguity, FrameSource},
};
use serde::Serialize;

use crate::cli::{
    motion_files::read_options,
    original::{MotionSource, open_motion},
    output::plain,
    paths,
    values::count,
};

/// Most labels that the text lists; the JSON has all of them.
const LABELS_LISTED_MAX: usize = 10;

#[derive(Debug, Serialize)]
pub(crate) struct AgainstReport {
    within_tolerance: bool,
    /// Ambiguities in the original: places that could also be read in another way.
    ambiguities: Vec<AmbiguityReport>,
    #[serde(flatten)]
    difference: Difference,
}

#[derive(Debug, Serialize)]
struct AmbiguityReport {
    kind: &'static str,
    #[serde(rename = "words")]
    text: String,
}

impl From<&Ambiguity> for AmbiguityReport {
    fn from(found: &Ambiguity) -> Self {
        Self { kind: found.kind(), text: found.to_string() }
    }
}

/// Compares a take with a motion file or another take.
///
/// # Errors
/// If one of the two cannot be read, or they have no frame in common.
pub(crate) fn against(
    take: &Path,
    original: &Path,
    tolerance_mm: f64,
) -> anyhow::Result<AgainstReport> {
    let open = |path: &Path| {
        TakeFrames::open(BufReader::new(SparseFile::open(path)?))
            .with_context(|| format!("cannot read {}", path.display()))
    };
    let take_frames = open(take)?;
    let cut_off = !take_frames.map().finished;
    let (mut ambiguities, mut notes) = (Vec::new(), Vec::new());
    let (difference, exact) = if paths::is_take(original) {
        let original = open(original)?;
        let exact = original.map().header.tolerance_mm == 0.0;
        (compare(take_frames, original), exact)
    } else {
        let options = read_options(&take_frames);
        let source = MotionSource::file(original)?;
        let motion = open_motion(&source, &options, false, &Arc::default())?;
        ambiguities.extend(motion.info().source.ambiguities.iter().map(AmbiguityReport::from));
        notes.extend(note_of(&options));
        (compare(take_frames, motion), true)
    };
    let mut difference = difference.with_context(|| {
        format!("cannot compare {} with {}", take.display(), original.display())
    })?;
    if cut_off {
        // The frames behind the cut are lost; that is not a difference.
        difference.frames_lost += difference.frames_after_take;
        difference.frames_missing -= difference.frames_after_take;
    }
    if !exact {
        // The original has an error of its own, which the take's blocks do not state.
        difference.beyond_stated = None;
    }
    notes.append(&mut difference.notes);
    difference.notes = notes;
    Ok(AgainstReport { ambiguities, ..AgainstReport::new(difference, tolerance_mm) })
}

/// The note that the original was read with the options of the import, if there were any.
fn note_of(options: &ReadOptions) -> Option<String> {
    let options: Vec<String> =
        options.settings().iter().map(|(name, value)| format!("--{name} {value}")).collect();
    (!options.is_empty())
        .then(|| format!("the original was read with the import's options: {}", options.join(" ")))
}

impl AgainstReport {
    pub(crate) fn new(difference: Difference, tolerance_mm: f64) -> Self {
        let within_tolerance = difference.is_within(tolerance_mm);
        Self { within_tolerance, ambiguities: Vec::new(), difference }
    }

    /// Whether the take agrees with the original within the tolerance.
    pub(crate) fn is_within(&self) -> bool {
        self.within_tolerance
    }

    /// The end of a line about the take: the largest error.
    pub(super) fn short(&self) -> String {
        let verdict = if self.is_within() { "agrees with" } else { "DIFFERS from" };
        format!("; {verdict} the original, max error {:.4} mm", self.difference.max_error_mm)
    }

    /// A line with the errors, and a line for each other kind of difference.
    pub(crate) fn text(&self, tolerance_mm: f64) -> String {
        let found = &self.difference;
        let verdict = match (tolerance_mm > 0.0, found.max_error_mm <= tolerance_mm) {
            (true, true) => format!("within the tolerance of {tolerance_mm} mm"),
            (true, false) => format!("NOT WITHIN the tolerance of {tolerance_mm} mm"),
            (false, _) => format!("{} not bit-identical", count(found.bits_differing, "sample")),
        };
        let (samples, frames) = (count(found.samples, "sample"), count(found.frames, "frame"));
        let (max_mm, rms_mm) = (found.max_error_mm, found.rms_error_mm);
        let mut out = format!(
            "against the original: {samples} of {frames}, max error {max_mm:.4} mm, rms {rms_mm:.4} mm, {verdict}\n"
        );
        for note in &found.notes {
            out += &format!("  {}\n", plain(note));
        }
        for ambiguity in &self.ambiguities {
            let text = plain(&ambiguity.text);
            out += &format!("  the original is ambiguous; it was read as in the import: {text}\n");
        }
        if found.frames_lost > 0 {
            let frames = count(found.frames_lost, "frame");
            out += &format!("  not compared, lost in the take: {frames}\n");
        }
        if let Some(beyond) = found.beyond_stated.filter(|&beyond| beyond > 0) {
            let samples = count(beyond, "sample");
            out += &format!("  ERROR ABOVE the one that the block states: {samples}\n");
        }
        if found.frames_missing > 0 {
            out += &format!("  in only one of the two: {}\n", count(found.frames_missing, "frame"));
        }
        if found.gaps_differing > 0 {
            let samples = count(found.gaps_differing, "sample");
            out += &format!("  a gap in only one of the two: {samples}\n");
        }
        if !found.labels_differing.is_empty() {
            let listed = found.labels_differing.len().min(LABELS_LISTED_MAX);
            let labels = found.labels_differing[..listed].join(", ");
            let more = match found.labels_differing.len() - listed {
                0 => String::new(),
                n => format!(" and {n} more"),
            };
            out += &format!("  labels differ: {}{more}\n", plain(&labels));
        }
        out
    }
}
