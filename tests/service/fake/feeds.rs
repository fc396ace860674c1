//! The event and frame feeds of the fake, with a bounded queue for each subscriber.

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use crossbeam_channel::{Sender, bounded};
use mocapd_acquire::pipeline::PreviewBody;
use mocapd_service::{
    control::EventFeed,
    live::{LiveFeed, LiveFrame, LiveMessage, LivePoses, LiveSamples, LiveTable},
    status::{ServiceEvent, ServiceEventKind, State},
};
use mocapd_take::poses::{Pose, PoseState};

/// Capacity of the queues: events and frames.
const EVENTS: usize = 64;
const FRAMES: usize = 8;

/// The queue of a subscriber, and the number of events that did not fit.
type Subscriber = (Sender<Arc<ServiceEvent>>, Arc<AtomicU64>);

#[derive(Debug, Default)]
pub(crate) struct Feeds {
    number: AtomicU64,
    subscribers: Mutex<Vec<Subscriber>>,
    viewers: Mutex<Vec<Sender<LiveMessage>>>,
    closed: Arc<AtomicBool>,
}

impl Feeds {
    pub(super) fn events(&self) -> EventFeed {
        let (sender, receiver) = bounded(EVENTS);
        let missed = Arc::new(AtomicU64::new(0));
        self.subscribers.lock().unwrap().push((sender, Arc::clone(&missed)));
        EventFeed::new(receiver, missed)
    }

    pub(super) fn live(&self) -> LiveFeed {
        let (sender, receiver) = bounded(FRAMES);
        sender.send(LiveMessage::Table(table(2))).unwrap();
        self.viewers.lock().unwrap().push(sender);
        LiveFeed::new(receiver, Arc::clone(&self.closed))
    }

    pub(crate) fn publish(
        &self,
        kind: ServiceEventKind,
        message: String,
        state: State,
        take: Option<&str>,
    ) {
        let number = self.number.fetch_add(1, Ordering::Relaxed) + 1;
        let event = Arc::new(ServiceEvent {
            number,
            unix_ms: 1_700_000_000_000 + number as i64,
            kind,
            message,
            state,
            take: take.map(str::to_owned),
            notes: None,
        });
        self.subscribers.lock().unwrap().retain(|(sender, missed)| {
            match sender.try_send(Arc::clone(&event)) {
                Err(crossbeam_channel::TrySendError::Full(_)) => {
                    missed.fetch_add(1, Ordering::Relaxed);
                    true
                }
                sent => sent.is_ok(),
            }
        });
    }

    /// Sends a frame to all viewers; returns their number.
    pub(crate) fn send_frame(&self, row: u64, n_markers: usize) -> usize {
        // Sampled channels in one frame.
        let samples = match row {
            7 => vec![LiveSamples { group: 1, first: 40, n: 50, ranges: vec![[-0.5, 9.0]] }],
            _ => Vec::new(),
        };
        // And rigid bodies in the same.
        let pose = Pose {
            state: PoseState::Tracked,
            position_mm: [1.0, 2.0, 3.0],
            quaternion: [0.6, 0.0, 0.8, 0.0],
            residual_mm: 0.25,
        };
        let body = PreviewBody { pose, n_tracked: 3 };
        let poses = (row == 7).then(|| LivePoses { n_frames: 5, bodies: vec![body] });
        let frame = Arc::new(LiveFrame {
            row,
            device_ticks: row * 10,
            arrival_unix_us: 1,
            positions_mm: vec![[row as f32, 2.0, f32::NAN]; n_markers],
            face: None,
            samples,
            poses,
        });
        self.send(&LiveMessage::Frame(frame))
    }

    /// Sends a new table of markers.
    pub(crate) fn send_table(&self, n_markers: usize) {
        self.send(&LiveMessage::Table(table(n_markers)));
    }

    fn send(&self, message: &LiveMessage) -> usize {
        let mut viewers = self.viewers.lock().unwrap();
        viewers.retain(|viewer| match viewer.try_send(message.clone()) {
            // A table is never dropped: wait for space in the queue.
            Err(crossbeam_channel::TrySendError::Full(message @ LiveMessage::Table(_))) => {
                viewer.send(message).is_ok()
            }
            Err(crossbeam_channel::TrySendError::Full(_)) => true,
            sent => sent.is_ok(),
        });
        viewers.len()
    }

    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Relaxed);
    }
}

fn table(n_markers: usize) -> Arc<LiveTable> {
    Arc::new(LiveTable {
        labels: (0..n_markers).map(|slot| format!("m{slot}")).collect(),
        labelled: vec![true; n_markers],
        up_axis: 3,
        rate_hz: 120.0,
        bones: vec![[0, 1]],
        limbs: Vec::new(),
        face: None,
        groups: Vec::new(),
        bodies: vec!["wand".to_owned()],
    })
}
