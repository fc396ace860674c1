//! What definitions name: labels of the markers of frames, rigid bodies as the recorder numbers them, and, for a server,
//! labelled markers as sets and assets, with the markers and positions of its frames.

use std::collections::{HashMap, HashSet};

use super::{
    frame::{
        ACTIVE, FrameOfData, HAS_MODEL, MEASURED, NatNetMarker, OCCLUDED, UNLABELLED, WireBody,
        in_mm,
    },
    message::text_of,
    model::{Asset, AssetKind, MarkerSet, Model},
};
use crate::device::{BODIES_MAX, BodyInfo, Pose, PoseStatus};

/// Diameter of every marker, which recordings do not have.
const MARKER_SIZE_M: f32 = 0.014;

/// Id of the first unlabelled marker: unlike a marker's place, so that nobody can take one for the other.
const FIRST_ID: u32 = 1000;

/// Millimetres as metres of float32.
#[must_use]
pub fn in_m(position_mm: [f32; 3]) -> [f32; 3] {
    position_mm.map(|mm| (f64::from(mm) / 1000.0) as f32)
}

/// A marker of a frame, by its place among all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServedMarker {
    /// x, y, z in millimetres; NaN while it is not seen.
    pub position_mm: [f32; 3],
    /// Its residual in metres.
    pub residual_m: f32,
}

/// Markers by their assets: that in front of the colon of a label, or one without a name. Assets are skeletons without bones,
/// and rigid bodies where a name says so.
#[derive(Debug, Default)]
pub struct AssetTable {
    model: Model,
    /// Places of the markers of each asset.
    places: Vec<Vec<usize>>,
    unlabelled: Vec<usize>,
    positions_m: Vec<Vec<[f32; 3]>>,
    labelled_now: Vec<NatNetMarker>,
    unlabelled_now: Vec<NatNetMarker>,
}

/// The asset and the marker of a label.
fn divide(label: &str) -> (&str, &str) {
    match label.split_once(':') {
        Some((asset, marker)) if !asset.is_empty() && !marker.is_empty() => (asset, marker),
        _ => ("", label),
    }
}

impl AssetTable {
    /// The markers of a recording: the label of each, or `None` for an unlabelled one.
    pub fn new<S: AsRef<str>>(labels: impl IntoIterator<Item = Option<S>>) -> Self {
        Self::with_bodies(&[] as &[&str], labels).0
    }

    /// The rigid bodies of a recording, with their ids, and its markers: the ids of bodies stay the same when markers are added.
    pub fn with_bodies<B: AsRef<str>, S: AsRef<str>>(
        bodies: &[B],
        labels: impl IntoIterator<Item = Option<S>>,
    ) -> (Self, Vec<u32>) {
        let mut table = Self::default();
        let ids = bodies.iter().map(|name| table.add_body(name.as_ref())).collect();
        for (place, label) in labels.into_iter().enumerate() {
            let Some(label) = label else {
                table.unlabelled.push(place);
                continue;
            };
            let (asset, name) = divide(label.as_ref());
            let index = table.asset(asset);
            if let (Some(set), Some(places)) =
                (table.model.sets.get_mut(index), table.places.get_mut(index))
            {
                set.markers.push(name.to_owned());
                places.push(place);
            }
        }
        (table, ids)
    }

    /// The place of an asset with this name, which is added if it is new.
    fn asset(&mut self, name: &str) -> usize {
        let model = &mut self.model;
        if let Some(index) = model.sets.iter().position(|set| set.name == name) {
            return index;
        }
        let (kind, id, markers) = (AssetKind::Skeleton, model.sets.len() as u32 + 1, Vec::new());
        model.sets.push(MarkerSet { name: name.to_owned(), markers: Vec::new() });
        model.assets.push(Asset { kind, id, name: name.to_owned(), markers });
        self.places.push(Vec::new());
        self.positions_m.push(Vec::new());
        model.sets.len() - 1
    }

    /// An asset becomes a rigid body; one without markers is added, and one of its own for a name that another body has.
    /// Returns its id.
    pub fn add_body(&mut self, name: &str) -> u32 {
        let is_body = |name: &str| {
            let mut bodies = self.model.assets.iter();
            bodies.any(|asset| asset.kind == AssetKind::RigidBody && asset.name == name)
        };
        let mut own = name.to_owned();
        let mut n = 1;
        while is_body(&own) {
            n += 1;
            own = format!("{name} ({n})");
        }
        let index = self.asset(&own);
        let asset = self.model.assets.get_mut(index);
        asset.map_or(0, |asset| {
            asset.kind = AssetKind::RigidBody;
            asset.id
        })
    }

