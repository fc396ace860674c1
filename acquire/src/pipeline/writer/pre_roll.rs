//! The pre-roll buffer: encoded stretches kept in memory for a take that begins later.

use std::{collections::VecDeque, time::Duration};

use mocapd_take::{record::Event, stretch::Span};

use crate::pipeline::{
    Counts, PreRollConfig,
    messages::{FrameTimes, SamplePart, StretchEnd, StretchReport},
};

/// Events kept with the stretches: as many as may wait for the writer. Beyond this, the oldest are dropped.
const EVENTS_MAX: usize = 1024;

/// An encoded stretch.
#[derive(Debug)]
pub(super) struct PreRollStretch {
    pub(super) stretch: u64,
    pub(super) span: Span,
    pub(super) first: FrameTimes,
    pub(super) last_arrival_ns: u64,
    pub(super) payload: Box<[u8]>,
    pub(super) report: StretchReport,
    /// The counters before it, and at its end.
    pub(super) before: Counts,
    pub(super) after: Counts,
}

impl PreRollStretch {
    /// Memory used by the stretch.
    fn bytes(&self) -> usize {
        self.payload.len() + self.report.tally.heap_bytes() + size_of::<Self>()
    }
}

/// The newest stretches, beginning with a key stretch.
#[derive(Debug)]
pub(super) struct PreRollBuffer {
    time_ns: u64,
    bytes_max: usize,
    stretches: VecDeque<PreRollStretch>,
    events: VecDeque<(u64, Event)>,
    /// Samples of sampled channels, by group in order of their stretches.
    samples: VecDeque<SamplePart>,
    sample_bytes: usize,
    bytes: usize,
    /// Whether stretches were dropped early because of the memory limit.
    cut: bool,
}

impl PreRollBuffer {
    pub(super) fn new(config: PreRollConfig) -> Self {
        // Two stretches per second, and those up to the next key.
        let usual = 2 * config.time.as_secs().min(600) as usize + 32;
        Self {
            time_ns: u64::try_from(config.time.as_nanos()).unwrap_or(u64::MAX),
            bytes_max: config.bytes_max,
            stretches: VecDeque::with_capacity(usual),
            events: VecDeque::with_capacity(EVENTS_MAX),
            samples: VecDeque::with_capacity(usual),
            sample_bytes: 0,
            bytes: 0,
            cut: false,
        }
    }

    pub(super) fn push(
        &mut self,
        stretch: u64,
        end: &StretchEnd,
        payload: &[u8],
        report: &StretchReport,
        (before, after): (Counts, Counts),
    ) {
        // A decoder can start only at a key.
        if self.stretches.is_empty() && !end.span.key {
            self.drop_samples(stretch + 1);
            return;
        }
        let kept = PreRollStretch {
            stretch,
            span: end.span,
            first: end.first,
            last_arrival_ns: end.last_arrival_ns,
            payload: payload.into(),
            report: report.clone(),
            before,
            after,
        };
        self.bytes += kept.bytes();
        self.stretches.push_back(kept);
        self.trim(end.last_arrival_ns, stretch);
    }

    /// Keeps samples of sampled channels.
    pub(super) fn samples(&mut self, part: SamplePart) {
        self.bytes += part.bytes();
        self.sample_bytes += part.bytes();
        self.samples.push_back(part);
        self.evict_samples();
    }

    /// Drops the oldest samples while they need more than half of the memory: frames are kept before them. While no frame
    /// comes, no stretch does either, and nothing else drops them.
    fn evict_samples(&mut self) {
        while self.sample_bytes > self.bytes_max / 2
            && let Some(oldest) = self.samples.pop_front()
        {
            self.bytes -= oldest.bytes();
            self.sample_bytes -= oldest.bytes();
            self.cut = true;
        }
    }

    /// The samples of stretches from `stretch` on.
    pub(super) fn samples_from(&self, stretch: u64) -> impl Iterator<Item = &SamplePart> {
        self.samples.iter().filter(move |part| part.stretch >= stretch)
    }

