//! A simulated NDI system that plays a motion. Sans-io: requests and the time go in, answers come out.
//!
//! Markers whose labels are named as tools act as tools that are plugged in, with a position and the identity rotation;
//! all other markers are strays. The motion starts with the first request for a frame. A frame that no request fetches
//! before the next one is due counts as dropped in the log. When the last frame of a motion that does not loop has been
//! fetched, the system leaves tracking mode and refuses requests for frames, which tells the host of the end.

mod frames;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use frames::Tracking;
use mocapd_drivers::ndi::{BAUD_AT_RESET, BAUDS, ReceivedRequest, RequestReader, code, put_text};
use mocapd_take::motion::{Marker, Motion};

use crate::{
    device::{DeviceError, LineDevice, Outbox, Queued, Rates, SentFrame, SentLog},
    source::Replay,
};

/// Maximum number of labels that an error lists.
const LABELS_NAMED: usize = 8;

/// Length of a part number.
const PART_NUMBER_BYTES: usize = 20;

/// The text of an answer, or the code of an error.
type Answer = Result<String, u8>;

/// A simulated NDI system.
#[derive(Debug)]
pub struct NdiDevice {
    settings: NdiSettings,
    replay: Replay,
    rates: Rates,
    ports: Ports,
    line: RequestReader,
    outbox: Outbox,
    initialized: bool,
    baud: u32,
    /// The line's speed once the pending answer is sent.
    baud_after: Option<u32>,
    tracking: Tracking,
    warnings: Vec<String>,
    log: SentLog,
    log_frames: bool,
    /// The caller's clock when the system's clock was 0.
    epoch_ns: Option<u64>,
}

impl NdiDevice {
    /// Creates a system that is switched on and waits for its host.
    ///
    /// # Errors
    /// When the motion is empty, no marker has a tool's label, there are too many tools or strays, or a rate or speed
    /// is out of range.
    pub fn new(motion: impl Into<Arc<Motion>>, settings: NdiSettings) -> Result<Self, NdiError> {
        let motion = motion.into();
        let markers = &motion.info.markers;
        match (markers.len(), motion.n_frames()) {
            (0, _) => return Err(DeviceError::NoMarkers.into()),
            (_, 0) => return Err(DeviceError::NoFrames.into()),
            _ => {}
        }
        if settings.tools.len() > TOOLS_MAX {
            return Err(NdiError::TooManyTools { found: settings.tools.len() });
        }
        let mut warnings = Vec::new();
        let mut tools = Vec::new();
        for label in &settings.tools {
            let Some(column) = markers.iter().position(|m| m.labelled && m.label == *label) else {
                return Err(NdiError::NoSuchTool { label: label.clone(), known: labels(markers) });
            };
            let part = part_number(label);
            if part != *label {
                warnings.push(format!("the label '{label}' is sent as part number '{part}'"));
            }
            tools.push((part, column));
        }
        // Until a tool is enabled, its marker is also a stray.
        if markers.len() > STRAYS_MAX {
            return Err(NdiError::TooManyStrays { found: markers.len() });
        }
        let rates = Rates::new(&motion, settings.rate_hz, settings.speed)?;
        let n_columns = markers.len();
        let replay = rates.replay(motion, rates.rate_millihertz);
        let mut outbox = Outbox::default();
        outbox.resize(0, rates.rate_millihertz, 0, None);
        Ok(Self {
            replay,
            rates,
            ports: Ports::new(tools, n_columns),
            line: RequestReader::default(),
            outbox,
            initialized: false,
            baud: BAUD_AT_RESET,
            baud_after: None,
            tracking: Tracking::default(),
            warnings,
            log: SentLog::default(),
            log_frames: false,
            epoch_ns: None,
            settings,
        })
    }

    /// One sentence for each label that had to be changed for a part number.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The frame rate, in millihertz.
    #[must_use]
    pub fn rate_millihertz(&self) -> u32 {
        self.rates.rate_millihertz
    }

    /// Whether it is in tracking mode.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.tracking.is_on
    }

    /// Restores the state after power-on, except for the line's speed.
    fn reset(&mut self) {
        self.end_run();
        self.initialized = false;
        self.ports.reset();
    }

    fn answer(&mut self, request: Result<ReceivedRequest, u8>, now_ns: u64) {
        if !self.outbox.has_room(0) {
            self.log.answers_dropped += 1;
            return;
        }
        let answer = request.and_then(|ReceivedRequest { name, args }| {
            self.frame_command(&name, &args, now_ns).unwrap_or_else(|| self.execute(&name, &args))
        });
        let answer = answer.unwrap_or_else(|code| format!("ERROR{code:02X}"));
        if !answer.is_empty() {
            self.outbox.put(Queued::Other, |out| put_text(&answer, out));
        }
    }
}

