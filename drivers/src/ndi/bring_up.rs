//! Bring-up: from a line in unknown state to a device with enabled tools.

use super::{
    HostState, MS, NdiHost, Outcome, PortStep, Task,
    frame::{BX_REQUEST, BX2_REQUEST, STRAYS_MAX, TOOLS_MAX},
    message::{BAUD_AT_RESET, BAUDS, code, with_crc, without_crc},
    strays,
};
use crate::{
    device::{BODIES_MAX, BodyInfo, Hello, MarkerInfo},
    transport::polled::LineCommand,
};

/// Steps of the search for the device: `INIT:` at a baud rate, or a break (`None`). A device in its power-on
/// state replies to the first. A break resets one that another program left at any rate. The rest are for
/// lines without break, the most common rates first.
const SEARCH: [Option<u32>; 10] = [
    Some(BAUD_AT_RESET),
    None,
    Some(921_600),
    Some(115_200),
    Some(1_228_739),
    Some(57_600),
    Some(230_400),
    Some(38_400),
    Some(19_200),
    Some(14_400),
];

/// Time-out of `INIT:` while the baud rate is a guess, in milliseconds. It doubles each time that all
/// guesses failed, up to four times the value.
const PROBE_TIMEOUT_MS: u64 = 200;

/// Time-out of a reset by break. The vendor's guide states no bound; a Vicra needs less.
const BREAK_TIMEOUT_MS: u64 = 1_500;

/// Time-out of a bring-up command: initializing a tool reads its memory.
const REPLY_TIMEOUT_MS: u64 = 2_000;

/// Pause between two guesses.
const PROBE_PAUSE_NS: u64 = 20 * MS;

/// Time-out of the first reply at a new baud rate.
const VERIFY_TIMEOUT_MS: u64 = 500;

/// Maximum number of characters of a reply that an error quotes.
const QUOTED_CHARS: usize = 40;

/// Settling time of device and adapter after a change of baud rate.
const SETTLING_NS: u64 = 100 * MS;

/// Maximum number of rounds of initialization: initializing one tool can reveal another on the same plug.
const ROUNDS_MAX: u32 = 4;

/// Frame rate of all but the fastest systems, by the vendor's guide.
const FRAME_HZ_DEFAULT: f64 = 60.0;

/// Plausible frame rates, in hertz.
const FRAME_HZ_RANGE: std::ops::RangeInclusive<f64> = 1.0..=10_000.0;

impl NdiHost {
    /// Starts the search for the device on a newly opened line.
    pub(super) fn start_search(&mut self) {
        self.state = HostState::BringUp;
        self.rounds = 0;
        self.probe(0);
    }

    /// Restarts the search after losing the device: it may have been power-cycled, or be at another baud rate.
    pub(super) fn restart_search(&mut self) {
        self.state = HostState::BringUp;
        self.todo.hello = true;
        self.todo.start = false;
        self.todo.stop = false;
        if self.run.is_line_reliable() {
            // A baud rate may have failed earlier because the device was switched off.
            self.speed_max = self.speed_requested;
        }
        self.run.reset_counts();
        (self.polls_lost, self.rounds) = (0, 0);
        self.probe(0);
    }

    fn probe(&mut self, step: usize) {
        let round = step / SEARCH.len();
        match SEARCH[step % SEARCH.len()] {
            Some(baud) => {
                self.set_baud(baud);
                let timeout_ms = PROBE_TIMEOUT_MS << round.min(2);
                // A device that immediately gives wrong replies must not cause a busy loop.
                let not_before_ns = self.line.now_ns() + if step > 0 { PROBE_PAUSE_NS } else { 0 };
                self.request(Task::Probe(step), with_crc("INIT:"), timeout_ms, not_before_ns);
            }
            None => {
                self.set_baud(BAUD_AT_RESET);
                self.line.send(LineCommand::Break);
                self.await_reply(Task::Break(step), BREAK_TIMEOUT_MS);
            }
        }
    }

    fn set_baud(&mut self, baud: u32) {
        self.baud = baud;
        self.line.send(LineCommand::Baud(baud));
    }

    fn send_text(&mut self, task: Task, text: &str) {
        self.request(task, with_crc(text), REPLY_TIMEOUT_MS, 0);
    }

