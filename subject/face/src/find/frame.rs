//! The coordinate frame of a face, given by two eyes and a mouth.

/// Maps a face's own coordinates to a picture's: the eyes are at (-1/2, 0) and (1/2, 0), the mouth at (0,
/// [`Frame::MOUTH`]).
///
/// The map is affine except for the turn of the head. A face is modelled as a cylinder of radius R; rotated by an angle
/// a, a point at x appears at x cos a + sqrt(R^2 - x^2) sin a. To second order, and with the eyes kept in place, that
/// is x + turn (x^2 - 1/4): one half is wider, and the nose is nearer to the other eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Midpoint of the eyes.
    pub origin: [f32; 2],
    /// Vector from the left to the right eye.
    pub across: [f32; 2],
    /// Vector of one unit towards the mouth.
    pub down: [f32; 2],
    /// About tan a / 2.3; positive where the nose points to the picture's left.
    pub turn: f32,
}

impl Frame {
    /// Distance of the mouth from the eyes, in eye distances: 70 mm to 63 mm on an adult.
    pub const MOUTH: f32 = 1.1;

    /// The frame through two eyes, the one at the picture's left first, and a mouth.
    pub(super) fn through([left, right]: [[f32; 2]; 2], mouth: [f32; 2], turn: f32) -> Self {
        let origin = [(left[0] + right[0]) / 2.0, (left[1] + right[1]) / 2.0];
        let across = [right[0] - left[0], right[1] - left[1]];
        // In a turned face the middle of the mouth is beside the midpoint of the eyes.
        let down = [0, 1].map(|i| (mouth[i] - origin[i] + turn / 4.0 * across[i]) / Self::MOUTH);
        Self { origin, across, down, turn }
    }

    /// Maps a point of the face to the picture.
    #[must_use]
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let x = x + self.turn * (x * x - 0.25);
        [0, 1].map(|i| self.origin[i] + x * self.across[i] + y * self.down[i])
    }

    /// The eyes: first the one at the picture's left.
    #[must_use]
    pub fn eyes(&self) -> [[f32; 2]; 2] {
        [self.at(-0.5, 0.0), self.at(0.5, 0.0)]
    }
}

/// Length of a vector. Squares cannot overflow on a photograph, and this is much faster than `hypot`.
pub(super) fn length([x, y]: [f32; 2]) -> f32 {
    (x * x + y * y).sqrt()
}
