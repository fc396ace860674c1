//! Names of the 53 points of (Yang et al. 2004).

use serde::{Deserialize, Serialize};

/// One of the 53 points that are located on a photograph (Yang et al. 2004): 12 of the outline, 10 of the brows, 5 of
/// the nose, 12 of the eyelids, 14 of the lips.
///
/// All but the outline are points of the iBUG-68 scheme, in its order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "&'static str", try_from = "String")]
pub struct FeatureId(u8);

impl From<FeatureId> for &'static str {
    fn from(id: FeatureId) -> Self {
        id.name()
    }
}

impl TryFrom<String> for FeatureId {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        Self::from_name(&name).ok_or_else(|| format!("none of the 53 points is called {name:?}"))
    }
}

/// Name and iBUG-68 number of each point.
const TABLE: [(&str, Option<u8>); FeatureId::COUNT] = [
    ("right_contour_top", None),
    ("right_contour_brow", None),
    ("right_contour_eye", None),
    ("right_contour_nose", None),
    ("right_contour_mouth", None),
    ("right_contour_chin", None),
    ("left_contour_top", None),
    ("left_contour_brow", None),
    ("left_contour_eye", None),
    ("left_contour_nose", None),
    ("left_contour_mouth", None),
    ("left_contour_chin", None),
    ("right_brow_1", Some(17)),
    ("right_brow_2", Some(18)),
    ("right_brow_3", Some(19)),
    ("right_brow_4", Some(20)),
    ("right_brow_5", Some(21)),
    ("left_brow_5", Some(22)),
    ("left_brow_4", Some(23)),
    ("left_brow_3", Some(24)),
    ("left_brow_2", Some(25)),
    ("left_brow_1", Some(26)),
    ("nose_right", Some(31)),
    ("nose_bottom_right", Some(32)),
    ("nose_bottom", Some(33)),
    ("nose_bottom_left", Some(34)),
    ("nose_left", Some(35)),
    ("right_eye_outer", Some(36)),
    ("right_eye_top_outer", Some(37)),
    ("right_eye_top_inner", Some(38)),
    ("right_eye_inner", Some(39)),
    ("right_eye_bottom_inner", Some(40)),
    ("right_eye_bottom_outer", Some(41)),
    ("left_eye_inner", Some(42)),
    ("left_eye_top_inner", Some(43)),
    ("left_eye_top_outer", Some(44)),
    ("left_eye_outer", Some(45)),
    ("left_eye_bottom_outer", Some(46)),
    ("left_eye_bottom_inner", Some(47)),
    ("mouth_right", Some(48)),
    ("mouth_top_right_outer", Some(49)),
    ("mouth_top_right", Some(50)),
    ("mouth_top", Some(51)),
    ("mouth_top_left", Some(52)),
    ("mouth_top_left_outer", Some(53)),
    ("mouth_left", Some(54)),
    ("mouth_bottom_left_outer", Some(55)),
    ("mouth_bottom_left", Some(56)),
    ("mouth_bottom", Some(57)),
    ("mouth_bottom_right", Some(58)),
    ("mouth_bottom_right_outer", Some(59)),
    ("mouth_inner_top", Some(62)),
    ("mouth_inner_bottom", Some(66)),
];

impl FeatureId {
    /// Number of points.
    pub const COUNT: usize = 53;
    /// Number of outline points, which come first.
    pub const CONTOUR: usize = 12;
    /// The outer corner of the right eye (iBUG 36).
    pub const RIGHT_EYE_OUTER: Self = Self(27);
    /// The outer corner of the left eye (iBUG 45).
    pub const LEFT_EYE_OUTER: Self = Self(36);

    /// All points in the order of [`index`](Self::index): the outline from the hairline down, right then left; then in
    /// the order of iBUG-68.
    pub fn all() -> impl ExactSizeIterator<Item = Self> + Clone {
        (0..Self::COUNT as u8).map(Self)
    }

    /// The point at `index`, if there is one.
    pub fn from_index(index: usize) -> Option<Self> {
        (index < Self::COUNT).then_some(Self(index as u8))
    }

    /// The point with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::all().find(|id| id.name() == name)
    }

    /// The point with this iBUG-68 number, from 0.
    pub fn from_ibug(point: usize) -> Option<Self> {
        Self::all().find(|id| id.ibug() == Some(point))
    }

    /// Index from 0 to 52.
    pub fn index(self) -> usize {
        self.0.into()
    }

    /// Its name in files, such as `right_eye_outer`. Right and left are the subject's own. Brows count from the temple
    /// inward.
    pub fn name(self) -> &'static str {
        TABLE[self.index()].0
    }

    /// Its iBUG-68 number, from 0; none for outline points, which that scheme places elsewhere.
    pub fn ibug(self) -> Option<usize> {
        TABLE[self.index()].1.map(Into::into)
    }

    /// Whether it is one of the two outline points at the hairline.
    #[must_use]
    pub fn is_hairline(self) -> bool {
        TABLE.get(self.index()).is_some_and(|(name, _)| name.ends_with("_contour_top"))
    }

    /// Whether it is on the subject's right, which is left in the picture of a face that looks at the camera.
    pub(super) fn is_right(self) -> bool {
        self.name().starts_with("right_")
    }

    /// Whether it lies on the outline, and so has no fixed place on the skin.
    pub fn is_contour(self) -> bool {
        self.index() < Self::CONTOUR
    }
}
