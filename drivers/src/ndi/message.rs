//! Requests and replies: their format, checksums, error codes and baud rates, and their exchange, one request at a time,
//! with time-outs, damage handling and retries.

/// Error codes of devices, as in `ERRORxx`.
#[expect(missing_docs, reason = "the vendor's guide describes each, and `advice` says what to do")]
pub mod code {
    pub const INVALID_COMMAND: u8 = 0x01;
    pub const TOO_LONG: u8 = 0x02;
    pub const BAD_CRC: u8 = 0x04;
    pub const COMM_FAILED: u8 = 0x06;
    pub const PARAMETERS: u8 = 0x07;
    pub const INVALID_PORT: u8 = 0x08;
    pub const INVALID_PRIORITY: u8 = 0x09;
    /// The command is invalid in the current mode, tracking or not.
    pub const WRONG_MODE: u8 = 0x0C;
    pub const NO_TOOL: u8 = 0x0D;
    pub const PORT_NOT_INITIALIZED: u8 = 0x0E;
    /// The reply to every command after a reset.
    pub const NOT_INITIALIZED: u8 = 0x10;
    pub const OUT_OF_RANGE: u8 = 0x23;
    pub const NO_SUCH_HANDLE: u8 = 0x2B;
    pub const ALL_PORTS_TAKEN: u8 = 0x2D;
}

use super::{
    Drain, HostState, MS, NdiHost, OnEvent, Outcome, Pending, PendingCommands, Task,
    frame::{read_bx, read_bx2},
};
use crate::transport::polled::{LineCommand, Request};

/// Baud rate after power-on, after a break, and after `COMM:00000`.
pub const BAUD_AT_RESET: u32 = 9_600;

/// Baud rates and their codes in `COMM`, in ascending order.
pub const BAUDS: [(u32, char); 9] = [
    (9_600, '0'),
    (14_400, '1'),
    (19_200, '2'),
    (38_400, '3'),
    (57_600, '4'),
    (115_200, '5'),
    (230_400, 'A'),
    (921_600, '6'),
    (1_228_739, '7'),
];

/// Index in [`BAUDS`] of the highest rate up to `baud`, or of the lowest rate.
pub(super) fn speed_at_most(baud: u32) -> usize {
    BAUDS.iter().rposition(|(speed, _)| *speed <= baud).unwrap_or(0)
}

// CRC-16/ARC: x^16 + x^15 + x^2 + 1, reflected, from 0.

const TABLE: [u16; 256] = table();

const fn table() -> [u16; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = byte as u16;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xA001 } else { crc >> 1 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
}

/// Computes the checksum of requests, of text replies, and of both parts of binary replies.
#[must_use]
pub fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc: u16, byte| crc >> 8 ^ TABLE[usize::from(crc as u8 ^ byte)])
}

/// Appends text and its checksum: a request with a colon, or a text reply.
pub fn put_text(text: &str, out: &mut Vec<u8>) {
    out.extend_from_slice(format!("{text}{:04X}\r", crc16(text.as_bytes())).as_bytes());
}

/// Appends a binary reply: a header, a block of at most 65535 bytes, and the checksum of each.
pub fn put_binary(block: &[u8], out: &mut Vec<u8>) {
    let mut header = [BINARY[0], BINARY[1], 0, 0];
    header[2..].copy_from_slice(&(block.len() as u16).to_le_bytes());
    for part in [&header[..], block] {
        out.extend_from_slice(part);
        out.extend_from_slice(&crc16(part).to_le_bytes());
    }
}

/// Makes a request with a checksum; `text` contains the colon.
///
/// All requests of this driver are constants, some with two digits appended: they fit.
pub(super) fn with_crc(text: &str) -> Request {
    let mut wire = Vec::new();
    put_text(text, &mut wire);
    Request::new(&wire).unwrap_or_default()
}

/// Makes a request without a checksum: a name, a space, options.
pub(super) fn without_crc(text: &str) -> Request {
    Request::new(format!("{text}\r").as_bytes()).unwrap_or_default()
}

/// Longest request that a device accepts: `PVWR` has 149 characters; the rest is reserve for options.
const RECEIVED_BYTES_MAX: usize = 1024;

