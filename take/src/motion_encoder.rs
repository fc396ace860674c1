//! Encodes frames as a take: the second half of an import.
//!
//! Every stretch is a key stretch, so each group of channels in each stretch is encoded independently, on any thread,
//! and the bytes do not depend on the number of threads. Where keys are chosen to be more than ten seconds apart,
//! stretches continue those before them, and one encoder has them all, in order. One stretch is read at a time, except
//! for a resampler that needs the whole take.

pub mod ordering;
mod parts;

use std::io::{self, Write};

use mocapd_codec::{
    BlockEncoder, BlockReport, Effort, GROUP_CHANNELS, Position, ResamplerKind, Settings,
};

use self::parts::StillSpans;
pub use self::{
    ordering::GroupOrder,
    parts::{EncodePart, EncodeParts},
};

use crate::{
    ChannelOrder, TakeError, TakeWriter,
    interchange::c3d,
    motion::{Foreign, FrameSource, Marker, MotionEvent, MotionInfo},
    record::{Channel, Event, Header, Ledger},
    sampled::{EncodedSpan, SamplesPlan},
    statistics::{BlockTally, StretchTally},
    stretch::{
        CHANNELS_MAX, LIVE_ROWS_MAX, NUMBERS, ROWS_MAX, SAMPLES_MAX, Span, StretchHeaderWriter,
        put_block,
    },
    timeline::Timeline,
};

/// Duration of an import's stretches, and so the distance between its key stretches, in seconds, unless the header
/// states a distance. Stretches in which nothing moves may be longer.
const STRETCH_S: f64 = 10.0;

/// Maximum number of samples of a take, missing ones included, whose channels are ordered: it is held in memory, with 13
/// bytes a sample, as many again for the room that growing buffers keep, and some 250 bytes for each channel of a part, 8
/// a sample. 2 097 152 samples take 71 MB at most; they are 5 minutes and 49 seconds of 50 markers at 120 Hz.
const ORDERED_SAMPLES_MAX: usize = 1 << 21;

/// Minimum number of rows of a stretch of such a take; of fewer, a channel of a part would take more memory than its
/// samples.
const ORDERED_ROWS_MIN: usize = 32;

/// Maximum number of channels of such a take: each encoding of a group is followed by one of the whole channel table, which
/// takes a millisecond for this many.
const ORDERED_CHANNELS_MAX: usize = 8 * GROUP_CHANNELS;

/// Rows of a stretch at `rate_hz`. A resampler that needs the whole take at once gets a single stretch.
#[must_use]
pub fn stretch_rows(codec: &Settings, rate_hz: f64, n_rows: usize, n_markers: usize) -> usize {
    if codec.kind.is_live() {
        let held = SAMPLES_MAX as usize / n_markers.max(1);
        ((STRETCH_S * rate_hz) as usize).min(held).clamp(1, LIVE_ROWS_MAX as usize)
    } else {
        n_rows.max(1)
    }
}

/// The channel table of these markers; a marker's id is its column.
#[must_use]
pub fn channels(markers: &[Marker]) -> Vec<Channel> {
    let channel = |(column, marker): (usize, &Marker)| Channel {
        marker_id: column as u16,
        label: marker.label.clone(),
        labelled: marker.labelled,
    };
    markers.iter().enumerate().map(channel).collect()
}

/// An encoded block, and what the encoder reports of each of its channels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EncodedPart {
    block: Vec<u8>,
    tally: BlockTally,
    /// One report per marker.
    pub reports: Vec<BlockReport>,
}

impl EncodedPart {
    /// Size of its block in bytes.
    #[must_use]
    pub fn n_bytes(&self) -> u64 {
        self.block.len() as u64
    }
}

/// The settings and shared bytes that all parts of one motion are encoded with.
#[derive(Debug)]
pub struct EncodePlan {
    n_rows: usize,
    n_markers: usize,
    codec: Settings,
    effort: Effort,
    /// Most rows of a part.
    part_rows: usize,
    /// Rows of a stretch that is not joined with others.
    stretch_rows: usize,
    /// Stretches from one key to the next.
    key_every: usize,
    shared: Vec<u8>,
}