    pub(super) fn bring_up_reply(&mut self, task: Task, outcome: Outcome<'_>) {
        match (task, outcome) {
            (Task::Probe(_), Outcome::Text("OKAY")) => self.set_speed(self.speed_max),
            // It is still tracking for a host that was killed.
            (Task::Probe(_), Outcome::Refused(code::WRONG_MODE)) if self.rounds == 0 => {
                self.rounds += 1;
                self.send_text(Task::LeaveTracking, "TSTOP:");
            }
            (Task::LeaveTracking, _) => self.send_text(Task::Probe(0), "INIT:"),
            (Task::Probe(_), Outcome::Refused(code)) => self.fail_code("initialize itself", code),
            (Task::Probe(step), _) => self.probe(step + 1),
            (Task::Break(_), Outcome::Text("RESET")) => {
                let not_before_ns = self.line.now_ns() + SETTLING_NS;
                self.request(Task::Probe(0), with_crc("INIT:"), REPLY_TIMEOUT_MS, not_before_ns);
            }
            (Task::Break(step), _) => self.probe(step + 1),
            (Task::Comm(index), Outcome::Text("OKAY")) => {
                self.set_baud(BAUDS[index].0);
                let not_before_ns = self.line.now_ns() + SETTLING_NS;
                self.request(Task::Verify, with_crc("VER:0"), VERIFY_TIMEOUT_MS, not_before_ns);
            }
            (Task::Comm(index), Outcome::Refused(_)) => self.set_speed(index.saturating_sub(1)),
            // The checksum was correct, so any text will do.
            (Task::Verify | Task::Version, Outcome::Text(_) | Outcome::Refused(_)) => {
                let text = if let Outcome::Text(text) = outcome { text } else { "NDI system" };
                self.hello = parse_version(text);
                self.send_text(Task::ApiRevision, "APIREV:");
            }
            (Task::Comm(_) | Task::Verify, _) => {
                // Device or adapter does not support that rate: start over with a lower maximum.
                self.speed_max = self.speed_max.saturating_sub(1);
                self.probe(1);
            }
            (_, Outcome::Timeout) => self.restart_search(),
            (Task::ApiRevision, _) => {
                self.bx2 = matches!(outcome, Outcome::Text(text) if has_bx2(text));
                self.send_text(Task::FrameFrequency, "GET:Param.Tracking.Frame Frequency");
            }
            (Task::FrameFrequency, _) => {
                let hz = parse_value(outcome).and_then(|value| value.parse().ok());
                let hz = hz.filter(|hz| FRAME_HZ_RANGE.contains(hz)).unwrap_or(FRAME_HZ_DEFAULT);
                self.hello.rate_millihertz = (hz * 1000.0).round() as u32;
                self.send_text(Task::TrackFrequency, "GET:Param.Tracking.Track Frequency");
            }
            (Task::TrackFrequency, _) => {
                // The device tracks every third, every second, or every frame.
                self.divisor = match parse_value(outcome) {
                    Some("0") => 3,
                    Some("1") => 2,
                    _ => 1,
                };
                self.list_ports(PortStep::Free);
            }
            (Task::List(step), Outcome::Text(text)) => match handles(text) {
                Some(handles) => self.handle_list(step, handles),
                None => {
                    let quoted: String = text.chars().take(QUOTED_CHARS).collect();
                    self.fail(format!(
                        "the NDI system returned an invalid port list '{}': update its firmware",
                        quoted.escape_debug()
                    ));
                }
            },
            (Task::Port(PortStep::Describe, handle), _) => {
                // A tool without a description is named after its port.
                let info = if let Outcome::Text(text) = outcome { text } else { "" };
                self.table.push(tool_marker(handle, info, &self.table));
                self.next_handle(PortStep::Describe);
            }
            (Task::Port(step, _), Outcome::Text(_)) => self.next_handle(step),
            (task, Outcome::Refused(code)) => self.fail_code(&action_text(task), code),
            (Task::Start | Task::Poll | Task::Stop, Outcome::Text(_)) => {}
        }
    }

    /// Requests the baud rate at an index in `BAUDS`, unless it is the current one.
    fn set_speed(&mut self, index: usize) {
        let (baud, digit) = BAUDS[index];
        if baud == self.baud || index == 0 {
            self.send_text(Task::Version, "VER:0");
        } else {
            self.send_text(Task::Comm(index), &format!("COMM:{digit}0000"));
        }
    }