/// The device's receive buffer: collects the bytes of a request until its carriage return.
#[derive(Debug, Default)]
pub struct RequestReader {
    bytes: Vec<u8>,
    too_long: bool,
}

/// A request split into name and arguments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedRequest {
    /// Text before the colon or space.
    pub name: String,
    /// Text after it, without the checksum.
    pub args: String,
}

impl RequestReader {
    /// Takes one byte. Returns the request that it completes, or the [error code](code) for an invalid one.
    pub fn push(&mut self, byte: u8) -> Option<Result<ReceivedRequest, u8>> {
        if byte != b'\r' {
            self.too_long |= self.bytes.len() >= RECEIVED_BYTES_MAX;
            if !self.too_long {
                self.bytes.push(byte);
            }
            return None;
        }
        let Self { bytes, too_long } = std::mem::take(self);
        match std::str::from_utf8(&bytes) {
            _ if too_long => Some(Err(code::TOO_LONG)),
            Ok("") => None,
            Ok(text) => Some(parse_request(text)),
            Err(_) => Some(Err(code::INVALID_COMMAND)),
        }
    }
}

fn parse_request(text: &str) -> Result<ReceivedRequest, u8> {
    let request =
        |name: &str, args: &str| Ok(ReceivedRequest { name: name.into(), args: args.into() });
    let Some((name, rest)) = text.split_once([':', ' ']) else { return request(text, "") };
    if text.as_bytes().get(name.len()) == Some(&b' ') {
        return request(name, rest);
    }
    let args = rest.len().checked_sub(4).and_then(|end| rest.split_at_checked(end));
    let (args, digits) = args.ok_or(code::BAD_CRC)?;
    let covered = text.as_bytes().get(..text.len() - 4).unwrap_or_default();
    if u16::from_str_radix(digits, 16) != Ok(crc16(covered)) {
        return Err(code::BAD_CRC);
    }
    request(name, args)
}

/// Longest accepted reply: a block of 16-bit length with header and checksum. 41 markers on tools and 255
/// strays need 5 kB.
pub(super) const REPLY_BYTES_MAX: usize = 6 + 0xFFFF + 2;

/// First two bytes of a binary reply, in wire order: with a length of 16 bits, and of 32 bits.
const BINARY: [u8; 2] = [0xC4, 0xA5];
const BINARY_LONG: [u8; 2] = [0xC8, 0xA5];

/// A reply as far as it has arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reply<'a> {
    /// More bytes are needed.
    Incomplete,
    /// The text, without its checksum.
    Text(&'a [u8]),
    /// The block, without its header and checksum.
    Binary(&'a [u8]),
    /// The checksum is wrong, or the reply too long.
    Damaged,
}

/// Parses the bytes received since the request.
pub(super) fn parse_reply(reply: &[u8]) -> Reply<'_> {
    match reply.get(..2) {
        Some(start) if start == BINARY => parse_binary_reply(reply, 2),
        Some(start) if start == BINARY_LONG => parse_binary_reply(reply, 4),
        // A single byte can be the start of either.
        None if matches!(reply.first(), None | Some(0xC4 | 0xC8)) => Reply::Incomplete,
        _ => parse_text_reply(reply),
    }
}

fn parse_binary_reply(reply: &[u8], length_bytes: usize) -> Reply<'_> {
    let n_header = 2 + length_bytes + 2;
    let Some((header, rest)) = reply.split_at_checked(n_header) else { return Reply::Incomplete };
    let Some(header) = strip_crc(header) else { return Reply::Damaged };
    let length = header.iter().skip(2).rev().fold(0, |n, byte| n << 8 | usize::from(*byte));
    if n_header + 2 > REPLY_BYTES_MAX.saturating_sub(length) {
        return Reply::Damaged;
    }
    let Some((block, extra)) = rest.split_at_checked(length + 2) else { return Reply::Incomplete };
    match strip_crc(block) {
        Some(block) if extra.is_empty() => Reply::Binary(block),
        _ => Reply::Damaged,
    }
}

fn parse_text_reply(reply: &[u8]) -> Reply<'_> {
    let Some(end) = reply.iter().position(|byte| *byte == b'\r') else { return Reply::Incomplete };
    let (line, extra) = reply.split_at(end);
    let Some((text, digits)) = line.split_last_chunk::<4>() else { return Reply::Damaged };
    let crc = std::str::from_utf8(digits).ok().filter(|_| digits.is_ascii());
    let crc = crc.and_then(|digits| u16::from_str_radix(digits, 16).ok());
    if crc == Some(crc16(text)) && extra == b"\r" { Reply::Text(text) } else { Reply::Damaged }
}

