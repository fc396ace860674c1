//! Labels that a spreadsheet would calculate.

use std::io;

use mocapd_take::{
    TakeMap,
    motion::{FrameSource, MotionInfo, Position},
};

/// What begins a formula in a spreadsheet, also in its full width; and what some of them skip before they look for one.
const FORMULAS: [char; 10] = ['=', '+', '-', '@', '\t', '\r', '＝', '＋', '－', '＠'];

/// A source whose labels begin no formula: such a one has an apostrophe before it, which spreadsheets take for the
/// beginning of a text.
pub(super) struct Guarded<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
}

impl<'a> Guarded<'a> {
    pub(super) fn new(frames: &'a mut dyn FrameSource) -> Self {
        let mut info = frames.info().clone();
        for marker in &mut info.markers {
            if marker.label.starts_with(FORMULAS) {
                marker.label.insert(0, '\'');
            }
        }
        Self { frames, info }
    }
}

impl FrameSource for Guarded<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        self.frames.next_frame(row)
    }

    fn stated_error_mm(&self, column: usize) -> Option<f64> {
        self.frames.stated_error_mm(column)
    }

    fn take(&self) -> Option<&TakeMap> {
        self.frames.take()
    }
}
