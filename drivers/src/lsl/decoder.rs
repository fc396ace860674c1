//! Decodes the feed of one stream into frames, samples or events.

use super::{
    description::StreamDescription,
    layout::{GroupLayout, MarkerColumns, StreamRole, TICK_HZ},
    values::{FeedDamage, TEXT_BYTES_MAX, ValueFormat, WireFormat, WireSample},
};
use crate::axis::{SampleAxis, Stamp};
use crate::{
    device::{DeviceEvent, Frame, Mark, MarkerSample, SampleBatch},
    link::SAMPLE_VALUES_MAX,
};

/// Receiver of the decoded events.
pub(super) type EventReceiver<'a> = &'a mut dyn FnMut(DeviceEvent<'_>);

/// Bytes of a sample that has not arrived in full, at most: a text of the greatest length among others.
const PARTIAL_BYTES_MAX: usize = 2 * TEXT_BYTES_MAX;

/// Longest text of an event, in characters.
const MARK_CHARS_MAX: usize = 1024;

/// A time stamp further than this from where the batch leads begins another batch, which has its own.
const BATCH_JITTER_S: f64 = 1e-3;

/// Samples of a group that have not been passed on.
#[derive(Debug, Default)]
struct OpenBatch {
    /// Batches passed on.
    number: u32,
    first: u64,
    /// When the first one was taken.
    time_s: f64,
    ticks: u64,
    samples: Vec<f32>,
}

/// What a stream has sent since the start.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct StreamCounts {
    /// Samples decoded.
    pub(super) samples: u64,
    /// Number of the first one and of the one after the last, missing ones included.
    first: Option<u64>,
    next: u64,
    /// Values that float32 does not have.
    pub(super) rounded: u64,
    /// Time stamps that are negative or no numbers.
    pub(super) bad_stamps: u64,
    /// Texts that were cut off.
    pub(super) cut_texts: u64,
}

/// The feed of one stream.
#[derive(Debug)]
pub(super) struct StreamDecoder {
    role: StreamRole,
    /// How many samples a frame has, if they are frames.
    frame_every: Option<u64>,
    format: ValueFormat,
    n_channels: usize,
    /// `None` until the feed is open.
    wire: Option<WireFormat>,
    bytes: Vec<u8>,
    read_ns: u64,
    /// The line's clock when they came.
    received_ns: u64,
    axis: SampleAxis,
    period_s: f64,
    /// The last time stamp: the one of a sample without is a period later, if the stream itself states a rate.
    last_s: f64,
    deduced_s: f64,
    newest_s: Option<f64>,
    /// Whether a note said that its time stamps are of another clock.
    pub(super) is_clock_noted: bool,
    last_ticks: u64,
    batches: Vec<OpenBatch>,
    markers: Vec<MarkerSample>,
    pub(super) counts: StreamCounts,
    missing_before: u64,
    /// Positions that were infinite, over all runs.
    pub(super) not_finite: u64,
}

impl StreamDecoder {
    pub(super) fn new(
        role: StreamRole,
        frame_every: Option<u64>,
        description: &StreamDescription,
    ) -> Self {
        let (n_groups, rate_millihertz, is_regular) = match &role {
            StreamRole::Events => (0, 0, false),
            StreamRole::Numbers { groups, rate_millihertz, is_regular, .. } => {
                (groups.len(), *rate_millihertz, *is_regular)
            }
        };
        let period_s = if rate_millihertz > 0 { 1000.0 / f64::from(rate_millihertz) } else { 0.0 };
        Self {
            role,
            frame_every,
            format: description.format,
            n_channels: description.n_channels,
            wire: None,
            bytes: Vec::new(),
            read_ns: 0,
            received_ns: 0,
            axis: SampleAxis::new(is_regular.then_some(period_s)),
            period_s,
            last_s: 0.0,
            deduced_s: if is_regular { period_s } else { 0.0 },
            newest_s: None,
            is_clock_noted: false,
            last_ticks: 0,
            batches: (0..n_groups).map(|_| OpenBatch::default()).collect(),
            markers: Vec::new(),
            counts: StreamCounts::default(),
            missing_before: 0,
            not_finite: 0,
        }
    }

    /// Whether it decodes what a stream with this role and description sends.
    pub(super) fn is_for(
        &self,
        role: &StreamRole,
        frame_every: Option<u64>,
        description: &StreamDescription,
    ) -> bool {
        (&self.role, self.frame_every) == (role, frame_every)
            && (self.format, self.n_channels) == (description.format, description.n_channels)
    }