/// Strips and checks the checksum; `None` when it is wrong.
fn strip_crc(bytes: &[u8]) -> Option<&[u8]> {
    let (covered, crc) = bytes.split_last_chunk::<2>()?;
    (u16::from_le_bytes(*crc) == crc16(covered)).then_some(covered)
}

/// Explains an error code and says what to do. The codes are those of the vendor's guide; unknown ones are
/// left to the guide.
pub(super) fn advice(code: u8) -> &'static str {
    match code {
        0x01 => "unknown command: update its firmware, which is too old for this driver",
        0x02 | 0x03 | 0x07 => "the command does not fit its firmware: update it",
        0x04 => "the command arrived damaged: check the cable, or use a lower baud rate",
        0x05 => "internal time-out: switch it off and on again",
        0x06 => "it does not support that baud rate: use a lower one",
        0x08 => "invalid port handle: plug the tool in again",
        0x09 => "it cannot track this tool, whose definition is for another kind of system",
        0x0C => "it is in an unexpected mode: close other programs that use it",
        0x0D => "no tool is assigned to the port: plug the tool in again",
        0x0E => "the port is not initialized: plug the tool in again",
        0x0F => "the port is not enabled: plug the tool in again",
        0x10 => "it is not initialized: switch it off and on again",
        0x11 => "it cannot stop tracking: switch it off and on again",
        0x12 => "it cannot start tracking: check its error light, and switch it off and on again",
        0x13 => "it cannot initialize the tool: unplug the tool, or correct its definition",
        0x14 | 0x22 | 0x24 => {
            "its calibration does not fit the tool or the volume: choose another volume"
        }
        0x15 => "it cannot initialize itself: switch it off and on again",
        0x18 | 0xF1 => "too much infrared light: shield it from lamps and sunlight",
        0x19 | 0x25 | 0x29 => "its firmware cannot be read: have it serviced",
        0x1A => "internal error: switch it off and on again",
        0x1D..=0x20 => "it cannot read the tool's memory: clean the tool's connector",
        0x21 => "the tool draws the wrong current: have the tool repaired",
        0x23 => "value out of range: update its firmware, which may be too old for this driver",
        0x28 => "its hardware changed while it was running: switch it off and on again",
        0x2A => "it is out of memory: unplug tools, and switch it off and on again",
        0x2B | 0x2C => "the tool was disconnected: plug it in again",
        0x2D => "all its ports are in use: switch it off and on again to free them",
        0xF4..=0xF6 => "its flash memory has failed: have it serviced",
        _ => "look up the code in its user's guide",
    }
}

/// Parses the code in `ERRORxx`.
fn error_code(text: &str) -> Option<u8> {
    let digits = text.strip_prefix("ERROR")?;
    (digits.len() == 2).then(|| u8::from_str_radix(digits, 16).ok()).flatten()
}

/// Silence on the line that ends a drain after damage: longer than the 16 ms for which an adapter may hold
/// back the rest of a reply.
const QUIET_NS: u64 = 20 * MS;

/// Time-out of a drain: a device that still sends then is reset. The longest reply takes 0.7 s at
/// 921600 baud.
const DRAIN_TIMEOUT_NS: u64 = 2_000 * MS;

/// Time-out of a drain during the search for the device, whose replies are short then.
const SEARCH_DRAIN_TIMEOUT_NS: u64 = 300 * MS;

/// Maximum number of bytes of a reply during the search. The longest has 12 bytes, `ERRORxx` with its checksum; the
/// rest allows for bytes that were on the line before.
const PROBE_REPLY_BYTES_MAX: usize = 64;

/// Attempts at a request before its time-out or refusal counts.
const ATTEMPTS: u32 = 3;

/// Consecutive polls without a valid reply after which the device counts as switched off or reset: half a
/// second, beyond the duration of any damage to single replies.
const POLLS_LOST_MAX: u32 = 5;

