//! What was left out is told, by a thread that may wait for the journal.

use std::{
    sync::Arc,
    thread::JoinHandle,
    time::{Duration, Instant},
};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use mocapd_acquire::threads;
use mocapd_take::escape::visible;

use super::gate::{Gate, SUMMARY};

/// How often what was left out is looked at.
const SUM_UP_EVERY: Duration = Duration::from_secs(5);

/// The thread. Dropping it tells what is left.
#[derive(Debug)]
pub(super) struct Running {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
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
    let (stop, stopped) = bounded::<()>(1);
    // A subscriber that holds for this thread alone holds for the new one, too: so it is in tests.
    let dispatch = tracing::dispatcher::get_default(Clone::clone);
    let thread = threads::spawn("mocapd-log", move || {
        tracing::dispatcher::with_default(&dispatch, || run(&gate, &stopped));
    })?;
    Ok(Running { stop: Some(stop), thread: Some(thread) })
}

fn run(gate: &Gate, stopped: &Receiver<()>) {
    while stopped.recv_timeout(SUM_UP_EVERY) == Err(RecvTimeoutError::Timeout) {
        sum_up(gate, false);
    }
    sum_up(gate, true);
}

fn sum_up(gate: &Gate, all: bool) {
    for (n, sample) in gate.left_out(Instant::now(), all) {
        tracing::warn!(target: SUMMARY, left_out = n, "{n} more like this were left out: {}", visible(&sample));
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
    use crate::log::{Level, gate, lines};

    #[derive(Debug, Clone, Default)]
    struct Memory(Arc<Mutex<Vec<u8>>>);

    impl Write for Memory {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
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
    fn logged(level: Level, scene: impl FnOnce(&Gate)) -> String {
        let (memory, gate) = (Memory::default(), Arc::new(Gate::new(level)));
        let registry = tracing_subscriber::registry()
            .with(lines(memory.clone()))
            .with(gate::Layer(Arc::clone(&gate)));
        tracing::subscriber::with_default(registry, || {
            let _running = start(Arc::clone(&gate)).unwrap();
            scene(&gate);
        });
        String::from_utf8(memory.0.lock().unwrap().clone()).unwrap()
    }

    #[test]
    fn words_come_with_their_fields_and_by_level() {
        let text = logged(Level::Info, |_| {
            tracing::info!(take = "jump.take", device = "usb:1209:0001", "a take has begun");
            tracing::debug!("nobody asked");
        });
        let line = text.lines().find(|line| line.contains("a take has begun")).unwrap();
        assert!(line.contains("take=\"jump.take\" device=\"usb:1209:0001\""), "{line}");
        assert!(!text.contains("nobody asked"), "{text}");
    }

    #[test]
    fn the_level_can_change() {
        let text = logged(Level::Error, |gate| {
            tracing::debug!("before");
            gate.set_level(Level::Debug);
            tracing::debug!("after");
        });
        assert!(!text.contains("before") && text.contains("after"), "{text}");
    }

    #[test]
    fn what_is_said_again_and_again_is_counted_and_told() {
        let text = logged(Level::Info, |_| {
            for n in 0..50 {
                tracing::warn!("the device stalled {n} times");
            }
        });
        assert_eq!(text.matches("WARN the device stalled").count(), 10, "{text}");
        assert!(text.contains("40 more like this were left out: the device stalled"), "{text}");
    }
}
