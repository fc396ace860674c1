//! An in-memory transport: each end reads the bytes that the other writes.

use std::{
    collections::VecDeque,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use mocapd_drivers::transport::{READ_TIMEOUT, Transport, TransportError, WRITE_TIMEOUT};

const NAME: &str = "memory";

/// One end of an in-memory line. Dropping it unplugs it: the other end reads the remaining bytes, then `Disconnected`.
#[derive(Debug)]
pub struct MemoryTransport {
    incoming: Arc<Pipe>,
    outgoing: Arc<Pipe>,
}

/// Creates both ends of a line that buffers `capacity_bytes` in each direction; a writer waits when the buffer is full.
#[must_use]
pub fn pair(capacity_bytes: usize) -> (MemoryTransport, MemoryTransport) {
    let there = Arc::new(Pipe::new(capacity_bytes));
    let back = Arc::new(Pipe::new(capacity_bytes));
    (
        MemoryTransport { incoming: Arc::clone(&back), outgoing: Arc::clone(&there) },
        MemoryTransport { incoming: there, outgoing: back },
    )
}

#[derive(Debug)]
struct Pipe {
    capacity_bytes: usize,
    state: Mutex<PipeState>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct PipeState {
    bytes: VecDeque<u8>,
    closed: bool,
}

impl Pipe {
    fn new(capacity_bytes: usize) -> Self {
        Self { capacity_bytes, state: Mutex::default(), changed: Condvar::new() }
    }

    /// Ignores poisoning: a panic elsewhere leaves the queue consistent, because no step under the lock can panic.
    fn lock(&self) -> MutexGuard<'_, PipeState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }
}

impl Drop for MemoryTransport {
    fn drop(&mut self) {
        self.incoming.close();
        self.outgoing.close();
    }
}

fn disconnected() -> TransportError {
    TransportError::Disconnected { device: NAME.to_owned() }
}

impl Transport for MemoryTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let pipe = &self.incoming;
        let waiting = |state: &mut PipeState| state.bytes.is_empty() && !state.closed;
        let (mut state, _) = pipe
            .changed
            .wait_timeout_while(pipe.lock(), READ_TIMEOUT, waiting)
            .unwrap_or_else(PoisonError::into_inner);
        if state.bytes.is_empty() {
            return if state.closed { Err(disconnected()) } else { Ok(0) };
        }
        let n = buf.len().min(state.bytes.len());
        for (to, from) in buf.iter_mut().zip(state.bytes.drain(..n)) {
            *to = from;
        }
        drop(state);
        pipe.changed.notify_all();
        Ok(n)
    }

    fn write_all(&mut self, mut bytes: &[u8]) -> Result<(), TransportError> {
        let pipe = &self.outgoing;
        let give_up_at = Instant::now() + WRITE_TIMEOUT;
        while !bytes.is_empty() {
            let full =
                |state: &mut PipeState| state.bytes.len() >= pipe.capacity_bytes && !state.closed;
            let left = give_up_at.saturating_duration_since(Instant::now());
            let (mut state, waited) = pipe
                .changed
                .wait_timeout_while(pipe.lock(), left, full)
                .unwrap_or_else(PoisonError::into_inner);
            if state.closed {
                return Err(disconnected());
            }
            if waited.timed_out() {
                return Err(TransportError::Stuck { device: NAME.to_owned() });
            }
            let room = pipe.capacity_bytes - state.bytes.len();
            let (now, later) = bytes.split_at(room.min(bytes.len()));
            state.bytes.extend(now);
            bytes = later;
            drop(state);
            pipe.changed.notify_all();
        }
        Ok(())
    }

    fn line_bytes_per_s(&self) -> Option<u64> {
        None
    }

    fn describe(&self) -> String {
        NAME.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_all(from: &mut MemoryTransport, n: usize) -> Vec<u8> {
        let mut got = Vec::new();
        let mut buf = [0; 7];
        while got.len() < n {
            let n = from.read(&mut buf).unwrap();
            got.extend_from_slice(&buf[..n]);
        }
        got
    }

    #[test]
    fn carries_more_than_it_holds() {
        let (mut a, mut b) = pair(16);
        let sent: Vec<u8> = (0..=255).collect();
        let expected = sent.clone();
        let writer =
            std::thread::Builder::new().spawn(move || a.write_all(&sent).map(|()| a)).unwrap();
        assert_eq!(read_all(&mut b, 256), expected);
        writer.join().unwrap().unwrap();
    }

    #[test]
    fn a_read_without_bytes_succeeds_and_an_unplugged_end_fails() {
        let (mut a, mut b) = pair(16);
        assert_eq!(b.read(&mut [0; 4]).unwrap(), 0);
        a.write_all(b"last").unwrap();
        drop(a);
        assert_eq!(read_all(&mut b, 4), b"last");
        assert!(matches!(b.read(&mut [0; 4]), Err(TransportError::Disconnected { .. })));
        assert!(matches!(b.write_all(b"x"), Err(TransportError::Disconnected { .. })));
    }

    #[test]
    fn a_write_without_a_reader_times_out() {
        let (mut a, _b) = pair(4);
        let error = a.write_all(b"too long").unwrap_err();
        assert!(matches!(error, TransportError::Stuck { .. }), "{error}");
    }
}
