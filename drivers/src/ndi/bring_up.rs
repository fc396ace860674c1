//! From a line of which nothing is known to a device whose tools are enabled.

use super::{
    frame::{BX_REQUEST, BX2_REQUEST, STRAYS_MAX, TOOLS_MAX},
    host::{MS, NdiHost, Outcome, State, Step, Task},
    message::{BAUD_AT_RESET, BAUDS, checked, code, plain},
    strays,
};
use crate::{
    device::{Hello, MarkerInfo},
    transport::turns::Order,
};

/// How a device is looked for: `INIT:` at a speed, or a break (`None`). A device that is where a
/// power-on leaves it answers the first; a break sets one back that another program left at any
/// speed; the rest are for lines that carry no break. The commonest speeds come first.
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

/// How long `INIT:` may take while the speed is a guess, milliseconds; twice as long each time that all
/// guesses were wrong, up to four times.
const SEEK_MS: u64 = 200;

/// How long a reset by break may take. The vendor's guide gives no bound; a Vicra needs less.
const BREAK_MS: u64 = 1_500;

/// How long a command of the bring-up may take: initializing a tool reads its memory.
const ANSWER_MS: u64 = 2_000;

/// Between two guesses.
const SEEK_PAUSE_NS: u64 = 20 * MS;

/// How long the first answer at a new speed may take to begin.
const CHECK_MS: u64 = 500;

/// Characters of an answer that an error quotes.
const SAID_CHARS: usize = 40;

/// How long device and adapter need for a new speed.
const SETTLE_NS: u64 = 100 * MS;

/// How often tools are looked for: initializing one may bring forth another on the same plug.
const ROUNDS_MAX: u32 = 4;

/// What the vendor's guide gives as the rate of all but the fastest systems.
const FRAME_HZ_DEFAULT: f64 = 60.0;

/// Rates that are believed, in hertz.
const FRAME_HZ: std::ops::RangeInclusive<f64> = 1.0..=10_000.0;

impl NdiHost {
    /// Looks for a device on a line on which nothing was said yet.
    pub(super) fn seek_first(&mut self) {
        self.state = State::BringUp;
        self.rounds = 0;
        self.seek(0);
    }

    /// The device was lost: it may have been switched off and on, or be at another speed.
    pub(super) fn seek_anew(&mut self) {
        self.state = State::BringUp;
        self.owed.hello = true;
        self.owed.start = false;
        self.owed.stop = false;
        if self.run.is_sound() {
            // A speed that failed before may have failed because the device was switched off.
            self.ceiling = self.asked_for;
        }
        self.run.lost();
        (self.polls_lost, self.rounds) = (0, 0);
        self.seek(0);
    }

    fn seek(&mut self, step: usize) {
        let round = step / SEARCH.len();
        match SEARCH[step % SEARCH.len()] {
            Some(baud) => {
                self.set_baud(baud);
                let patience_ms = SEEK_MS << round.min(2);
                // What answers everything at once, and wrongly, must not make us spin.
                let not_before_ns = self.desk.now_ns() + if step > 0 { SEEK_PAUSE_NS } else { 0 };
                self.ask(Task::Seek(step), checked("INIT:"), patience_ms, not_before_ns);
            }
            None => {
                self.set_baud(BAUD_AT_RESET);
                self.desk.order(Order::Break);
                self.expect(Task::Break(step), BREAK_MS);
            }
        }
    }

    fn set_baud(&mut self, baud: u32) {
        self.baud = baud;
        self.desk.order(Order::Baud(baud));
    }

    fn ask_checked(&mut self, task: Task, text: &str) {
        self.ask(task, checked(text), ANSWER_MS, 0);
    }

