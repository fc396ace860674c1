//! Frames of the simulated NDI system: their production, the requests that fetch them, and their encodings as answers:
//! `TX` in text, `BX` and `BX2` in binary.

use mocapd_drivers::ndi::{code, put_binary, put_text};
use mocapd_take::motion::{Position, is_gap};

use super::{Answer, NdiDevice, Ports, mode};
use crate::device::{Queued, SentCounters, SentFrame, frame_after_ns};

const SECOND_NS: u64 = 1_000_000_000;

/// `TSTART:80` resets the frame counter.
const RESET_COUNTER: &str = "80";

/// How long the last frame of a motion stays available, so that a slow line can still fetch it.
const LAST_FRAME_NS: u64 = SECOND_NS;

/// Maximum number of unfetched frames that wait for a later request. Beyond it (a minute at 60 Hz) they count as
/// dropped, regardless of later requests.
const MISSED_MAX: usize = 4096;

/// The frame that requests can fetch.
#[derive(Debug, Clone, Copy)]
struct Current {
    /// Its entry in the log.
    sent: SentFrame,
    /// Whether any request has fetched it.
    fetched: bool,
    /// `BX2` has fetched it.
    fetched_by_bx2: bool,
}

/// Tracking mode, from `TSTART` to its end.
#[derive(Debug, Default)]
pub(super) struct Tracking {
    pub(super) is_on: bool,
    /// Time of the first frame, which comes with the first request for one.
    start_ns: Option<u64>,
    current: Option<Current>,
    /// Frames since the last one fetched.
    missed: Vec<SentFrame>,
    row: Vec<Position>,
    /// Frames produced before the counter was last reset.
    counted_from: u64,
    sequence: u8,
    /// Whether a run has ended, by itself or by a command.
    ended: bool,
    end_reported: bool,
}

impl Tracking {
    pub(super) fn end_was_reported(&self) -> bool {
        self.ended && self.end_reported
    }

    /// The number of frames whose fate is not decided yet.
    pub(super) fn waiting(&self) -> u64 {
        let current = self.current.is_some_and(|frame| !frame.fetched);
        self.missed.len() as u64 + u64::from(current)
    }
}

impl NdiDevice {
    /// Produces the frames that are due, and returns the time of the next.
    pub(super) fn produce_until(&mut self, now_ns: u64) -> u64 {
        let n_frames = self.replay.n_frames().max(1);
        while let Some(start_ns) = self.tracking.start_ns {
            let produced = self.log.run.frames_produced;
            let next_ns =
                start_ns.saturating_add(frame_after_ns(produced, self.rates.rate_millihertz));
            if next_ns > now_ns {
                return next_ns;
            }
            if !self.settings.looping && produced >= n_frames {
                // The last frame stays available until it is fetched or its extra time is over.
                let waits_until_ns = next_ns.saturating_add(LAST_FRAME_NS);
                if self.tracking.waiting() > 0 && now_ns < waits_until_ns {
                    return waits_until_ns;
                }
                self.end_run();
            } else {
                self.produce(produced % n_frames, next_ns);
            }
        }
        u64::MAX
    }

    fn produce(&mut self, index: u64, at_ns: u64) {
        self.settle_current();
        self.replay.frame(index, &mut self.tracking.row);
        let present = self.tracking.row.iter().filter(|position| !is_gap(**position)).count();
        self.tracking.current = Some(Current {
            sent: SentFrame {
                run: self.log.starts,
                seq: (self.log.total.frames_produced - self.tracking.counted_from) as u32,
                device_ticks: at_ns.saturating_sub(self.epoch_ns.unwrap_or(at_ns)),
                present: present as u32,
                dropped: false,
                unasked: false,
                host_ns: at_ns,
            },
            fetched: false,
            fetched_by_bx2: false,
        });
        self.log.run.frames_produced += 1;
        self.log.total.frames_produced += 1;
    }

    /// The current frame is no longer available: logs it if it was fetched.
    fn settle_current(&mut self) {
        let Some(frame) = self.tracking.current.take() else { return };
        if frame.fetched {
            let absent = self.tracking.row.len() as u64 - u64::from(frame.sent.present);
            for counters in [&mut self.log.run, &mut self.log.total] {
                counters.samples += u64::from(frame.sent.present);
                counters.samples_occluded += absent;
            }
            self.log_frame(frame.sent);
        } else {
            if self.tracking.missed.len() >= MISSED_MAX {
                self.settle_missed(false);
            }
            self.tracking.missed.push(frame.sent);
        }
    }

