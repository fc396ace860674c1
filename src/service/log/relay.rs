//! Words from threads that must not wait, said by one that may; and what was left out.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, Sender, bounded};

use super::{
    Level,
    gate::{Gate, SUMMARY},
};
use crate::threads;

/// A reader says at most some ten things at once (its notes of one read); a journal that stalls for longer than these
/// fill up costs words, which are counted, and no frame.
const WAITING_MAX: usize = 64;

/// How often what was left out is looked at.
const SUM_UP_EVERY: Duration = Duration::from_secs(5);

#[derive(Debug)]
struct Words {
    level: Level,
    text: String,
    take: Option<String>,
    device: Option<String>,
}

/// Takes words and returns at once.
#[derive(Debug, Clone)]
pub struct Relay {
    queue: Sender<Words>,
    dropped: Arc<AtomicU64>,
}

impl Relay {
    /// Says something of a take and a device, as far as there are any.
    pub fn say(&self, level: Level, text: &str, take: Option<&str>, device: Option<&str>) {
        let words = Words {
            level,
            text: text.to_owned(),
            take: take.map(str::to_owned),
            device: device.map(str::to_owned),
        };
        if self.queue.try_send(words).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The thread that says them.
#[derive(Debug)]
pub(super) struct Running {
    relay: Relay,
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    pub(super) fn relay(&self) -> Relay {
        self.relay.clone()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

pub(super) fn start(gate: Arc<Gate>) -> anyhow::Result<Running> {
    let (queue, words) = bounded(WAITING_MAX);
    let (stop, stopped) = bounded::<()>(1);
    let relay = Relay { queue, dropped: Arc::default() };
    let dropped = Arc::clone(&relay.dropped);
    // A subscriber that holds for this thread alone holds for the new one, too: so it is in tests.
    let dispatch = tracing::dispatcher::get_default(Clone::clone);
    let thread = threads::spawn("mocapd-log", move || {
        tracing::dispatcher::with_default(&dispatch, || run(&gate, &words, &stopped, &dropped));
    })?;
    Ok(Running { relay, stop: Some(stop), thread: Some(thread) })
}

fn run(gate: &Gate, words: &Receiver<Words>, stopped: &Receiver<()>, dropped: &AtomicU64) {
    let mut summed_up = Instant::now();
    loop {
        crossbeam_channel::select! {
            recv(words) -> words => if let Ok(words) = words { say(&words) },
            recv(stopped) -> _ => {
                words.try_iter().for_each(|words| say(&words));
                sum_up(gate, dropped, true);
                return;
            }
            default(SUM_UP_EVERY) => {}
        }
        if summed_up.elapsed() >= SUM_UP_EVERY {
            sum_up(gate, dropped, false);
            summed_up = Instant::now();
        }
    }
}

fn say(words: &Words) {
    let Words { level, text, take, device } = words;
    let (take, device) = (take.as_deref(), device.as_deref());
    match level {
        Level::Error => tracing::error!(take, device, "{text}"),
        Level::Warn => tracing::warn!(take, device, "{text}"),
        Level::Info => tracing::info!(take, device, "{text}"),
        Level::Debug => tracing::debug!(take, device, "{text}"),
        Level::Trace => tracing::trace!(take, device, "{text}"),
    }
}

fn sum_up(gate: &Gate, dropped: &AtomicU64, all: bool) {
    for (n, sample) in gate.left_out(Instant::now(), all) {
        tracing::warn!(target: SUMMARY, left_out = n, "{n} more like this were left out: {sample}");
    }
    let n = dropped.swap(0, Ordering::Relaxed);
    if n > 0 {
        tracing::warn!(target: SUMMARY, left_out = n, "{n} messages were left out: the log did not take them in time");
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io::{self, Write},
        sync::Mutex,
    };

    use tracing_subscriber::{fmt::MakeWriter, layer::SubscriberExt};

    use super::*;
    use crate::service::log::{gate, lines};

    /// Lines into memory, by a writer that may be held up.
    #[derive(Debug, Clone, Default)]
    struct Memory {
        bytes: Arc<Mutex<Vec<u8>>>,
    }

    impl Memory {
        fn text(&self) -> String {
            String::from_utf8(self.bytes.lock().unwrap().clone()).unwrap()
        }
    }

    impl Write for Memory {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.bytes.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl<'a> MakeWriter<'a> for Memory {
        type Writer = Self;

        fn make_writer(&'a self) -> Self {
            self.clone()
        }
    }

    /// Runs `scene` with a log, and gives what it wrote until it ended.
    fn logged(level: Level, scene: impl FnOnce(&Relay, &Gate, &Memory)) -> String {
        let (memory, gate) = (Memory::default(), Arc::new(Gate::new(level)));
        let registry = tracing_subscriber::registry()
            .with(lines(memory.clone()))
            .with(gate::Layer(Arc::clone(&gate)));
        tracing::subscriber::with_default(registry, || {
            let running = start(Arc::clone(&gate)).unwrap();
            scene(&running.relay(), &gate, &memory);
        });
        memory.text()
    }

    #[test]
    fn words_come_with_their_fields_and_by_level() {
        let text = logged(Level::Info, |relay, _, _| {
            relay.say(Level::Info, "a take has begun", Some("jump.take"), Some("usb:1209:0001"));
            relay.say(Level::Debug, "nobody asked", None, None);
            tracing::warn!(take = "run.take", "said directly");
        });
        let line = text.lines().find(|line| line.contains("a take has begun")).unwrap();
        assert!(line.contains("take=\"jump.take\" device=\"usb:1209:0001\""), "{line}");
        assert!(text.contains("WARN said directly take=\"run.take\""), "{text}");
        assert!(!text.contains("nobody asked"), "{text}");
    }

    #[test]
    fn the_level_can_change() {
        let text = logged(Level::Error, |_, gate, _| {
            tracing::debug!("before");
            gate.set_level(Level::Debug);
            tracing::debug!("after");
        });
        assert!(!text.contains("before") && text.contains("after"), "{text}");
    }

    #[test]
    fn what_is_said_again_and_again_is_counted_and_told() {
        let text = logged(Level::Info, |relay, _, _| {
            for n in 0..50 {
                relay.say(Level::Warn, &format!("the device stalled {n} times"), None, None);
                while !relay.queue.is_empty() {
                    std::thread::yield_now();
                }
            }
        });
        assert_eq!(text.matches("WARN the device stalled").count(), 10, "{text}");
        assert!(text.contains("40 more like this were left out: the device stalled"), "{text}");
    }

    #[test]
    fn a_log_that_stalls_holds_nobody_up_and_says_what_it_did_not_take() {
        let began = Instant::now();
        let text = logged(Level::Info, |relay, _, memory| {
            let stalled = memory.bytes.lock().unwrap();
            relay.say(Level::Info, "first", None, None);
            while !relay.queue.is_empty() {
                std::thread::yield_now();
            }
            for n in 0..WAITING_MAX + 36 {
                relay.say(Level::Info, &"x".repeat(n), None, None);
            }
            assert!(began.elapsed() < Duration::from_secs(5), "held up");
            drop(stalled);
        });
        assert!(
            text.contains("36 messages were left out: the log did not take them in time"),
            "{text}"
        );
    }
}
