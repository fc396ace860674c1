//! Rigid bodies as the recorder numbers them.

use super::{
    frame::{FrameOfData, WireBody, in_mm},
    model::{AssetKind, Model},
};
use crate::device::{BODIES_MAX, BodyInfo, Pose, PoseStatus};

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
