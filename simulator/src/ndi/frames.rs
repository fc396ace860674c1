//! Production of frames, and the requests that fetch them.

use mocapd_drivers::ndi::{code, put_binary, put_text};
use mocapd_take::motion::{Position, is_gap};

use super::report::{Bx2Options, FrameReport, bx2};
use super::{Answer, NdiDevice, mode};
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
