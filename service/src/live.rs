//! Frames for people's eyes: some thirty a second, the newest ones, and never at the cost of the data plane.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use crossbeam_channel::Receiver;

/// From the face to the device's millimetres: for each axis three factors and what is added.
pub type FacePose = [[f32; 4]; 3];

/// One message of the live stream.
#[derive(Debug, Clone, PartialEq)]
pub enum LiveMessage {
    /// Which markers there are: before the first frame, and whenever that changes.
    Table(Arc<LiveTable>),
    /// A frame.
    Frame(Arc<LiveFrame>),
}

/// The markers of the frames that follow.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct LiveTable {
    /// Labels, by slot.
    pub labels: Vec<String>,
    /// Whether the device knows the marker, by slot.
    pub labelled: Vec<bool>,
    /// Which axis points up: 0 unknown, 1 x, 2 y, 3 z.
    pub up_axis: u8,
    /// Frames a second that the device sends.
    pub rate_hz: f64,
    /// Pairs of slots between which a line is drawn.
    pub bones: Vec<[u16; 2]>,
    /// Those of them that are limbs of the subject's skeleton.
    pub limbs: Vec<LiveLimb>,
    /// The subject's face, where markers say where it is.
    pub face: Option<LiveFace>,
}

/// The wireframe of a face.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct LiveFace {
    /// Its vertices, in its own millimetres.
    pub vertices_mm: Vec<[f32; 3]>,
    /// Pairs of vertices that are joined.
    pub lines: Vec<[usize; 2]>,
}

/// A limb of the subject's skeleton between two markers.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct LiveLimb {
    /// The slots of the markers.
    pub ends: [u16; 2],
    /// How long the scan has it, in millimetres.
    pub length_mm: f64,
    /// How far the markers may be off that before somebody should look.
    pub off_mm: f64,
}

/// One frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LiveFrame {
    /// Its row, counted since the device was armed.
    pub row: u64,
    /// By the device's clock.
    pub device_ticks: u64,
    /// When its last byte arrived, in microseconds since 1970.
    pub arrival_unix_us: u64,
    /// In millimetres, by slot; NaN where the marker is not seen.
    pub positions_mm: Vec<[f32; 3]>,
    /// Where the subject's face is, where its markers are seen.
    pub face: Option<FacePose>,
}

impl LiveMessage {
    /// As it goes to a browser, little endian: u32 length of what follows, u8 kind. Kind 1, a table: JSON. Kind 2, a
    /// frame: three bytes of zero, u64 row, u64 ticks, u64 arrival in microseconds since 1970, then three f32 a marker
    /// (NaN where it is not seen). Behind a frame kind 3, the place of the subject's face: three bytes of zero, then for
    /// each axis three factors of a vertex and what is added, f32.
    pub fn put(&self, out: &mut Vec<u8>) {
        match self {
            Self::Table(table) => message(out, |out| {
                out.push(1);
                // A table of strings and numbers is always JSON.
                serde_json::to_writer(&mut *out, table.as_ref()).ok();
            }),
            Self::Frame(frame) => {
                message(out, |out| frame.put(out));
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

/// Its length, then what `put` puts.
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

/// One viewer's frames: the newest few. What a slow viewer does not take is dropped, its table never.
#[derive(Debug)]
pub struct LiveFeed {
    pub(crate) messages: Receiver<LiveMessage>,
    pub(crate) closed: Arc<AtomicBool>,
    /// Tells the other end that it is still there.
    pub(crate) _alive: Arc<()>,
}

impl LiveFeed {
    /// What comes from `messages`, until `closed` is true.
    #[must_use]
    pub fn new(messages: Receiver<LiveMessage>, closed: Arc<AtomicBool>) -> Self {
        Self { messages, closed, _alive: Arc::default() }
    }

    /// The next message, waited for at most so long. `None`: none came.
    #[must_use]
    pub fn next(&self, wait: Duration) -> Option<LiveMessage> {
        self.messages.recv_timeout(wait).ok()
    }

    /// Whether the service ends, and no more will come.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.closed.load(Ordering::Relaxed) && self.messages.is_empty()
    }
}
