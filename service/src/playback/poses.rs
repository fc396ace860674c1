//! What moves with the markers of a take, for a player: windows of the poses of its rigid bodies, which the take has, and of
//! the face of its subject, which is fitted to the markers on it.

use std::io::{Read, Seek};

use mocapd_drivers::device::BODIES_MAX;
use mocapd_take::{
    TakeError, TakeMap,
    poses::{PoseBody, PoseState, PosesByRow, RowPoses},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    WINDOW_SAMPLES_MAX,
    window::{
        DAMAGED, EVERY_MAX, HEADER_BYTES, SHORTENED, WINDOW_BYTES_MAX, WindowError, WindowRequest,
        decode_rows, labels, put_header, rows_of,
    },
};
use crate::{
    live::{FacePose, POSE_VALUES, pose_values},
    subject::FaceOverlay,
};

/// The signature of a window of poses of rigid bodies: "mocapd bodies", version 1.
const BODIES_MAGIC: &[u8; 4] = b"MPB1";

/// Maximum number of bodies that a player shows: as many as a recorder records. A response for one frame has to be small.
const SHOWN_MAX: usize = BODIES_MAX;

/// Maximum length of a body's name in characters.
const NAME_CHARS_MAX: usize = 200;

/// The rigid bodies of a take.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct BodyList {
    /// Their names, in the order of [`TakeBodies::window`]; they may be empty, and may repeat.
    pub names: Vec<String>,
    /// Maximum number of frames of a window: a response has at most a megabyte.
    pub window_frames_max: u64,
}

/// The rigid bodies of a take, and where their poses are.
#[derive(Debug, Clone)]
pub struct TakeBodies {
    map: TakeMap,
    poses: Option<PosesByRow>,
}

/// The poses of all bodies in some frames.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseWindow {
    n_bodies: u32,
    first_row: u64,
    every: u32,
    flags: u32,
    n_frames: u32,
    /// By frame and body.
    poses: Vec<[f32; POSE_VALUES]>,
}

impl TakeBodies {
    /// Reads the take for its bodies, without decoding anything but times.
    ///
    /// # Errors
    /// Those of the reader.
    pub fn open(mut input: impl Read + Seek) -> Result<Self, TakeError> {
        let mut map = TakeMap::scan(&mut input)?;
        let poses = PosesByRow::read(&mut input, &map)?;
        // The index has its own copy of what it needs.
        map.foreign.clear();
        Ok(Self { map, poses })
    }

    fn n_bodies(&self) -> usize {
        self.poses.as_ref().map_or(0, |poses| poses.bodies().len().min(SHOWN_MAX))
    }

    fn frames_max(&self) -> u64 {
        (WINDOW_BYTES_MAX - HEADER_BYTES) / (4 * POSE_VALUES * self.n_bodies().max(1)) as u64
    }

    /// The bodies.
    #[must_use]
    pub fn list(&self) -> BodyList {
        let bodies = self.poses.as_ref().map(PosesByRow::bodies).unwrap_or_default();
        BodyList {
            names: bodies.iter().take(SHOWN_MAX).map(name).collect(),
            window_frames_max: self.frames_max(),
        }
    }

    /// Entries that it holds in memory: key stretches, channels, blocks of poses, and times.
    #[must_use]
    pub fn n_entries(&self) -> usize {
        let of_poses = self.poses.as_ref().map_or(0, PosesByRow::n_entries);
        self.map.keys.len() + self.map.channels.len() + of_poses
    }

    /// The poses in the frames of a window; none if the take has no bodies.
    ///
    /// # Errors
    /// Those of [`WindowError`].
    pub fn window(
        &self,
        input: &mut (impl Read + Seek),
        request: &WindowRequest,
    ) -> Result<PoseWindow, WindowError> {
        let rows = rows_of(&self.map, request)?;
        let every = u64::from(request.every.clamp(1, EVERY_MAX));
        let mut window = PoseWindow {
            n_bodies: self.n_bodies() as u32,
            first_row: rows.start,
            every: every as u32,
            flags: 0,
            n_frames: 0,
            poses: Vec::new(),
        };
        let Some(index) = self.poses.as_ref().filter(|_| window.n_bodies > 0) else {
            return Ok(window);
        };
        let n_stored = index.bodies().len();
        let values = n_stored * POSE_VALUES;
        let worked_max = (WINDOW_SAMPLES_MAX / values as u64).max(1);
        let rows_max = self.frames_max().saturating_mul(every).min(worked_max);
        let end = rows.end.min(rows.start.saturating_add(rows_max));
        window.flags = if end < rows.end { SHORTENED } else { 0 };
        let (mut read, mut poses) = (index.rows(rows.start..end), Vec::new());
        while let Some(found) = read.next(input, RowPoses::ROWS_AT_ONCE, &mut poses)? {
            for (row, of_row) in found.zip(poses.chunks_exact(n_stored)) {
                let of_row = of_row.get(..self.n_bodies()).unwrap_or(of_row);
                if !(row - rows.start).is_multiple_of(every) {
                    continue;
                }
                let is_missing = of_row.iter().any(|pose| pose.state == PoseState::Missing);
                window.flags |= if is_missing { DAMAGED } else { 0 };
                window.poses.extend(of_row.iter().map(pose_values));
                window.n_frames += 1;
            }
        }
        Ok(window)
    }
}

fn name(body: &PoseBody) -> String {
    body.name.chars().take(NAME_CHARS_MAX).collect()
}

impl PoseWindow {
    /// The window as bytes, little endian: the four bytes `MPB1`, u32 number of bodies, u64 first row, u32 number of frames, u32
    /// rows from one frame to the next, u32 flags, u32 zero; then for each frame and body nine f32, as in the live stream.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let n_bytes = HEADER_BYTES as usize + 4 * POSE_VALUES * self.poses.len();
        let mut out = Vec::with_capacity(n_bytes);
        let words = [self.n_bodies, self.n_frames, self.every, self.flags];
        put_header(&mut out, BODIES_MAGIC, self.first_row, words);
        for value in self.poses.as_flattened() {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out
    }
}

/// The signature of a window of poses of the face: "mocapd poses", version 1.
const FACE_MAGIC: &[u8; 4] = b"MPP1";

/// Numbers of a pose of the face: three factors of a vertex and an offset for each axis.
const FACE_VALUES: usize = 12;

/// Maximum number of poses of the face in a window: each is fitted, which takes some hundredths of a millisecond.
const FACES_MAX: u64 = 4096;

/// Where no pose of the face is known.
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
        let faces_max = FACES_MAX.min((WINDOW_BYTES_MAX - HEADER_BYTES) / (4 * FACE_VALUES) as u64);
        let worked_max = WINDOW_SAMPLES_MAX / n_markers as u64;
        let rows_max = faces_max.saturating_mul(every.into()).min(worked_max.max(1));
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
            Vec::with_capacity(HEADER_BYTES as usize + 4 * FACE_VALUES * self.poses.len());
        let words = [1, self.poses.len() as u32, self.every, self.flags];
        put_header(&mut out, FACE_MAGIC, self.first_row, words);
        for value in self.poses.iter().flatten().flatten() {
            out.extend_from_slice(&value.to_le_bytes());
        }
        out
    }
}
