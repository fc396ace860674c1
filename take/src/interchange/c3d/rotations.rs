//! Poses of rigid bodies in a C3D file: the ROTATION group and its data section, as C-Motion introduced them in 2019 and
//! ezc3d, `Visual3D` and others read them.
//!
//! The section has 17 floats for each body in each frame: a 4 x 4 matrix, column after column, that takes points of the body
//! to the laboratory, and a residual, which is -1 where there is no pose. It begins at a block whose number has 16 bits.

use std::io::{self, Write};

use super::{
    header::{BLOCK, is_counted_by_length},
    parameters::Parameters,
};
use crate::{
    interchange::{
        InterchangeError, Result,
        frame_poses::{FramePoses, body_names},
    },
    motion::MotionInfo,
    poses::{Pose, matrix},
};

pub(super) const ROTATION: &str = "ROTATION";

/// Floats of a pose.
const POSE_FLOATS: usize = 17;

/// The largest number of a block at which a section may begin, less those before the data: a header and 255 of parameters.
/// The number has 16 bits, and readers take it as a signed one: ezc3d reads zeros from a section beyond.
const BLOCKS_MAX: u64 = i16::MAX as u64 - 257;

/// The poses of a file.
#[derive(Debug)]
pub(super) struct Rotations<'a> {
    info: &'a MotionInfo,
    n_bodies: u64,
    /// Bytes of the points and analog samples.
    data_bytes: u64,
    /// Whether the section is behind these, as other programs write it. It is before them if they end beyond the last block
    /// at which a section may begin, or if their length tells how many frames there are.
    is_behind: bool,
}

/// Number of blocks.
pub(super) fn blocks(bytes: u64) -> u64 {
    bytes.div_ceil(BLOCK as u64)
}

impl<'a> Rotations<'a> {
    /// The poses of a recording for a file with `frame_bytes` of points and analog samples a frame; `None` if it has none, or
    /// they do not fit.
    pub(super) fn of(info: &'a MotionInfo, frame_bytes: u64) -> Option<Self> {
        let n_bodies = info.recording.as_ref()?.bodies().len() as u64;
        let data_bytes = info.n_frames.saturating_mul(frame_bytes);
        let is_behind = blocks(data_bytes) <= BLOCKS_MAX && !is_counted_by_length(info);
        let found = Self { info, n_bodies, data_bytes, is_behind };
        let fits = is_behind || blocks(found.n_bytes()) <= BLOCKS_MAX;
        (n_bodies > 0 && fits).then_some(found)
    }

    /// The most frames whose poses fit, for a file with `frame_bytes` of points and analog samples a frame.
    pub(super) fn frames_max(frame_bytes: u64) -> u64 {
        let fitting = BLOCKS_MAX * BLOCK as u64 / frame_bytes.max(1);
        fitting.min(u64::from(u16::MAX) - 1)
    }

    /// Whether the section is behind the points and analog samples.
    pub(super) fn is_behind(&self) -> bool {
        self.is_behind
    }

    /// Sets the parameters, as if the section began at block 1: its place is not known yet.
    pub(super) fn fill_parameters(&self, parameters: &mut Parameters) -> Result<()> {
        let names = body_names(self.info);
        parameters.set_integer(ROTATION, "USED", names.len() as u16);
        parameters.set_integer(ROTATION, "DATA_START", 1);
        parameters.set_float(ROTATION, "RATE", self.info.rate_hz as f32);
        parameters.set_integer(ROTATION, "RATIO", 1);
        match u16::try_from(self.info.n_frames) {
            Ok(n_frames) => parameters.set_integer(ROTATION, "FRAMES", n_frames),
            Err(_) => parameters.set_float(ROTATION, "FRAMES", self.info.n_frames as f32),
        }
        let about = names.iter().map(|_| String::new()).collect::<Vec<_>>();
        for (name, texts) in [("LABELS", &names), ("DESCRIPTIONS", &about)] {
            parameters.set_texts(ROTATION, name, texts).map_err(|name| {
                InterchangeError::Unsupported(format!(
                    "C3D names of rigid bodies have at most 255 bytes, but `{name}` has {}",
                    name.len()
                ))
            })?;
        }
        Ok(())
    }

    /// Bytes of the section, whole blocks.
    pub(super) fn n_bytes(&self) -> u64 {
        let n_floats = self.info.n_frames.saturating_mul(self.n_bodies * POSE_FLOATS as u64);
        n_floats.saturating_mul(4).checked_next_multiple_of(BLOCK as u64).unwrap_or(u64::MAX)
    }

    /// Sets the place of the section. Returns the block of the points, if that of the first data is `first`.
    pub(super) fn set_place(&self, parameters: &mut Parameters, first: u16) -> u16 {
        // Both fit, as `of` has found.
        let behind = |bytes: u64| first.saturating_add(blocks(bytes) as u16);
        let (own, points) = match self.is_behind {
            true => (behind(self.data_bytes), first),
            false => (first, behind(self.n_bytes())),
        };
        parameters.set_integer(ROTATION, "DATA_START", own);
        points
    }

    /// Writes the section.
    pub(super) fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let Some(mut poses) = FramePoses::open(self.info) else { return Ok(()) };
        let (mut words, mut n_written) = (Vec::new(), 0);
        for _ in 0..self.info.n_frames {
            words.clear();
            poses.next_frame()?.iter().for_each(|pose| put(pose, &mut words));
            out.write_all(&words)?;
            n_written += words.len() as u64;
        }
        let padding = self.n_bytes().saturating_sub(n_written).min(BLOCK as u64);
        out.write_all(&[0; BLOCK][..padding as usize])
    }
}

fn put(pose: &Pose, out: &mut Vec<u8>) {
    let (matrix, residual) = match pose.is_tracked() {
        true => (matrix(pose).map(|number| number as f32), pose.residual_mm),
        false => ([f32::NAN; 16], -1.0),
    };
    // A residual that is unknown is 0, as that of a point; below 0 there is no pose.
    let residual = if pose.is_tracked() { residual.max(0.0) } else { residual };
    out.extend(matrix.into_iter().chain([residual]).flat_map(f32::to_le_bytes));
}
