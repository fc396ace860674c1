//! The frame that two eyes and a mouth give.

/// A map from a face's own coordinates to a picture's: the eyes are at (-1/2, 0) and (1/2, 0), the mouth at
/// (0, [`Frame::MOUTH`]).
///
/// It is affine but for the turn of the head: a face is a cylinder of radius R, and turned by an angle a its places x are
/// seen at x cos a + sqrt(R^2 - x^2) sin a. To the second order, and with the eyes where they are, that is
/// x + turn (x^2 - 1/4): one half is wider, and the nose is nearer to the other eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// The middle of the eyes.
    pub origin: [f32; 2],
    /// From the left eye to the right one.
    pub across: [f32; 2],
    /// One unit towards the mouth.
    pub down: [f32; 2],
    /// About tan a / 2.3; positive where the nose points to the picture's left.
    pub turn: f32,
}

impl Frame {
    /// How far the mouth is from the eyes, in distances of the eyes: 63 mm and 70 mm on an adult.
    pub const MOUTH: f32 = 1.1;

    /// Where a point of the picture is in the face; far away where the frame has no area.
    #[must_use]
    pub fn inside(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (dx, dy) = (x - self.origin[0], y - self.origin[1]);
        let area = self.across[0] * self.down[1] - self.across[1] * self.down[0];
        if area.abs() < f32::MIN_POSITIVE {
            return [f32::MAX; 2];
        }
        let seen = (dx * self.down[1] - dy * self.down[0]) / area;
        let y = (dy * self.across[0] - dx * self.across[1]) / area;
        if self.turn.abs() < 1e-3 {
            return [seen, y];
        }
        let root = 1.0 + 4.0 * self.turn * (seen + self.turn / 4.0);
        // Beyond the edge of the cylinder there is no face.
        let x = if root > 0.0 { (root.sqrt() - 1.0) / (2.0 * self.turn) } else { f32::MAX };
        [x, y]
    }

    /// Where a point of the face is in the picture.
    #[must_use]
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let x = x + self.turn * (x * x - 0.25);
        let place = |i: usize| {
            let part = |v: &[f32; 2]| v.get(i).copied().unwrap_or_default();
            part(&self.origin) + x * part(&self.across) + y * part(&self.down)
        };
        [place(0), place(1)]
    }

    /// The eyes: first the one at the picture's left.
    #[must_use]
    pub fn eyes(&self) -> [[f32; 2]; 2] {
        [self.at(-0.5, 0.0), self.at(0.5, 0.0)]
    }
}

/// How long a way is. On a photograph nothing is so long that its square has no end, and this is much faster than `hypot`.
pub(super) fn length([x, y]: [f32; 2]) -> f32 {
    (x * x + y * y).sqrt()
}