impl EncodePlan {
    /// Plans the encoding of all frames of a source with the settings in `header`. Also returns the parts, which are
    /// read one stretch at a time, in the order in which [`MotionWriter::push`] expects them.
    ///
    /// # Errors
    /// `InvalidArgument` for more markers than a take can have, or more samples than a stretch of that resampler can
    /// hold; `Codec` when the codec rejects the input (`spline:exhaustive` on a long take); `Io` when the source fails.
    pub fn new<'f>(
        frames: &'f mut dyn FrameSource,
        header: &Header,
    ) -> Result<(Self, EncodeParts<'f>), TakeError> {
        let codec = header.codec()?;
        let info = frames.info();
        let n_markers = info.markers.len();
        let n_rows = usize::try_from(info.n_frames).unwrap_or(usize::MAX);
        if n_markers > CHANNELS_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "a take has at most {CHANNELS_MAX} markers, but the motion has {n_markers}"
            )));
        }
        let stretch_rows = stretch_rows(&codec, header.rate_hz, n_rows, n_markers);
        let stretch_rows = match header.key_rows() {
            Some(_) if header.has_long_keys() => header.stretch_rows.max(1) as usize,
            key_rows => key_rows.map_or(stretch_rows, |rows| stretch_rows.min(rows)),
        };
        if stretch_rows as u64 > ROWS_MAX || (stretch_rows * n_markers) as u64 > SAMPLES_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "{n_rows} frames of {n_markers} markers are too many for {}, which encodes them \
                 as a whole; use dense, fast or lossless",
                codec.kind
            )));
        }
        let still = StillSpans::of(header, &codec, n_markers);
        let part_rows = still.as_ref().map_or(0, StillSpans::rows_max).max(stretch_rows);
        let key_rows = header.key_rows().filter(|_| header.has_long_keys() && codec.kind.is_live());
        let key_every = key_rows.map_or(1, |rows| rows / stretch_rows).max(1);
        let mut parts = EncodeParts::new(frames, n_rows, stretch_rows, still, key_every);
        let mut shared = Vec::new();
        if !codec.kind.is_live() {
            shared = codec.plan(&parts.first_stretch()?)?;
        }
        let effort = header.effort();
        let plan =
            Self { n_rows, n_markers, codec, effort, part_rows, stretch_rows, key_every, shared };
        Ok((plan, parts))
    }

    /// Whether parts depend on those before them, so that [one encoder](Self::encoder) must encode them all, in order.
    #[must_use]
    pub fn is_sequential(&self) -> bool {
        self.key_every > 1
    }

    /// Memory that the samples of a part take, in bytes.
    #[must_use]
    pub fn part_bytes(&self) -> usize {
        let n_samples = self.part_rows.min(self.n_rows) * self.n_markers.min(GROUP_CHANNELS);
        n_samples * (size_of::<Position>() + size_of::<bool>())
    }

    /// Whether an order of the channels is searched for: with `dense` at the greatest effort, for as many samples as may
    /// be in memory, and where a channel can be predicted from others.
    #[must_use]
    pub fn searches_order(&self) -> bool {
        self.codec.kind == ResamplerKind::Dense
            && self.effort == Effort::MAX
            && (3..=ORDERED_CHANNELS_MAX).contains(&self.n_markers)
            && self.stretch_rows.min(self.n_rows) >= ORDERED_ROWS_MIN
            && self.n_rows.saturating_mul(self.n_markers) <= ORDERED_SAMPLES_MAX
    }

    /// Size in bytes of a take whose channels are in `order`, without their samples and foreign parts.
    ///
    /// # Errors
    /// Those of [`MotionWriter`].
    fn table_bytes(
        &self,
        described: (&MotionInfo, &Header),
        order: &ChannelOrder,
    ) -> Result<u64, TakeError> {
        Ok(MotionWriter::begin_in(self, described, order.clone(), io::sink())?.finish()?.2)
    }

    /// Size in bytes of a take with these parts, whose channels are in `order`, and of its foreign parts those that depend
    /// on the order.
    ///
    /// # Errors
    /// Those of [`MotionWriter`].
    fn ordered_bytes<'p>(
        &self,
        (info, header): (&MotionInfo, &Header),
        order: &ChannelOrder,
        parts: impl IntoIterator<Item = (&'p EncodePart, &'p EncodedPart)>,
    ) -> Result<u64, TakeError> {
        let mut writer = MotionWriter::begin_in(self, (info, header), order.clone(), io::sink())?;
        for part in info.foreign.iter().filter(|part| c3d::is_by_marker(part)) {
            let moved = writer.ordered(part)?;
            writer.take.foreign(moved.as_ref().unwrap_or(part))?;
        }
        parts.into_iter().try_for_each(|(part, coded)| writer.push(part, coded))?;
        Ok(writer.finish()?.2)
    }

    /// An encoder of parts. Each thread needs its own.
    #[must_use]
    pub fn encoder(&self) -> PartEncoder<'_> {
        self.encoder_with(self.effort)
    }

    /// An encoder of parts like [`encoder`](Self::encoder), with another effort.
    #[must_use]
    fn encoder_with(&self, effort: Effort) -> PartEncoder<'_> {
        PartEncoder { plan: self, effort, encoders: Vec::new() }
    }
}

