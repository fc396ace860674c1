//! Polled lines: transports to devices that only reply to requests.
//!
//! A reader calls [`Transport::read`] and passes the bytes to a [`Protocol`](crate::device::Protocol); it
//! writes only the commands of the user. A polled device needs more: a request after every reply, at the
//! right time, and on a serial line occasionally a break or another baud rate. Its protocol sends these as
//! [`LineCommand`]s through a [`LineCommandSender`], and the [`PolledTransport`] around the line executes
//! them at the start of the next read, which follows immediately. The transport also publishes the time, so
//! that the protocol needs no clock.
//!
//! Sender and receiver live on the reader's thread, and neither ever waits for the other.

use std::{
    net::{Ipv4Addr, SocketAddrV4},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use super::{DatagramSource, READ_TIMEOUT, Transport, TransportError};

/// Capacity of the channel: a protocol sends at most a few commands between two reads, such as a break, a
/// baud rate and a request.
pub const LINE_COMMANDS_MAX: usize = 8;

/// Maximum number of bytes of a request: those with which a client of NatNet connects.
pub const REQUEST_BYTES_MAX: usize = 275;

/// Time-out of the reply to a goodbye request.
const GOODBYE_TIMEOUT: Duration = Duration::from_millis(100);

/// A short request, stored inline so that sending it does not allocate.
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
    /// Copies `bytes`; `None` when they exceed [`REQUEST_BYTES_MAX`].
    #[must_use]
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let mut kept = [0; REQUEST_BYTES_MAX];
        kept.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(Self { bytes: kept, len: bytes.len() })
    }

    /// The bytes of the request.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

/// A command of a protocol to its line.
#[derive(Debug, Clone, PartialEq, Eq)]
#[expect(clippy::large_enum_variant, reason = "a box would allocate")]
pub enum LineCommand {
    /// Write a request at a given time or later.
    Write {
        /// The request.
        request: Request,
        /// Earliest time, on the clock of [`LineCommandSender::now_ns`].
        not_before_ns: u64,
    },
    /// Send a break, if the line has one.
    Break,
    /// Receive datagrams of frames from this source.
    Listen(DatagramSource),
    /// Receive no more from that source.
    StopListening,
    /// Change the baud rate. A rate that the port does not support is ignored.
    Baud(u32),
    /// Requests to write when the line is closed, so that the next host finds the device as this one did.
    /// Replaces the earlier ones.
    Goodbye(Vec<Request>),
    /// End the session: the next read fails with this message.
    Fail(String),
    /// End the connection because of this cause: the next read fails, and the host waits for the device to come back.
    Lost(String),
}

/// The sender of line commands, held by the protocol.
#[derive(Debug)]
pub struct LineCommandSender {
    commands: SyncSender<LineCommand>,
    now_ns: Arc<AtomicU64>,
    is_datagram: Arc<AtomicBool>,
    stranger: Arc<AtomicU64>,
}

/// An address and a port as a number; 0 for none.
fn packed(address: Option<SocketAddrV4>) -> u64 {
    address
        .map_or(0, |address| u64::from(u32::from(*address.ip())) << 16 | u64::from(address.port()))
}

impl LineCommandSender {
    /// The last sender of datagrams that are not the device's.
    #[must_use]
    pub fn stranger(&self) -> Option<SocketAddrV4> {
        let packed = self.stranger.load(Ordering::Relaxed);
        let ip = Ipv4Addr::from((packed >> 16) as u32);
        (packed != 0).then(|| SocketAddrV4::new(ip, packed as u16))
    }
    /// Whether the bytes of the last read are one datagram, and no part of the stream.
    #[must_use]
    pub fn is_datagram(&self) -> bool {
        self.is_datagram.load(Ordering::Relaxed)
    }

    /// Time of the last read, in nanoseconds since the line was opened.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.now_ns.load(Ordering::Relaxed)
    }

    /// Sends a command; `false` when the queue is full or the line gone.
    pub fn send(&self, command: LineCommand) -> bool {
        self.commands.try_send(command).is_ok()
    }
}

/// The receiver of line commands, held by the transport.
#[derive(Debug)]
pub struct LineCommandReceiver {
    commands: Receiver<LineCommand>,
    now_ns: Arc<AtomicU64>,
    is_datagram: Arc<AtomicBool>,
    stranger: Arc<AtomicU64>,
}

impl LineCommandReceiver {
    /// Publishes to the protocol who else sends datagrams.
    pub fn set_stranger(&self, stranger: Option<SocketAddrV4>) {
        self.stranger.store(packed(stranger), Ordering::Relaxed);
    }
    /// Publishes to the protocol whether it gets a datagram next.
    pub fn set_datagram(&self, is_datagram: bool) {
        self.is_datagram.store(is_datagram, Ordering::Relaxed);
    }

