//! The thread of a publisher, the same for every protocol.

use std::{
    net::SocketAddr,
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};

use crossbeam_channel::RecvTimeoutError;
use mocapd_acquire::{
    pipeline::{TappedBatch, TappedFrame},
    threads::{self, StopReceiver, StopSender},
};

use super::{LivePublisher, PublishedFeed, PublishedSource, PublisherName};
use crate::{
    control::Control,
    status::{PublishStatus, ServiceEventKind},
    trigger::RateLimit,
};

/// Time between two looks at the tap while something is wanted: well below the 3 ms in which frames reach the clients' sockets.
const POLL_STREAMING: Duration = Duration::from_millis(1);

/// The same while nothing is: the tap holds half a second.
const POLL_IDLE: Duration = Duration::from_millis(20);

/// Frames, and batches of samples, between two looks at the clients: their sockets take as many at once.
const FRAMES_A_TURN: usize = 16;
const BATCHES_A_TURN: usize = 64;

/// Time between two reports of the clients to the status.
const REPORT_INTERVAL: Duration = Duration::from_millis(200);

/// Time between two attempts to open the port: an address that comes with the network needs some seconds.
const REOPEN_INTERVAL: Duration = Duration::from_secs(5);

/// A publisher, until it is closed.
#[derive(Debug)]
pub struct RunningPublisher {
    address: SocketAddr,
    stopper: StopSender,
    threads: Vec<JoinHandle<()>>,
}

impl RunningPublisher {
    /// Where clients connect.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Adds a thread to wait for that ends after the publisher's own.
    pub(super) fn add_thread(&mut self, thread: JoinHandle<()>) {
        self.threads.push(thread);
    }

    /// Disconnects all clients, and ends.
    pub fn close(self) {
        drop(self.stopper);
        for thread in self.threads {
            // A thread that panicked has reported it already.
            drop(thread.join());
        }
    }
}

/// Opens a publisher and starts its thread. `listen` is the configured address, and `open` opens it.
///
/// A port that cannot be opened is a warning, and tried again until it can: the recording does without clients.
///
/// # Errors
/// The thread cannot be started.
pub(super) fn start<P: LivePublisher + Send + 'static>(
    feed: PublishedFeed,
    control: &Arc<dyn Control>,
    listen: SocketAddr,
    mut open: impl FnMut() -> anyhow::Result<P> + Send + 'static,
) -> anyhow::Result<RunningPublisher> {
    let PublisherName { id, title } = feed.name;
    let opened = open();
    let address = opened.as_ref().map_or(listen, LivePublisher::address);
    match &opened {
        Ok(_) => report_opened(control.as_ref(), title, address),
        Err(error) => {
            let every_s = REOPEN_INTERVAL.as_secs();
            let message = format!("{error:#}; tried again every {every_s} s");
            control.notify(ServiceEventKind::Warning, &message);
        }
    }
    let (stopper, stopped) = threads::stop_channel();
    let control = Arc::clone(control);
    let work = move || {
        let guard = PanicGuard { feed: feed.clone(), control: Arc::clone(&control) };
        let opened = opened.ok().or_else(|| wait_for(open, &stopped, control.as_ref(), title));
        if let Some(publisher) = opened {
            PublisherThread::new(publisher, feed, control, stopped).run();
        }
        drop(guard);
    };
    let thread = threads::spawn(&format!("mocapd-{id}"), work)?;
    Ok(RunningPublisher { address, stopper, threads: vec![thread] })
}

fn report_opened(control: &dyn Control, title: &str, address: SocketAddr) {
    let message = format!("published for clients of {title} at {address}");
    control.notify(ServiceEventKind::State, &message);
}

/// Tries until the port can be opened, or the service stops.
fn wait_for<P: LivePublisher>(
    mut open: impl FnMut() -> anyhow::Result<P>,
    stopped: &StopReceiver,
    control: &dyn Control,
    title: &str,
) -> Option<P> {
    loop {
        // Nothing is sent on it: it ends when it is time to stop.
        if stopped.channel().recv_timeout(REOPEN_INTERVAL) == Err(RecvTimeoutError::Disconnected) {
            return None;
        }
        if let Ok(publisher) = open() {
            report_opened(control, title, publisher.address());
            return Some(publisher);
        }
    }
}

