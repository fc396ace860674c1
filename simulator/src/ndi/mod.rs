//! An NDI system over a motion, sans-io: requests and the time go in, answers come out.
//!
//! Markers whose labels are named as tools are plugged in, and reported with their positions and no
//! turn; all other markers are strays. The motion begins with the first request for a frame. One that no
//! request fetched before the next one came was dropped by the device, and its log says so. After the
//! last frame of a motion that does not loop was fetched the system leaves tracking, and refuses to give
//! frames: so a host sees the end.

use std::sync::Arc;

use frames::Tracking;
use mocapd_drivers::ndi::{BAUD_AT_RESET, ReceivedRequest, RequestLine, put_text};
use mocapd_take::motion::{Marker, Motion};
use setup::Ports;

use crate::device::{DeviceError, LineDevice, Outbox, Rates, SentFrame, SentLog};
use crate::replay::Replay;

mod frames;
mod report;
mod setup;

#[cfg(test)]
mod tests;

/// Labels that an error names.
const LABELS_NAMED: usize = 8;

/// Bytes of a part number.
const PART_NUMBER_BYTES: usize = 20;

/// A simulated NDI system.
#[derive(Debug)]
pub struct NdiDevice {
    settings: NdiSettings,
    replay: Replay,
    rates: Rates,
    ports: Ports,
    line: RequestLine,
    outbox: Outbox,
    initialized: bool,
    baud: u32,
    /// The speed from when the answer at hand has left.
    baud_after: Option<u32>,
    tracking: Tracking,
    warnings: Vec<String>,
    log: SentLog,
    log_frames: bool,
    /// When the system's clock was 0.
    epoch_ns: Option<u64>,
}

impl NdiDevice {
    /// A system that is switched on, and waits.
    ///
    /// # Errors
    /// When there is nothing to report, a tool is not there, or a rate or speed is out of range.
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
                return Err(NdiError::NoSuchTool { label: label.clone(), known: known(markers) });
            };
            let part = part_number(label);
            if part != *label {
                warnings.push(format!("label '{label}' is no part number, sent as '{part}'"));
            }
            tools.push((part, column));
        }
        // Until a tool is enabled its marker is a stray, too.
        if markers.len() > STRAYS_MAX {
            return Err(NdiError::TooManyStrays { found: markers.len() });
        }
        let rates = Rates::new(&motion, settings.rate_hz, settings.speed)?;
        let n_columns = markers.len();
        let replay = rates.replay(motion, rates.rate_mhz);
        let mut outbox = Outbox::default();
        outbox.resize(0, rates.rate_mhz, None);
        Ok(Self {
            replay,
            rates,
            ports: Ports::new(tools, n_columns),
            line: RequestLine::default(),
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

    /// What of the motion could not be said as it was, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Its frame rate, in millihertz.
    #[must_use]
    pub fn rate_mhz(&self) -> u32 {
        self.rates.rate_mhz
    }

    /// Whether it tracks.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.tracking.is_on
    }

    /// As after power-on, but for the line's speed.
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
        let said = answer.unwrap_or_else(|code| format!("ERROR{code:02X}"));
        if !said.is_empty() {
            self.outbox.put(false, |out| put_text(&said, out));
        }
    }
}

/// Labels to choose from, or how many more there are than are named.
fn known(markers: &[Marker]) -> String {
    let labels: Vec<_> = markers.iter().filter(|m| m.labelled).map(|m| m.label.as_str()).collect();
    if labels.is_empty() {
        return "nothing: no marker has a label".to_owned();
    }
    let named = labels.iter().take(LABELS_NAMED).copied().collect::<Vec<_>>().join(", ");
    match labels.len().saturating_sub(LABELS_NAMED) {
        0 => named,
        more => format!("{named} and {more} more"),
    }
}

/// What fits into a part number: printable ASCII.
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
        self.line = RequestLine::default();
        self.outbox.discard();
        (self.baud, self.baud_after) = (BAUD_AT_RESET, None);
        self.outbox.put(false, |out| put_text("RESET", out));
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

/// Tools that can be plugged in; the rest of the handles are for tools that a host loads.
pub const TOOLS_MAX: usize = 32;

/// Stray markers in one answer: `BX` counts them in a byte.
pub const STRAYS_MAX: usize = 255;

/// How the system plays its motion.
#[derive(Debug, Clone, PartialEq)]
pub struct NdiSettings {
    /// Serial number it gives.
    pub serial: String,
    /// Resample to this rate, Hz; `None` for the recorded one.
    pub rate_hz: Option<f64>,
    /// Times faster than it was recorded, 0.001 to 1000, to the nearest 0.001.
    pub speed: f64,
    /// Begin again after the last frame, and never end.
    pub looping: bool,
    /// Labels of the markers that are tools, plugged in in this order; all others are strays.
    pub tools: Vec<String>,
    /// Whether it knows `BX2`, as systems since the Vega do.
    pub bx2: bool,
    /// The highest speed that `COMM` may set, in baud.
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

/// Why a motion cannot be an NDI system.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NdiError {
    /// A tool that is not there.
    #[error("no marker is called '{label}': name one of {known}")]
    NoSuchTool {
        /// As it was given.
        label: String,
        /// What there is: the first labels, and how many more.
        known: String,
    },
    /// More than can be plugged in.
    #[error("{found} tools are more than the {TOOLS_MAX} that can be plugged in: name fewer")]
    TooManyTools {
        /// As given.
        found: usize,
    },
    /// More than an answer counts.
    #[error(
        "{found} stray markers are more than the {STRAYS_MAX} of an answer: choose a file with fewer"
    )]
    TooManyStrays {
        /// In the motion.
        found: usize,
    },
    /// The motion makes no device of any kind.
    #[error(transparent)]
    Device(#[from] DeviceError),
}
