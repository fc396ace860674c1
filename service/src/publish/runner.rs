//! The thread of a publisher, the same for every protocol.

use std::{
    net::SocketAddr,
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};

use crossbeam_channel::RecvTimeoutError;
use mocapd_acquire::{
    pipeline::{LeftOut, TappedBatch, TappedFrame},
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

    /// Disconnects all clients of these publishers at the same time, and ends.
    pub fn close_all(publishers: Vec<Self>) {
        let (stoppers, threads): (Vec<_>, Vec<_>) =
            publishers.into_iter().map(|publisher| (publisher.stopper, publisher.threads)).unzip();
        drop(stoppers);
        for thread in threads.into_iter().flatten() {
            // A thread that panicked has reported it already.
            drop(thread.join());
        }
    }

    /// Disconnects all clients, and ends.
    pub fn close(self) {
        Self::close_all(vec![self]);
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

fn sum(a: LeftOut, b: LeftOut) -> LeftOut {
    LeftOut {
        frames: a.frames + b.frames,
        poses: a.poses + b.poses,
        batches: a.batches + b.batches,
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
    /// What the taps of earlier devices left out.
    left_out: LeftOut,
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
            left_out: LeftOut::default(),
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
            if let Some(before) = self.source.replace(source) {
                self.leave(before);
            }
        }
        let Some(source) = &self.source else { return };
        let wanted = self.publisher.wanted();
        let wants_poses = wanted.frames && self.publisher.wants_poses();
        source.tap.set_wanted(wanted.frames, wants_poses, wanted.samples);
        if source.tap.is_over()
            && let Some(source) = self.source.take()
        {
            self.leave(source);
            self.publisher.set_device(None);
        }
    }

    /// Counts what was left out of a device that is over.
    fn leave(&mut self, source: PublishedSource) {
        self.left_out = sum(self.left_out, source.tap.abandon());
    }

    /// Passes on what waits in the tap, as much as one turn takes.
    fn publish(&mut self) {
        let Some(PublishedSource { tap, device }) = &mut self.source else { return };
        let (mut n_batches, mut n_frames) = (0, 0);
        while n_batches < BATCHES_A_TURN && tap.next_batch(&mut self.batch) {
            self.publisher.samples(device, &self.batch);
            n_batches += 1;
        }
        while n_frames < FRAMES_A_TURN && tap.next_frame(&mut self.frame) {
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
        let now = self.source.as_ref().map(|source| source.tap.left_out()).unwrap_or_default();
        let LeftOut { frames, poses, batches } = sum(self.left_out, now);
        self.feed.report(Some(PublishStatus {
            frames_left_out: frames,
            poses_left_out: poses,
            batches_left_out: batches,
            ..self.publisher.status()
        }));
    }

    fn warn(&mut self, message: &str) {
        if let Some(message) = self.rate_limit.admit(message, self.began.elapsed()) {
            self.control.notify(ServiceEventKind::Warning, &message);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io,
        sync::{Mutex, MutexGuard, PoisonError},
    };

    use mocapd_acquire::{
        header,
        pipeline::{Intake, Pipeline, PipelineConfig},
    };
    use mocapd_codec::{ResamplerKind, Settings, Tolerance};
    use mocapd_drivers::device::{
        Frame, MarkerSample, SampleBatch, SampleForm, SampledChannelInfo, SampledGroupInfo,
    };

    use super::*;
    use crate::{
        publish::{Publications, PublishedDevice, WantedKinds},
        viewer::TakeViewer,
    };

    const NAME: PublisherName = PublisherName { id: "test", title: "Test" };

    #[derive(Debug, Default)]
    struct Seen {
        devices: Vec<Option<f64>>,
        rows: Vec<u64>,
        samples: Vec<f32>,
        is_closed: bool,
        panics: bool,
    }

    #[derive(Debug, Clone, Default)]
    struct FakePublisher(Arc<Mutex<Seen>>);

    impl FakePublisher {
        fn seen(&self) -> MutexGuard<'_, Seen> {
            self.0.lock().unwrap_or_else(PoisonError::into_inner)
        }
    }

    impl LivePublisher for FakePublisher {
        fn address(&self) -> SocketAddr {
            ([127, 0, 0, 1], 7).into()
        }

        fn set_device(&mut self, device: Option<&PublishedDevice>) {
            self.seen().devices.push(device.map(|device| device.header.rate_hz));
        }

        fn wanted(&self) -> WantedKinds {
            WantedKinds { frames: true, samples: true }
        }

        fn wants_poses(&self) -> bool {
            true
        }

        fn frame(&mut self, _: &PublishedDevice, frame: &TappedFrame) {
            let mut seen = self.seen();
            assert!(!seen.panics, "as the test wants");
            seen.rows.push(frame.row);
        }

        fn samples(&mut self, _: &PublishedDevice, batch: &TappedBatch) {
            self.seen().samples.extend(&batch.samples);
        }

        fn exchange(&mut self, timeout: Duration) -> io::Result<()> {
            std::thread::sleep(timeout);
            Ok(())
        }

        fn take_news(&mut self) -> Vec<String> {
            Vec::new()
        }

        fn status(&self) -> PublishStatus {
            let frames_sent = self.seen().rows.len() as u64;
            PublishStatus { protocol: NAME.id.to_owned(), frames_sent, ..PublishStatus::default() }
        }

        fn close(self) {
            self.seen().is_closed = true;
        }
    }

    /// A device that was armed, with its tap passed on.
    fn arm(publications: &Publications, rate_hz: f64) -> (Intake, Pipeline) {
        let codec =
            Settings { kind: ResamplerKind::Lossless, tolerance: Tolerance::from_mm(1.0).unwrap() };
        let group = SampledGroupInfo {
            rate_millihertz: 1_000_000,
            channels: vec![SampledChannelInfo::default()],
            ..SampledGroupInfo::default()
        };
        let config = PipelineConfig {
            sampled: vec![group],
            publish_taps: publications.len(),
            ..PipelineConfig::new(codec, rate_hz, 1_000_000, Vec::new())
        };
        let header = header::new(&codec, rate_hz).unwrap();
        let (intake, pipeline, armed) = Pipeline::arm(&config, &header).unwrap();
        let device = PublishedDevice {
            progress: Arc::clone(pipeline.progress()),
            header,
            bodies: Vec::new(),
            sampled: config.sampled,
            plates: Vec::new(),
            subject: None,
        };
        publications.set_device(armed.publish_taps, &device);
        (intake, pipeline)
    }

    fn send(intake: &mut Intake, seq: u32) {
        let markers = [MarkerSample { id: 1, ..MarkerSample::default() }];
        let device_ticks = u64::from(seq) * 10_000;
        intake.samples(&SampleBatch {
            group: 0,
            number: seq,
            first: seq.into(),
            device_ticks,
            form: SampleForm::Int16,
            n_channels: 1,
            samples: &[seq as f32],
        });
        let frame = Frame { seq, device_ticks, timecode: None, markers: &markers };
        intake.frame(&frame, 1_000_000 + device_ticks * 1000);
    }

    fn wait_until(what: &str, is_so: impl Fn() -> bool) {
        let until = Instant::now() + Duration::from_secs(30);
        while !is_so() {
            assert!(Instant::now() < until, "not within 30 s: {what}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn a_publisher_gets_frames_and_samples_of_one_device_after_another() {
        let publications = Publications::new(&[NAME]);
        assert!(publications.feed(PublisherName { id: "other", ..NAME }).is_none());
        let (fake, control) = (FakePublisher::default(), TakeViewer::default());
        let (publisher, control): (_, Arc<dyn Control>) = (fake.clone(), Arc::new(control));
        let open = move || Ok(publisher.clone());
        let feed = publications.feed(NAME).unwrap();
        let running = start(feed, &control, ([127, 0, 0, 1], 0).into(), open).unwrap();
        assert_eq!(running.address().port(), 7);
        let mut pipelines = Vec::new();
        for (index, rate_hz) in [100.0, 50.0].into_iter().enumerate() {
            let (mut intake, pipeline) = arm(&publications, rate_hz);
            wait_until("the device", || fake.seen().devices.len() == index + 1);
            // What is wanted is asked for in the same turn.
            std::thread::sleep(POLL_STREAMING * 20);
            (0..20).for_each(|seq| send(&mut intake, seq));
            wait_until("the frames", || fake.seen().rows.len() == 20 * (index + 1));
            pipelines.push((intake, pipeline));
        }
        wait_until("the samples", || fake.seen().samples.len() == 40);
        assert_eq!(fake.seen().devices, [Some(100.0), Some(50.0)]);
        assert_eq!(fake.seen().rows, [(0..20).collect::<Vec<u64>>(), (0..20).collect()].concat());
        let is_counted = |status: PublishStatus| status.frames_sent == 40;
        wait_until("the report", || publications.status().into_iter().any(is_counted));
        for (intake, pipeline) in pipelines {
            drop(intake);
            pipeline.join().unwrap();
        }
        wait_until("the end of the device", || fake.seen().devices.last() == Some(&None));
        assert_eq!(publications.status()[0].frames_left_out, 0);
        running.close();
        assert!(fake.seen().is_closed && publications.status().is_empty());
    }

    #[test]
    fn a_publisher_that_fails_is_not_in_the_status_any_more() {
        let publications = Publications::new(&[NAME]);
        let fake = FakePublisher::default();
        let control: Arc<dyn Control> = Arc::new(TakeViewer::default());
        let publisher = fake.clone();
        let open = move || Ok(publisher.clone());
        let feed = publications.feed(NAME).unwrap();
        let running = start(feed, &control, ([127, 0, 0, 1], 0).into(), open).unwrap();
        let (mut intake, pipeline) = arm(&publications, 100.0);
        wait_until("the report", || !publications.status().is_empty());
        wait_until("the device", || !fake.seen().devices.is_empty());
        std::thread::sleep(POLL_STREAMING * 20);
        fake.seen().panics = true;
        send(&mut intake, 0);
        wait_until("the failure", || publications.status().is_empty());
        running.close();
        drop(intake);
        pipeline.join().unwrap();
    }
}