    /// Whether markers belong to an asset of this name.
    #[must_use]
    pub fn has_asset(&self, name: &str) -> bool {
        self.model.assets.iter().any(|asset| asset.name == name)
    }

    /// The definitions.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The definitions, to add to them or to change them.
    pub fn model_mut(&mut self) -> &mut Model {
        &mut self.model
    }

    /// Number of labelled markers, and of unlabelled ones.
    #[must_use]
    pub fn n_markers(&self) -> [usize; 2] {
        [self.places.iter().map(Vec::len).sum(), self.unlabelled.len()]
    }

    /// Takes over the markers of a frame, by their places. Places beyond them are not seen.
    pub fn fill(&mut self, markers: impl Fn(usize) -> Option<ServedMarker>) {
        self.labelled_now.clear();
        self.unlabelled_now.clear();
        let seen = |place: usize| {
            let marker = markers(place)?;
            let is_seen = !marker.position_mm.iter().any(|value| value.is_nan());
            is_seen.then_some((in_m(marker.position_mm), marker.residual_m))
        };
        for (index, (places, positions_m)) in
            self.places.iter().zip(&mut self.positions_m).enumerate()
        {
            positions_m.clear();
            for (member, place) in places.iter().enumerate() {
                let found = seen(*place);
                let (position_m, residual_m) = found.unwrap_or_default();
                positions_m.push(position_m);
                self.labelled_now.push(NatNetMarker {
                    id: ((index as u32 + 1) << 16) | (member as u32 + 1),
                    position_m,
                    size_m: MARKER_SIZE_M,
                    flags: HAS_MODEL | if found.is_some() { MEASURED } else { OCCLUDED },
                    residual_m,
                });
            }
        }
        for place in &self.unlabelled {
            if let Some((position_m, residual_m)) = seen(*place) {
                self.unlabelled_now.push(unlabelled(*place as u32, position_m, residual_m));
            }
        }
    }

    /// Adds an unlabelled marker to the frame that was taken over.
    pub fn add_unlabelled(&mut self, place: u32, marker: ServedMarker) {
        let position_m = in_m(marker.position_mm);
        self.unlabelled_now.push(unlabelled(place, position_m, marker.residual_m));
    }

    /// The labelled markers of the frame.
    #[must_use]
    pub fn labelled(&self) -> &[NatNetMarker] {
        &self.labelled_now
    }

    /// The unlabelled markers of the frame that are seen.
    #[must_use]
    pub fn unlabelled(&self) -> &[NatNetMarker] {
        &self.unlabelled_now
    }

    /// The sets of the frame, each with the positions of its markers in metres: zeros for one that is not seen.
    pub fn sets(&self) -> impl Iterator<Item = (&MarkerSet, &[[f32; 3]])> {
        self.model.sets.iter().zip(self.positions_m.iter().map(Vec::as_slice))
    }

    /// Ids of the skeletons.
    #[must_use]
    pub fn skeletons(&self) -> Vec<u32> {
        let all = self.model.assets.iter();
        all.filter(|asset| asset.kind == AssetKind::Skeleton).map(|asset| asset.id).collect()
    }
}

fn unlabelled(place: u32, position_m: [f32; 3], residual_m: f32) -> NatNetMarker {
    NatNetMarker {
        id: FIRST_ID.saturating_add(place),
        position_m,
        size_m: MARKER_SIZE_M,
        flags: MEASURED | UNLABELLED,
        residual_m,
    }
}

/// The set of all markers, which repeats those of the others.
const ALL: &str = "all";

/// Longest label in bytes, as those of the link protocol and of C3D files are.
const LABEL_BYTES_MAX: usize = 255;

/// Markers of one asset, whose labels follow each other.
#[derive(Debug)]
struct LabelRange {
    first: usize,
    n: usize,
}

/// Which labels the markers of frames have.
#[derive(Debug, Default)]
pub(super) struct MarkerNames {
    ranges: Vec<LabelRange>,
    by_name: HashMap<String, usize>,
    /// Place of the range of each asset.
    by_asset: HashMap<u32, usize>,
    /// Labels of active markers, whose ids do not tell their asset and do not change.
    by_marker: HashMap<u32, usize>,
}