/// Encodes parts, in any order unless the plan [is sequential](EncodePlan::is_sequential).
#[derive(Debug)]
pub struct PartEncoder<'a> {
    plan: &'a EncodePlan,
    effort: Effort,
    /// One for each group of channels if parts continue those before them; else one for all.
    encoders: Vec<Box<dyn BlockEncoder>>,
}

impl PartEncoder<'_> {
    /// Encodes a part as a block, a key block unless it continues a part before it.
    ///
    /// # Errors
    /// `Codec`.
    pub fn encode(&mut self, part: &EncodePart) -> Result<EncodedPart, TakeError> {
        self.encode_in(part, None)
    }

    /// Encodes a part like [`encode`](Self::encode), with its channels in another order.
    ///
    /// # Errors
    /// `Codec`.
    pub fn encode_in(
        &mut self,
        part: &EncodePart,
        order: Option<&GroupOrder>,
    ) -> Result<EncodedPart, TakeError> {
        // Key parts need nothing of those before them.
        let continues = self.plan.is_sequential();
        let group = if continues { part.first_marker / GROUP_CHANNELS } else { 0 };
        self.encode_with(group, part, part.key, order)
    }

    /// Encodes a part as a key block, with its channels in another order.
    ///
    /// # Errors
    /// `Codec`.
    fn encode_key(
        &mut self,
        part: &EncodePart,
        order: &GroupOrder,
    ) -> Result<EncodedPart, TakeError> {
        self.encode_with(0, part, true, Some(order))
    }

    /// Encodes a part with the encoder of this number.
    fn encode_with(
        &mut self,
        number: usize,
        part: &EncodePart,
        key: bool,
        order: Option<&GroupOrder>,
    ) -> Result<EncodedPart, TakeError> {
        let mut coded = EncodedPart::default();
        if part.n_markers > 0 {
            coded.reports.resize(part.n_markers, BlockReport::default());
            let mut channels = part.rows()?;
            if let Some(order) = order {
                let rows = order.iter().filter_map(|&channel| channels.get(usize::from(channel)));
                channels = rows.copied().collect();
            }
            let EncodedPart { block, tally, reports } = &mut coded;
            let plan = self.plan;
            let new = || plan.codec.encoder_with(self.effort);
            if self.encoders.len() <= number {
                self.encoders.resize_with(number + 1, new);
            }
            let Some(encoder) = self.encoders.get_mut(number) else { return Ok(coded) };
            encoder.encode(&channels, &plan.shared, key, block, reports)?;
            *tally = BlockTally::of_encoded(block, &channels, reports, encoder.kept_rows());
        }
        Ok(coded)
    }
}

/// Writes the encoded parts of a plan as a take.
#[derive(Debug)]
pub struct MotionWriter<'a, W> {
    plan: &'a EncodePlan,
    take: TakeWriter<W>,
    order: ChannelOrder,
    front: StretchHeaderWriter,
    payload: Vec<u8>,
    tally: BlockTally,
    n_samples: u64,
}

impl<'a, W: Write> MotionWriter<'a, W> {
    /// Writes the header, and of `info` the subject, the foreign parts and the events.
    ///
    /// # Errors
    /// Those of [`begin`](Self::begin), [`TakeWriter::foreign`] and [`push_events`](Self::push_events).
    pub fn new(
        plan: &'a EncodePlan,
        info: &MotionInfo,
        header: &Header,
        out: W,
    ) -> Result<Self, TakeError> {
        Self::new_in(plan, (info, header), ChannelOrder::default(), out)
    }

    /// Writes what [`new`](Self::new) does, of a take whose parts were encoded with their channels in `order`, as
    /// [`begin_in`](Self::begin_in).
    pub(crate) fn new_in(
        plan: &'a EncodePlan,
        (info, header): (&MotionInfo, &Header),
        order: ChannelOrder,
        out: W,
    ) -> Result<Self, TakeError> {
        let mut writer = Self::begin_in(plan, (info, header), order, out)?;
        for part in &info.foreign {
            let moved = writer.ordered(part)?;
            writer.take.foreign(moved.as_ref().unwrap_or(part))?;
        }
        writer.push_events(&info.events)?;
        Ok(writer)
    }

    /// Writes the header, and of `info` the subject. The caller writes the foreign parts and the events next.
    ///
    /// # Errors
    /// Those of [`TakeWriter::new`] and [`TakeWriter::subject`].
    pub fn begin(
        plan: &'a EncodePlan,
        info: &MotionInfo,
        header: &Header,
        out: W,
    ) -> Result<Self, TakeError> {
        Self::begin_in(plan, (info, header), ChannelOrder::default(), out)
    }

