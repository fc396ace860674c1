//! The sampled channels and rigid bodies of a recorded take, for a device that plays it.
//!
//! A device plays them at their nominal rates from the first frame on: samples from before it are left out, and so is by how
//! much the clocks of frames and samples drifted. Lost samples and poses are not sent; the host finds that the device
//! dropped them.

use std::io::{BufReader, Read, Seek};
use std::path::Path;
use std::sync::Arc;

use mocapd_drivers::device::{
    BODIES_MAX, BodyInfo, ForcePlateInfo, PlateOutput, Pose, PoseStatus, SampleForm,
    SampledChannelInfo, SampledGroupInfo,
};
use mocapd_drivers::link::GROUPS_MAX;
use mocapd_drivers::plain_file;
use mocapd_take::poses::{Pose as StoredPose, PoseBody, PoseState, PosesByRow, RowPoses};
use mocapd_take::record::{RecordedPlate, SampleForm as StoredForm};
use mocapd_take::sampled::{GroupSamples, SampleTimeLine};
use mocapd_take::{TakeError, TakeMap};

use crate::generator::{RecordedPoses, RigidBodies};
use crate::sampled::{RecordedSamples, SampledSource};
use crate::source::SourceError;

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
pub fn read(path: &Path, seconds: Option<f64>) -> Result<RecordedSignals, SourceError> {
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