    /// Drops the samples of stretches before `stretch`.
    fn drop_samples(&mut self, stretch: u64) {
        while let Some(part) = self.samples.pop_front_if(|part| part.stretch < stretch) {
            self.bytes -= part.bytes();
            self.sample_bytes -= part.bytes();
        }
    }

    pub(super) fn event(&mut self, stretch: u64, event: Event) {
        if self.events.len() == EVENTS_MAX {
            self.events.pop_front();
        }
        self.events.push_back((stretch, event));
    }

    /// Index of the first stretch for a take with `pre_roll` before `now_ns`: the last key that is old enough, but
    /// nothing from before an outage that had begun by then.
    pub(super) fn start_of(&self, pre_roll: Duration, now_ns: u64) -> usize {
        if pre_roll.is_zero() {
            return self.stretches.len();
        }
        let pre_roll_ns = u64::try_from(pre_roll.as_nanos()).unwrap_or(u64::MAX);
        let from_ns = now_ns.saturating_sub(pre_roll_ns);
        // Nothing is recent enough: the device was disconnected.
        if self.stretches.back().is_none_or(|newest| newest.last_arrival_ns < from_ns) {
            return self.stretches.len();
        }
        let old_enough = |kept: &PreRollStretch| kept.span.key && kept.first.arrival_ns <= from_ns;
        let Some(at) = self.stretches.iter().rposition(old_enough) else { return 0 };
        // All stretches of that key may be older than requested.
        let next_key = self.stretches.iter().skip(at + 1).position(|kept| kept.span.key);
        let next_key = next_key.map(|after| at + 1 + after);
        let end = next_key.unwrap_or(self.stretches.len());
        let reaches_into = |kept: &PreRollStretch| kept.last_arrival_ns >= from_ns;
        let is_needed = self.stretches.range(at..end).any(reaches_into);
        if is_needed { at } else { end }
    }

    pub(super) fn from(&self, at: usize) -> impl Iterator<Item = &PreRollStretch> {
        self.stretches.iter().skip(at)
    }

    pub(super) fn events(&self) -> impl Iterator<Item = &(u64, Event)> {
        self.events.iter()
    }

    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    pub(super) fn is_cut(&self) -> bool {
        self.cut
    }

    /// Time in seconds from the first frame to the last.
    pub(super) fn seconds(&self) -> f64 {
        let ends = (self.stretches.front(), self.stretches.back());
        let (Some(first), Some(last)) = ends else { return 0.0 };
        last.last_arrival_ns.saturating_sub(first.first.arrival_ns) as f64 * 1e-9
    }

    /// Drops stretches that are older than configured, up to a key at a time.
    fn trim(&mut self, newest_ns: u64, newest: u64) {
        let from_ns = newest_ns.saturating_sub(self.time_ns);
        self.evict_samples();
        let mut over = self.bytes > self.bytes_max;
        while let Some(next_key) = self.next_key() {
            let is_old = self.stretches[next_key].first.arrival_ns <= from_ns;
            if !is_old && !over {
                break;
            }
            self.cut |= !is_old;
            self.drop_first(next_key);
            let first = self.stretches.front().map_or(newest + 1, |kept| kept.stretch);
            self.drop_samples(first);
            over = self.bytes > self.bytes_max;
        }
        if over {
            // The stretches since the last key alone exceed the limit: nothing can be kept before the next key.
            self.cut = true;
            self.drop_first(self.stretches.len());
        }
        let first = self.stretches.front().map_or(newest + 1, |kept| kept.stretch);
        self.drop_samples(first);
        let first = self.stretches.front().map_or(u64::MAX, |kept| kept.stretch);
        while self.events.front().is_some_and(|(stretch, _)| *stretch < first) {
            self.events.pop_front();
        }
    }

    fn next_key(&self) -> Option<usize> {
        self.stretches.iter().skip(1).position(|kept| kept.span.key).map(|at| at + 1)
    }

    fn drop_first(&mut self, n: usize) {
        self.bytes -= self.stretches.drain(..n).map(|kept| kept.bytes()).sum::<usize>();
    }
}
