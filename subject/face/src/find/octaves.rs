//! A photograph at its size, at half of it, at a quarter, and so on: whatever is looked at small begins from there.

use super::Plane;

/// Brightness, each plane half as wide as the one before.
#[derive(Debug)]
pub(super) struct Octaves(Vec<Plane>);

impl Octaves {
    /// Down to a few pixels.
    pub(super) fn new(grey: Plane) -> Self {
        let mut planes = vec![grey];
        while let Some(last) = planes.last().filter(|last| last.width().min(last.height()) >= 32) {
            planes.push(last.halved());
        }
        Self(planes)
    }

    /// The largest plane that need not be shrunk by two and more for a pixel to be `shrink` of the photograph's, and the
    /// plane's own shrinking.
    pub(super) fn at(&self, shrink: f32) -> Option<(&Plane, f32)> {
        let wanted = shrink.max(1.0).log2() as usize;
        let which = wanted.min(self.0.len().saturating_sub(1));
        self.0.get(which).map(|plane| (plane, (1_u64 << which.min(32)) as f32))
    }
}
