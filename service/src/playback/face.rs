//! Where the face of a take's subject is, for a player: its pose in the frames of a window, from the markers on it.

use std::io::{Read, Seek};

use mocapd_take::TakeMap;

use super::{
    WINDOW_SAMPLES_MAX,
    window::{
        DAMAGED, EVERY_MAX, HEADER_BYTES, SHORTENED, WINDOW_BYTES_MAX, WindowError, WindowRequest,
        decode_rows, put_header, rows_of,
    },
};
use crate::{live::FacePose, subject::FaceOverlay};

/// The signature of a window of poses: "mocapd poses", version 1.
const MAGIC: &[u8; 4] = b"MPP1";

/// Numbers of a pose: three factors of a vertex and an offset for each axis.
const POSE_VALUES: usize = 12;

/// Maximum number of poses of a window: each is fitted, which takes some hundredths of a millisecond.
const POSES_MAX: u64 = 4096;

/// Where no pose is known.
const UNKNOWN: FacePose = [[f32::NAN; 4]; 3];

/// The poses of the face in some frames.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceWindow {
    first_row: u64,
    every: u32,
    flags: u32,
    poses: Vec<FacePose>,
}

impl FaceWindow {
    /// Fits the face of the take's subject to its markers in the frames of a window. There are no poses without a face whose
    /// markers are mapped.
    ///
    /// # Errors
    /// Those of [`WindowError`].
    pub fn read(
        input: &mut (impl Read + Seek),
        map: &TakeMap,
        request: &WindowRequest,
    ) -> Result<Self, WindowError> {
        let rows = rows_of(map, request)?;
        let every = request.every.clamp(1, EVERY_MAX);
        let mut window = Self { first_row: rows.start, every, flags: 0, poses: Vec::new() };
        let Some(face) = FaceOverlay::new(map.subject.as_ref(), &labels(map)) else {
            return Ok(window);
        };
        let n_markers = map.channels.len().max(1);
        let poses_max = POSES_MAX.min((WINDOW_BYTES_MAX - HEADER_BYTES) / (4 * POSE_VALUES) as u64);
        let worked_max = WINDOW_SAMPLES_MAX / n_markers as u64;
        let rows_max = poses_max.saturating_mul(every.into()).min(worked_max.max(1));
        let end = rows.end.min(rows.start.saturating_add(rows_max));
        window.flags |= if end < rows.end { SHORTENED } else { 0 };
        let (positions, is_damaged) = decode_rows(input, map, &(rows.start..end), every)?;
        window.flags |= if is_damaged { DAMAGED } else { 0 };
        let frames = positions.chunks_exact(n_markers);
        window.poses.extend(frames.map(|frame| face.pose(frame).unwrap_or(UNKNOWN)));
        Ok(window)
    }

    /// The window as bytes, little endian: the four bytes `MPP1`, u32 1, u64 first row, u32 number of frames, u32 rows from one
    /// frame to the next, u32 flags, u32 zero; then the frames, each twelve f32 as in the live stream, NaN where the pose is
    /// not known.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out =
            Vec::with_capacity(HEADER_BYTES as usize + 4 * POSE_VALUES * self.poses.len());
        let words = [1, self.poses.len() as u32, self.every, self.flags];
        put_header(&mut out, MAGIC, self.first_row, words);
        for value in self.poses.iter().flatten().flatten() {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out
    }
}

/// The labels of a take's markers.
pub(super) fn labels(map: &TakeMap) -> Vec<String> {
    map.channels.iter().map(|channel| channel.label.clone()).collect()
}
