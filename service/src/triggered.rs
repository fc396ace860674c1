//! Executes capture triggers that are received, and sends triggers for takes that start and stop here.

use std::{
    net::IpAddr,
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, SystemTime},
};

use crossbeam_channel::{after, never, select};
use mocapd_acquire::threads::{self, StopReceiver, StopSender};
use rustix::rand::{GetRandomFlags, getrandom};

use super::{
    control::{Control, EventFeed, Mark, RefusalKind, Request, Start},
    status::{ServiceEvent, ServiceEventKind},
    trigger::{
        Announcer, Capture, Listener, RateLimit, ReceivedTrigger, StopResult, TakeName, Trigger,
        TriggerQueue, first_packet_id,
        socket::{self, ListenerThread, TakeQueries, TriggerSender},
    },
};
use crate::config::TriggerConfig;

/// The threads that receive and send triggers.
#[derive(Debug)]
pub struct Triggers {
    listening: Option<ListenerThread>,
    stopper: StopSender,
    worker: JoinHandle<()>,
}

/// Executes triggers, and announces takes.
#[derive(Debug)]
struct Worker {
    control: Arc<dyn Control>,
    triggers: TriggerQueue,
    events: EventFeed,
    announcer: Announcer,
    sender: Option<TriggerSender>,
    /// The take that another program started: it is not announced, because that program has announced it.
    triggered: Option<TriggeredTake>,
    /// Limits messages about triggers without effect: a sender can send a thousand of them per second.
    rate_limit: RateLimit,
    stopped: StopReceiver,
}

/// The effect of a trigger, with its message.
#[derive(Debug)]
enum Outcome {
    /// A take started or stopped.
    Acted(String),
    /// Nothing changed.
    Nothing(String),
}

#[derive(Debug)]
struct TriggeredTake {
    take: String,
    by: IpAddr,
}

impl Triggers {
    /// Starts as configured; `None` if triggers are neither received nor sent.
    ///
    /// # Errors
    /// The address is unavailable, or the system refuses a thread or socket.
    pub fn open(
        config: &TriggerConfig,
        rig: &str,
        control: &Arc<dyn Control>,
    ) -> anyhow::Result<Option<Self>> {
        if config.listen.is_none() && config.send_to.is_empty() {
            return Ok(None);
        }
        let mut mark = [0; 8];
        getrandom(&mut mark, GetRandomFlags::empty())?;
        let mark = u64::from_le_bytes(mark);
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let triggers = TriggerQueue::default();
        let (stopper, stopped) = threads::stop_channel();
        let mut listening = None;
        if let Some(address) = config.listen {
            let [names, takes, notifier] = std::array::from_fn(|_| Arc::clone(control));
            let queries = TakeQueries {
                exists: Box::new(move |name| names.take_path(name).is_ok()),
                recording: Box::new(move || takes.status().take.map(|take| take.name)),
            };
            let report = move |text: &str| notifier.notify(ServiceEventKind::Trigger, text);
            let listener = Listener::new(config.allow_from.clone(), config.delay_max, mark);
            let socket = socket::bind(address)?;
            listening = Some(socket::listen(socket, listener, queries, triggers.clone(), report)?);
        }
        let send_to = config.send_to.clone();
        let sender = (!send_to.is_empty()).then(|| TriggerSender::new(send_to)).transpose()?;
        let worker = Worker {
            control: Arc::clone(control),
            triggers,
            events: control.events(),
            announcer: Announcer::new(rig, mark, first_packet_id(now.as_secs())),
            sender,
            triggered: None,
            rate_limit: RateLimit::default(),
            stopped,
        };
        let worker = threads::spawn("mocapd-triggered", move || worker.run())?;
        Ok(Some(Self { listening, stopper, worker }))
    }

    /// Stops receiving and sending.
    pub fn close(self) {
        drop(self.listening);
        drop(self.stopper);
        // A thread that panicked has reported it already.
        drop(self.worker.join());
    }
}

impl Worker {
    fn run(mut self) {
        while !self.stopped.is_stopped() {
            match self.triggers.take_due() {
                Some(received) => self.execute(&received),
                None => self.wait(),
            }
            self.announce();
        }
        // Announces the end of the take that was finished when the service stopped.
        self.announce();
    }

    /// Waits until a trigger arrives or is due, an event happens, or the thread has to stop.
    fn wait(&mut self) {
        let due = self.triggers.due_in().map_or_else(never, after);
        let event = select! {
            recv(self.events.events) -> event => event,
            recv(self.triggers.woken()) -> _ => return,
            recv(due) -> _ => return,
            recv(self.stopped.channel()) -> _ => return,
        };
        match event {
            Ok(event) => self.announce_event(&event),
            // The service is ending: there will be no more events, and this thread will be stopped soon.
            Err(_) => {
                self.stopped.channel().recv().ok();
            }
        }
    }