/// Reports that the thread has panicked: otherwise the status would show its last clients for ever.
struct PanicGuard {
    feed: PublishedFeed,
    control: Arc<dyn Control>,
}

impl Drop for PanicGuard {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.feed.report(None);
            let message = format!(
                "what is received is not published for clients of {} any more: its thread has failed; please report this \
                 bug, and restart the service",
                self.feed.name.title
            );
            self.control.notify(ServiceEventKind::Failure, &message);
        }
    }
}

/// The state of a publisher's thread.
struct PublisherThread<P> {
    publisher: P,
    feed: PublishedFeed,
    control: Arc<dyn Control>,
    source: Option<PublishedSource>,
    frame: TappedFrame,
    batch: TappedBatch,
    /// Whether more waits than one turn takes.
    is_behind: bool,
    /// Frames, poses of frames, and batches that the taps left out.
    left_out: [u64; 3],
    rate_limit: RateLimit,
    began: Instant,
    reported: Option<Instant>,
    stopped: StopReceiver,
}

impl<P: LivePublisher> PublisherThread<P> {
    fn new(
        publisher: P,
        feed: PublishedFeed,
        control: Arc<dyn Control>,
        stopped: StopReceiver,
    ) -> Self {
        Self {
            publisher,
            feed,
            control,
            source: None,
            frame: TappedFrame::default(),
            batch: TappedBatch::default(),
            is_behind: false,
            left_out: [0; 3],
            rate_limit: RateLimit::default(),
            began: Instant::now(),
            reported: None,
            stopped,
        }
    }

    fn run(mut self) {
        while !self.stopped.is_stopped() {
            self.follow_source();
            self.publish();
            let is_streaming = self.publisher.wanted().any() && self.source.is_some();
            let timeout = match is_streaming {
                true if self.is_behind => Duration::ZERO,
                true => POLL_STREAMING,
                false => POLL_IDLE,
            };
            if let Err(error) = self.publisher.exchange(timeout) {
                // Not at once again: the system may be out of memory.
                std::thread::sleep(POLL_IDLE);
                self.warn(&format!("waiting for {} clients failed: {error}", self.feed.name.title));
            }
            self.report();
        }
        self.publisher.set_device(None);
        self.publisher.close();
        self.feed.report(None);
    }

    /// Takes over a device that was armed, or ends with one that was disarmed.
    fn follow_source(&mut self) {
        if let Some(source) = self.feed.take_source() {
            self.publisher.set_device(Some(&source.device));
            self.source = Some(source);
        }
        let Some(source) = &self.source else { return };
        let wanted = self.publisher.wanted();
        source.tap.set_wanted(wanted.frames, wanted.samples);
        if source.tap.is_over() {
            self.source = None;
            self.publisher.set_device(None);
        }
    }

    /// Passes on what waits in the tap, as much as one turn takes.
    fn publish(&mut self) {
        let Some(PublishedSource { tap, device }) = &mut self.source else { return };
        let [frames, poses, batches] = &mut self.left_out;
        let (mut n_batches, mut n_frames) = (0, 0);
        while n_batches < BATCHES_A_TURN && tap.next_batch(&mut self.batch) {
            *batches += self.batch.batches_left_out;
            self.publisher.samples(device, &self.batch);
            n_batches += 1;
        }
        while n_frames < FRAMES_A_TURN && tap.next_frame(&mut self.frame) {
            *frames += self.frame.frames_left_out;
            *poses += self.frame.poses_left_out;
            self.publisher.frame(device, &self.frame);
            n_frames += 1;
        }
        self.is_behind = n_batches == BATCHES_A_TURN || n_frames == FRAMES_A_TURN;
    }

    fn report(&mut self) {
        for message in self.publisher.take_news() {
            self.warn(&message);
        }
        if self.reported.is_some_and(|at| at.elapsed() < REPORT_INTERVAL) {
            return;
        }
        self.reported = Some(Instant::now());
        let [frames_left_out, poses_left_out, batches_left_out] = self.left_out;
        self.feed.report(Some(PublishStatus {
            frames_left_out,
            poses_left_out,
            batches_left_out,
            ..self.publisher.status()
        }));
    }

    fn warn(&mut self, message: &str) {
        if let Some(message) = self.rate_limit.admit(message, self.began.elapsed()) {
            self.control.notify(ServiceEventKind::Warning, &message);
        }
    }
}