    fn handle_list(&mut self, step: PortStep, handles: Vec<u8>) {
        match step {
            PortStep::Free => self.rounds = 0,
            PortStep::Initialize => {
                self.rounds += 1;
                if handles.is_empty() || self.rounds > ROUNDS_MAX {
                    return self.list_ports(PortStep::Enable);
                }
            }
            PortStep::Enable => {}
            PortStep::Describe => self.table.clear(),
        }
        self.handles_left = handles;
        // They are popped from the end, so in the device's order.
        self.handles_left.reverse();
        self.next_handle(step);
    }

    fn list_ports(&mut self, step: PortStep) {
        self.send_text(Task::List(step), &format!("PHSR:{:02X}", step as u8));
    }

    /// Processes the next handle of the list, or requests the next list.
    fn next_handle(&mut self, step: PortStep) {
        if let Some(handle) = self.handles_left.pop() {
            let text = match step {
                PortStep::Free => format!("PHF:{handle:02X}"),
                PortStep::Initialize => format!("PINIT:{handle:02X}"),
                PortStep::Enable => format!("PENA:{handle:02X}D"),
                PortStep::Describe => format!("PHINF:{handle:02X}0005"),
            };
            return self.send_text(Task::Port(step, handle), &text);
        }
        match step {
            // Initializing can reveal more handles.
            PortStep::Free | PortStep::Initialize => self.list_ports(PortStep::Initialize),
            PortStep::Enable => self.list_ports(PortStep::Describe),
            PortStep::Describe => self.finish_bring_up(),
        }
    }

    fn finish_bring_up(&mut self) {
        if !self.bx2 && self.table.is_empty() {
            // BX carries frame numbers in its tool data: without a tool, frames have no number.
            self.fail("no tool is plugged into the NDI system, and its firmware numbers frames only with a tool: plug one in".to_owned());
            return;
        }
        let tools = self.table.iter().take(BODIES_MAX);
        let body = |tool: &MarkerInfo| BodyInfo { id: tool.id, name: tool.label.clone() };
        self.bodies = tools.map(body).collect();
        let hello = &mut self.hello;
        let frame_rate_millihertz = hello.rate_millihertz;
        hello.rate_millihertz = frame_rate_millihertz / self.divisor;
        (hello.rate_min_millihertz, hello.rate_max_millihertz) =
            (hello.rate_millihertz, hello.rate_millihertz);
        // BX2 has a clock in nanoseconds; the clock of BX is the frame number.
        hello.tick_hz = if self.bx2 { 1_000_000_000 } else { u64::from(frame_rate_millihertz) };
        hello.markers_max = self.table.len() as u16 + STRAYS_MAX as u16;
        self.poll = if self.bx2 { without_crc(BX2_REQUEST) } else { with_crc(BX_REQUEST) };
        self.state = HostState::Ready;
        self.set_goodbye(false);
    }

    /// Sets the requests to send on closing, so that the next host finds the device at 9600 baud and stopped.
    pub(super) fn set_goodbye(&mut self, tracking: bool) {
        let stop = tracking.then(|| with_crc("TSTOP:"));
        let reset_baud = (self.baud != BAUD_AT_RESET).then(|| with_crc("COMM:00000"));
        self.line.send(LineCommand::Goodbye(stop.into_iter().chain(reset_baud).collect()));
    }
}

const _: () = assert!(strays::FIRST_ID as usize >= TOOLS_MAX);

/// Describes the purpose of a request in an error message.
fn action_text(task: Task) -> String {
    match task {
        Task::Port(PortStep::Free, port) => format!("free port {port:02X}"),
        Task::Port(PortStep::Initialize, port) => format!("initialize the tool in port {port:02X}"),
        Task::Port(PortStep::Enable, port) => format!("enable the tool in port {port:02X}"),
        _ => "list its ports".to_owned(),
    }
}

