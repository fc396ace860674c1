//! Labels of markers: out of the model definitions, and of ids and positions of frames.

use std::collections::{HashMap, HashSet};

use super::{
    frame::{FrameOfData, OCCLUDED, UNLABELLED, WireMarker},
    message::{Bitstream, text_of},
    model::Model,
};

/// The set of all markers, which repeats those of the others.
const ALL: &str = "all";

/// Markers of one asset, whose labels follow each other.
#[derive(Debug)]
struct LabelRange {
    name: String,
    first: usize,
    n: usize,
}

/// Which labels the markers of frames have.
#[derive(Debug, Default)]
pub(super) struct MarkerNames {
    ranges: Vec<LabelRange>,
    /// Place of the range of each asset.
    by_asset: HashMap<u32, usize>,
}

/// Whether a marker of a frame has a label.
pub(super) fn is_labelled(marker: &WireMarker, version: Bitstream) -> bool {
    marker.id >> 16 != 0 && !(version.has_ticks() && marker.flags & UNLABELLED != 0)
}

impl MarkerNames {
    /// The names, and all labels in their order: `asset:marker`, or the marker's name for a set without one.
    pub(super) fn new(model: &Model) -> (Self, Vec<String>) {
        let mut names = Self::default();
        let mut labels = Vec::new();
        let has_others = model.sets.iter().any(|set| set.name != ALL);
        let sets = model.sets.iter().filter(|set| set.name != ALL || !has_others);
        let sets = sets.map(|set| (&set.name, &set.markers));
        let assets = model.assets.iter().map(|asset| (&asset.name, &asset.markers));
        for (name, markers) in sets.chain(assets) {
            if markers.is_empty() || names.range(name).is_some() {
                continue;
            }
            let (first, n) = (labels.len(), markers.len());
            names.ranges.push(LabelRange { name: name.clone(), first, n });
            labels.extend(markers.iter().map(|marker| match name.as_str() {
                "" => marker.clone(),
                name => format!("{name}:{marker}"),
            }));
        }
        let mut ambiguous = HashSet::new();
        for asset in &model.assets {
            let Some(range) = names.range(&asset.name) else { continue };
            let before = names.by_asset.insert(asset.id, range);
            if before.is_some_and(|before| before != range) {
                // A rigid body and a skeleton: positions will tell.
                ambiguous.insert(asset.id);
            }
        }
        names.by_asset.retain(|id, _| !ambiguous.contains(id));
        (names, labels)
    }

    fn range(&self, name: &str) -> Option<usize> {
        self.ranges.iter().position(|range| range.name == name)
    }

    /// Place of a labelled marker's label.
    pub(super) fn label(&self, id: u32) -> Option<usize> {
        let range = self.ranges.get(*self.by_asset.get(&(id >> 16))?)?;
        let index = usize::try_from(id & 0xFFFF).ok()?.checked_sub(1)?;
        (index < range.n).then_some(range.first + index)
    }

    /// Whether an asset's markers have labels.
    pub(super) fn knows(&self, id: u32) -> bool {
        self.by_asset.contains_key(&(id >> 16))
    }

    /// Finds the sets of assets that have no id in the definitions: a set has the same positions as its markers.
    pub(super) fn learn(&mut self, frame: &FrameOfData<'_>, version: Bitstream) {
        for marker in frame.markers() {
            let is_seen = marker.flags & OCCLUDED == 0 && marker.position_m != [0.0; 3];
            if !is_seen || !is_labelled(&marker, version) || self.knows(marker.id) {
                continue;
            }
            let bits = marker.position_m.map(f32::to_bits);
            let Some(index) = ((marker.id & 0xFFFF) as usize).checked_sub(1) else { continue };
            let found = frame.marker_sets().find_map(|(name, positions)| {
                let range = self.range(&text_of(name))?;
                (positions.get(index)?.map(f32::to_bits) == bits).then_some(range)
            });
            if let Some(range) = found {
                self.by_asset.insert(marker.id >> 16, range);
            }
        }
    }
}