impl NdiHost {
    /// Sends a request. Its outcome is dispatched by `task`.
    pub(super) fn request(
        &mut self,
        task: Task,
        request: Request,
        timeout_ms: u64,
        not_before_ns: u64,
    ) {
        let timeout_ns = timeout_ms * MS;
        self.pending = Some(Pending { task, request, timeout_ns, attempts: 0, active_ns: 0 });
        self.transmit(not_before_ns);
    }

    /// Waits for a reply without sending a request, as after a break.
    pub(super) fn await_reply(&mut self, task: Task, timeout_ms: u64) {
        self.reply.clear();
        let (request, timeout_ns) = (Request::default(), timeout_ms * MS);
        let active_ns = self.line.now_ns();
        self.pending = Some(Pending { task, request, timeout_ns, attempts: ATTEMPTS, active_ns });
    }

    /// Sends the pending request, possibly again.
    fn transmit(&mut self, not_before_ns: u64) {
        let now_ns = self.line.now_ns();
        self.reply.clear();
        if let Some(pending) = &mut self.pending {
            pending.attempts += 1;
            pending.active_ns = not_before_ns.max(now_ns);
            let request = pending.request;
            if !self.line.send(LineCommand::Write { request, not_before_ns }) {
                // The line is gone; the next read returns the error.
                self.pending = None;
            }
        }
    }

    /// Ends the session with an error. The next command of the host starts a new search.
    pub(super) fn fail(&mut self, message: String) {
        self.state = HostState::Off;
        self.pending = None;
        self.todo = PendingCommands::default();
        self.line.send(LineCommand::Fail(message));
    }

    /// Ends the session with the refusal of a request, its error code and advice.
    pub(super) fn fail_code(&mut self, what: &str, code: u8) {
        let advice = advice(code);
        self.fail(format!("the NDI system cannot {what} (ERROR{code:02X}): {advice}"));
    }

    pub(super) fn receive(&mut self, bytes: &[u8], on_event: OnEvent<'_>) {
        let now_ns = self.line.now_ns();
        if let Some(drain) = &mut self.drain {
            if !bytes.is_empty() {
                drain.last_byte_ns = now_ns;
                self.counters.bytes_skipped += bytes.len() as u64;
            }
            let Drain { since_ns, last_byte_ns } = *drain;
            if now_ns - last_byte_ns >= QUIET_NS {
                self.drain = None;
                self.retry(on_event);
            } else if now_ns - since_ns > self.drain_timeout_ns() {
                self.drain = None;
                self.drain_timed_out(on_event);
            }
            return;
        }
        let Some(pending) = &mut self.pending else {
            self.counters.bytes_skipped += bytes.len() as u64;
            return;
        };
        if !bytes.is_empty() {
            pending.active_ns = pending.active_ns.max(now_ns);
            let room = REPLY_BYTES_MAX - self.reply.len();
            self.reply.extend_from_slice(bytes.get(..room).unwrap_or(bytes));
            let fits = bytes.len() <= room
                && (!self.is_probing() || self.reply.len() <= PROBE_REPLY_BYTES_MAX);
            if fits {
                self.check_reply(on_event);
            } else {
                self.start_drain(now_ns);
            }
        } else if now_ns.saturating_sub(pending.active_ns) > pending.timeout_ns {
            if !self.reply.is_empty() {
                // The reply is incomplete, and no more bytes arrive.
                self.count_damage();
            }
            self.retry(on_event);
        }
    }

    /// Whether the device's baud rate is still unknown.
    fn is_probing(&self) -> bool {
        matches!(self.pending, Some(Pending { task: Task::Probe(_) | Task::Break(_), .. }))
    }

    fn is_searching(&self) -> bool {
        self.is_probing() || self.pending.is_some_and(|pending| pending.task == Task::Verify)
    }

    fn drain_timeout_ns(&self) -> u64 {
        if self.is_searching() { SEARCH_DRAIN_TIMEOUT_NS } else { DRAIN_TIMEOUT_NS }
    }

    /// Handles a device that keeps sending unrequested bytes: at the wrong baud rate, or of another kind.
    fn drain_timed_out(&mut self, on_event: OnEvent<'_>) {
        match self.pending.filter(|_| self.is_searching()) {
            Some(pending) => self.dispatch(pending.task, Outcome::Timeout, on_event),
            None => self.restart_search(),
        }
    }