    /// Whether its samples are frames.
    pub(super) fn has_frames(&self) -> bool {
        self.frame_every.is_some()
    }

    /// A run begins: counts start from zero.
    pub(super) fn begin(&mut self) {
        self.counts = StreamCounts::default();
        self.missing_before = self.axis.missing();
    }

    /// Frames missing in this run, outages apart. Of frames of several samples it is not known: they count as not received.
    pub(super) fn missing(&self) -> u64 {
        if self.frame_every == Some(1) { self.axis.missing() - self.missing_before } else { 0 }
    }

    /// Frames of this run, missing ones included.
    pub(super) fn produced(&self) -> u64 {
        let every = self.frame_every.unwrap_or(1);
        let Some(first) = self.counts.first else { return 0 };
        self.counts.next.div_ceil(every).saturating_sub(first.div_ceil(every))
    }

    /// The newest time stamp that the last bytes completed.
    pub(super) fn newest_s(&self) -> Option<f64> {
        self.newest_s
    }

    /// Whether its feed is open.
    pub(super) fn is_open(&self) -> bool {
        self.wire.is_some()
    }

    /// The connection was lost.
    pub(super) fn close(&mut self) {
        self.wire = None;
        self.bytes.clear();
        self.axis.rejoin();
    }

    /// The feed is open.
    pub(super) fn open(&mut self, is_big_endian: bool) {
        self.bytes.clear();
        self.last_s = 0.0;
        let (format, n_channels) = (self.format, self.n_channels);
        self.wire = Some(WireFormat { format, n_channels, is_big_endian });
    }

    /// Decodes bytes of the feed, read at this time of the host's clock, and received at this time of the line's. On an error the feed is lost: nothing marks where the next sample begins.
    pub(super) fn receive(
        &mut self,
        bytes: &[u8],
        (read_ns, received_ns): (u64, u64),
        on_event: EventReceiver<'_>,
    ) -> Result<(), String> {
        (self.read_ns, self.received_ns) = (read_ns, received_ns);
        self.bytes.extend_from_slice(bytes);
        self.newest_s = None;
        self.decode(true, on_event)?;
        if self.bytes.len() > PARTIAL_BYTES_MAX {
            return Err(format!("it sends a sample of more than {PARTIAL_BYTES_MAX} bytes"));
        }
        Ok(())
    }

    /// Passes on a sample that waits for the one after it.
    pub(super) fn flush(&mut self, on_event: EventReceiver<'_>) -> Result<(), String> {
        self.decode(false, on_event)
    }

    /// Whether a sample waits longer than the next one can take to come; `now_ns` is the line's clock.
    pub(super) fn is_waiting_since(&self, now_ns: u64) -> bool {
        let periods_ns = (4.0 * self.period_s * 1e9) as u64;
        !self.bytes.is_empty()
            && now_ns.saturating_sub(self.received_ns) > periods_ns.max(50_000_000)
    }

    fn decode(&mut self, may_wait: bool, on_event: EventReceiver<'_>) -> Result<(), String> {
        let Some(wire) = self.wire else {
            self.bytes.clear();
            return Ok(());
        };
        // Taken out while its samples are passed on.
        let bytes = std::mem::take(&mut self.bytes);
        let mut at = 0;
        let outcome = loop {
            let rest = bytes.get(at..).unwrap_or_default();
            match wire.sample(rest) {
                Ok(Some((sample, used))) => {
                    let time_s = sample.time_s.unwrap_or(self.last_s + self.deduced_s);
                    let stamp = Stamp { time_s, read_ns: self.read_ns };
                    let deduced_s = self.deduced_s;
                    let following = || {
                        let (next, _) = wire.sample(rest.get(used..)?).ok()??;
                        Some(next.time_s.unwrap_or(time_s + deduced_s))
                    };
                    let Some(number) = self.axis.number(stamp, following, may_wait) else {
                        break Ok(());
                    };
                    at += used;
                    self.last_s = time_s;
                    self.newest_s =
                        Some(time_s).filter(|time_s| time_s.is_finite()).or(self.newest_s);
                    self.counts.samples += 1;
                    self.counts.first.get_or_insert(number);
                    self.counts.next = number + 1;
                    let ticks = self.ticks(time_s);
                    self.emit(&sample, number, (time_s, ticks), on_event);
                }
                Ok(None) => break Ok(()),
                Err(FeedDamage::Tag(tag)) => break Err(format!("it sends no sample (byte {tag})")),
                Err(FeedDamage::Length(n)) => break Err(format!("it sends a text of {n} bytes")),
            }
        };
        self.bytes = bytes;
        self.bytes.drain(..at);
        self.pass_batches_on(on_event);
        outcome
    }

