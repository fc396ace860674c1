//! `--for-spreadsheet`: labels that a spreadsheet would take for formulas.

use std::io;

use mocapd_take::{
    TakeMap,
    motion::{FrameSource, MotionInfo, Position},
};

/// Characters that begin a formula in a spreadsheet, full-width ones included, and the white space that some
/// spreadsheets skip before one.
const FORMULAS: [char; 10] = ['=', '+', '-', '@', '\t', '\r', '＝', '＋', '－', '＠'];

/// A source that puts an apostrophe before labels that would begin a formula; spreadsheets then read them as text.
pub(super) struct EscapedLabels<'a> {
    frames: &'a mut dyn FrameSource,
    info: MotionInfo,
}

/// Puts an apostrophe before a label that would begin a formula.
pub(super) fn escape(label: &mut String) {
    if label.starts_with(FORMULAS) {
        label.insert(0, '\'');
    }
}

impl<'a> EscapedLabels<'a> {
    pub(super) fn new(frames: &'a mut dyn FrameSource) -> Self {
        let mut info = frames.info().clone();
        for marker in &mut info.markers {
            escape(&mut marker.label);
        }
        Self { frames, info }
    }
}

impl FrameSource for EscapedLabels<'_> {
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

    fn count_sampled(&self, n_frames: u64) {
        self.frames.count_sampled(n_frames);
    }
}