/// Ids whose labels positions have told: several times the markers of a volume. A server that invents more has no more names.
const LEARNED_MAX: usize = 1 << 14;

/// Whether a marker of a frame has a label: flags tell it, and before bitstream 3.0 the asset in its id.
pub(super) fn is_labelled(marker: &NatNetMarker, has_flags: bool) -> bool {
    match has_flags {
        true if marker.flags & UNLABELLED != 0 => false,
        // Not all servers set the flag.
        true => marker.flags & HAS_MODEL != 0 || marker.id >> 16 != 0,
        false => marker.id >> 16 != 0,
    }
}

/// Cuts a label off at its limit.
fn cut(mut label: String) -> String {
    if label.len() > LABEL_BYTES_MAX {
        let end = (0..=LABEL_BYTES_MAX).rev().find(|end| label.is_char_boundary(*end));
        label.truncate(end.unwrap_or(0));
    }
    label
}

impl MarkerNames {
    /// The names, and all labels in their order: `asset:marker`, or the marker's name for a set without one.
    pub(super) fn new(model: &Model) -> (Self, Vec<String>) {
        let mut names = Self::default();
        let mut labels = Vec::new();
        let is_asset = model.assets.iter().any(|asset| asset.name == ALL);
        let has_others = !is_asset && model.sets.iter().any(|set| set.name != ALL);
        let sets = model.sets.iter().filter(|set| set.name != ALL || !has_others);
        let sets = sets.map(|set| (&set.name, &set.markers));
        let assets = model.assets.iter().map(|asset| (&asset.name, &asset.markers));
        for (name, markers) in sets.chain(assets) {
            if markers.is_empty() || names.by_name.contains_key(name) {
                continue;
            }
            let (first, n) = (labels.len(), markers.len());
            names.by_name.insert(name.clone(), names.ranges.len());
            names.ranges.push(LabelRange { first, n });
            labels.extend(markers.iter().map(|marker| match name.as_str() {
                "" => cut(marker.clone()),
                name => cut(format!("{name}:{marker}")),
            }));
        }
        let mut ambiguous = HashSet::new();
        for asset in &model.assets {
            let Some(range) = names.by_name.get(&asset.name).copied() else { continue };
            let before = names.by_asset.insert(asset.id, range);
            if before.is_some_and(|before| before != range) {
                // A rigid body and a skeleton: positions will tell.
                ambiguous.insert(asset.id);
            }
        }
        names.by_asset.retain(|id, _| !ambiguous.contains(id));
        (names, labels)
    }

    /// Place of a labelled marker's label.
    pub(super) fn label(&self, id: u32) -> Option<usize> {
        if let Some(label) = self.by_marker.get(&id) {
            return Some(*label);
        }
        let range = self.ranges.get(*self.by_asset.get(&(id >> 16))?)?;
        let index = usize::try_from(id & 0xFFFF).ok()?.checked_sub(1)?;
        (index < range.n).then_some(range.first + index)
    }

    /// Finds the labels of markers that the definitions do not tell: a set has the same positions as its markers. Takes one
    /// look at each position of the sets, and at each marker.
    pub(super) fn learn(&mut self, frame: &FrameOfData<'_>) {
        // `None` for a position that two markers have.
        let mut places: HashMap<[u32; 3], Option<(usize, usize)>> = HashMap::new();
        for (name, positions) in frame.marker_sets() {
            let Some(range) = self.by_name.get(&text_of(name)).copied() else { continue };
            let mut index = 0;
            while let Some(position_m) = positions.get(index) {
                if position_m != [0.0; 3] {
                    places
                        .entry(position_m.map(f32::to_bits))
                        .and_modify(|place| *place = None)
                        .or_insert(Some((range, index)));
                }
                index += 1;
            }
        }
        for marker in frame.markers() {
            let is_seen = marker.flags & OCCLUDED == 0;
            if !is_seen || !is_labelled(&marker, frame.has_flags()) {
                continue;
            }
            let place = places.get(&marker.position_m.map(f32::to_bits)).copied().flatten();
            let Some((range, index)) = place.filter(|_| self.label(marker.id).is_none()) else {
                continue;
            };
            let asset = marker.id >> 16;
            if asset != 0 && (marker.id & 0xFFFF) as usize == index + 1 {
                self.by_asset.insert(asset, range);
            } else if marker.flags & ACTIVE != 0
                && self.by_marker.len() < LEARNED_MAX
                && let Some(LabelRange { first, n }) = self.ranges.get(range)
                && index < *n
            {
                self.by_marker.insert(marker.id, first + index);
            }
        }
    }
}

