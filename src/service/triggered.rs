//! Capture triggers at work: those that are heard start and stop takes, and our starts and stops are told.

use std::{
    net::IpAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, SystemTime},
};

use rustix::rand::{GetRandomFlags, getrandom};

use super::{
    control::{Control, EventFeed, Mark, RefusalKind, Request, Start},
    status::ServiceEvent,
    trigger::{
        self, Announcer, Listener, Queue, Received, StopResult, TakeName, Trigger, first_packet_id,
        socket::{self, Questions, Teller},
    },
};
use crate::{config::TriggerConfig, threads};

/// Between two looks at what happened, and whether it is over. A trigger is carried out when it is due, without one.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// The threads that hear and tell.
#[derive(Debug)]
pub struct Triggers {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

/// Who carries out what is heard.
#[derive(Debug)]
struct Worker {
    control: Arc<dyn Control>,
    triggers: Queue,
    events: EventFeed,
    announcer: Announcer,
    teller: Option<Teller>,
    /// The take that another program started, which need not be told of it.
    triggered: Option<Triggered>,
    stop: Arc<AtomicBool>,
}

#[derive(Debug)]
struct Triggered {
    take: String,
    by: IpAddr,
}

impl Triggers {
    /// As configured; `None` where nothing is to be heard or told.
    ///
    /// # Errors
    /// When the address cannot be listened on, or the system gives no thread or socket.
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
        let triggers = Queue::default();
        let stop = Arc::new(AtomicBool::new(false));
        let mut threads = Vec::new();
        if let Some(address) = config.listen {
            let (names, takes, words) =
                (Arc::clone(control), Arc::clone(control), Arc::clone(control));
            let questions = Questions {
                exists: Box::new(move |name| names.take_path(name).is_ok()),
                recording: Box::new(move || takes.status().take.map(|take| take.name)),
            };
            let say = move |text: &str| words.tell("trigger", text);
            let listener = Listener::new(config.allow_from.clone(), config.delay_max, mark);
            let socket = socket::bind(address)?;
            let (queue, stop) = (triggers.clone(), Arc::clone(&stop));
            threads.push(socket::listen(socket, listener, questions, queue, say, stop)?);
        }
        let teller = match config.send_to.is_empty() {
            true => None,
            false => Some(Teller::new(config.send_to.clone())?),
        };
        let worker = Worker {
            control: Arc::clone(control),
            triggers,
            events: control.events(),
            announcer: Announcer::new(rig, mark, first_packet_id(now.as_secs())),
            teller,
            triggered: None,
            stop: Arc::clone(&stop),
        };
        threads.push(threads::spawn("mocapd-triggered", move || worker.run())?);
        Ok(Some(Self { stop, threads }))
    }

    /// Hears and tells no more.
    pub fn close(self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            // A thread that panicked has told so already.
            drop(thread.join());
        }
    }
}

impl Worker {
    fn run(mut self) {
        while !self.stop.load(Ordering::Relaxed) {
            if let Some(received) = self.triggers.next(LOOK_EVERY) {
                self.carry_out(&received);
            }
            self.announce();
        }
        // The end of the take that was finished when the service stopped.
        self.announce();
    }

    fn carry_out(&mut self, received: &Received) {
        let note = received.trigger.note(received.from.ip());
        let words = match &received.trigger {
            Trigger::Start(start) => self.start(start, received.sender(), &note),
            Trigger::Stop(stop) => self.stop(stop, received, &note),
            Trigger::Complete(_) => note,
        };
        self.control.tell("trigger", &words);
    }

    fn start(&mut self, start: &trigger::Start, by: IpAddr, note: &str) -> String {
        let name = start.name.as_ref().map(|name| name.text().to_owned());
        let start = Start { name, notes: Some(note.to_owned()), ..Start::default() };
        match self.control.start(&start) {
            Ok(started) => {
                let words = format!("{note}: recording {}", started.name);
                self.triggered = Some(Triggered { take: started.name, by });
                words
            }
            Err(refusal) => format!("{note}: not started: {refusal}"),
        }
    }

    fn stop(&self, stop: &trigger::Stop, received: &Received, note: &str) -> String {
        let name = stop.name.as_ref().map(TakeName::text);
        let was_recording = received.recording.as_deref();
        let recording = self.control.status().take.map(|take| take.name);
        let Some(recording) = recording.as_deref() else {
            return match (self.triggers.cancel_starts(received.from, name), was_recording) {
                (0, Some(was)) => format!("{note}: {was} was over already"),
                (0, None) => format!("{note}: no take is being recorded"),
                (n, _) => format!("{note}: starts that waited, now cancelled: {n}"),
            };
        };
        if name.is_some_and(|name| name != recording) {
            return match self.triggers.cancel_starts(received.from, name) {
                0 => format!("{note}: another take is being recorded, {recording}: it goes on"),
                n => format!("{note}: starts that waited, now cancelled: {n}"),
            };
        }
        // Without a name the take is meant that was being recorded when the trigger came, and no later one. Where there
        // was none, its sender can only mean a start of its own, which came before it and was not carried out yet.
        match was_recording.filter(|_| name.is_none()) {
            Some(was) if was != recording => return format!("{note}: {was} was over already"),
            None if name.is_none() && !self.is_started_by(recording, received.sender()) => {
                return match self.triggers.cancel_starts(received.from, name) {
                    0 => format!(
                        "{note}: no take was being recorded when it came: {recording} goes on"
                    ),
                    n => format!("{note}: starts that waited, now cancelled: {n}"),
                };
            }
            _ => {}
        }
        // A take that cannot be marked can be stopped.
        self.control.mark(&Mark { text: note.to_owned(), ..Mark::default() }).ok();
        match self.control.stop(&Request::default()) {
            Ok(stopped) => format!("{note}: stopped {}", stopped.name),
            Err(refusal) if refusal.kind == RefusalKind::Conflict => {
                format!("{note}: it was over already")
            }
            Err(refusal) => format!("{note}: not stopped: {refusal}"),
        }
    }

    fn is_started_by(&self, take: &str, sender: IpAddr) -> bool {
        self.triggered.as_ref().is_some_and(|started| started.take == take && started.by == sender)
    }

    fn announce(&mut self) {
        while let Some(event) = self.events.next(Duration::ZERO) {
            let Some(name) = event.take.as_deref() else { continue };
            if self.triggered.as_ref().is_some_and(|started| started.take == name) {
                continue;
            }
            for datagram in self.datagrams(&event, name) {
                let failed = self.teller.as_ref().map(|teller| teller.tell(&datagram));
                for words in failed.unwrap_or_default() {
                    self.control.tell("warning", &words);
                }
            }
        }
    }

    fn datagrams(&mut self, event: &ServiceEvent, name: &str) -> Vec<Vec<u8>> {
        let Some(name) = TakeName::of(name) else { return Vec::new() };
        let Self { announcer, teller: Some(_), .. } = self else { return Vec::new() };
        match event.kind.as_str() {
            "take-started" => {
                vec![announcer.start(&name, event.notes.as_deref().unwrap_or_default())]
            }
            "take-stopped" => {
                vec![announcer.stop(&name, &StopResult::Success), announcer.complete(&name)]
            }
            "failure" => vec![announcer.stop(&name, &StopResult::Fail)],
            _ => Vec::new(),
        }
    }
}