    pub(super) fn brought_up(&mut self, task: Task, outcome: Outcome<'_>) {
        match (task, outcome) {
            (Task::Seek(_), Outcome::Text("OKAY")) => self.faster(self.ceiling),
            // It tracks for a host that was killed.
            (Task::Seek(_), Outcome::Refused(code::WRONG_MODE)) if self.rounds == 0 => {
                self.rounds += 1;
                self.ask_checked(Task::Release, "TSTOP:");
            }
            (Task::Release, _) => self.ask_checked(Task::Seek(0), "INIT:"),
            (Task::Seek(_), Outcome::Refused(code)) => self.fail_refused("initialize itself", code),
            (Task::Seek(step), _) => self.seek(step + 1),
            (Task::Break(_), Outcome::Text("RESET")) => {
                let not_before_ns = self.desk.now_ns() + SETTLE_NS;
                self.ask(Task::Seek(0), checked("INIT:"), ANSWER_MS, not_before_ns);
            }
            (Task::Break(step), _) => self.seek(step + 1),
            (Task::Comm(place), Outcome::Text("OKAY")) => {
                self.set_baud(BAUDS[place].0);
                let not_before_ns = self.desk.now_ns() + SETTLE_NS;
                self.ask(Task::Check, checked("VER:0"), CHECK_MS, not_before_ns);
            }
            (Task::Comm(place), Outcome::Refused(_)) => self.faster(place.saturating_sub(1)),
            // Whatever it says of itself, its checksum was right.
            (Task::Check | Task::Version, Outcome::Text(text)) => {
                self.hello = hello(text);
                self.ask_checked(Task::ApiRevision, "APIREV:");
            }
            (Task::Check | Task::Version, Outcome::Refused(_)) => {
                self.hello = hello("NDI system");
                self.ask_checked(Task::ApiRevision, "APIREV:");
            }
            (Task::Comm(_) | Task::Check, _) => {
                // One of the two cannot run at that speed: back to the start, and no further up.
                self.ceiling = self.ceiling.saturating_sub(1);
                self.seek(1);
            }
            (_, Outcome::Silence) => self.seek_anew(),
            (Task::ApiRevision, _) => {
                self.bx2 = matches!(outcome, Outcome::Text(text) if has_bx2(text));
                self.ask_checked(Task::FrameFrequency, "GET:Param.Tracking.Frame Frequency");
            }
            (Task::FrameFrequency, _) => {
                let hz = value(outcome).and_then(|value| value.parse().ok());
                let hz = hz.filter(|hz| FRAME_HZ.contains(hz)).unwrap_or(FRAME_HZ_DEFAULT);
                self.hello.rate_mhz = (hz * 1000.0).round() as u32;
                self.ask_checked(Task::TrackFrequency, "GET:Param.Tracking.Track Frequency");
            }
            (Task::TrackFrequency, _) => {
                // Every third, every second, or every frame is tracked.
                self.divisor = match value(outcome) {
                    Some("0") => 3,
                    Some("1") => 2,
                    _ => 1,
                };
                self.list(Step::Free);
            }
            (Task::List(step), Outcome::Text(text)) => match handles(text) {
                Some(handles) => self.listed(step, handles),
                None => {
                    let said: String = text.chars().take(SAID_CHARS).collect();
                    self.fail(format!(
                        "the NDI system lists its ports as '{}', which is no list: update its firmware",
                        said.escape_debug()
                    ));
                }
            },
            (Task::Port(Step::Describe, handle), _) => {
                // A tool that is not described is known by its port.
                let info = if let Outcome::Text(text) = outcome { text } else { "" };
                self.table.push(marker(handle, info, &self.table));
                self.next_handle(Step::Describe);
            }
            (Task::Port(step, _), Outcome::Text(_)) => self.next_handle(step),
            (task, Outcome::Refused(code)) => self.fail_refused(&what(task), code),
            (Task::Start | Task::Poll | Task::Stop, Outcome::Text(_)) => {}
        }
    }

    /// The highest speed up to a place in `BAUDS`, unless it is the one at hand.
    fn faster(&mut self, place: usize) {
        let (baud, digit) = BAUDS[place];
        if baud == self.baud || place == 0 {
            self.ask_checked(Task::Version, "VER:0");
        } else {
            self.ask_checked(Task::Comm(place), &format!("COMM:{digit}0000"));
        }
    }

    fn listed(&mut self, step: Step, handles: Vec<u8>) {
        match step {
            Step::Free => self.rounds = 0,
            Step::Initialize => {
                self.rounds += 1;
                if handles.is_empty() || self.rounds > ROUNDS_MAX {
                    self.list(Step::Enable);
                    return;
                }
            }
            Step::Enable => {}
            Step::Describe => self.table.clear(),
        }
        self.todo = handles;
        // Taken from the end: in the device's order.
        self.todo.reverse();
        self.next_handle(step);
    }

    fn list(&mut self, step: Step) {
        self.ask_checked(Task::List(step), &format!("PHSR:{:02X}", step as u8));
    }

    /// The next handle of a list, or the next list.
    fn next_handle(&mut self, step: Step) {
        if let Some(handle) = self.todo.pop() {
            let text = match step {
                Step::Free => format!("PHF:{handle:02X}"),
                Step::Initialize => format!("PINIT:{handle:02X}"),
                Step::Enable => format!("PENA:{handle:02X}D"),
                Step::Describe => format!("PHINF:{handle:02X}0005"),
            };
            return self.ask_checked(Task::Port(step, handle), &text);
        }
        match step {
            // Initializing may have brought forth more.
            Step::Free | Step::Initialize => self.list(Step::Initialize),
            Step::Enable => self.list(Step::Describe),
            Step::Describe => self.ready(),
        }
    }