    /// Takes the next command, if there is one.
    pub fn try_recv(&self) -> Option<LineCommand> {
        self.commands.try_recv().ok()
    }

    /// Publishes the time to the protocol.
    pub fn set_now_ns(&self, now_ns: u64) {
        self.now_ns.store(now_ns, Ordering::Relaxed);
    }
}

/// Makes a channel for line commands.
#[must_use]
pub fn line_command_channel() -> (LineCommandSender, LineCommandReceiver) {
    let (sender, receiver) = sync_channel(LINE_COMMANDS_MAX);
    let now_ns = Arc::new(AtomicU64::new(0));
    let is_datagram = Arc::new(AtomicBool::new(false));
    let stranger = Arc::new(AtomicU64::new(0));
    (
        LineCommandSender {
            commands: sender,
            now_ns: Arc::clone(&now_ns),
            is_datagram: Arc::clone(&is_datagram),
            stranger: Arc::clone(&stranger),
        },
        LineCommandReceiver { commands: receiver, now_ns, is_datagram, stranger },
    )
}

/// A transport that executes line commands before it reads.
#[derive(Debug)]
pub struct PolledTransport {
    line: Box<dyn Transport>,
    queue: LineCommandReceiver,
    opened_at: Instant,
    /// A write whose time has not come.
    next: Option<LineCommand>,
    goodbye: Vec<Request>,
}

impl PolledTransport {
    /// Wraps `line`.
    #[must_use]
    pub fn new(line: Box<dyn Transport>, queue: LineCommandReceiver) -> Self {
        Self { line, queue, opened_at: Instant::now(), next: None, goodbye: Vec::new() }
    }

    fn publish_time(&self) -> u64 {
        let now_ns = u64::try_from(self.opened_at.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.queue.set_now_ns(now_ns);
        now_ns
    }

    /// Executes the queued commands; `false` when the next write is not due within the time-out of a read.
    fn execute(&mut self) -> Result<bool, TransportError> {
        // The queue holds no more, and the protocol cannot add any in between.
        for _ in 0..=LINE_COMMANDS_MAX {
            let Some(command) = self.next.take().or_else(|| self.queue.try_recv()) else { break };
            match command {
                LineCommand::Write { request, not_before_ns } => {
                    let early_ns = not_before_ns.saturating_sub(self.publish_time());
                    let timeout_ns = READ_TIMEOUT.as_nanos() as u64;
                    thread::sleep(Duration::from_nanos(early_ns.min(timeout_ns)));
                    if early_ns > timeout_ns {
                        self.next = Some(command);
                        return Ok(false);
                    }
                    self.line.write_all(request.as_bytes())?;
                }
                LineCommand::Break => drop(self.line.send_break()?),
                LineCommand::Listen(source) => self.line.listen(source)?,
                LineCommand::StopListening => self.line.stop_listening(),
                LineCommand::Baud(baud) => match self.line.set_baud(baud) {
                    // The device does not reply at the old rate, and the search continues.
                    Ok(()) | Err(TransportError::Refused(_)) => {}
                    Err(error) => return Err(error),
                },
                LineCommand::Goodbye(goodbye) => self.goodbye = goodbye,
                LineCommand::Fail(message) => return Err(TransportError::Refused(message)),
                LineCommand::Lost(cause) => {
                    let device = self.line.describe();
                    return Err(TransportError::ConnectionLost { device, cause });
                }
            }
        }
        Ok(true)
    }

    /// Writes the goodbye requests, and waits briefly for each reply: a port may discard unsent bytes when it is
    /// closed.
    fn send_goodbye(&mut self) -> Result<(), TransportError> {
        let mut reply = [0; 64];
        for request in std::mem::take(&mut self.goodbye) {
            self.line.write_all(request.as_bytes())?;
            let sent_at = Instant::now();
            while sent_at.elapsed() < GOODBYE_TIMEOUT {
                let n = self.line.read(&mut reply)?;
                if reply.get(..n).is_some_and(|reply| reply.ends_with(b"\r")) {
                    break;
                }
            }
        }
        Ok(())
    }
}

impl Transport for PolledTransport {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let may_read = self.execute()?;
        let n = if may_read { self.line.read(buf)? } else { 0 };
        self.queue.set_datagram(n > 0 && self.line.arrival().is_datagram);
        self.queue.set_stranger(self.line.stranger());
        self.publish_time();
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

impl Drop for PolledTransport {
    fn drop(&mut self) {
        if self.send_goodbye().is_err() {
            // The line is closed either way, and a disconnected device needs no goodbye.
        }
    }
}