    /// Begins a take like [`begin`](Self::begin), whose parts were encoded with their channels in `order`. `header` has
    /// them in that of the source.
    ///
    /// # Errors
    /// Those of [`begin`](Self::begin).
    pub fn begin_in(
        plan: &'a EncodePlan,
        (info, header): (&MotionInfo, &Header),
        order: ChannelOrder,
        out: W,
    ) -> Result<Self, TakeError> {
        let mut header = header.clone();
        order.apply_to_table(&mut header.channels);
        let mut take = TakeWriter::new(out, &header)?;
        info.subject.iter().try_for_each(|subject| take.subject(subject))?;
        take.order(&order)?;
        Ok(Self::continuing(plan, &header, order, take))
    }

    /// Continues a take of which everything that precedes its stretches is written.
    pub(crate) fn continuing(
        plan: &'a EncodePlan,
        header: &Header,
        order: ChannelOrder,
        take: TakeWriter<W>,
    ) -> Self {
        let front = StretchHeaderWriter::new(header.stretch_rows);
        let (payload, tally) = (Vec::new(), BlockTally::default());
        Self { plan, take, order, front, payload, tally, n_samples: 0 }
    }

    /// The take, to write what follows its stretches.
    pub(crate) fn into_take(self) -> TakeWriter<W> {
        self.take
    }

    /// A foreign part that has something for each marker, in the order in which the markers are coded; `None` for one that
    /// stays as it is.
    ///
    /// # Errors
    /// Those of the scratch file that the part may be in.
    pub fn ordered(&self, part: &Foreign) -> Result<Option<Foreign>, TakeError> {
        Ok(c3d::reordered(part, &self.order)?)
    }

    /// Writes a foreign part. Of one with samples it writes the description, and returns what is to be encoded: the
    /// caller [writes](Self::push_span) all spans of it, before the next part.
    ///
    /// # Errors
    /// Those of [`TakeWriter::foreign`].
    pub fn push_foreign<'p>(
        &mut self,
        part: &'p Foreign,
    ) -> Result<Option<SamplesPlan<'p>>, TakeError> {
        let plan = self.take.plan_samples(part)?;
        if plan.is_none() {
            self.take.foreign(part)?;
        }
        Ok(plan)
    }

    /// Writes the next span of a foreign part.
    ///
    /// # Errors
    /// Those of [`TakeWriter::span`].
    pub fn push_span(&mut self, encoded: &EncodedSpan) -> Result<(), TakeError> {
        self.take.span(encoded)
    }

    /// Writes the events of the motion, after its foreign parts.
    ///
    /// # Errors
    /// Those of [`TakeWriter::event`].
    pub fn push_events(&mut self, events: &[MotionEvent]) -> Result<(), TakeError> {
        for MotionEvent { frame, kind, text } in events {
            let (row, kind, text) = (*frame, *kind, text.clone());
            self.take.event(&Event { kind, row, device_ticks: 0, host_ns: 0, input: 0, text })?;
        }
        Ok(())
    }

    /// Writes the next part, in the order of [`EncodeParts`].
    ///
    /// # Errors
    /// Those of [`TakeWriter::stretch`].
    pub fn push(&mut self, part: &EncodePart, coded: &EncodedPart) -> Result<(), TakeError> {
        let n_markers = self.plan.n_markers;
        let alone = n_markers <= GROUP_CHANNELS;
        let number = (part.stretch % usize::from(NUMBERS)) as u8;
        let (first_row, n_rows) = (part.first_row as u64, part.n_rows as u32);
        let span = Span { first_row, n_rows, key: part.key, number };
        if part.first_marker == 0 {
            self.payload.clear();
            self.tally.restart(part.n_rows);
            let shared = &self.plan.shared;
            self.front.put(span, &Timeline::default(), shared, alone, &mut self.payload);
        }
        put_block(&coded.block, alone, &mut self.payload);
        self.tally.append(&coded.tally);
        self.n_samples += coded.reports.iter().map(|report| u64::from(report.samples)).sum::<u64>();
        if part.first_marker + part.n_markers == n_markers {
            self.take.stretch(span, &self.payload, &StretchTally::of(&self.tally))?;
        }
        Ok(())
    }

    /// Closes the take. Returns its ledger, the output and the number of bytes written.
    ///
    /// # Errors
    /// Those of [`TakeWriter::finish`].
    pub fn finish(self) -> Result<(Ledger, W, u64), TakeError> {
        let n_rows = self.plan.n_rows as u64;
        let announced = n_rows * self.plan.n_markers as u64;
        let ledger = Ledger {
            finished: true,
            frames_sent: n_rows,
            recorded: n_rows,
            samples_announced: announced,
            samples_present: self.n_samples,
            samples_occluded: announced - self.n_samples,
            ..Ledger::default()
        };
        let (out, bytes) = self.take.finish(&ledger)?;
        Ok((ledger, out, bytes))
    }
}