/// The first labels and the number of the others, for an error.
fn labels(markers: &[Marker]) -> String {
    let labels: Vec<_> = markers.iter().filter(|m| m.labelled).map(|m| m.label.as_str()).collect();
    if labels.is_empty() {
        return "none: no marker has a label".to_owned();
    }
    let named = labels.iter().take(LABELS_NAMED).copied().collect::<Vec<_>>().join(", ");
    match labels.len().saturating_sub(LABELS_NAMED) {
        0 => named,
        more => format!("{named} and {more} more"),
    }
}

/// Converts a label to a part number: printable ASCII, truncated.
fn part_number(label: &str) -> String {
    let printable = label.chars().map(|c| if (' '..='~').contains(&c) { c } else { '_' });
    printable.take(PART_NUMBER_BYTES).collect()
}

impl LineDevice for NdiDevice {
    fn on_bytes(&mut self, bytes: &[u8], now_ns: u64) {
        self.epoch_ns.get_or_insert(now_ns);
        for byte in bytes {
            if let Some(request) = self.line.push(*byte) {
                self.answer(request, now_ns);
            }
        }
    }

    fn on_break(&mut self, _: u64) {
        self.reset();
        self.line = RequestReader::default();
        self.outbox.discard();
        (self.baud, self.baud_after) = (BAUD_AT_RESET, None);
        self.outbox.put(Queued::Other, |out| put_text("RESET", out));
    }

    fn poll(&mut self, now_ns: u64) -> u64 {
        self.epoch_ns.get_or_insert(now_ns);
        self.produce_until(now_ns)
    }

    fn pending(&self) -> &[u8] {
        self.outbox.pending()
    }

    fn sent(&mut self, n: usize) {
        self.outbox.sent(n);
        if self.outbox.pending().is_empty()
            && let Some(baud) = self.baud_after.take()
        {
            self.baud = baud;
        }
    }

    fn baud(&self) -> Option<u32> {
        Some(self.baud)
    }

    fn has_ended(&self) -> bool {
        self.tracking.end_was_reported()
    }

    fn log(&self) -> SentLog {
        let mut log = self.outbox.complete_log(&self.log);
        log.frames_waiting += self.tracking.waiting();
        log
    }

    fn keep_frame_log(&mut self) {
        self.log_frames = true;
    }

    fn take_frames(&mut self) -> Vec<SentFrame> {
        std::mem::take(&mut self.log.frames)
    }
}

/// Maximum number of tools that can be plugged in; the other handles are for tools that a host loads.
pub const TOOLS_MAX: usize = 32;

/// Maximum number of stray markers in one answer: `BX` counts them in one byte.
pub const STRAYS_MAX: usize = 255;

/// How an NDI system plays its motion.
#[derive(Debug, Clone, PartialEq)]
pub struct NdiSettings {
    /// Serial number that the system reports.
    pub serial: String,
    /// Resample the motion to this rate, Hz; `None` keeps the recorded rate.
    pub rate_hz: Option<f64>,
    /// Playback speed, 0.001 to 1000, rounded to 0.001.
    pub speed: f64,
    /// Restart after the last frame, and never end.
    pub looping: bool,
    /// Labels of the markers that act as tools, plugged in in this order; all others are strays.
    pub tools: Vec<String>,
    /// Whether it supports `BX2`, as systems since the Vega do.
    pub bx2: bool,
    /// Highest speed that `COMM` may set, baud.
    pub baud_max: u32,
}

impl Default for NdiSettings {
    fn default() -> Self {
        Self {
            serial: "SIM0001".to_owned(),
            rate_hz: None,
            speed: 1.0,
            looping: false,
            tools: Vec::new(),
            bx2: true,
            baud_max: 1_228_739,
        }
    }
}

/// Why a motion cannot be played as an NDI system.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NdiError {
    /// No marker has the label of a tool.
    #[error("no marker is labelled '{label}'; the labels are {known}")]
    NoSuchTool {
        /// The label of the tool.
        label: String,
        /// The first labels of the motion, and the number of the others.
        known: String,
    },
    /// More tools than can be plugged in.
    #[error("{found} tools, but at most {TOOLS_MAX} can be plugged in: name fewer")]
    TooManyTools {
        /// Tools requested.
        found: usize,
    },
    /// More markers than an answer can count.
    #[error("{found} markers, but an answer holds at most {STRAYS_MAX}: choose a file with fewer")]
    TooManyStrays {
        /// Markers in the motion.
        found: usize,
    },
    /// The motion or a setting suits no device.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// The answer without data.