    /// Settles the missed frames: as dropped, because a later request came, or as unasked, because none will.
    fn settle_missed(&mut self, unasked: bool) {
        let missed = std::mem::take(&mut self.tracking.missed);
        for counters in [&mut self.log.run, &mut self.log.total] {
            let count =
                if unasked { &mut counters.frames_unasked } else { &mut counters.frames_dropped };
            *count += missed.len() as u64;
        }
        missed.into_iter().for_each(|sent| {
            self.log_frame(SentFrame { dropped: !unasked, unasked, ..sent });
        });
    }

    fn log_frame(&mut self, sent: SentFrame) {
        if self.log_frames {
            self.log.frames.push(sent);
        }
    }

    pub(super) fn end_run(&mut self) {
        self.settle_current();
        self.settle_missed(true);
        self.tracking.start_ns = None;
        if std::mem::take(&mut self.tracking.is_on) {
            self.log.ends += 1;
            (self.tracking.ended, self.tracking.end_reported) = (true, false);
        }
    }

    /// Answers a command about frames; the answer is empty when it is queued already. `None` for other commands.
    pub(super) fn frame_command(&mut self, name: &str, args: &str, now_ns: u64) -> Option<Answer> {
        if !matches!(name, "TSTART" | "TSTOP" | "TX" | "BX" | "BX2") || !self.initialized {
            return None;
        }
        if self.tracking.is_on && !matches!(name, "TSTART" | "TSTOP") {
            self.tracking.start_ns.get_or_insert(now_ns);
        }
        // The command can fetch frames that were due before it.
        self.produce_until(now_ns);
        let answer = match name {
            "TSTART" if self.is_running() => Err(code::WRONG_MODE),
            "TSTART" => self.start(args),
            _ if !self.is_running() => {
                self.tracking.end_reported = true;
                Err(code::WRONG_MODE)
            }
            "TSTOP" => {
                self.end_run();
                self.tracking.end_reported = true;
                Ok("OKAY".to_owned())
            }
            "TX" => mode(args).map(|mode| {
                let first = self.fetch(false);
                let text = self.report().tx(mode);
                self.outbox.put(Queued::frame_if(first), |out| put_text(&text, out));
                String::new()
            }),
            "BX" => mode(args).map(|mode| {
                let first = self.fetch(false);
                self.put_binary(first, &self.report().bx(mode))
            }),
            "BX2" if !self.settings.bx2 => Err(code::INVALID_COMMAND),
            _ => Bx2Options::of(args).ok_or(code::PARAMETERS).map(|options| self.bx2(options)),
        };
        self.log.refused += u64::from(answer.is_err() && name == "TSTART");
        Some(answer)
    }

    fn start(&mut self, args: &str) -> Answer {
        match args {
            "" => {}
            RESET_COUNTER => self.tracking.counted_from = self.log.total.frames_produced,
            _ => return Err(code::PARAMETERS),
        }
        self.log.starts += 1;
        self.log.run = SentCounters::default();
        (self.tracking.ended, self.tracking.end_reported) = (false, false);
        (self.tracking.is_on, self.tracking.start_ns) = (true, None);
        Ok("OKAY".to_owned())
    }

    fn bx2(&mut self, options: Bx2Options) -> String {
        let is_new = self.tracking.current.is_some_and(|frame| !frame.fetched_by_bx2);
        let first = self.fetch(true);
        self.tracking.sequence = self.tracking.sequence.wrapping_add(u8::from(is_new));
        let report = self.report();
        let block = bx2(is_new.then_some(&report), options, self.tracking.sequence);
        self.put_binary(first && is_new, &block)
    }

    /// Marks the current frame as fetched; `true` for the first time.
    fn fetch(&mut self, by_bx2: bool) -> bool {
        let Some(frame) = &mut self.tracking.current else { return false };
        frame.fetched_by_bx2 |= by_bx2;
        let first = !std::mem::replace(&mut frame.fetched, true);
        self.settle_missed(false);
        first
    }

