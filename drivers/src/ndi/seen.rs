//! What one answer to a poll shows.

use crate::device::MarkerSample;

/// Below this a coordinate is the vendor's mark for "no number" (-3.697314e28).
const BAD_FLOAT: f32 = -3.0e28;

/// Positions of stray markers in one frame that are told apart: what `BX` can count.
pub(super) const STRAYS_MAX: usize = 255;

/// Tools that are told apart: port handles have 8 bits.
pub(super) const TOOLS_MAX: usize = 256;

/// One frame; its memory is used again for the next.
#[derive(Debug)]
pub(super) struct Seen {
    /// The device's frame number; `None` when the answer has no frame.
    pub(super) number: Option<u32>,
    /// The device's time at exposure, nanoseconds; only `BX2` has it.
    pub(super) time_ns: Option<u64>,
    /// One entry a tool, by its port handle.
    pub(super) tools: Vec<MarkerSample>,
    /// Markers that belong to no tool, millimetres, in the device's order.
    pub(super) strays: Vec<[f32; 3]>,
    /// Strays beyond [`STRAYS_MAX`].
    pub(super) strays_beyond: usize,
    /// Positions that were no numbers.
    pub(super) not_finite: u64,
}

impl Seen {
    pub(super) fn new() -> Self {
        Self {
            number: None,
            time_ns: None,
            tools: Vec::with_capacity(TOOLS_MAX),
            strays: Vec::with_capacity(STRAYS_MAX),
            strays_beyond: 0,
            not_finite: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.number = None;
        self.time_ns = None;
        self.tools.clear();
        self.strays.clear();
        self.strays_beyond = 0;
        self.not_finite = 0;
    }

    /// The newest number of the parts counts for the whole.
    pub(super) fn number(&mut self, number: u32, time_ns: Option<u64>) {
        let newer = self.number.is_none_or(|known| number.wrapping_sub(known).cast_signed() > 0);
        if newer {
            self.number = Some(number);
            self.time_ns = time_ns;
        }
    }

    /// A tool: where its origin is, and how well its markers fit it, both in millimetres.
    pub(super) fn tool(&mut self, handle: u8, found: Option<([f32; 3], f32)>) {
        if self.tools.len() >= TOOLS_MAX {
            return;
        }
        let id = u16::from(handle);
        let found = found.filter(|(position_mm, _)| self.is_position(*position_mm));
        self.tools.push(match found {
            None => MarkerSample { id, occluded: true, ..MarkerSample::default() },
            Some((position_mm, error_mm)) => MarkerSample {
                id,
                occluded: false,
                // 0 would say that no residual is given; a value that is no number becomes 0.
                residual_10um: (error_mm * 100.0).round().clamp(1.0, 255.0) as u8,
                position_mm,
            },
        });
    }

    pub(super) fn stray(&mut self, position_mm: [f32; 3]) {
        if !self.is_position(position_mm) {
            return;
        }
        if self.strays.len() < STRAYS_MAX {
            self.strays.push(position_mm);
        } else {
            self.strays_beyond += 1;
        }
    }

    fn is_position(&mut self, position_mm: [f32; 3]) -> bool {
        let finite = position_mm.iter().all(|value| value.is_finite());
        self.not_finite += u64::from(!finite);
        finite && position_mm.iter().all(|value| *value > BAD_FLOAT)
    }
}