const OKAY: &str = "OKAY";

/// Commands that are allowed before `INIT`.
const ALWAYS: [&str; 7] = ["INIT", "RESET", "ECHO", "VER", "APIREV", "GETINFO", "COMM"];

/// Commands that are not allowed in tracking mode.
const SETUP_ONLY: [&str; 9] =
    ["COMM", "PHRQ", "PHF", "PVWR", "PINIT", "PENA", "PDIS", "SET", "TSTART"];

impl NdiDevice {
    /// Executes a command; returns the answer without its checksum, or the error code.
    fn execute(&mut self, name: &str, args: &str) -> Answer {
        if !self.initialized && !ALWAYS.contains(&name) {
            return Err(code::NOT_INITIALIZED);
        }
        if self.is_running() && SETUP_ONLY.contains(&name) {
            return Err(code::WRONG_MODE);
        }
        match name {
            "INIT" => {
                self.reset();
                self.initialized = true;
                Ok(OKAY.to_owned())
            }
            "RESET" => {
                self.baud_after = Some(BAUD_AT_RESET);
                self.reset();
                Ok("RESET".to_owned())
            }
            "ECHO" => Ok(args.to_owned()),
            "BEEP" if matches!(args.parse(), Ok(1..=9)) => Ok("1".to_owned()),
            "BEEP" => Err(code::OUT_OF_RANGE),
            "VER" => self.version(args),
            "APIREV" => Ok(if self.settings.bx2 { "G.003.005" } else { "D.001.007" }.to_owned()),
            "GETINFO" => self.parameter(args).map(|(value, rest)| format!("{args}={value};{rest}")),
            "GET" => self.parameter(args).map(|(value, _)| format!("{args}={value}")),
            "SET" => self.set(args),
            "COMM" => self.comm(args),
            "PHSR" => self.list(args),
            "PHRQ" => Ok(format!("{:02X}", self.ports.request().ok_or(code::ALL_PORTS_TAKEN)?)),
            "PHF" => {
                self.ports.free(handle(args)?).then(|| OKAY.to_owned()).ok_or(code::NO_SUCH_HANDLE)
            }
            "PVWR" => self.write_rom(args),
            "PINIT" => self.initialize(handle(args)?),
            "PENA" => self.enable(args),
            "PDIS" => {
                self.ports.get(handle(args)?).ok_or(code::INVALID_PORT)?.enabled = false;
                Ok(OKAY.to_owned())
            }
            "PHINF" => self.info(args),
            _ => Err(code::INVALID_COMMAND),
        }
    }

    fn version(&self, args: &str) -> Answer {
        let firmware = env!("CARGO_PKG_VERSION");
        match args {
            "0" | "1" | "2" | "3" | "4" | "5" | "7" | "8" => Ok(format!(
                "mocapd-sim Control Firmware\nNDI S/N: {}\nCharacterization Date: 01/01/26\n\
                 Freeze Tag: mocapd-sim {firmware}\nFreeze Date : 01/01/26\n",
                self.settings.serial
            )),
            _ => Err(code::OUT_OF_RANGE),
        }
    }

    /// The value of a parameter, and the rest of the answer to `GETINFO`: type, attributes, range, names, description.
    fn parameter(&self, name: &str) -> Result<(String, &'static str), u8> {
        match name {
            "Features.Firmware.Version" => Ok((
                env!("CARGO_PKG_VERSION").to_owned(),
                "3;1;0;12;;Current firmware revision number, of a simulator",
            )),
            "Features.Hardware.Serial Number" => {
                Ok((self.settings.serial.clone(), "3;1;0;12;;Serial number"))
            }
            "Param.Tracking.Frame Frequency" => {
                let rate_hz = f64::from(self.rate_millihertz()) / 1000.0;
                Ok((rate_hz.to_string(), "1;3;1;10000;;Frames a second"))
            }
            "Param.Tracking.Track Frequency" => {
                Ok(("2".to_owned(), "1;3;0;2;;Tracked frames: every third, second, or each"))
            }
            _ => Err(code::OUT_OF_RANGE),
        }
    }

    /// Accepts the current value only; every other value is out of range.
    fn set(&self, args: &str) -> Answer {
        let (name, value) = args.split_once('=').ok_or(code::PARAMETERS)?;
        let (known, _) = self.parameter(name)?;
        if known == value { Ok(OKAY.to_owned()) } else { Err(code::OUT_OF_RANGE) }
    }

