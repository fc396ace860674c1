//! What an importer kept of a C3D file besides trajectories: parameters, analog channels and force plates.

use std::{fs::File, io, ops::Range, sync::Arc};

use mocapd_take::{
    TakeError, TakeFrames, TakeMap,
    damage::Problem,
    foreign::{
        analog::{self, AnalogSamples},
        content::ScratchFile,
        force_plates::{Baseline, ForcePlates, PlateLoad, PlateLoads},
        parameters::{self, C3dParameter, C3dValues},
    },
    motion::{FrameSource, MotionInfo},
};

use crate::{
    errors::{Failure, Result},
    source::{Source, read_exact_at, write_all_at},
};

/// Values of a load in an array: force, moment, centre of pressure and free moment, three axes each.
pub(crate) const LOAD_VALUES: usize = 12;

/// The parts to read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum KeptParts {
    /// The parameters, a few kB.
    Parameters,
    /// The parameters and the analog samples.
    All,
}

/// A take with the content of its parts.
#[derive(Debug)]
pub(crate) struct KeptContent {
    pub(crate) info: MotionInfo,
    /// The analog samples that are lost, which are NaN, one phrase each; and the parameters, if they are.
    pub(crate) lost: Vec<String>,
}

/// Describes a take, with the content of these parts. Large content is in a temporary file.
pub(crate) fn read_kept(source: &Source, parts: KeptParts) -> Result<KeptContent> {
    let is_wanted = |kind: &str| match parts {
        KeptParts::Parameters => parameters::is_needed(kind),
        KeptParts::All => analog::is_needed(kind),
    };
    let frames = TakeFrames::open_with(source.reader(), is_wanted, scratch)?;
    let info = frames.info();
    // An import of a C3D file has parameters, and samples if the parameters declare them, unless they were dropped on
    // request.
    if info.source.format == "c3d" && is_part_lost(frames.map()) {
        let found = match parameters::read(info).map_err(as_damage)? {
            Some(found) if !frames.problems().contains(&Problem::ParametersLost) => found,
            _ => return Err(lost("the parameters of the C3D file")),
        };
        if parts == KeptParts::All && has_channels(&found) && analog(info)?.is_none() {
            return Err(lost("the analog samples of the C3D file"));
        }
    }
    let is_lost = |problem: &&Problem| match problem {
        Problem::SamplesLost { kind, .. } => analog::is_needed(kind),
        other => **other == Problem::ParametersLost,
    };
    let lost = frames.problems().iter().filter(is_lost).map(ToString::to_string).collect();
    Ok(KeptContent { info: info.clone(), lost })
}

/// Whether the damage of a take may have cost it a part: parts precede the stretches.
fn is_part_lost(map: &TakeMap) -> bool {
    let stretches_at = map.keys.first().map_or(u64::MAX, |key| key.offset);
    map.problems.iter().any(|problem| match problem {
        Problem::Damaged { offset, .. } => *offset < stretches_at,
        Problem::CutOff => map.keys.is_empty(),
        Problem::ForeignTooLong { .. } | Problem::PartUnreadable { .. } => true,
        _ => false,
    })
}

/// Whether the file states analog channels.
fn has_channels(parameters: &[C3dParameter]) -> bool {
    let used = parameters.iter().find(|parameter| parameter.is("ANALOG", "USED"));
    used.is_some_and(|used| matches!(&used.values, C3dValues::Integers(n) if n.first() != Some(&0)))
}

fn lost(what: &str) -> Failure {
    Failure::Damaged(format!("{what} cannot be read: this part of the take is damaged or missing"))
}

/// An error of the content of a part: the caller's arguments are not the reason.
fn as_damage(error: TakeError) -> Failure {
    match error {
        TakeError::InvalidArgument(message) => Failure::Damaged(message),
        other => other.into(),
    }
}

/// The parameters; empty if the take has none.
pub(crate) fn parameters(kept: &MotionInfo) -> Result<Vec<C3dParameter>> {
    Ok(parameters::read(kept).map_err(as_damage)?.unwrap_or_default())
}

/// The analog samples of all frames; `None` without analog channels.
pub(crate) fn analog(kept: &MotionInfo) -> Result<Option<AnalogSamples<'_>>> {
    AnalogSamples::open(kept).map_err(as_damage)
}

/// The force plates; empty if the take has none.
pub(crate) fn force_plates(kept: &MotionInfo) -> Result<ForcePlates> {
    Ok(ForcePlates::of(kept).map_err(as_damage)?.unwrap_or_default())
}

