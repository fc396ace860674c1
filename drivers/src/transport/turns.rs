//! Lines on which the host has to speak first, again and again.
//!
//! Whoever reads a device calls [`Transport::read`] and gives the bytes to a
//! [`Protocol`](crate::device::Protocol); it writes only what people ask for. A device that must be
//! polled needs more: a request after every answer, at the right time, and on a serial line a break
//! or another speed now and then. Its protocol leaves such [`Order`]s on a [`Desk`], and a
//! [`TurnTransport`] around the line carries them out at the beginning of the next read, which
//! follows at once. It also tells the protocol the time, so that the protocol needs no clock.
//!
//! Both ends live on the reader's thread: the queue between them is never waited for.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use super::{READ_TIMEOUT, Transport, TransportError};

/// Orders that are kept: a protocol leaves at most a few between two reads, say a break, a speed
/// and a request.
pub const ORDERS_MAX: usize = 8;

/// Bytes of a request. The longest of the families at hand takes 60.
pub const REQUEST_BYTES_MAX: usize = 96;

/// How long a device may take to confirm a farewell.
const FAREWELL_WITHIN: Duration = Duration::from_millis(100);

/// Bytes that are written whole, without memory of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    bytes: [u8; REQUEST_BYTES_MAX],
    len: usize,
}

impl Default for Request {
    fn default() -> Self {
        Self { bytes: [0; REQUEST_BYTES_MAX], len: 0 }
    }
}

impl Request {
    /// `None` when it is longer than [`REQUEST_BYTES_MAX`].
    #[must_use]
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let mut kept = [0; REQUEST_BYTES_MAX];
        kept.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(Self { bytes: kept, len: bytes.len() })
    }

    /// The bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

/// What a line is to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Order {
    /// Write a request, not before the desk's clock says so.
    Write {
        /// The bytes.
        request: Request,
        /// On the clock of [`Desk::now_ns`].
        not_before_ns: u64,
    },
    /// Send a break.
    Break,
    /// Change the speed.
    Baud(u32),
    /// What to write when the line is closed, so that the next host finds the device as this one
    /// did; it replaces an earlier farewell.
    Farewell(Vec<Request>),
    /// End the session: the next read fails with these words.
    Fail(String),
}

/// The protocol's end.
#[derive(Debug)]
pub struct Desk {
    orders: SyncSender<Order>,
    now_ns: Arc<AtomicU64>,
}

impl Desk {
    /// Nanoseconds since the line was opened, when it was last read.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.now_ns.load(Ordering::Relaxed)
    }

    /// `false` when the queue is full, or the line gone: nothing was ordered then.
    pub fn order(&self, order: Order) -> bool {
        self.orders.try_send(order).is_ok()
    }
}

/// The line's end.
#[derive(Debug)]
pub struct Orders {
    orders: Receiver<Order>,
    now_ns: Arc<AtomicU64>,
}

impl Orders {
    /// The next one.
    pub fn next_order(&self) -> Option<Order> {
        self.orders.try_recv().ok()
    }

    /// Tells the protocol the time.
    pub fn set_now_ns(&self, now_ns: u64) {
        self.now_ns.store(now_ns, Ordering::Relaxed);
    }
}

/// A desk, and the orders left on it.
#[must_use]
pub fn desk() -> (Desk, Orders) {
    let (sender, receiver) = sync_channel(ORDERS_MAX);
    let now_ns = Arc::new(AtomicU64::new(0));
    (Desk { orders: sender, now_ns: Arc::clone(&now_ns) }, Orders { orders: receiver, now_ns })
}

/// A line that carries out orders before it reads.
#[derive(Debug)]
pub struct TurnTransport {
    line: Box<dyn Transport>,
    orders: Orders,
    opened: Instant,
    /// Whose time has not come.
    held: Option<Order>,
    farewell: Vec<Request>,
}

impl TurnTransport {
    /// A line around `line`.
    #[must_use]
    pub fn new(line: Box<dyn Transport>, orders: Orders) -> Self {
        Self { line, orders, opened: Instant::now(), held: None, farewell: Vec::new() }
    }

    fn tell_time(&self) -> u64 {
        let now_ns = u64::try_from(self.opened.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.orders.set_now_ns(now_ns);
        now_ns
    }

    /// `false` when the next order's time has not come within a read's patience.
    fn carry_out(&mut self) -> Result<bool, TransportError> {
        // As many as there can be: a protocol gets no turn in between.
        for _ in 0..=ORDERS_MAX {
            let Some(order) = self.held.take().or_else(|| self.orders.next_order()) else { break };
            match order {
                Order::Write { request, not_before_ns } => {
                    let early_ns = not_before_ns.saturating_sub(self.tell_time());
                    let patience_ns = READ_TIMEOUT.as_nanos() as u64;
                    thread::sleep(Duration::from_nanos(early_ns.min(patience_ns)));
                    if early_ns > patience_ns {
                        self.held = Some(order);
                        return Ok(false);
                    }
                    self.line.write_all(request.as_bytes())?;
                }
                Order::Break => drop(self.line.send_break()?),
                Order::Baud(baud) => match self.line.set_baud(baud) {
                    // What is asked at the old speed is not answered, and the search goes on.
                    Ok(()) | Err(TransportError::Refused(_)) => {}
                    Err(error) => return Err(error),
                },
                Order::Farewell(farewell) => self.farewell = farewell,
                Order::Fail(words) => return Err(TransportError::Refused(words)),
            }
        }
        Ok(true)
    }

    /// Says goodbye, waiting a moment for each answer: a port that is closed at once may drop what
    /// it has not sent.
    fn take_leave(&mut self) -> Result<(), TransportError> {
        let mut answer = [0; 64];
        for request in std::mem::take(&mut self.farewell) {
            self.line.write_all(request.as_bytes())?;
            let said = Instant::now();
            while said.elapsed() < FAREWELL_WITHIN {
                let n = self.line.read(&mut answer)?;
                if answer.get(..n).is_some_and(|answer| answer.ends_with(b"\r")) {
                    break;
                }
            }
        }
        Ok(())
    }
}

impl Transport for TurnTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let may_read = self.carry_out()?;
        let n = if may_read { self.line.read(buf)? } else { 0 };
        self.tell_time();
        Ok(n)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        self.line.write_all(bytes)
    }

    fn send_break(&mut self) -> Result<bool, TransportError> {
        self.line.send_break()
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        self.line.set_baud(baud)
    }

    fn inner(&self) -> Option<&dyn Transport> {
        Some(&*self.line)
    }
}

impl Drop for TurnTransport {
    fn drop(&mut self) {
        if self.take_leave().is_err() {
            // The line is closed either way; a device that is gone needs no farewell.
        }
    }
}
