//! Labels of markers: out of the model definitions, and of ids and positions of frames.

use std::collections::{HashMap, HashSet};

use super::{
    frame::{ACTIVE, FrameOfData, HAS_MODEL, NatNetMarker, OCCLUDED, UNLABELLED},
    message::text_of,
    model::Model,
};

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
