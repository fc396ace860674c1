//! Capture triggers at work: those that are heard start and stop takes, and our starts and stops are told.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant, SystemTime},
};

use crossbeam_channel::{Receiver, RecvTimeoutError};
use rustix::rand::{GetRandomFlags, getrandom};

use super::{
    control::{Control, EventFeed, Mark, RefusalKind, Request, Start},
    status::ServiceEvent,
    trigger::{
        Announcer, Listener, StopResult, TakeName, Trigger, first_packet_id,
        socket::{self, Received, Teller},
    },
};
use crate::{config::TriggerConfig, threads};

/// Between two looks at what happened, and whether it is over.
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
    triggers: Receiver<Received>,
    events: EventFeed,
    announcer: Announcer,
    teller: Option<Teller>,
    /// The take that another program started: it need not be told of it.
    triggered: Option<String>,
    stop: Arc<AtomicBool>,
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
        let (heard, triggers) = socket::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let mut threads = Vec::new();
        if let Some(address) = config.listen {
            if config.allow_from.is_empty() {
                control.tell(
                    "warning",
                    &format!(
                        "triggers on {address} are taken from everybody: trigger.allow_from narrows it"
                    ),
                );
            }
            let names = Arc::clone(control);
            let exists = move |name: &str| names.take_path(name).is_ok();
            let words = Arc::clone(control);
            let say = move |text: &str| words.tell("trigger", text);
            let listener = Listener::new(config.allow_from.clone(), mark);
            let socket = socket::bind(address)?;
            let stop = Arc::clone(&stop);
            threads.push(socket::listen(socket, listener, exists, heard, say, stop)?);
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
            match self.triggers.recv_timeout(LOOK_EVERY) {
                Ok(received) => self.carry_out(&received),
                Err(RecvTimeoutError::Timeout) => {}
                // Nobody listens: there is only to tell.
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(LOOK_EVERY),
            }
            self.announce();
        }
        // The end of the take that was finished when the service stopped.
        self.announce();
    }

    fn carry_out(&mut self, Received { from, trigger }: &Received) {
        let note = trigger.note(from.ip());
        match trigger {
            Trigger::Start(start) => {
                self.wait(start.delay);
                let name = start.name.as_ref().map(|name| name.text().to_owned());
                let start = Start { name, notes: Some(note.clone()), ..Start::default() };
                match self.control.start(&start) {
                    Ok(started) => {
                        self.control
                            .tell("trigger", &format!("{note}: recording {}", started.name));
                        self.triggered = Some(started.name);
                    }
                    Err(refusal) => {
                        self.control.tell("trigger", &format!("{note}: not started: {refusal}"));
                    }
                }
            }
            Trigger::Stop(stop) => {
                let recording = self.control.status().take.map(|take| take.name);
                let Some(recording) = recording else {
                    self.control.tell("trigger", &format!("{note}: no take is being recorded"));
                    return;
                };
                if stop.name.as_ref().is_some_and(|name| name.text() != recording) {
                    let words =
                        format!("{note}: another take is being recorded, {recording}: it goes on");
                    self.control.tell("trigger", &words);
                    return;
                }
                self.wait(stop.delay);
                if self.control.status().take.is_none_or(|take| take.name != recording) {
                    self.control.tell("trigger", &format!("{note}: {recording} was over already"));
                    return;
                }
                // A take that cannot be marked can be stopped.
                self.control.mark(&Mark { text: note.clone(), ..Mark::default() }).ok();
                let words = match self.control.stop(&Request::default()) {
                    Ok(stopped) => format!("{note}: stopped {}", stopped.name),
                    Err(refusal) if refusal.kind == RefusalKind::Conflict => {
                        format!("{note}: it was over already")
                    }
                    Err(refusal) => format!("{note}: not stopped: {refusal}"),
                };
                self.control.tell("trigger", &words);
            }
            Trigger::Complete(_) => self.control.tell("trigger", &note),
        }
    }

    /// A delay that was asked for, at most [`DELAY_MAX`](super::trigger::DELAY_MAX).
    fn wait(&self, delay: Duration) {
        let until = Instant::now() + delay;
        while !self.stop.load(Ordering::Relaxed) {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            std::thread::sleep(left.min(LOOK_EVERY));
        }
    }

    fn announce(&mut self) {
        while let Some(event) = self.events.next(Duration::ZERO) {
            let Some(name) = event.take.as_deref() else { continue };
            if self.triggered.as_deref() == Some(name) {
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