    /// `bdddh`: speed, data bits with parity and stop bits, handshake.
    fn comm(&mut self, args: &str) -> Answer {
        let digit = args.chars().next().ok_or(code::PARAMETERS)?;
        let (baud, _) = BAUDS.into_iter().find(|(_, d)| *d == digit).ok_or(code::COMM_FAILED)?;
        match args.get(1..) {
            Some("0000" | "0001") if baud <= self.settings.baud_max => {
                self.baud_after = Some(baud);
                Ok(OKAY.to_owned())
            }
            Some(rest) if rest.len() == 4 => Err(code::COMM_FAILED),
            _ => Err(code::PARAMETERS),
        }
    }

    /// Lists handles: all (0), to be freed (1), not initialized (2), not enabled (3), enabled (4).
    fn list(&self, args: &str) -> Answer {
        let is_listed = |port: &&Port| match args {
            "00" | "" => true,
            "02" => !port.initialized,
            "03" => port.initialized && !port.enabled,
            "04" => port.enabled,
            _ => false,
        };
        if !["", "00", "01", "02", "03", "04"].contains(&args) {
            return Err(code::PARAMETERS);
        }
        let ports: Vec<_> = self.ports.iter().filter(is_listed).collect();
        let mut text = format!("{:02X}", ports.len());
        for port in ports {
            text.push_str(&format!("{:02X}{:03X}", port.handle, port.status()));
        }
        Ok(text)
    }

    /// Writes a page of a tool definition: `hhaaaa` and 64 bytes in hexadecimal.
    fn write_rom(&mut self, args: &str) -> Answer {
        let port = self.ports.get(handle(args)?).ok_or(code::INVALID_PORT)?;
        let address = args.get(2..6).and_then(|a| usize::from_str_radix(a, 16).ok());
        let digits = args.get(6..).filter(|digits| digits.len() == 2 * PAGE_BYTES);
        let (Some(address), Some(digits)) = (address, digits) else { return Err(code::PARAMETERS) };
        let mut page = [0; PAGE_BYTES];
        for (at, byte) in page.iter_mut().enumerate() {
            let two = digits.get(2 * at..2 * at + 2).ok_or(code::PARAMETERS)?;
            *byte = u8::from_str_radix(two, 16).map_err(|_| code::PARAMETERS)?;
        }
        if port.write(address, &page) { Ok(OKAY.to_owned()) } else { Err(code::OUT_OF_RANGE) }
    }

    fn initialize(&mut self, handle: u8) -> Answer {
        let port = self.ports.get(handle).ok_or(code::INVALID_PORT)?;
        if !port.written {
            return Err(code::NO_TOOL);
        }
        port.initialized = true;
        Ok(OKAY.to_owned())
    }

    /// Enables a tool: `hhm`, where the priority is static, dynamic or button box.
    fn enable(&mut self, args: &str) -> Answer {
        let port = self.ports.get(handle(args)?).ok_or(code::INVALID_PORT)?;
        match args.get(2..) {
            Some("S" | "D" | "B") if port.initialized => {
                port.enabled = true;
                Ok(OKAY.to_owned())
            }
            Some("S" | "D" | "B") => Err(code::PORT_NOT_INITIALIZED),
            _ => Err(code::INVALID_PRIORITY),
        }
    }

    fn info(&mut self, args: &str) -> Answer {
        let port = self.ports.get(handle(args)?).ok_or(code::INVALID_PORT)?;
        let mode = mode(args.get(2..).unwrap_or_default())?;
        let (handle, status, part) = (port.handle, port.status(), &port.part_number);
        let mut text = String::new();
        for (bit, field) in [
            (0x01, format!("02000000{:<12}001{handle:08X}{status:02X}", "mocapd-sim")),
            (0x02, "00000000".to_owned()),
            (0x04, format!("{part:<20}")),
            (0x08, "00".to_owned()),
            (0x10, "29".to_owned()),
            (0x20, format!("SIM0001 00{handle:02X}00")),
            (0x40, "00".to_owned()),
        ] {
            if mode & bit != 0 {
                text.push_str(&field);
            }
        }
        Ok(text)
    }
}

fn handle(args: &str) -> Result<u8, u8> {
    let digits = args.get(..2).ok_or(code::PARAMETERS)?;
    u8::from_str_radix(digits, 16).map_err(|_| code::PARAMETERS)
}

