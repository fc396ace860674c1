//! Which points make which line of a face, and the colours they are drawn in.

use crate::model::FeatureId;

/// A part of the face that is drawn in a colour of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Around the face.
    Contour,
    /// Both of them.
    Brow,
    /// Lids.
    Eye,
    /// Wings and base.
    Nose,
    /// Lips.
    Mouth,
}

/// A line through points.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Curve {
    /// Of what.
    pub part: Part,
    /// In their order.
    pub points: Vec<FeatureId>,
    /// Whether the last is joined to the first.
    pub closed: bool,
}

impl Part {
    /// Red, green and blue: apart for all kinds of colour vision (Okabe and Ito 2008), on skin and on paper.
    pub fn colour(self) -> [u8; 3] {
        match self {
            Self::Contour => [0x00, 0x72, 0xb2],
            Self::Brow => [0x00, 0x9e, 0x73],
            Self::Eye => [0xf0, 0xe4, 0x42],
            Self::Nose => [0xe6, 0x9f, 0x00],
            Self::Mouth => [0xcc, 0x79, 0xa7],
        }
    }

    /// The part that a point belongs to.
    pub fn of(id: FeatureId) -> Self {
        match id.index() {
            0..12 => Self::Contour,
            12..22 => Self::Brow,
            22..27 => Self::Nose,
            27..39 => Self::Eye,
            _ => Self::Mouth,
        }
    }
}

impl Curve {
    /// All lines of a face.
    pub fn all() -> Vec<Self> {
        let points = |indices: &mut dyn Iterator<Item = usize>| {
            indices.filter_map(FeatureId::from_index).collect()
        };
        let open = |part, mut range: std::ops::Range<usize>| Self {
            part,
            points: points(&mut range),
            closed: false,
        };
        let ring = |part, mut range: std::ops::Range<usize>| Self {
            part,
            points: points(&mut range),
            closed: true,
        };
        vec![
            open(Part::Contour, 0..6),
            open(Part::Contour, 6..12),
            open(Part::Brow, 12..17),
            open(Part::Brow, 17..22),
            open(Part::Nose, 22..27),
            ring(Part::Eye, 27..33),
            ring(Part::Eye, 33..39),
            ring(Part::Mouth, 39..51),
            // The line between the lips: from corner to corner, over and under the opening.
            Self {
                part: Part::Mouth,
                points: points(&mut [39, 51, 45, 52].into_iter()),
                closed: true,
            },
        ]
    }
}
