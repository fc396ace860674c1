//! What a device plays: motion from files, whose format follows from the extension, or from the generator, resampled to
//! another rate one frame at a time; and the sampled channels and rigid bodies of a recorded take.
//!
//! A device plays those at their nominal rates from the first frame on: samples from before it are left out, and so is by how
//! much the clocks of frames and samples drifted. Lost samples and poses are not sent; the host finds that the device
//! dropped them.

use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use mocapd_drivers::device::{
    BODIES_MAX, BodyInfo, ForcePlateInfo, PlateOutput, Pose, PoseStatus, SampleForm,
    SampledChannelInfo, SampledGroupInfo,
};
use mocapd_drivers::link::GROUPS_MAX;
use mocapd_drivers::plain_file;
use mocapd_take::foreign::content::{MemoryScratch, ScratchFile};
use mocapd_take::interchange::{Format, InterchangeError, residuals_10um};
use mocapd_take::motion::{FrameSource, GAP, Motion, Position, is_gap};
use mocapd_take::poses::{Pose as StoredPose, PoseBody, PoseState, PosesByRow, RowPoses};
use mocapd_take::record::{RecordedPlate, SampleForm as StoredForm};
use mocapd_take::sampled::{GroupSamples, Recording, SampleTimeLine};
use mocapd_take::{TakeError, TakeFrames, TakeMap};

use crate::generator::{RecordedPoses, RigidBodies, Rng};
use crate::sampled::{RecordedSamples, SampledSource};

/// Why a motion could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The file's extension is that of no known format.
    #[error("{}: unknown file extension: use .take, .c3d, .trc, .tsv or .csv", path.display())]
    Extension {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be opened or read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The content does not match the extension.
    #[error("{}", path.display())]
    Interchange {
        /// The file.
        path: PathBuf,
        /// The format's error.
        source: InterchangeError,
    },
    /// The take is unreadable.
    #[error("{}", path.display())]
    Take {
        /// The file.
        path: PathBuf,
        /// The take's error.
        source: TakeError,
    },
}

/// Whether a file has the extension of a motion format.
#[must_use]
pub fn is_motion(path: &Path) -> bool {
    is_take(path) || Format::from_extension(path).is_some_and(Format::is_read)
}

fn is_take(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("take"))
}

/// Reads a whole motion; returns it with one warning for each problem that reading tolerated.
///
/// # Errors
/// When the extension is unknown, or the file cannot be read.
pub fn read(path: &Path) -> Result<(Motion, Vec<String>), SourceError> {
    let owned = || path.to_owned();
    let format = Format::from_extension(path).filter(|format| format.is_read());
    if !is_motion(path) {
        return Err(SourceError::Extension { path: owned() });
    }
    let read = |source| SourceError::Read { path: owned(), source };
    let Some(format) = format.filter(|_| !is_take(path)) else {
        let file = plain_file::open(path).map_err(read)?;
        let (motion, problems) = mocapd_take::read_motion(BufReader::new(file))
            .map_err(|source| SourceError::Take { path: owned(), source })?;
        return Ok((motion, problems.iter().map(ToString::to_string).collect()));
    };
    let mut bytes = Vec::new();
    plain_file::open(path).and_then(|mut file| file.read_to_end(&mut bytes)).map_err(read)?;
    let motion =
        format.read(&bytes).map_err(|source| SourceError::Interchange { path: owned(), source })?;
    let warnings = motion.info.source.warnings.clone();
    Ok((motion, warnings))
}

/// Truncates a motion to its first seconds, but at least one frame if it has any.
pub fn keep_first(motion: &mut Motion, seconds: f64) {
    let requested = (seconds * motion.info.rate_hz).round().max(1.0);
    // A float beyond usize saturates, which truncates nothing.
    let n_frames = motion.n_frames().min(requested as usize);
    motion.positions_mm.truncate(n_frames * motion.info.markers.len());
    motion.info.n_frames = n_frames as u64;
}

/// The argument of `--generate`: `jump` or `jump:SEED`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Generated {
    /// Seed of the jump, 1 by default.
    pub seed: u64,
}

impl FromStr for Generated {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, seed) = text.split_once(':').unwrap_or((text, "1"));
        if name != "jump" {
            return Err(format!("unknown motion '{name}', expected jump or jump:SEED"));
        }
        let bad = |_| format!("invalid seed '{seed}': expected 0 to {}", u64::MAX);
        Ok(Self { seed: seed.parse().map_err(bad)? })
    }
}