/// Fills `out`, which has a row for each of `samples` and a column for each of `channels`, with physical values; NaN for
/// samples that the file does not have.
pub(crate) fn read_analog(
    kept: &MotionInfo,
    source: &Source,
    samples: &Range<u64>,
    channels: &[usize],
    out: &mut [f64],
) -> Result<()> {
    let ratio = analog(kept)?.map_or(0, |analog| analog.samples_per_frame());
    let (part, rows_before) = part(kept, samples, ratio);
    let Some(mut analog) = analog(&part)? else {
        out.fill(f64::NAN);
        return Ok(());
    };
    let n_channels = analog.channels().len();
    let mut out = RowFiller::new(out, channels.len(), rows_before);
    let mut block = Vec::new();
    while analog.next_block(&mut block)? > 0 {
        source.check()?;
        for row in block.chunks_exact(n_channels.max(1)) {
            let Some(out) = out.next() else { continue };
            for (out, &channel) in out.iter_mut().zip(channels) {
                *out = row.get(channel).copied().unwrap_or(f64::NAN);
            }
        }
    }
    out.fill(f64::NAN);
    Ok(())
}

/// Fills `out`, which has a row for each of `samples` and [`LOAD_VALUES`] columns for each of `plates`, with loads; NaN for
/// samples that the file does not have.
pub(crate) fn read_loads(
    kept: &MotionInfo,
    source: &Source,
    samples: &Range<u64>,
    plates: &[usize],
    out: &mut [f64],
) -> Result<()> {
    let ratio = analog(kept)?.map_or(0, |analog| analog.samples_per_frame());
    let (part, rows_before) = part(kept, samples, ratio);
    let loads = PlateLoads::open(&part, Baseline::AsStored).map_err(as_damage)?;
    let Some(mut loads) = loads else {
        out.fill(f64::NAN);
        return Ok(());
    };
    let n_plates = loads.plates().plates.len();
    let mut out = RowFiller::new(out, plates.len() * LOAD_VALUES, rows_before);
    let mut block = Vec::new();
    while loads.next_block(&mut block)? > 0 {
        source.check()?;
        for row in block.chunks_exact(n_plates.max(1)) {
            let Some(out) = out.next() else { continue };
            for (out, &plate) in out.as_chunks_mut::<LOAD_VALUES>().0.iter_mut().zip(plates) {
                *out = row.get(plate).map_or([f64::NAN; LOAD_VALUES], values);
            }
        }
    }
    out.fill(f64::NAN);
    Ok(())
}

pub(crate) fn values(load: &PlateLoad) -> [f64; LOAD_VALUES] {
    let mut values = [f64::NAN; LOAD_VALUES];
    let PlateLoad { force_n, moment_nm, cop_mm, free_moment_nm } = load;
    let all = [force_n, moment_nm, cop_mm, free_moment_nm].into_iter().flatten();
    values.iter_mut().zip(all).for_each(|(value, found)| *value = *found);
    values
}

/// The frames that have `samples`, as the description of that part of the take, and the number of samples in them before
/// the first one.
fn part(kept: &MotionInfo, samples: &Range<u64>, ratio: usize) -> (MotionInfo, u64) {
    let ratio = ratio.max(1) as u64;
    let first_frame = samples.start / ratio;
    let mut part = kept.clone();
    part.cut(first_frame, samples.end.div_ceil(ratio).max(first_frame));
    (part, samples.start - first_frame * ratio)
}

/// The rows of an array, filled one after another.
struct RowFiller<'a> {
    left: &'a mut [f64],
    width: usize,
    /// Rows that come first but are not in the array.
    rows_before: u64,
}

impl<'a> RowFiller<'a> {
    fn new(out: &'a mut [f64], width: usize, rows_before: u64) -> Self {
        Self { left: out, width, rows_before }
    }

    /// The place of the next row; `None` if the array does not have it.
    fn next(&mut self) -> Option<&'a mut [f64]> {
        if self.rows_before > 0 {
            self.rows_before -= 1;
            return None;
        }
        let (row, left) = std::mem::take(&mut self.left).split_at_mut_checked(self.width)?;
        self.left = left;
        Some(row)
    }

    /// Fills the rows that are left.
    fn fill(self, value: f64) {
        self.left.fill(value);
    }
}

/// A temporary file without a name, for content that is not to be held in memory.
#[derive(Debug)]
struct Scratch(File);

impl ScratchFile for Scratch {
    fn read_at(&self, at: u64, bytes: &mut [u8]) -> io::Result<()> {
        read_exact_at(&self.0, bytes, at)
    }

    fn write_at(&self, at: u64, bytes: &[u8]) -> io::Result<()> {
        write_all_at(&self.0, bytes, at).map_err(|error| scratch_error(&error))
    }
}

pub(crate) fn scratch() -> io::Result<Arc<dyn ScratchFile>> {
    let file = tempfile::tempfile().map_err(|error| scratch_error(&error))?;
    Ok(Arc::new(Scratch(file)))
}

fn scratch_error(error: &io::Error) -> io::Error {
    let folder = std::env::temp_dir();
    let message = format!(
        "cannot write the analog samples of the take to a temporary file in {} ({error}): set TMPDIR to another folder",
        folder.display()
    );
    io::Error::new(error.kind(), message)
}
