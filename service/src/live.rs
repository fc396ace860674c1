//! The live view: the newest frames, some thirty a second, never at the cost of recording.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use crossbeam_channel::Receiver;
use mocapd_acquire::pipeline::{PreviewBody, SampleRange};
use mocapd_drivers::device::{SampleForm, SampledChannelInfo, SampledGroupInfo};
use mocapd_take::poses::Pose;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The placement of the face in the device's volume: for each axis three factors of a vertex, and an offset in
/// millimetres.
pub type FacePose = [[f32; 4]; 3];

/// One message of the live stream.
#[derive(Debug, Clone, PartialEq)]
pub enum LiveMessage {
    /// The markers: sent before the first frame and whenever they change.
    Table(Arc<LiveTable>),
    /// A frame.
    Frame(Arc<LiveFrame>),
}

/// The markers of the frames that follow.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct LiveTable {
    /// Labels, by slot.
    pub labels: Vec<String>,
    /// Whether the device identifies the marker, by slot.
    pub labelled: Vec<bool>,
    /// The vertical axis: 0 unknown, 1 x, 2 y, 3 z.
    pub up_axis: u8,
    /// The device's frame rate in Hz.
    pub rate_hz: f64,
    /// Pairs of slots to join by a line.
    pub bones: Vec<[u16; 2]>,
    /// The lines that are limbs of the subject's skeleton.
    pub limbs: Vec<LiveLimb>,
    /// The subject's face, if its markers are mapped.
    pub face: Option<LiveFace>,
    /// The groups of sampled channels.
    pub groups: Vec<LiveGroup>,
    /// The names of the rigid bodies; they may be empty, and may repeat.
    pub bodies: Vec<String>,
}

/// A group of sampled channels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LiveGroup {
    /// Its number.
    pub number: u8,
    /// Samples of a channel in a second.
    pub rate_hz: f64,
    /// Its channels.
    pub channels: Vec<LiveChannel>,
}

/// A sampled channel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LiveChannel {
    /// Its name; may be empty, and may repeat.
    pub name: String,
    /// The unit of its values; may be empty.
    pub unit: String,
    /// The least and the largest value that its counts can express: a channel that reaches them is clipped. Null for samples
    /// that are no counts.
    pub full_scale: Option<[f64; 2]>,
}

/// The wireframe of a face.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct LiveFace {
    /// Vertices in the face's own coordinates, in millimetres.
    pub vertices_mm: Vec<[f32; 3]>,
    /// Pairs of vertices joined by a line.
    pub lines: Vec<[usize; 2]>,
}

/// A limb of the subject's skeleton between two markers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct LiveLimb {
    /// The slots of the two markers.
    pub ends: [u16; 2],
    /// The length measured in the scan, in millimetres.
    pub length_mm: f64,
    /// The tolerated difference from that length, in millimetres.
    pub off_mm: f64,
}

/// One frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LiveFrame {
    /// Row number, counted since the device was armed.
    pub row: u64,
    /// Time by the device's clock, in ticks.
    pub device_ticks: u64,
    /// Arrival of the frame's last byte, in microseconds since 1970.
    pub arrival_unix_us: u64,
    /// Positions in millimetres, by slot; NaN if the marker is not seen.
    pub positions_mm: Vec<[f32; 3]>,
    /// The placement of the subject's face, if its markers are seen.
    pub face: Option<FacePose>,
    /// What the sampled channels did since the previous frame: columns of a strip chart, in order of time.
    pub samples: Vec<LiveSamples>,
    /// The poses of the rigid bodies, if they came with the frame.
    pub poses: Option<LivePoses>,
}

/// The poses of the rigid bodies in a frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LivePoses {
    /// Frames with poses since the device was armed.
    pub n_frames: u64,
    /// By body of the table.
    pub bodies: Vec<PreviewBody>,
}

/// About a twentieth of a second of a group of sampled channels; more while a viewer does not read.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LiveSamples {
    /// The index of the group in the table.
    pub group: u8,
    /// Number of the first sample since the device was armed.
    pub first: u64,
    /// Samples of a channel from the first to the last.
    pub n: u32,
    /// By channel the least and the largest value, in its unit; NaN if there is none.
    pub ranges: Vec<[f32; 2]>,
}