    fn report(&self) -> FrameReport<'_> {
        let (number, time_ns) =
            self.tracking.current.map_or((0, 0), |f| (f.sent.seq, f.sent.device_ticks));
        FrameReport { ports: &self.ports, row: &self.tracking.row, number, time_ns }
    }

    fn put_binary(&mut self, is_frame: bool, block: &[u8]) -> String {
        self.outbox.put(Queued::frame_if(is_frame), |out| put_binary(block, out));
        String::new()
    }
}

/// Reply options of `TX` and `BX`.
const TRANSFORMS: u16 = 0x0001;
const TOOL_INFO: u16 = 0x0002;
const ACTIVE_STRAY: u16 = 0x0004;
const TOOL_MARKERS: u16 = 0x0008;
const STRAYS: u16 = 0x1000;

/// Maximum number of strays in an answer to `TX`.
const TX_STRAYS_MAX: usize = 50;

/// Fit error of every simulated tool, millimetres.
const FIT_ERROR_MM: f32 = 0.25;

/// One frame, with the ports that determine what is reported.
#[derive(Debug, Clone, Copy)]
pub(super) struct FrameReport<'a> {
    pub(super) ports: &'a Ports,
    /// One position per marker, millimetres; empty before the first frame.
    pub(super) row: &'a [Position],
    pub(super) number: u32,
    /// The device's clock, nanoseconds.
    pub(super) time_ns: u64,
}

/// An enabled tool in one frame.
struct Tool {
    handle: u8,
    status: u32,
    position: Option<Position>,
}

impl FrameReport<'_> {
    fn tools(&self) -> impl Iterator<Item = Tool> {
        self.ports.enabled().map(|port| {
            let position = port.column.and_then(|column| self.row.get(column)).copied();
            let position = position.filter(|position| !is_gap(*position));
            Tool { handle: port.handle, status: port.status(), position }
        })
    }

    fn strays(&self) -> impl Iterator<Item = Position> {
        let seen = self.row.iter().enumerate().filter(|(_, position)| !is_gap(**position));
        seen.filter(|(column, _)| !self.ports.is_tool(*column)).map(|(_, position)| *position)
    }

    /// The text of an answer to `TX`.
    pub(super) fn tx(&self, mode: u16) -> String {
        let mut text = format!("{:02X}", self.tools().count());
        for Tool { handle, status, position } in self.tools() {
            text.push_str(&format!("{handle:02X}"));
            if mode & TRANSFORMS != 0 {
                match position.and_then(coordinates) {
                    Some(xyz) => {
                        let error = (FIT_ERROR_MM * 1e4) as i32;
                        text.push_str(&format!("+10000+00000+00000+00000{xyz}{error:+06}"));
                    }
                    None => text.push_str("MISSING"),
                }
                text.push_str(&format!("{status:08X}{:08X}", self.number));
            }
            if mode & TOOL_INFO != 0 {
                text.push_str("00000000000000000000");
            }
            if mode & ACTIVE_STRAY != 0 {
                text.push_str("MISSING");
            }
            text.push('\n');
        }
        if mode & STRAYS != 0 {
            let strays: Vec<_> =
                self.strays().filter_map(coordinates).take(TX_STRAYS_MAX).collect();
            text.push_str(&format!("{:02X}", strays.len()));
            text.push_str(&"0".repeat(strays.len().div_ceil(4)));
            text.push_str(&strays.concat());
        }
        text.push_str("0000");
        text
    }

    /// The block of an answer to `BX`.
    pub(super) fn bx(&self, mode: u16) -> Vec<u8> {
        let mut block = vec![self.tools().count() as u8];
        for Tool { handle, status, position } in self.tools() {
            block.extend([handle, if position.is_some() { 1 } else { 2 }]);
            if mode & TRANSFORMS != 0 {
                if let Some(position) = position {
                    transform(position, &mut block);
                }
                block.extend(status.to_le_bytes());
                block.extend(self.number.to_le_bytes());
            }
            if mode & TOOL_INFO != 0 {
                block.extend([0; 11]);
            }
            // No active strays, and no single markers of a tool.
            block.extend((mode & ACTIVE_STRAY != 0).then_some(0));
            block.extend((mode & TOOL_MARKERS != 0).then_some(0));
        }
        if mode & STRAYS != 0 {
            let n_strays = self.strays().count();
            block.push(n_strays as u8);
            block.resize(block.len() + n_strays.div_ceil(8), 0);
            self.strays().for_each(|position| floats(&position, &mut block));
        }
        block.extend([0, 0]);
        block
    }
}

