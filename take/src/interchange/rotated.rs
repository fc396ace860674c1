//! A frame source rotated so that another axis is up.

use super::c3d;
use crate::{
    map::TakeMap,
    motion::{FrameSource, MotionInfo, Position, UpAxis},
    up_axis::Rotation,
};

/// A frame source rotated by a quarter turn: its positions, and of the data kept from a C3D file the force plate
/// corners and the coordinates under gaps.
pub struct RotatedFrames<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
    rotation: Rotation,
}

impl std::fmt::Debug for RotatedFrames<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RotatedFrames").field("rotation", &self.rotation).finish_non_exhaustive()
    }
}

impl<'a> RotatedFrames<'a> {
    /// Rotates `frames` so that the axis `up` points up; `None` if the source does not state its up axis.
    ///
    /// # Errors
    /// Those of reading and rewriting the data kept from a C3D file.
    pub fn new(frames: &'a mut dyn FrameSource, up: UpAxis) -> std::io::Result<Option<Self>> {
        let mut info = frames.info().clone();
        let Some(rotation) = Rotation::between(info.up, up) else { return Ok(None) };
        info.up = up;
        if !rotation.is_identity() {
            c3d::rotate(&mut info.foreign, info.markers.len(), rotation)?;
            info.recording = info
                .recording
                .map(|recording| recording.turned(|vector| rotation.apply_f64(vector)));
        }
        Ok(Some(Self { frames, info, rotation }))
    }

    /// Kinds of the foreign parts that keep their old axes although they may hold vectors in space: model outputs.
    #[must_use]
    pub fn not_rotated(&self) -> Vec<String> {
        let kept = self.info.foreign.iter().filter(|part| part.kind == c3d::MODEL_OUTPUTS);
        let kept = kept.filter(|_| !self.rotation.is_identity());
        kept.map(|part| part.kind.clone()).collect()
    }
}

impl FrameSource for RotatedFrames<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool> {
        let is_there = self.frames.next_frame(row)?;
        row.iter_mut().for_each(|at| *at = self.rotation.apply(*at));
        Ok(is_there)
    }

    fn stated_error_mm(&self, column: usize) -> Option<f64> {
        self.frames.stated_error_mm(column)
    }

    fn take(&self) -> Option<&TakeMap> {
        self.frames.take()
    }

    fn is_lost(&self) -> bool {
        self.frames.is_lost()
    }

    fn count_sampled(&self, n_frames: u64) {
        self.frames.count_sampled(n_frames);
    }
}