/// Parses the reply to `VER:0`: the first line is the model, others name serial number and firmware.
fn parse_version(text: &str) -> Hello {
    let field = |name: &str| {
        let found = text.lines().find_map(|line| line.trim().strip_prefix(name));
        found.unwrap_or_default().trim().to_owned()
    };
    Hello {
        model: text.lines().next().unwrap_or_default().trim().to_owned(),
        serial: field("NDI S/N:"),
        firmware: field("Freeze Tag:"),
        ..Hello::default()
    }
}

/// Whether an API revision such as `G.003.005` has `BX2`, introduced with the Vega's third revision.
fn has_bx2(revision: &str) -> bool {
    let mut parts = revision.split('.');
    let family = parts.next().unwrap_or_default();
    let major: u32 = parts.next().and_then(|major| major.parse().ok()).unwrap_or(0);
    family >= "G" && major >= 3
}

/// Extracts the value of `Name=value`.
fn parse_value<'a>(outcome: Outcome<'a>) -> Option<&'a str> {
    let Outcome::Text(text) = outcome else { return None };
    text.split_once('=').map(|(_, value)| value.trim())
}

/// Parses the reply to `PHSR`: a count, then handle and status of each; `None` when invalid.
fn handles(text: &str) -> Option<Vec<u8>> {
    let (count, mut rest) = hex_byte(text)?;
    let mut handles = Vec::with_capacity(usize::from(count));
    for _ in 0..count {
        let (handle, after) = hex_byte(rest)?;
        // Skip three digits of port status.
        rest = after.get(3..)?;
        handles.push(handle);
    }
    rest.is_empty().then_some(handles)
}

fn hex_byte(text: &str) -> Option<(u8, &str)> {
    let (digits, rest) = text.split_at_checked(2)?;
    Some((u8::from_str_radix(digits, 16).ok()?, rest))
}

/// Converts a tool to a marker, from the reply to `PHINF:hh0005`. The label is its part number, else its
/// serial number, else its port.
///
/// Fields of the reply: tool type (8), manufacturer (12), revision (3), serial number (8), port status (2),
/// part number (20).
fn tool_marker(handle: u8, info: &str, others: &[MarkerInfo]) -> MarkerInfo {
    let field = |from: usize, to: usize| {
        let field = info.get(from..to).unwrap_or_default();
        field.chars().filter(|c| !c.is_control()).collect::<String>().trim().to_owned()
    };
    let (serial, part) = (field(23, 31), field(33, 53));
    let port = format!("port {handle:02X}");
    let no_serial = serial.bytes().all(|byte| byte == b'0');
    let names = match (part.is_empty(), no_serial) {
        (false, false) => [part.clone(), format!("{part} {serial}"), format!("{part} {port}")],
        (false, true) => [part.clone(), format!("{part} {port}"), port],
        (true, false) => [serial.clone(), format!("{serial} {port}"), port],
        (true, true) => [port.clone(), port.clone(), port],
    };
    let is_new = |name: &&String| others.iter().all(|other| other.label != **name);
    let label = names.iter().find(is_new).unwrap_or(&names[2]).clone();
    MarkerInfo { id: u16::from(handle), label, labelled: true }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn port_lists_parse_or_are_rejected() {
        assert_eq!(handles("00"), Some(vec![]));
        assert_eq!(handles("020A00103010"), Some(vec![0x0A, 0x03]));
        for bad in ["", "0", "01", "010A", "010A0100", "xx", "ZZ0A001", "01\u{e9}A001"] {
            assert_eq!(handles(bad), None, "{bad}");
        }
    }

    #[test]
    fn tools_get_unique_labels() {
        let info =
            |serial: &str, part: &str| format!("02000000NDI         001{serial}31{part:<20}");
        let mut table: Vec<MarkerInfo> = Vec::new();
        for (handle, serial, part, label) in [
            (1, "00000000", "8700449", "8700449"),
            (2, "3A2B1C00", "8700449", "8700449 3A2B1C00"),
            (3, "3A2B1C00", "8700449", "8700449 port 03"),
            (4, "12345678", "", "12345678"),
            (5, "00000000", "", "port 05"),
        ] {
            let marker = tool_marker(handle, &info(serial, part), &table);
            assert_eq!((marker.id, marker.label.as_str()), (u16::from(handle), label));
            table.push(marker);
        }
        assert_eq!(tool_marker(0xFE, "UNOCCUPIED", &table).label, "port FE");
    }
}
