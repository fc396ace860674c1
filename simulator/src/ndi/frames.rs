//! Frames whose time comes, and requests that fetch them.

use mocapd_take::motion::{Position, is_gap};

use super::{
    NdiDevice,
    report::{self, Moment, Wanted, bx2},
    request::INVALID,
    setup::WRONG_MODE,
};
use crate::device::{SentCounters, SentFrame};

const SECOND_NS: u64 = 1_000_000_000;

/// `TSTART:80` sets the frame counter back.
const RESET_COUNTER: &str = "80";

/// Errors of options.
const PARAMETERS: u8 = 0x07;

/// The frame that can be had now.
#[derive(Debug, Clone, Copy)]
struct Current {
    number: u32,
    /// The caller's clock, and the system's own.
    at_ns: u64,
    time_ns: u64,
    present: u32,
    /// Whether any request fetched it, and whether `BX2` did.
    fetched: bool,
    fetched_new: bool,
}

/// From `TSTART` to the end.
#[derive(Debug, Default)]
pub(super) struct Tracking {
    start_ns: Option<u64>,
    current: Option<Current>,
    row: Vec<Position>,
    /// The frame counter when it was last set back.
    counted_from: u64,
    sequence: u8,
    /// A run has ended: by itself, or by a command.
    ended: bool,
    told: bool,
}

impl Tracking {
    pub(super) fn is_on(&self) -> bool {
        self.start_ns.is_some()
    }

    pub(super) fn end_was_told(&self) -> bool {
        self.ended && self.told
    }
}

impl NdiDevice {
    /// Produces the frames whose time has come; gives the time of the next.
    pub(super) fn produce_until(&mut self, now_ns: u64) -> u64 {
        let n_frames = self.replay.n_frames().max(1);
        while let Some(start_ns) = self.tracking.start_ns {
            let produced = self.log.run.frames_produced;
            let after = u128::from(produced) * 1000 * u128::from(SECOND_NS)
                / u128::from(self.rates.rate_mhz.max(1));
            let next_ns = start_ns.saturating_add(u64::try_from(after).unwrap_or(u64::MAX));
            if next_ns > now_ns {
                return next_ns;
            }
            if !self.settings.looping && produced >= n_frames {
                // The last frame could be had for as long as every other one.
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
            number: (self.log.total.frames_produced - self.tracking.counted_from) as u32,
            at_ns,
            time_ns: at_ns.saturating_sub(self.epoch_ns.unwrap_or(at_ns)),
            present: present as u32,
            fetched: false,
            fetched_new: false,
        });
        self.log.run.frames_produced += 1;
        self.log.total.frames_produced += 1;
    }

    /// The frame at hand can no longer be had.
    fn settle_current(&mut self) {
        let Some(frame) = self.tracking.current.take() else { return };
        let absent = self.tracking.row.len() as u64 - u64::from(frame.present);
        for counters in [&mut self.log.run, &mut self.log.total] {
            if frame.fetched {
                counters.samples += u64::from(frame.present);
                counters.samples_occluded += absent;
            } else {
                counters.frames_dropped += 1;
            }
        }
        if self.log_frames {
            self.log.frames.push(SentFrame {
                run: self.log.starts,
                seq: frame.number,
                device_ticks: frame.time_ns,
                present: frame.present,
                dropped: !frame.fetched,
                host_ns: frame.at_ns,
            });
        }
    }

    pub(super) fn end_run(&mut self) {
        self.settle_current();
        if self.tracking.start_ns.take().is_some() {
            self.log.ends += 1;
            (self.tracking.ended, self.tracking.told) = (true, false);
        }
    }

    /// The answer to a command about frames; empty when it is queued already. `None` for other commands.
    pub(super) fn report(
        &mut self,
        name: &str,
        args: &str,
        now_ns: u64,
    ) -> Option<Result<String, u8>> {
        if !matches!(name, "TSTART" | "TSTOP" | "TX" | "BX" | "BX2") || !self.initialized {
            return None;
        }
        // Frames that were due before the command can be had by it.
        self.produce_until(now_ns);
        let answer = match name {
            "TSTART" if self.is_running() => Err(WRONG_MODE),
            "TSTART" => self.start(args, now_ns),
            _ if !self.is_running() => {
                self.tracking.told = true;
                Err(WRONG_MODE)
            }
            "TSTOP" => {
                self.end_run();
                self.tracking.told = true;
                Ok("OKAY".to_owned())
            }
            "TX" => mode(args).map(|mode| {
                let first = self.fetch(false);
                let text = self.moment().tx(mode);
                self.outbox.put(first, |out| report::text(&text, out));
                String::new()
            }),
            "BX" => mode(args).map(|mode| {
                let first = self.fetch(false);
                self.put_binary(first, &self.moment().bx(mode))
            }),
            "BX2" if !self.settings.bx2 => Err(INVALID),
            _ => Wanted::of(args).ok_or(PARAMETERS).map(|wanted| self.bx2(wanted)),
        };
        if answer.is_err() {
            self.log.refused += u64::from(name == "TSTART");
        }
        Some(answer)
    }

    fn start(&mut self, args: &str, now_ns: u64) -> Result<String, u8> {
        match args {
            "" => {}
            RESET_COUNTER => self.tracking.counted_from = self.log.total.frames_produced,
            _ => return Err(PARAMETERS),
        }
        self.log.starts += 1;
        self.log.run = SentCounters::default();
        (self.tracking.ended, self.tracking.told) = (false, false);
        self.tracking.start_ns = Some(now_ns);
        self.produce_until(now_ns);
        Ok("OKAY".to_owned())
    }

    fn bx2(&mut self, wanted: Wanted) -> String {
        let is_new = self.tracking.current.is_some_and(|frame| !frame.fetched_new);
        let first = self.fetch(true);
        self.tracking.sequence = self.tracking.sequence.wrapping_add(u8::from(is_new));
        let moment = self.moment();
        let block = bx2(is_new.then_some(&moment), wanted, self.tracking.sequence);
        self.put_binary(first && is_new, &block)
    }

    /// Marks the frame at hand as fetched; whether it is for the first time.
    fn fetch(&mut self, by_bx2: bool) -> bool {
        let Some(frame) = &mut self.tracking.current else { return false };
        frame.fetched_new |= by_bx2;
        !std::mem::replace(&mut frame.fetched, true)
    }

    fn moment(&self) -> Moment<'_> {
        let (number, time_ns) = self.tracking.current.map_or((0, 0), |f| (f.number, f.time_ns));
        Moment { ports: &self.ports, row: &self.tracking.row, number, time_ns }
    }

    fn put_binary(&mut self, is_frame: bool, block: &[u8]) -> String {
        self.outbox.put(is_frame, |out| report::binary(block, out));
        String::new()
    }
}

/// Reply options, four digits; transforms and status when there are none.
fn mode(args: &str) -> Result<u16, u8> {
    if args.is_empty() { Ok(1) } else { u16::from_str_radix(args, 16).map_err(|_| PARAMETERS) }
}