/// The bodies of the definitions. One keeps its number for as long as the driver lives.
#[derive(Debug, Default)]
pub(super) struct BodyTable {
    /// The server's id of each number.
    wire_ids: Vec<u32>,
    /// Those that are described now.
    pub(super) infos: Vec<BodyInfo>,
    /// Bodies beyond the most that are recorded.
    pub(super) n_excess: usize,
    poses: Vec<Pose>,
}

impl BodyTable {
    /// Takes over the bodies of the definitions.
    pub(super) fn update(&mut self, model: &Model) {
        self.infos.clear();
        self.n_excess = 0;
        for asset in model.assets.iter().filter(|asset| asset.kind == AssetKind::RigidBody) {
            let id = match self.number(asset.id) {
                Some(id) => id,
                None if self.wire_ids.len() < BODIES_MAX => {
                    self.wire_ids.push(asset.id);
                    self.wire_ids.len() as u16 - 1
                }
                None => {
                    self.n_excess += 1;
                    continue;
                }
            };
            if self.infos.iter().all(|info| info.id != id) {
                self.infos.push(BodyInfo { id, name: asset.name.clone() });
            }
        }
    }

    fn number(&self, wire_id: u32) -> Option<u16> {
        self.wire_ids.iter().position(|id| *id == wire_id).map(|number| number as u16)
    }

    /// The poses of a frame.
    pub(super) fn poses(&mut self, frame: &FrameOfData<'_>) -> &[Pose] {
        self.poses.clear();
        for body in frame.bodies() {
            let Some(number) = self.number(body.id) else { continue };
            let is_listed = self.poses.iter().any(|pose| pose.body == number);
            if !is_listed {
                self.poses.push(pose(number, &body));
            }
        }
        &self.poses
    }
}

fn pose(body: u16, wire: &WireBody) -> Pose {
    let [x, y, z, w] = wire.quaternion_xyzw;
    let status = if wire.is_tracked { PoseStatus::Tracked } else { PoseStatus::Lost };
    let position_mm = in_mm(wire.position_m);
    let [residual_mm, ..] = in_mm([wire.error_m; 3]);
    Pose { body, status, position_mm, quaternion: [w, x, y, z], residual_mm }.checked()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_become_sets_of_assets_and_positions_follow_them() {
        let labels = [Some("Body:a"), None, Some("b"), Some("Body:c"), Some(":d")];
        let mut table = AssetTable::new(labels);
        assert_eq!(table.add_body("Body"), 1);
        assert_eq!(table.add_body("wand"), 3, "one without markers");
        let (first, ids) = AssetTable::with_bodies(&["wand", "Body", "wand"], labels);
        assert_eq!((ids, first.model().sets[2].name.as_str()), (vec![1, 2, 3], "wand (2)"));
        assert_eq!(first.model().sets[1].markers, ["a", "c"]);
        let names: Vec<_> =
            table.model().sets.iter().map(|set| (&*set.name, set.markers.len())).collect();
        assert_eq!(names, [("Body", 2), ("", 2), ("wand", 0)]);
        assert_eq!((table.n_markers(), table.skeletons()), ([4, 1], vec![2]));
        let hidden = [f32::NAN; 3];
        let places = [[1.0; 3], [2.0; 3], hidden, [4.0; 3]];
        table.fill(|place| {
            let position_mm = *places.get(place)?;
            Some(ServedMarker { position_mm, residual_m: 0.5 })
        });
        let found: Vec<_> =
            table.labelled().iter().map(|marker| (marker.id, marker.flags)).collect();
        let (seen, hidden) = (HAS_MODEL | MEASURED, HAS_MODEL | OCCLUDED);
        let expected = [(0x1_0001, seen), (0x1_0002, seen), (0x2_0001, hidden), (0x2_0002, hidden)];
        assert_eq!(found, expected);
        assert_eq!(table.unlabelled()[0].id, 1001);
        assert_eq!(table.unlabelled()[0].position_m, [0.002; 3]);
        assert_eq!(table.sets().nth(1).unwrap().1, [[0.0; 3]; 2]);
    }
}
