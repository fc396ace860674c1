//! Waiting until the host has read what was sent: a hang-up discards what is still on its way.

use std::time::Duration;

/// How long the host may read nothing before it counts as gone.
const PATIENCE_NS: u64 = 1_000_000_000;

/// Between two looks.
pub(super) const LOOK: Duration = Duration::from_millis(5);

/// Watches the bytes that are left for the host.
#[derive(Debug, Default)]
pub(super) struct Drain {
    left: Option<u64>,
    progress_ns: u64,
    empty_looks: u32,
}

impl Drain {
    /// `left` are all bytes between the device and the host. `true` when it is time to hang up.
    pub(super) fn is_over(&mut self, left: u64, now_ns: u64) -> bool {
        if self.left != Some(left) {
            self.left = Some(left);
            self.progress_ns = now_ns;
        }
        // The kernel hands bytes from one buffer to the next on its own time, and counts only the last one:
        // nothing must be there for some looks running.
        self.empty_looks = if left == 0 { self.empty_looks + 1 } else { 0 };
        self.empty_looks > 4 || now_ns.saturating_sub(self.progress_ns) > PATIENCE_NS
    }
}