impl LiveMessage {
    /// Appends the message in the wire format, little endian: u32 length of what follows, u8 kind. Kind 1 is a table in
    /// JSON. Kind 2 is a frame: three zero bytes, u64 row, u64 ticks, u64 arrival in microseconds since 1970, then
    /// three f32 per marker (NaN if it is not seen). Kind 3, the placement of the subject's face, follows the frame
    /// that it belongs to: three zero bytes, then for each axis three factors of a vertex and an offset, as f32. So does
    /// kind 4, about a twentieth of a second of a group of sampled channels: u8 index of the group in the table, two zero bytes,
    /// u64 number of the first sample, u32 number of samples, then for each channel its least and its largest value as f32.
    /// And so does kind 5, the poses of the rigid bodies: three zero bytes, u64 number of frames with poses since the device was
    /// armed, for each body of the table the nine f32 of `pose_values`, and then for each a u64: in how many of these frames it
    /// was tracked.
    pub fn put(&self, out: &mut Vec<u8>) {
        match self {
            Self::Table(table) => message(out, |out| {
                out.push(1);
                // A table of strings and numbers can always be written as JSON.
                serde_json::to_writer(&mut *out, table.as_ref()).ok();
            }),
            Self::Frame(frame) => {
                message(out, |out| frame.put(out));
                for LiveSamples { group, first, n, ranges } in &frame.samples {
                    message(out, |out| {
                        out.extend_from_slice(&[4, *group, 0, 0]);
                        out.extend_from_slice(&first.to_le_bytes());
                        out.extend_from_slice(&n.to_le_bytes());
                        ranges
                            .as_flattened()
                            .iter()
                            .for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
                    });
                }
                if let Some(LivePoses { n_frames, bodies }) = &frame.poses {
                    message(out, |out| {
                        out.extend_from_slice(&[5, 0, 0, 0]);
                        out.extend_from_slice(&n_frames.to_le_bytes());
                        let values = bodies.iter().flat_map(|body| pose_values(&body.pose));
                        values.for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
                        for body in bodies {
                            out.extend_from_slice(&body.n_tracked.to_le_bytes());
                        }
                    });
                }
                if let Some(face) = &frame.face {
                    message(out, |out| {
                        out.extend_from_slice(&[3, 0, 0, 0]);
                        face.iter().flatten().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
                    });
                }
            }
        }
    }
}

/// Numbers of a pose for viewers.
pub(crate) const POSE_VALUES: usize = 9;

/// A pose for viewers: the number of its state in outputs (`docs/poses.md`), the residual in millimetres, the position in
/// millimetres, and the rotation as a quaternion w, x, y, z. NaN where there is none.
pub(crate) fn pose_values(pose: &Pose) -> [f32; POSE_VALUES] {
    let ([x, y, z], [qw, qx, qy, qz]) = (pose.position_mm, pose.quaternion);
    [f32::from(pose.state.code()), pose.residual_mm, x, y, z, qw, qx, qy, qz]
}

/// The groups as viewers need them.
pub(crate) fn live_groups(groups: &[SampledGroupInfo]) -> Vec<LiveGroup> {
    let group = |group: &SampledGroupInfo| LiveGroup {
        number: group.id,
        rate_hz: f64::from(group.rate_millihertz) / 1000.0,
        channels: group.channels.iter().map(|channel| live_channel(group.form, channel)).collect(),
    };
    groups.iter().map(group).collect()
}

fn live_channel(form: SampleForm, channel: &SampledChannelInfo) -> LiveChannel {
    let counts = match form {
        SampleForm::Int16 => Some([f64::from(i16::MIN), f64::from(i16::MAX)]),
        // A converter of 24 bits and others send these, and nobody says which.
        SampleForm::Int32 | SampleForm::Float32 => None,
    };
    let full_scale = counts.map(|counts| {
        let [a, b] = counts.map(|count| (count - channel.offset) * channel.scale);
        [a.min(b), a.max(b)]
    });
    LiveChannel { name: channel.name.clone(), unit: channel.unit.clone(), full_scale }
}

/// By channel the ends of what the device sent, in the channel's unit.
pub(crate) fn values_of(group: &SampledGroupInfo, sent: &[SampleRange]) -> Vec<[f32; 2]> {
    let value = |(range, channel): (&SampleRange, &SampledChannelInfo)| {
        let [a, b] = range.map(|sent| channel.value(sent));
        [a.min(b) as f32, a.max(b) as f32]
    };
    sent.iter().zip(&group.channels).map(value).collect()
}

/// Appends the length of what `put` appends, then that.
fn message(out: &mut Vec<u8>, put: impl FnOnce(&mut Vec<u8>)) {
    let at = out.len();
    out.extend_from_slice(&[0; 4]);
    put(out);
    let len = (out.len() - at - 4) as u32;
    out[at..at + 4].copy_from_slice(&len.to_le_bytes());
}

impl LiveFrame {
    fn put(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&[2, 0, 0, 0]);
        for number in [self.row, self.device_ticks, self.arrival_unix_us] {
            out.extend_from_slice(&number.to_le_bytes());
        }
        for value in self.positions_mm.iter().flatten() {
            out.extend_from_slice(&value.to_le_bytes());
        }
    }
}

/// The newest frames for one viewer. If the viewer is slow, frames are dropped, but never the table.
#[derive(Debug)]
pub struct LiveFeed {
    pub(crate) messages: Receiver<LiveMessage>,
    pub(crate) closed: Arc<AtomicBool>,
    /// Lets the sender notice when the feed is dropped.
    pub(crate) _alive: Arc<()>,
}

impl LiveFeed {
    /// A feed that receives from `messages` until `closed` is set.
    #[must_use]
    pub fn new(messages: Receiver<LiveMessage>, closed: Arc<AtomicBool>) -> Self {
        Self { messages, closed, _alive: Arc::default() }
    }

    /// Waits at most `wait` for the next message.
    #[must_use]
    pub fn next(&self, wait: Duration) -> Option<LiveMessage> {
        self.messages.recv_timeout(wait).ok()
    }

    /// Whether the service is ending, so that no more messages will come.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.closed.load(Ordering::Relaxed) && self.messages.is_empty()
    }
}