    fn execute(&mut self, received: &ReceivedTrigger) {
        let note = received.trigger.note(received.from.ip());
        let outcome = match &received.trigger {
            Trigger::Start(start) => self.start(start, received.sender(), &note),
            Trigger::Stop(stop) => self.stop(stop, received, &note),
            Trigger::Complete(_) => Outcome::Nothing(note),
        };
        let message = match outcome {
            Outcome::Acted(message) => Some(message),
            Outcome::Nothing(message) => self.rate_limit.admit(&message, self.triggers.now()),
        };
        if let Some(message) = message {
            self.control.notify(ServiceEventKind::Trigger, &message);
        }
    }

    fn start(&mut self, start: &Capture, by: IpAddr, note: &str) -> Outcome {
        let name = start.name.as_ref().map(|name| name.text().to_owned());
        let start = Start { name, notes: Some(note.to_owned()), ..Start::default() };
        match self.control.start(&start) {
            Ok(started) => {
                let message = format!("{note}: recording {}", started.name);
                self.triggered = Some(TriggeredTake { take: started.name, by });
                Outcome::Acted(message)
            }
            Err(refusal) => Outcome::Nothing(format!("{note}: not started: {refusal}")),
        }
    }

    fn stop(&self, stop: &Capture, received: &ReceivedTrigger, note: &str) -> Outcome {
        let name = stop.name.as_ref().map(TakeName::text);
        let was_recording = received.recording.as_deref();
        let recording = self.control.status().take.map(|take| take.name);
        // A stop that matches no take in progress may mean a start that is still pending.
        let cancel = |otherwise: String| match self.triggers.cancel_starts(received.from, name) {
            0 => Outcome::Nothing(format!("{note}: {otherwise}")),
            n => Outcome::Acted(format!("{note}: delayed starts cancelled: {n}")),
        };
        let Some(recording) = recording.as_deref() else {
            return cancel(match was_recording {
                Some(was) => format!("{was} had already ended"),
                None => "no take is being recorded".to_owned(),
            });
        };
        if name.is_some_and(|name| name != recording) {
            return cancel(format!("another take, {recording}, is being recorded and continues"));
        }
        // Without a name, a stop means the take that was being recorded when it arrived, not a later one. If there was
        // none, it can only mean a start by the same sender that arrived earlier and was not executed yet.
        match was_recording.filter(|_| name.is_none()) {
            Some(was) if was != recording => {
                return Outcome::Nothing(format!("{note}: {was} had already ended"));
            }
            None if name.is_none() && !self.is_started_by(recording, received.sender()) => {
                let goes_on =
                    format!("no take was being recorded when it arrived; {recording} continues");
                return cancel(goes_on);
            }
            _ => {}
        }
        // A take that cannot be marked can still be stopped.
        self.control.mark(&Mark { text: note.to_owned(), ..Mark::default() }).ok();
        match self.control.stop(&Request::default()) {
            Ok(stopped) => Outcome::Acted(format!("{note}: stopped {}", stopped.name)),
            Err(refusal) if refusal.kind == RefusalKind::Conflict => {
                Outcome::Nothing(format!("{note}: the take had already ended"))
            }
            // The take may have ended with a loss, which must not be missing from the log.
            Err(refusal) => Outcome::Acted(format!("{note}: not stopped: {refusal}")),
        }
    }

    fn is_started_by(&self, take: &str, sender: IpAddr) -> bool {
        self.triggered.as_ref().is_some_and(|started| started.take == take && started.by == sender)
    }

    fn announce(&mut self) {
        while let Some(event) = self.events.next(Duration::ZERO) {
            self.announce_event(&event);
        }
    }

    fn announce_event(&mut self, event: &ServiceEvent) {
        let Some(name) = event.take.as_deref() else { return };
        if self.triggered.as_ref().is_some_and(|started| started.take == name) {
            return;
        }
        for datagram in self.datagrams(event, name) {
            let failed = self.sender.as_ref().map(|sender| sender.send(&datagram));
            for message in failed.unwrap_or_default() {
                self.control.notify(ServiceEventKind::Warning, &message);
            }
        }
    }

    fn datagrams(&mut self, event: &ServiceEvent, name: &str) -> Vec<Vec<u8>> {
        let Some(name) = TakeName::of(name) else { return Vec::new() };
        let Self { announcer, sender: Some(_), .. } = self else { return Vec::new() };
        match event.kind {
            ServiceEventKind::TakeStarted => {
                vec![announcer.start(&name, event.notes.as_deref().unwrap_or_default())]
            }
            ServiceEventKind::TakeStopped => {
                vec![announcer.stop(&name, &StopResult::Success), announcer.complete(&name)]
            }
            ServiceEventKind::Failure => vec![announcer.stop(&name, &StopResult::Fail)],
            _ => Vec::new(),
        }
    }
}