/// A motion, sampled in steps of a fraction of its own frames.
///
/// Positions between recorded frames are interpolated (Catmull-Rom). A frame that coincides with a recorded one
/// equals it bit for bit. Where one of the two enclosing samples is missing, the result is a gap.
#[derive(Debug, Clone)]
pub struct Replay {
    motion: Arc<Motion>,
    /// Recorded frames per step, as an exact fraction.
    step: (u64, u64),
}

impl Replay {
    /// Plays every recorded frame unchanged.
    #[must_use]
    pub fn native(motion: Arc<Motion>) -> Self {
        Self { motion, step: (1, 1) }
    }

    /// Resamples from the `recorded` to the `wanted` rate, both in the same unit (the device uses millihertz). `None`
    /// when either is 0.
    #[must_use]
    pub fn resampled(motion: Arc<Motion>, recorded: u64, wanted: u64) -> Option<Self> {
        (recorded > 0 && wanted > 0).then_some(Self { motion, step: (recorded, wanted) })
    }

    /// The recorded motion.
    #[must_use]
    pub fn motion(&self) -> &Arc<Motion> {
        &self.motion
    }

    /// Number of resampled frames from the first recorded one to the last.
    #[must_use]
    pub fn n_frames(&self) -> u64 {
        let Some(last) = (self.motion.n_frames() as u64).checked_sub(1) else { return 0 };
        let (num, den) = self.step;
        let steps = u128::from(last) * u128::from(den) / u128::from(num);
        u64::try_from(steps).unwrap_or(u64::MAX - 1) + 1
    }

    /// The recorded frame that is nearest to a resampled one.
    pub(crate) fn recorded_frame(&self, index: u64) -> u64 {
        let (num, den) = (u128::from(self.step.0), u128::from(self.step.1));
        u64::try_from((u128::from(index) * num + den / 2) / den).unwrap_or(u64::MAX)
    }

    /// Replaces `row` by one frame, with one position per marker, in millimetres; empty past the end.
    pub fn frame(&self, index: u64, row: &mut Vec<Position>) {
        row.clear();
        let (num, den) = (u128::from(self.step.0), u128::from(self.step.1));
        let at = u128::from(index) * num;
        if index >= self.n_frames() {
            return;
        }
        let before = (at / den) as usize;
        let part = at % den;
        if part == 0 {
            row.extend_from_slice(self.motion.frame(before));
        } else {
            between(&self.motion, before, part as f64 / den as f64, row);
        }
    }
}

/// Appends every marker's position between frame `before` and the next, at the fraction `part` in (0, 1).
fn between(motion: &Motion, before: usize, part: f64, row: &mut Vec<Position>) {
    let here = motion.frame(before);
    let next = motion.frame(before + 1);
    let earlier = before.checked_sub(1).map_or(&[][..], |i| motion.frame(i));
    let later = motion.frame(before + 2);
    for (marker, &p1) in here.iter().enumerate() {
        let get = |frame: &[Position]| frame.get(marker).copied().filter(|p| !is_gap(*p));
        row.push(match get(next) {
            Some(p2) if !is_gap(p1) => cubic(get(earlier), p1, p2, get(later), part),
            _ => GAP,
        });
    }
}

/// The cubic between `p1` and `p2` whose slopes are the chords of their neighbours.
///
/// Catmull and Rom, "A class of local interpolating splines", 1974; Hermite form. Next to a gap the slope is that of
/// the segment itself, which gives a parabola, or a line between two gaps.
fn cubic(
    p0: Option<Position>,
    p1: Position,
    p2: Position,
    p3: Option<Position>,
    x: f64,
) -> Position {
    let mut out = [0.0; 3];
    for (axis, value) in out.iter_mut().enumerate() {
        let at = |p: Position| f64::from(p[axis]);
        let (a, b) = (at(p1), at(p2));
        let from = p0.map_or(b - a, |p| 0.5 * (b - at(p)));
        let to = p3.map_or(b - a, |p| 0.5 * (at(p) - a));
        let d = b - a;
        let (c2, c3) = (3.0 * d - 2.0 * from - to, from + to - 2.0 * d);
        *value = (a + x * (from + x * (c2 + x * c3))) as f32;
    }
    out
}