/// Size of a tool definition: sixteen pages of 64 bytes.
const ROM_BYTES: usize = 1024;

/// Size of a page, which one `PVWR` writes.
const PAGE_BYTES: usize = 64;

/// The part number's bytes in a tool definition.
const PART_NUMBER: std::ops::Range<usize> = 592..612;

/// Maximum number of handles that a host may request in addition to the tools that are plugged in.
const LOADED_MAX: usize = 32;

/// A port handle and its tool.
#[derive(Debug, Clone, Default)]
struct Port {
    handle: u8,
    /// The tool's column in the motion; `None` when it is never visible.
    column: Option<usize>,
    part_number: String,
    initialized: bool,
    enabled: bool,
    /// The tool definition loaded by a host; `None` for a tool that is plugged in.
    rom: Option<Box<[u8; ROM_BYTES]>>,
    written: bool,
}

impl Port {
    /// Status bits: occupied (1), initialized (16), enabled (32).
    fn status(&self) -> u32 {
        1 | u32::from(self.initialized) << 4 | u32::from(self.enabled) << 5
    }

    /// Writes a page; `false` when it lies outside the definition, or the tool is plugged in.
    fn write(&mut self, address: usize, page: &[u8; PAGE_BYTES]) -> bool {
        let Some(rom) = &mut self.rom else { return false };
        let Some(place) = rom.get_mut(address..).and_then(|rest| rest.get_mut(..PAGE_BYTES)) else {
            return false;
        };
        place.copy_from_slice(page);
        self.written = true;
        let text = rom.get(PART_NUMBER).unwrap_or_default();
        let printable = text.iter().take_while(|byte| (b' '..=b'~').contains(*byte));
        self.part_number = printable.map(|byte| char::from(*byte)).collect();
        true
    }
}

/// All handles, in ascending order.
#[derive(Debug)]
struct Ports {
    ports: Vec<Port>,
    n_columns: usize,
}

impl Ports {
    /// Creates the handles of the tools that are plugged in, from their part numbers and columns.
    fn new(tools: Vec<(String, usize)>, n_columns: usize) -> Self {
        let port = |(handle, (part_number, column))| Port {
            handle,
            column: Some(column),
            part_number,
            written: true,
            ..Port::default()
        };
        Self { ports: (1..).zip(tools).map(port).collect(), n_columns }
    }

    /// Restores the state after power-on: loaded tools are gone.
    fn reset(&mut self) {
        self.ports.retain(|port| port.rom.is_none());
        for port in &mut self.ports {
            (port.initialized, port.enabled) = (false, false);
        }
    }

    fn get(&mut self, handle: u8) -> Option<&mut Port> {
        self.ports.iter_mut().find(|port| port.handle == handle)
    }

    fn iter(&self) -> impl Iterator<Item = &Port> {
        self.ports.iter()
    }

    fn enabled(&self) -> impl Iterator<Item = &Port> {
        self.ports.iter().filter(|port| port.enabled)
    }

    /// Creates a handle for a tool to be loaded; the first marker that is not a tool yet acts as this tool.
    fn request(&mut self) -> Option<u8> {
        let loaded = self.ports.iter().filter(|port| port.rom.is_some()).count();
        if loaded >= LOADED_MAX {
            return None;
        }
        let handle = (0x0A..=0xFE).find(|handle| self.ports.iter().all(|p| p.handle != *handle))?;
        let column = (0..self.n_columns)
            .find(|column| self.ports.iter().all(|port| port.column != Some(*column)));
        let rom = Some(Box::new([0; ROM_BYTES]));
        self.ports.push(Port { handle, column, rom, ..Port::default() });
        self.ports.sort_by_key(|port| port.handle);
        Some(handle)
    }

    /// Frees the handle of a loaded tool; a tool that is plugged in keeps its own. `false` when there is no such
    /// handle.
    fn free(&mut self, handle: u8) -> bool {
        let before = self.ports.len();
        self.ports.retain(|port| port.handle != handle || port.rom.is_none());
        before > self.ports.len() || self.ports.iter().any(|port| port.handle == handle)
    }

    /// Whether the marker in this column is reported as a tool.
    fn is_tool(&self, column: usize) -> bool {
        self.enabled().any(|port| port.column == Some(column))
    }
}

/// Parses reply options, four hexadecimal digits; the default is transforms and status.
fn mode(args: &str) -> Result<u16, u8> {
    match args {
        "" => Ok(1),
        digits => u16::from_str_radix(digits, 16).map_err(|_| code::PARAMETERS),
    }
}
