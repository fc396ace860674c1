//! Rigid bodies as the recorder numbers them.

use super::{
    bodies::BodyComponent, body_settings::BodySettings, groups::bounded, labels::LabelTable,
};
use crate::{
    device::{BODIES_MAX, BodyInfo, Pose},
    link::TEXT_BYTES_MAX,
};

/// The bodies of the settings. A name keeps its number for as long as the driver lives, also when QTM's list changes.
#[derive(Debug, Default)]
pub(super) struct NamedBodies {
    names: LabelTable,
    /// The poses of the open frame.
    poses: Vec<Pose>,
}

impl NamedBodies {
    /// Takes over the bodies of the settings. Returns how many are more than can be recorded.
    pub(super) fn update(&mut self, bodies: &[BodySettings]) -> usize {
        let name = |(index, body): (usize, &BodySettings)| match body.name.as_str() {
            "" => format!("body {}", index + 1),
            name => bounded(name, TEXT_BYTES_MAX),
        };
        let names: Vec<String> = bodies.iter().enumerate().map(name).collect();
        self.names.update(&names);
        bodies.len() - self.infos().len()
    }

    /// Number of bodies of a frame.
    pub(super) fn n_bodies(&self) -> usize {
        self.names.n_labels()
    }

    /// The bodies that are recorded, in QTM's order.
    pub(super) fn infos(&self) -> Vec<BodyInfo> {
        let markers = self.names.markers().into_iter();
        let recorded = markers.filter(|marker| usize::from(marker.id) < BODIES_MAX);
        recorded.map(|marker| BodyInfo { id: marker.id, name: marker.label }).collect()
    }

    /// Forgets the poses of the last frame.
    pub(super) fn begin_frame(&mut self) {
        self.poses.clear();
    }

    /// Takes over the poses of a frame. Returns whether they are those of the settings' bodies.
    pub(super) fn read(&mut self, component: &BodyComponent<'_>) -> bool {
        self.poses.clear();
        if component.n_bodies() != self.n_bodies() {
            return false;
        }
        for (index, body) in component.bodies().enumerate() {
            let number = self.names.id(index).filter(|id| usize::from(*id) < BODIES_MAX);
            self.poses.extend(number.map(|number| body.pose(number)));
        }
        true
    }

    /// The poses of the frame.
    pub(super) fn poses(&self) -> &[Pose] {
        &self.poses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bodies(names: &[&str]) -> Vec<BodySettings> {
        let body = |name: &&str| BodySettings { name: (*name).to_owned(), ..Default::default() };
        names.iter().map(body).collect()
    }

    fn numbers(table: &NamedBodies) -> Vec<(u16, String)> {
        table.infos().into_iter().map(|info| (info.id, info.name)).collect()
    }

    #[test]
    fn a_name_keeps_its_number_and_names_are_unique() {
        let mut table = NamedBodies::default();
        assert_eq!(table.update(&bodies(&["cup", "", "cup"])), 0);
        let pair = |id, name: &str| (id, name.to_owned());
        assert_eq!(numbers(&table), [pair(0, "cup"), pair(1, "body 2"), pair(2, "cup (2)")]);
        table.update(&bodies(&["table", "cup"]));
        assert_eq!(numbers(&table), [pair(3, "table"), pair(0, "cup")]);
        assert_eq!(table.n_bodies(), 2);
    }

    #[test]
    fn more_bodies_than_are_recorded_are_counted() {
        let names: Vec<String> = (0..BODIES_MAX + 3).map(|index| format!("b{index}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let mut table = NamedBodies::default();
        assert_eq!(table.update(&bodies(&names)), 3);
        assert_eq!((table.infos().len(), table.n_bodies()), (BODIES_MAX, BODIES_MAX + 3));
    }
}