/// The residuals of the markers of a motion, as devices report them: in units of 10 micrometres, 255 for larger ones, and 0
/// for none.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Residuals {
    n_markers: usize,
    /// Frame after frame, and in each all markers.
    counts_10um: Vec<u8>,
}

impl Residuals {
    /// Random ones: between 0.05 mm and 0.69 mm, each marker around a value of its own, and none now and then.
    #[must_use]
    pub fn generated(seed: u64, motion: &Motion) -> Self {
        let n_markers = motion.info.markers.len();
        let mut streams: Vec<Rng> =
            (0..n_markers as u64).map(|marker| Rng::stream(seed, marker)).collect();
        let usual: Vec<f64> = streams.iter_mut().map(|rng| 5.0 + 50.0 * rng.unit()).collect();
        let mut counts_10um = Vec::with_capacity(motion.n_frames() * n_markers);
        for _ in 0..motion.n_frames() {
            counts_10um.extend(streams.iter_mut().zip(&usual).map(|(rng, usual)| {
                let has_one = rng.below(256) > 0;
                let noise = 14.0 * (rng.unit() + rng.unit()) / 2.0;
                if has_one { (usual + noise) as u8 } else { 0 }
            }));
        }
        Self { n_markers, counts_10um }
    }

    /// Those of a C3D file, or of a take that was imported from one or recorded with them; `None` if there are none.
    /// `motion` is what was read from the file.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read(path: &Path, motion: &Motion) -> Result<Option<Self>, SourceError> {
        let owned = || path.to_owned();
        let n_markers = motion.info.markers.len();
        let read = |source| SourceError::Read { path: owned(), source };
        if !is_take(path) {
            let counts = residuals_10um(&motion.info).map_err(read)?;
            return Ok(counts.map(|counts_10um| Self { n_markers, counts_10um }));
        }
        let of_take = |source| SourceError::Take { path: owned(), source };
        let open = || plain_file::open(path).map(BufReader::new).map_err(read);
        let map = TakeMap::scan(&mut open()?).map_err(of_take)?;
        if let Some(recording) = Recording::open(&map, open()?).map_err(of_take)?
            && recording.has_residuals()
        {
            let n_frames = motion.n_frames();
            let rows = 0..n_frames as u64;
            let mut rows = recording.residuals(&rows, n_markers).map_err(of_take)?;
            let mut counts_10um = Vec::with_capacity(n_frames * n_markers);
            for _ in 0..n_frames {
                counts_10um.extend_from_slice(rows.next_row().map_err(read)?);
            }
            return Ok(Some(Self { n_markers, counts_10um }));
        }
        let is_of_c3d = |kind: &str| kind.starts_with("c3d/");
        let in_memory = || Ok(Arc::new(MemoryScratch::default()) as Arc<dyn ScratchFile>);
        let frames = TakeFrames::open_with(open()?, is_of_c3d, in_memory).map_err(of_take)?;
        let counts = residuals_10um(frames.info()).map_err(read)?;
        Ok(counts.map(|counts_10um| Self { n_markers, counts_10um }))
    }

    /// Those of a frame of the motion, by marker; none past its end.
    #[must_use]
    pub fn frame(&self, index: u64) -> &[u8] {
        let mut rows = self.counts_10um.chunks_exact(self.n_markers.max(1));
        usize::try_from(index).ok().and_then(|index| rows.nth(index)).unwrap_or_default()
    }
}

/// Limit on what is held in memory: half an hour of 64 channels at 2 kHz, and as much of poses.
const BYTES_MAX: usize = 1 << 30;

/// What a take has besides its markers.
#[derive(Debug, Default)]
pub struct RecordedSignals {
    /// Its groups of sampled channels.
    pub sampled: Vec<SampledSource>,
    /// Its rigid bodies.
    pub bodies: Option<Arc<RigidBodies>>,
    /// What cannot be played, and why, one sentence each.
    pub left_out: Vec<String>,
}

/// Reads the sampled channels and the poses of a recorded take, those of its first seconds if there is a limit.
///
/// # Errors
/// When the file cannot be read or is no take.
pub fn read_signals(path: &Path, seconds: Option<f64>) -> Result<RecordedSignals, SourceError> {
    let owned = || path.to_owned();
    let file =
        plain_file::open(path).map_err(|source| SourceError::Read { path: owned(), source })?;
    read_from(&mut BufReader::new(file), seconds)
        .map_err(|source| SourceError::Take { path: owned(), source })
}

