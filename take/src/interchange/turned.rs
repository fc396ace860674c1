//! Frames turned so that another axis is up.

use super::{c3d, turn::Turn};
use crate::{
    map::TakeMap,
    motion::{FrameSource, MotionInfo, Position, UpAxis},
};

/// A source whose positions, and what it holds of C3D beside them in space, are turned by quarters.
pub struct Turned<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
    turn: Turn,
}

impl std::fmt::Debug for Turned<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Turned").field("turn", &self.turn).finish_non_exhaustive()
    }
}

impl<'a> Turned<'a> {
    /// With `up` up; `None` when the source does not say what is up.
    ///
    /// # Errors
    /// Those of reading what the source keeps of C3D, and of writing it turned.
    pub fn new(frames: &'a mut dyn FrameSource, up: UpAxis) -> std::io::Result<Option<Self>> {
        let mut info = frames.info().clone();
        let Some(turn) = Turn::between(info.up, up) else { return Ok(None) };
        info.up = up;
        if !turn.is_none() {
            c3d::turn(&mut info.foreign, info.markers.len(), turn)?;
        }
        Ok(Some(Self { frames, info, turn }))
    }

    /// What is given as it was, although it may lie in space.
    #[must_use]
    pub fn not_turned(&self) -> Vec<String> {
        let kept = self.info.foreign.iter().filter(|part| part.kind == c3d::MODEL_OUTPUTS);
        if self.turn.is_none() { Vec::new() } else { kept.map(|part| part.kind.clone()).collect() }
    }
}

impl FrameSource for Turned<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool> {
        let is_there = self.frames.next_frame(row)?;
        row.iter_mut().for_each(|at| *at = self.turn.of(*at));
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
}
