//! A simulated NDI system that plays a motion. Sans-io: requests and the time go in, answers come out.
//!
//! Markers whose labels are named as tools act as tools that are plugged in, with a position and the identity rotation;
//! all other markers are strays. The motion starts with the first request for a frame. A frame that no request fetches
//! before the next one is due counts as dropped in the log. When the last frame of a motion that does not loop has been
//! fetched, the system leaves tracking mode and refuses requests for frames, which tells the host of the end.

use std::sync::Arc;

use frames::Tracking;
use mocapd_drivers::ndi::{BAUD_AT_RESET, ReceivedRequest, RequestReader, put_text};
use mocapd_take::motion::{Marker, Motion};
use setup::Ports;

use crate::device::{DeviceError, LineDevice, Outbox, Queued, Rates, SentFrame, SentLog};
use crate::source::Replay;

mod frames;
mod report;
mod setup;

#[cfg(test)]
mod tests;

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