/// Appends the identity rotation, the position and the fit error.
fn transform([x, y, z]: Position, block: &mut Vec<u8>) {
    floats(&[1.0, 0.0, 0.0, 0.0, x, y, z, FIT_ERROR_MM], block);
}

fn floats(values: &[f32], block: &mut Vec<u8>) {
    block.extend(values.iter().flat_map(|value| value.to_le_bytes()));
}

/// Three numbers with sign and six digits, in hundredths of a millimetre; `None` when one does not fit.
fn coordinates(position: Position) -> Option<String> {
    let hundredths = position.map(|value| (f64::from(value) * 100.0).round());
    let fits = hundredths.iter().all(|value| value.abs() < 1e6);
    fits.then(|| hundredths.map(|value| format!("{:+07}", value as i64)).concat())
}

// The General Binary Format of `BX2`.

const VERSION: u16 = 1;
const FRAME: u16 = 1;
const DATA_6D: u16 = 2;
const DATA_3D: u16 = 3;

/// Frame type of passive markers.
const PASSIVE: u8 = 2;

/// The handle of the list of strays.
const STRAYS_HANDLE: u16 = 0xFFFF;

const MISSING: u16 = 0x0100;

const COMPONENT_HEADER: usize = 12;

/// Options of `BX2`: what an answer contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bx2Options {
    tools: bool,
    strays: bool,
}

impl Bx2Options {
    /// Parses the options; `None` if one is unknown.
    pub(super) fn of(options: &str) -> Option<Self> {
        let mut parsed = Self { tools: true, strays: false };
        for option in options.split_ascii_whitespace() {
            match option {
                "--6d=tools" => parsed.tools = true,
                "--6d=none" => parsed.tools = false,
                "--3d=strays" | "--3d=all" => parsed.strays = true,
                "--3d=tools" | "--3d=none" => parsed.strays = false,
                "--1d=none" | "--1d=buttons" | "--sensor=none" => {}
                _ => return None,
            }
        }
        Some(parsed)
    }
}

/// The block of an answer to `BX2`; without a report, that of an answer with no new frame.
pub(super) fn bx2(report: Option<&FrameReport<'_>>, options: Bx2Options, sequence: u8) -> Vec<u8> {
    let mut block = Vec::new();
    container(report.is_some().into(), &mut block);
    let Some(report) = report else { return block };
    component(FRAME, 1, &mut block, |block| {
        block.extend([PASSIVE, sequence, 0, 0]);
        block.extend(report.number.to_le_bytes());
        block.extend(((report.time_ns / SECOND_NS) as u32).to_le_bytes());
        block.extend(((report.time_ns % SECOND_NS) as u32).to_le_bytes());
        container(u16::from(options.tools) + u16::from(options.strays), block);
        if options.tools {
            component(DATA_6D, report.tools().count(), block, |block| data_6d(report, block));
        }
        if options.strays {
            component(DATA_3D, 1, block, |block| data_3d(report, block));
        }
    });
    block
}

fn container(components: u16, block: &mut Vec<u8>) {
    block.extend(VERSION.to_le_bytes());
    block.extend(components.to_le_bytes());
}

/// Appends a component: its header, with the size, and what `body` writes.
fn component(kind: u16, items: usize, block: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let mut inside = Vec::new();
    body(&mut inside);
    block.extend(kind.to_le_bytes());
    block.extend(((COMPONENT_HEADER + inside.len()) as u32).to_le_bytes());
    block.extend(0_u16.to_le_bytes());
    block.extend((items as u32).to_le_bytes());
    block.extend(inside);
}

fn data_6d(report: &FrameReport<'_>, block: &mut Vec<u8>) {
    for Tool { handle, position, .. } in report.tools() {
        block.extend(u16::from(handle).to_le_bytes());
        match position {
            Some(position) => {
                block.extend(0_u16.to_le_bytes());
                transform(position, block);
            }
            None => block.extend(MISSING.to_le_bytes()),
        }
    }
}

fn data_3d(report: &FrameReport<'_>, block: &mut Vec<u8>) {
    block.extend(STRAYS_HANDLE.to_le_bytes());
    block.extend((report.strays().count() as u16).to_le_bytes());
    for (index, position) in (0_u16..).zip(report.strays()) {
        block.extend([0, 0]);
        block.extend(index.to_le_bytes());
        floats(&position, block);
    }
}
