//! Whether a line carries the frames.

use crate::device::LinkBudget;

/// Bytes a second that a budget keeps for messages that are no frames.
///
/// A Status a second (26 bytes), ten Pongs (24 each) and thirty trigger edges (18 each) are 806;
/// the rest is for Markers that appear.
pub const RESERVE_BYTES_PER_S: u64 = 1024;

/// What frames of `frame_bytes` on the wire need at `rate_mhz`, what the line has, and the highest
/// rate up to `rate_max_mhz` that fits, in millihertz (0 when none does).
///
/// `line_bytes_per_s` of 0 is a line without a limit.
#[must_use]
pub fn link_budget(
    frame_bytes: usize,
    rate_mhz: u32,
    rate_max_mhz: u32,
    line_bytes_per_s: u64,
) -> LinkBudget {
    let frame_bytes = u128::from(frame_bytes.max(1) as u64);
    let needed = (frame_bytes * u128::from(rate_mhz)).div_ceil(1000);
    let needed = u64::try_from(needed).unwrap_or(u64::MAX).saturating_add(RESERVE_BYTES_PER_S);
    let available = if line_bytes_per_s == 0 { u64::MAX } else { line_bytes_per_s };
    let for_frames = u128::from(available.saturating_sub(RESERVE_BYTES_PER_S));
    let fits_mhz = u32::try_from(for_frames * 1000 / frame_bytes).unwrap_or(u32::MAX);
    LinkBudget {
        needed_bytes_per_s: needed,
        available_bytes_per_s: available,
        rate_fits_mhz: fits_mhz.min(rate_max_mhz),
    }
}

impl LinkBudget {
    /// Whether the line carries what is needed.
    #[must_use]
    pub fn fits(&self) -> bool {
        self.needed_bytes_per_s <= self.available_bytes_per_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{FrameForm, frame_bytes_in_volume};

    #[test]
    fn the_rate_that_fits_fits_and_the_next_does_not() {
        for line in [11_520u64, 92_160, 300_000, 1_200_000] {
            for frame_bytes in [64, 559, 2104] {
                let fits = link_budget(frame_bytes, 1, u32::MAX, line).rate_fits_mhz;
                assert!(link_budget(frame_bytes, fits, u32::MAX, line).fits());
                assert!(!link_budget(frame_bytes, fits + 1, u32::MAX, line).fits());
            }
        }
    }

    #[test]
    fn the_document_states_the_budget_of_40_and_of_200_markers() {
        for (n_markers, frame_bytes, rate_fits_hz) in [(40, 436, 685), (200, 2063, 144)] {
            assert_eq!(frame_bytes_in_volume(FrameForm::Compact, n_markers), frame_bytes);
            let budget = link_budget(frame_bytes, 60_000, 1_000_000, 300_000);
            assert_eq!(budget.rate_fits_mhz / 1000, rate_fits_hz);
        }
    }

    #[test]
    fn an_unlimited_line_carries_the_highest_rate() {
        let budget = link_budget(160_657, 1_000_000, 1_000_000, 0);
        assert!(budget.fits());
        assert_eq!(budget.available_bytes_per_s, u64::MAX);
        assert_eq!(budget.rate_fits_mhz, 1_000_000);
    }

    #[test]
    fn a_line_below_the_reserve_carries_nothing() {
        let budget = link_budget(100, 60_000, 1_000_000, 960);
        assert!(!budget.fits());
        assert_eq!(budget.rate_fits_mhz, 0);
    }
}
