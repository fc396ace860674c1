//! Encoding and decoding of rigid bodies: their table, and their poses in a frame.

use super::{
    ENVELOPE_BYTES, EncodeError, LABEL_BYTES_MAX, POSE_BYTES_MAX, POSES_HEADER_BYTES,
    envelope::Framer,
    messages::{kind, put_text},
    wire_bytes,
};
use crate::{
    bytes::{Cursor, WireValue},
    device::{BODIES_MAX, BodyInfo, DeviceEvent, EndOfPoses, Pose, PoseFrame, PoseStatus},
};

/// Bytes on the wire of the poses of a frame, at most.
#[must_use]
pub const fn pose_frame_bytes_max(n_bodies: usize) -> usize {
    wire_bytes(ENVELOPE_BYTES + POSES_HEADER_BYTES + n_bodies * POSE_BYTES_MAX)
}

/// The reason why bodies with these ids cannot be sent; sender and receiver apply the same rule.
fn ids_error(ids: impl Iterator<Item = u16> + Clone) -> Option<&'static str> {
    if ids.clone().count() > BODIES_MAX {
        Some("there are more than 128 bodies")
    } else if !ids.is_sorted_by(|a, b| a < b) {
        Some("their ids do not ascend: sort them, without duplicates")
    } else {
        None
    }
}

pub(super) fn put_bodies(bodies: &[BodyInfo], out: &mut Vec<u8>) -> Result<(), EncodeError> {
    if let Some(error) = ids_error(bodies.iter().map(|body| body.id)) {
        return Err(EncodeError::Bodies(error));
    }
    (bodies.len() as u16).put(out);
    for body in bodies {
        body.id.put(out);
        put_text("body name", &body.name, LABEL_BYTES_MAX, out)?;
    }
    Ok(())
}

/// Decodes a table of bodies into `bodies`, reusing their memory. After `None` its contents are unspecified.
pub(super) fn get_bodies(payload: &[u8], bodies: &mut Vec<BodyInfo>) -> Option<()> {
    let mut cursor = Cursor::new(payload);
    let n = usize::from(cursor.get::<u16>()?);
    if n > BODIES_MAX {
        return None;
    }
    bodies.resize_with(n, BodyInfo::default);
    for body in bodies.iter_mut() {
        body.id = cursor.get()?;
        cursor.text(LABEL_BYTES_MAX)?.clone_into(&mut body.name);
    }
    cursor.end(()).filter(|()| ids_error(bodies.iter().map(|body| body.id)).is_none())
}

pub(super) fn put_poses(
    framer: &mut Framer,
    frame: &PoseFrame<'_>,
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    if let Some(error) = ids_error(frame.poses.iter().map(|pose| pose.body)) {
        return Err(EncodeError::Poses(error));
    }
    let is_status = |status: PoseStatus| PoseStatus::from_code(status.code()) == Some(status);
    if !frame.poses.iter().all(|pose| is_status(pose.status)) {
        return Err(EncodeError::Poses("another status is not within 3 to 127"));
    }
    let message = framer.open(kind::POSES);
    frame.seq.put(message);
    frame.number.put(message);
    frame.device_ticks.put(message);
    (frame.poses.len() as u16).put(message);
    for pose in frame.poses {
        pose.body.put(message);
        pose.status.code().put(message);
        if pose.status == PoseStatus::Tracked {
            pose.position_mm.put(message);
            pose.quaternion.into_iter().for_each(|value| value.put(message));
            pose.residual_mm.put(message);
        }
    }
    framer.close(out);
    Ok(())
}

/// In place of the number of poses: there are no more.
const END: u16 = u16::MAX;

pub(super) fn put_end(framer: &mut Framer, end: EndOfPoses, out: &mut Vec<u8>) {
    let message = framer.open(kind::POSES);
    end.seq.put(message);
    end.number.put(message);
    end.device_ticks.put(message);
    END.put(message);
    framer.close(out);
}

/// Decodes the poses of a frame, which are in `poses`, or their end.
pub(super) fn get_poses<'a>(payload: &[u8], poses: &'a mut Vec<Pose>) -> Option<DeviceEvent<'a>> {
    let mut cursor = Cursor::new(payload);
    let (seq, number, device_ticks) = (cursor.get()?, cursor.get()?, cursor.get()?);
    let n = cursor.get::<u16>()?;
    if n == END {
        return cursor.end(DeviceEvent::EndOfPoses(EndOfPoses { seq, number, device_ticks }));
    }
    if usize::from(n) > BODIES_MAX {
        return None;
    }
    poses.clear();
    for _ in 0..n {
        let body = cursor.get()?;
        let status = PoseStatus::from_code(cursor.get()?)?;
        let mut pose = Pose::without(body, status);
        if status == PoseStatus::Tracked {
            pose.position_mm = cursor.get()?;
            for value in &mut pose.quaternion {
                *value = cursor.get()?;
            }
            pose.residual_mm = cursor.get()?;
        }
        poses.push(pose);
    }
    cursor.end(())?;
    let is_valid = ids_error(poses.iter().map(|pose| pose.body)).is_none();
    is_valid.then_some(DeviceEvent::Poses(PoseFrame { seq, number, device_ticks, poses }))
}
