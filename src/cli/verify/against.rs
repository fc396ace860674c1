//! How far a take lies from an original, as docs/json.md has it, and for people.

use std::{io::BufReader, path::Path};

use anyhow::Context;
use mocapd::compare::{Difference, compare};
use mocapd_acquire::files::SparseFile;
use mocapd_take::{
    TakeFrames,
    interchange::ReadOptions,
    motion::{Ambiguity, MotionFrames},
};
use serde::Serialize;

use crate::cli::{
    original::read_motion_with,
    output::plain,
    paths,
    values::{count, thousands},
    whole::read_options,
};

/// Most labels that are listed for people; `--json` has all of them.
const LABELS_LISTED_MAX: usize = 10;

#[derive(Debug, Serialize)]
pub(crate) struct AgainstReport {
    within_tolerance: bool,
    /// Where the original can be read in another way than it was.
    ambiguities: Vec<AmbiguityReport>,
    #[serde(flatten)]
    difference: Difference,
}

#[derive(Debug, Serialize)]
struct AmbiguityReport {
    kind: &'static str,
    words: String,
}

impl From<&Ambiguity> for AmbiguityReport {
    fn from(found: &Ambiguity) -> Self {
        Self { kind: found.kind(), words: found.to_string() }
    }
}

/// Compares a take with a file of the field or another take.
///
/// # Errors
/// That one of the two cannot be read.
pub(super) fn against(
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
    let mut ambiguities = Vec::new();
    let mut notes = Vec::new();
    let (difference, exact) = if paths::is_take(original) {
        let original = open(original)?;
        let exact = original.map().header.tolerance_mm == 0.0;
        (compare(take_frames, original), exact)
    } else {
        let options = read_options(&take_frames);
        let motion = read_motion_with(original, &options)?;
        ambiguities.extend(motion.info.source.ambiguities.iter().map(AmbiguityReport::from));
        notes.extend(note_of(&options));
        (compare(take_frames, MotionFrames::new(&motion)), true)
    };
    let mut difference = difference.with_context(|| {
        format!("cannot compare {} with {}", take.display(), original.display())
    })?;
    if cut_off {
        // What came behind the cut is lost, and no difference.
        difference.frames_lost += std::mem::take(&mut difference.frames_missing);
    }
    if !exact {
        // Its own rounding comes to what a block states.
        difference.beyond_stated = None;
    }
    notes.append(&mut difference.notes);
    difference.notes = notes;
    Ok(AgainstReport { ambiguities, ..AgainstReport::new(difference, tolerance_mm) })
}

/// That the original was read with what the import was given.
fn note_of(options: &ReadOptions) -> Option<String> {
    let given: Vec<String> =
        options.settings().iter().map(|(name, value)| format!("--{name} {value}")).collect();
    (!given.is_empty())
        .then(|| format!("the original was read as it was imported, with {}", given.join(" ")))
}

impl AgainstReport {
    pub(crate) fn new(difference: Difference, tolerance_mm: f64) -> Self {
        let within_tolerance = difference.is_within(tolerance_mm);
        Self { within_tolerance, ambiguities: Vec::new(), difference }
    }

    /// Whether nothing differs but distances within the tolerance.
    pub(crate) fn is_within(&self) -> bool {
        self.within_tolerance
    }

    /// One line, and what is wrong beside the distances.
    pub(crate) fn words(&self, tolerance_mm: f64) -> String {
        let found = &self.difference;
        let verdict = match (tolerance_mm > 0.0, found.max_error_mm <= tolerance_mm) {
            (true, true) => format!("within the tolerance of {tolerance_mm} mm"),
            (true, false) => format!("NOT WITHIN the tolerance of {tolerance_mm} mm"),
            (false, _) => format!("{} differ in a bit", count(found.bits_differing, "sample")),
        };
        let mut out = format!(
            "against the original: {} of {}, max error {:.4} mm, rms {:.4} mm, {verdict}\n",
            count(found.samples, "sample"),
            count(found.frames, "frame"),
            found.max_error_mm,
            found.rms_error_mm
        );
        for note in &found.notes {
            out += &format!("  {}\n", plain(note));
        }
        for ambiguity in &self.ambiguities {
            let words = plain(&ambiguity.words);
            out += &format!(
                "  the original can be read in another way, and was read as at import: {words}\n"
            );
        }
        if found.frames_lost > 0 {
            let frames = count(found.frames_lost, "frame");
            out += &format!("  not compared, the take lost them: {frames}\n");
        }
        if let Some(beyond) = found.beyond_stated.filter(|&beyond| beyond > 0) {
            let samples = count(beyond, "sample");
            out += &format!("  FARTHER AWAY than their blocks state: {samples}\n");
        }
        if found.frames_missing > 0 {
            out += &format!("  in one of the two only: {}\n", count(found.frames_missing, "frame"));
        }
        if found.gaps_differing > 0 {
            let samples = thousands(found.gaps_differing);
            out += &format!("  a gap in one of the two only: {samples} samples\n");
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