    fn ready(&mut self) {
        if !self.bx2 && self.table.is_empty() {
            // BX numbers frames by their tools: without one nobody could tell them apart.
            self.fail("no tool is plugged into the NDI system, and its firmware numbers frames by their tools: plug one in".to_owned());
            return;
        }
        let hello = &mut self.hello;
        let frame_mhz = hello.rate_mhz;
        hello.rate_mhz = frame_mhz / self.divisor;
        (hello.rate_min_mhz, hello.rate_max_mhz) = (hello.rate_mhz, hello.rate_mhz);
        // BX2 has a clock in nanoseconds; the clock of BX is the frame number.
        hello.tick_hz = if self.bx2 { 1_000_000_000 } else { u64::from(frame_mhz) };
        hello.markers_max = self.table.len() as u16 + STRAYS_MAX as u16;
        self.poll = if self.bx2 { plain(BX2_REQUEST) } else { checked(BX_REQUEST) };
        self.state = State::Ready;
        self.farewell(false);
    }

    /// The next host finds the device at the speed that it looks for first, and not tracking.
    pub(super) fn farewell(&mut self, tracking: bool) {
        let slower = self.baud != BAUD_AT_RESET;
        let mut farewell = Vec::new();
        farewell.extend(tracking.then(|| checked("TSTOP:")));
        farewell.extend(slower.then(|| checked("COMM:00000")));
        self.desk.order(Order::Farewell(farewell));
    }
}

const _: () = assert!(strays::FIRST_ID as usize >= TOOLS_MAX);

/// What a request was to do, for people.
fn what(task: Task) -> String {
    match task {
        Task::Port(Step::Free, handle) => format!("free port {handle:02X}"),
        Task::Port(Step::Initialize, handle) => format!("initialize the tool in port {handle:02X}"),
        Task::Port(Step::Enable, handle) => format!("enable the tool in port {handle:02X}"),
        _ => "list its ports".to_owned(),
    }
}

/// The answer to `VER:0`: the first line is the model, others name serial number and firmware.
fn hello(text: &str) -> Hello {
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

/// `G.003.005`: `BX2` came with the Vega's third revision.
fn has_bx2(revision: &str) -> bool {
    let mut parts = revision.split('.');
    let family = parts.next().unwrap_or_default();
    let major: u32 = parts.next().and_then(|major| major.parse().ok()).unwrap_or(0);
    family >= "G" && major >= 3
}

/// The value in `Name=value`.
fn value<'a>(outcome: Outcome<'a>) -> Option<&'a str> {
    match outcome {
        Outcome::Text(text) => text.split_once('=').map(|(_, value)| value.trim()),
        Outcome::Refused(_) | Outcome::Silence => None,
    }
}

/// Handles in an answer to `PHSR`: a count, then a handle and a status each; `None` when it is none.
fn handles(text: &str) -> Option<Vec<u8>> {
    let (count, mut rest) = hex_byte(text)?;
    let mut handles = Vec::with_capacity(usize::from(count));
    for _ in 0..count {
        let (handle, after) = hex_byte(rest)?;
        // Three digits of port status.
        rest = after.get(3..)?;
        handles.push(handle);
    }
    rest.is_empty().then_some(handles)
}

fn hex_byte(text: &str) -> Option<(u8, &str)> {
    let (digits, rest) = text.split_at_checked(2)?;
    Some((u8::from_str_radix(digits, 16).ok()?, rest))
}

/// A tool as a marker, from the answer to `PHINF:hh0005`: its part number, or its serial number
/// where it has none, or its port.
///
/// The answer: tool type (8), manufacturer (12), revision (3), serial number (8), port status (2),
/// part number (20).
fn marker(handle: u8, info: &str, others: &[MarkerInfo]) -> MarkerInfo {
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
    fn handles_of_an_answer() {
        assert_eq!(handles("00"), Some(vec![]));
        assert_eq!(handles("020A00103010"), Some(vec![0x0A, 0x03]));
        for bad in ["", "0", "01", "010A", "010A0100", "xx", "ZZ0A001", "01\u{e9}A001"] {
            assert_eq!(handles(bad), None, "{bad}");
        }
    }

    #[test]
    fn tools_get_names_of_their_own() {
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
            let marker = marker(handle, &info(serial, part), &table);
            assert_eq!((marker.id, marker.label.as_str()), (u16::from(handle), label));
            table.push(marker);
        }
        assert_eq!(marker(0xFE, "UNOCCUPIED", &table).label, "port FE");
    }
}