fn read_from(
    input: &mut (impl Read + Seek),
    seconds: Option<f64>,
) -> Result<RecordedSignals, TakeError> {
    let map = TakeMap::scan(input)?;
    let mut found = RecordedSignals::default();
    let mut bytes_left = BYTES_MAX;
    if map.recorded_groups().next().is_some() {
        let line = SampleTimeLine::read(&mut *input, &map)?;
        let (plates, unusable) = map.force_plates();
        found.left_out.extend(unusable.iter().map(|why| format!("a force plate: {why}")));
        for (index, group) in line.groups().iter().enumerate() {
            // Frames have the residuals of their markers.
            if group.group.has_residuals() {
                continue;
            }
            let first = first_sample(&line, index, map.n_rows);
            match read_group(input, group, (first, seconds), &mut bytes_left)? {
                Ok(samples) => {
                    let of_group = plates.iter().filter(|plate| plate.group == group.group.number);
                    let plates = of_group.filter_map(plate_info).collect();
                    match SampledSource::recorded(info(group), plates, samples) {
                        Ok(source) => found.sampled.push(source),
                        Err(error) => found.left_out.push(error.to_string()),
                    }
                }
                Err(why) => found.left_out.push(why),
            }
        }
    }
    if let Some(index) = PosesByRow::read(&mut *input, &map)? {
        match read_poses(input, &index, rows_of(&map, seconds), bytes_left)? {
            Ok(poses) => found.bodies = Some(Arc::new(RigidBodies::recorded(poses))),
            Err(why) => found.left_out.push(why),
        }
    }
    Ok(found)
}

fn rows_of(map: &TakeMap, seconds: Option<f64>) -> u64 {
    let rows = |seconds: f64| (seconds * map.header.rate_hz).round().max(1.0) as u64;
    seconds.map_or(map.n_rows, |seconds| rows(seconds).min(map.n_rows))
}

/// The first sample that was taken with the first frame, or after it.
fn first_sample(line: &SampleTimeLine, group: usize, n_rows: u64) -> Option<u64> {
    let (index, clock) = (line.index(group)?, line.clock(group)?);
    let mut first = None;
    index.in_rows(clock, &(0..n_rows.max(1)), |number, row| {
        first = row.map(|_| number);
        first.is_none()
    });
    first
}

fn info(group: &GroupSamples) -> SampledGroupInfo {
    let group = &group.group;
    let channel = |channel: &mocapd_take::record::SampledChannel| SampledChannelInfo {
        name: channel.name.clone(),
        unit: channel.unit.clone(),
        scale: channel.scale,
        offset: channel.offset,
    };
    SampledGroupInfo {
        id: u8::try_from(group.number).unwrap_or(u8::MAX),
        form: match group.form {
            StoredForm::Int16 => SampleForm::Int16,
            StoredForm::Float32 => SampleForm::Float32,
            // Recorders do not write these; their counts fit.
            StoredForm::Uint16 => SampleForm::Int32,
        },
        rate_millihertz: (group.rate_hz * 1000.0).round() as u32,
        channels: group.channels.iter().map(channel).collect(),
    }
}

fn plate_info(plate: &RecordedPlate) -> Option<ForcePlateInfo> {
    let stated = plate.stated();
    let output = PlateOutput::ALL.into_iter().find(|output| output.code() == stated.code)?;
    let channels = stated.channels.iter().map(|&channel| u8::try_from(channel).ok());
    Some(ForcePlateInfo {
        number: stated.number,
        output,
        group: u8::try_from(stated.group).ok()?,
        channels: channels.collect::<Option<_>>()?,
        corners_mm: stated.corners_mm.map(|corner| corner.map(|at| at as f32)),
        origin_mm: stated.origin_mm.map(|at| at as f32),
    })
}