    fn check_reply(&mut self, on_event: OnEvent<'_>) {
        let now_ns = self.line.now_ns();
        let Some(task) = self.pending.map(|pending| pending.task) else { return };
        match parse_reply(&self.reply) {
            Reply::Incomplete => {}
            Reply::Damaged => self.start_drain(now_ns),
            Reply::Binary(block) => {
                let read = if self.bx2 { read_bx2 } else { read_bx };
                if task == Task::Poll && read(block, &mut self.frame).is_some() {
                    self.counters.messages += 1;
                    self.pending = None;
                    self.polls_lost = 0;
                    self.frame_reply(on_event);
                } else {
                    self.start_drain(now_ns);
                }
            }
            Reply::Text(text) => {
                // Replies are ASCII. Text replies are rare, so a copy is acceptable.
                let text = String::from_utf8_lossy(text).into_owned();
                self.counters.messages += 1;
                match error_code(&text) {
                    Some(code) => self.on_refusal(task, code, on_event),
                    None => self.dispatch(task, Outcome::Text(&text), on_event),
                }
            }
        }
    }

    /// Repeats a refused request before the refusal counts: the request may have been damaged on its way.
    fn on_refusal(&mut self, task: Task, code: u8, on_event: OnEvent<'_>) {
        let for_good = task == Task::Poll && code == code::WRONG_MODE;
        if !for_good && self.pending.is_some_and(|pending| pending.attempts < ATTEMPTS) {
            self.transmit(0);
        } else {
            self.dispatch(task, Outcome::Refused(code), on_event);
        }
    }

    fn count_damage(&mut self) {
        self.counters.bytes_skipped += self.reply.len() as u64;
        // While the baud rate is unknown, damage only means a wrong guess.
        if !self.is_searching() {
            self.counters.messages_damaged += 1;
        }
        self.reply.clear();
    }

    fn start_drain(&mut self, now_ns: u64) {
        self.count_damage();
        self.drain = Some(Drain { since_ns: now_ns, last_byte_ns: now_ns });
    }

    /// Repeats a request that had no valid reply, or gives up.
    fn retry(&mut self, on_event: OnEvent<'_>) {
        let Some(Pending { task, attempts, .. }) = self.pending else { return };
        if task == Task::Poll {
            self.polls_lost += 1;
            self.run.count_unread();
            self.pending = None;
            if self.polls_lost >= POLLS_LOST_MAX {
                self.restart_search();
            } else {
                self.next_poll();
            }
        } else if attempts < ATTEMPTS && !matches!(task, Task::Probe(_) | Task::Break(_)) {
            self.transmit(0);
        } else {
            self.dispatch(task, Outcome::Timeout, on_event);
        }
    }

    /// Ends the pending request, and handles its outcome.
    fn dispatch(&mut self, task: Task, outcome: Outcome<'_>, on_event: OnEvent<'_>) {
        self.pending = None;
        match task {
            Task::Start | Task::Poll | Task::Stop => self.track_reply(task, outcome, on_event),
            _ => self.bring_up_reply(task, outcome),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_checksums() {
        for (text, crc) in [
            ("INIT:", 0xE3A5),
            ("OKAY", 0xA896),
            ("RESET", 0xBE6F),
            ("VER:0", 0x65EE),
            ("GETINFO:Features.Firmware.Version", 0x0492),
            ("GET:Device.*", 0x722D),
            ("PHSR:00", 0x20FF),
            ("PINIT:01", 0x31EA),
            ("SFLIST:03", 0x500F),
            ("123456789", 0xBB3D),
            ("", 0),
        ] {
            assert_eq!(crc16(text.as_bytes()), crc, "{text}");
        }
    }

    #[test]
    fn known_requests() {
        for (text, wire) in [
            ("INIT:", &b"INIT:E3A5\r"[..]),
            ("VER:0", b"VER:065EE\r"),
            ("PHSR:00", b"PHSR:0020FF\r"),
            ("PINIT:01", b"PINIT:0131EA\r"),
            ("GETINFO:Features.Firmware.Version", b"GETINFO:Features.Firmware.Version0492\r"),
        ] {
            assert_eq!(with_crc(text).as_bytes(), wire);
        }
        assert_eq!(without_crc("BX2 --6d=tools").as_bytes(), b"BX2 --6d=tools\r");
    }
}