    fn ticks(&mut self, time_s: f64) -> u64 {
        let ticks = (time_s * TICK_HZ as f64).round();
        if (0.0..u64::MAX as f64).contains(&ticks) {
            self.last_ticks = ticks as u64;
        } else {
            self.counts.bad_stamps += 1;
        }
        self.last_ticks
    }

    fn emit(
        &mut self,
        sample: &WireSample<'_>,
        number: u64,
        (time_s, ticks): (f64, u64),
        on_event: EventReceiver<'_>,
    ) {
        let StreamRole::Numbers { markers, groups, .. } = &self.role else {
            let text = sample.text();
            let one_line: String = text
                .chars()
                .map(|c| if c.is_control() { ' ' } else { c })
                .take(MARK_CHARS_MAX)
                .collect();
            self.counts.cut_texts += u64::from(text.chars().nth(MARK_CHARS_MAX).is_some());
            on_event(DeviceEvent::Mark(Mark { device_ticks: ticks, text: &one_line }));
            return;
        };
        if let Some(every) = self.frame_every.filter(|every| number.is_multiple_of(*every)) {
            self.markers.clear();
            for (id, marker) in markers.iter().enumerate() {
                let marker = position(sample, id as u16, marker, &mut self.not_finite);
                self.markers.push(marker);
            }
            on_event(DeviceEvent::Frame(Frame {
                seq: (number / every) as u32,
                device_ticks: ticks,
                timecode: None,
                markers: &self.markers,
            }));
        }
        for (group, batch) in groups.iter().zip(&mut self.batches) {
            let n = batch.samples.len() / group.columns.len().max(1);
            let expected_s = batch.time_s + n as f64 * self.period_s;
            let continues = number == batch.first + n as u64
                && (time_s - expected_s).abs() <= BATCH_JITTER_S
                && batch.samples.len() + group.columns.len() <= SAMPLE_VALUES_MAX;
            if !continues {
                batch.pass_on(group, on_event);
            }
            if batch.samples.is_empty() {
                (batch.first, batch.time_s, batch.ticks) = (number, time_s, ticks);
            }
            for &column in &group.columns {
                let Some(value) = sample.value(column) else { continue };
                self.counts.rounded += u64::from(value.is_rounded());
                batch.samples.push(value.to_f32());
            }
        }
    }

    fn pass_batches_on(&mut self, on_event: EventReceiver<'_>) {
        if let StreamRole::Numbers { groups, .. } = &self.role {
            for (group, batch) in groups.iter().zip(&mut self.batches) {
                batch.pass_on(group, on_event);
            }
        }
    }
}

/// The position of a marker; NaN is how streams say that they do not see it.
fn position(
    sample: &WireSample<'_>,
    id: u16,
    marker: &MarkerColumns,
    not_finite: &mut u64,
) -> MarkerSample {
    let position_mm = marker
        .columns
        .map(|column| sample.value(column).map_or(f32::NAN, |value| value.scaled(marker.factor)));
    let is_finite = position_mm.iter().all(|value| value.is_finite());
    let is_missing = position_mm.iter().any(|value| value.is_nan());
    *not_finite += u64::from(!is_finite && !is_missing);
    MarkerSample {
        id,
        occluded: !is_finite,
        residual_10um: 0,
        position_mm: if is_finite { position_mm } else { [0.0; 3] },
    }
}

impl OpenBatch {
    fn pass_on(&mut self, group: &GroupLayout, on_event: EventReceiver<'_>) {
        if self.samples.is_empty() {
            return;
        }
        on_event(DeviceEvent::Samples(SampleBatch {
            group: group.info.id,
            number: self.number,
            first: self.first,
            device_ticks: self.ticks,
            form: group.info.form,
            n_channels: group.columns.len() as u8,
            samples: &self.samples,
        }));
        self.number = self.number.wrapping_add(1);
        self.samples.clear();
    }
}