/// The samples of a group from its first one on, or why it cannot be played.
fn read_group(
    input: &mut (impl Read + Seek),
    group: &GroupSamples,
    (first, seconds): (Option<u64>, Option<f64>),
    bytes_left: &mut usize,
) -> Result<Result<RecordedSamples, String>, TakeError> {
    let (number, n_channels) = (group.group.number, group.group.channels.len());
    if number as usize >= GROUPS_MAX {
        return Ok(Err(format!("group {number}: a device has the groups 0 to {}", GROUPS_MAX - 1)));
    }
    let Some(first) = first else {
        return Ok(Err(format!("group {number}: no sample was taken with a frame")));
    };
    let limit = seconds.map_or(u64::MAX, |seconds| (seconds * group.group.rate_hz).ceil() as u64);
    let end = group.n_samples().min(first.saturating_add(limit));
    let mut samples = RecordedSamples::default();
    let mut is_too_large = false;
    group.read(input, |from, n, found| {
        let (start, stop) = (from.max(first), (from + n).min(end));
        let Some(found) = found.filter(|_| start < stop && !is_too_large) else { return Ok(()) };
        let bytes = (stop - start) as usize * n_channels * size_of::<f32>();
        let Some(left) = bytes_left.checked_sub(bytes) else {
            is_too_large = true;
            return Ok(());
        };
        *bytes_left = left;
        let columns: Vec<&[f32]> = found.chunks_exact(n as usize).collect();
        let rows = (start - from) as usize..(stop - from) as usize;
        samples.add(start - first, rows, &columns);
        Ok(())
    })?;
    samples.end_at(end.saturating_sub(first));
    let too_large = || {
        format!(
            "group {number}: its samples need more than 1 GiB of memory: play less with --seconds"
        )
    };
    Ok(if is_too_large { Err(too_large()) } else { Ok(samples) })
}

fn read_poses(
    input: &mut (impl Read + Seek),
    index: &PosesByRow,
    n_rows: u64,
    bytes_left: usize,
) -> Result<Result<RecordedPoses, String>, TakeError> {
    let n_bodies = index.bodies().len();
    let bytes = (n_rows as usize).saturating_mul(n_bodies).saturating_mul(size_of::<Pose>());
    if n_bodies > BODIES_MAX {
        return Ok(Err(format!("{n_bodies} rigid bodies: a device has at most {BODIES_MAX}")));
    }
    if bytes > bytes_left {
        let why = "the rigid bodies: their poses need more than 1 GiB of memory with the samples: \
                   play less with --seconds";
        return Ok(Err(why.to_owned()));
    }
    // A device lists its bodies by their numbers, of which no two are the same.
    let mut order: Vec<(usize, &PoseBody)> = index.bodies().iter().enumerate().collect();
    order.sort_by_key(|(_, body)| body.number);
    if order.windows(2).any(|pair| pair[0].1.number == pair[1].1.number) {
        return Ok(Err("the rigid bodies: two of them have the same number".to_owned()));
    }
    let mut infos = Vec::new();
    for (_, body) in &order {
        let Ok(id) = u16::try_from(body.number) else {
            return Ok(Err(format!("the rigid bodies: number {} of one of them", body.number)));
        };
        infos.push(BodyInfo { id, name: body.name.clone() });
    }
    let mut recorded = RecordedPoses::new(infos);
    let (mut rows, mut poses) = (index.rows(0..n_rows), Vec::new());
    while rows.next(input, RowPoses::ROWS_AT_ONCE, &mut poses)?.is_some() {
        for of_row in poses.chunks_exact(n_bodies) {
            let is_missing = of_row.iter().all(|pose| pose.state == PoseState::Missing);
            let of_bodies = order.iter().filter_map(|(at, body)| of_row.get(*at).zip(Some(body)));
            let sent = of_bodies.filter_map(|(pose, body)| sent(pose, body.number as u16));
            recorded.add_frame(!is_missing, sent);
        }
    }
    Ok(Ok(recorded))
}

/// A pose as a device sends it; `None` if it did not list the body.
fn sent(pose: &StoredPose, body: u16) -> Option<Pose> {
    let without = |status| Some(Pose::without(body, status));
    match pose.state {
        PoseState::Tracked => Some(Pose {
            body,
            status: PoseStatus::Tracked,
            position_mm: pose.position_mm,
            quaternion: pose.quaternion,
            residual_mm: pose.residual_mm,
        }),
        PoseState::Lost => without(PoseStatus::Lost),
        PoseState::Rejected => without(PoseStatus::Rejected),
        // The first code of later versions: that of the take is not known.
        PoseState::Other => without(PoseStatus::Other(3)),
        PoseState::Missing | PoseState::Refused | PoseState::Unlisted => None,
    }
}

#[cfg(test)]
mod tests;
