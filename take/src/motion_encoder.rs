//! Encodes trajectories in memory as a take: the second half of an import.
//!
//! Every stretch is a key stretch, so each group of channels in each stretch is encoded independently, on any thread,
//! and the bytes do not depend on the number of threads.

use std::io::Write;

use mocapd_codec::{
    BlockEncoder, BlockReport, CodecError, GROUP_CHANNELS, Position, Rows, Settings,
};

use crate::{
    TakeError, TakeWriter,
    motion::{Marker, Motion, MotionEvent, is_gap},
    record::{Channel, Event, Header, Ledger},
    statistics::{BlockTally, StretchTally},
    stretch::{
        CHANNELS_MAX, LIVE_ROWS_MAX, NUMBERS, ROWS_MAX, SAMPLES_MAX, Span, StretchHeaderWriter,
        put_block,
    },
    timeline::Timeline,
};

/// Duration of an import's stretches, and so the distance between its key stretches, in seconds.
const STRETCH_S: f64 = 10.0;

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

/// One group of channels over one stretch: the unit that is encoded independently.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EncodePart {
    /// First row.
    pub first_row: usize,
    /// Number of rows.
    pub n_rows: usize,
    /// Column of the first marker.
    pub first_marker: usize,
    /// Number of markers.
    pub n_markers: usize,
}

/// An encoded block, and what the encoder reports of each of its channels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EncodedPart {
    block: Vec<u8>,
    tally: BlockTally,
    /// One report per marker.
    pub reports: Vec<BlockReport>,
}

/// The settings and shared bytes that all parts of one motion are encoded with.
#[derive(Debug)]
pub struct EncodePlan<'a> {
    motion: &'a Motion,
    codec: Settings,
    stretch_rows: usize,
    shared: Vec<u8>,
}

impl<'a> EncodePlan<'a> {
    /// Plans the encoding of `motion` with the settings in `header`.
    ///
    /// # Errors
    /// `InvalidArgument` for more markers than a take can have, or more samples than a stretch of that resampler can
    /// hold; `Codec` when the codec rejects the input (`spline:exhaustive` on a long take).
    pub fn new(motion: &'a Motion, header: &Header) -> Result<Self, TakeError> {
        let codec = header.codec()?;
        let (n_rows, n_markers) = (motion.n_frames(), motion.info.markers.len());
        if n_markers > CHANNELS_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "a take has at most {CHANNELS_MAX} markers, but the motion has {n_markers}"
            )));
        }
        let stretch_rows = stretch_rows(&codec, header.rate_hz, n_rows, n_markers);
        if stretch_rows as u64 > ROWS_MAX || (stretch_rows * n_markers) as u64 > SAMPLES_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "{n_rows} frames of {n_markers} markers are too many for {}, which encodes them \
                 as a whole; use dense, fast or lossless",
                codec.kind
            )));
        }
        let shared = shared(motion, &codec)?;
        Ok(Self { motion, codec, stretch_rows, shared })
    }

    /// The parts, in the order in which [`MotionWriter::push`] expects them.
    pub fn parts(&self) -> impl Iterator<Item = EncodePart> + use<> {
        let (n_rows, n_markers) = (self.motion.n_frames(), self.motion.info.markers.len());
        let stretch_rows = self.stretch_rows;
        (0..n_rows).step_by(stretch_rows).flat_map(move |first_row| {
            // A take without markers still has its stretches.
            (0..n_markers.max(1)).step_by(GROUP_CHANNELS).map(move |first_marker| EncodePart {
                first_row,
                n_rows: stretch_rows.min(n_rows - first_row),
                first_marker,
                n_markers: GROUP_CHANNELS.min(n_markers - first_marker),
            })
        })
    }

    /// An encoder of parts. Each thread needs its own.
    #[must_use]
    pub fn encoder(&self) -> PartEncoder<'_> {
        PartEncoder { plan: self, encoder: self.codec.encoder(), columns: ColumnBuffer::default() }
    }
}

/// Encodes parts, in any order.
#[derive(Debug)]
pub struct PartEncoder<'a> {
    plan: &'a EncodePlan<'a>,
    encoder: Box<dyn BlockEncoder>,
    columns: ColumnBuffer,
}

impl PartEncoder<'_> {
    /// Encodes a part as a key block.
    ///
    /// # Errors
    /// `Codec`.
    pub fn encode(&mut self, part: EncodePart) -> Result<EncodedPart, TakeError> {
        self.columns.fill(self.plan.motion, part);
        let mut coded = EncodedPart::default();
        if part.n_markers > 0 {
            coded.reports.resize(part.n_markers, BlockReport::default());
            let channels = self.columns.rows()?;
            let EncodedPart { block, tally, reports } = &mut coded;
            self.encoder.encode(&channels, &self.plan.shared, true, block, reports)?;
            *tally = BlockTally::of_encoded(block, &channels, reports, self.encoder.kept_rows());
        }
        Ok(coded)
    }
}

/// Writes the encoded parts of a plan as a take.
#[derive(Debug)]
pub struct MotionWriter<'a, W> {
    plan: &'a EncodePlan<'a>,
    take: TakeWriter<W>,
    front: StretchHeaderWriter,
    payload: Vec<u8>,
    tally: BlockTally,
    n_samples: u64,
}

impl<'a, W: Write> MotionWriter<'a, W> {
    /// Writes the header, the subject, the foreign parts and the events.
    ///
    /// # Errors
    /// Those of [`TakeWriter::new`], [`TakeWriter::subject`], [`TakeWriter::foreign`] and [`TakeWriter::event`].
    pub fn new(plan: &'a EncodePlan<'a>, header: &Header, out: W) -> Result<Self, TakeError> {
        let mut take = TakeWriter::new(out, header)?;
        let info = &plan.motion.info;
        info.subject.iter().try_for_each(|subject| take.subject(subject))?;
        info.foreign.iter().try_for_each(|part| take.foreign(part))?;
        for MotionEvent { frame, kind, text } in &info.events {
            let (row, kind, text) = (*frame, *kind, text.clone());
            take.event(&Event { kind, row, device_ticks: 0, host_ns: 0, input: 0, text })?;
        }
        let front = StretchHeaderWriter::new(header.stretch_rows);
        let (payload, tally) = (Vec::new(), BlockTally::default());
        Ok(Self { plan, take, front, payload, tally, n_samples: 0 })
    }

    /// Writes the next part, in the order of [`EncodePlan::parts`].
    ///
    /// # Errors
    /// Those of [`TakeWriter::stretch`].
    pub fn push(&mut self, part: EncodePart, coded: &EncodedPart) -> Result<(), TakeError> {
        let n_markers = self.plan.motion.info.markers.len();
        let alone = n_markers <= GROUP_CHANNELS;
        let number = (part.first_row / self.plan.stretch_rows % usize::from(NUMBERS)) as u8;
        let (first_row, n_rows) = (part.first_row as u64, part.n_rows as u32);
        let span = Span { first_row, n_rows, key: true, number };
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
        let n_rows = self.plan.motion.n_frames() as u64;
        let announced = n_rows * self.plan.motion.info.markers.len() as u64;
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

/// Samples of one part, column by column; reused from part to part.
#[derive(Debug, Default)]
struct ColumnBuffer {
    positions: Vec<Vec<Position>>,
    present: Vec<Vec<bool>>,
}

impl ColumnBuffer {
    /// Copies the samples of `part` out of `motion`.
    fn fill(&mut self, motion: &Motion, part: EncodePart) {
        self.positions.resize_with(part.n_markers, Vec::new);
        self.present.resize_with(part.n_markers, Vec::new);
        for (positions, present) in self.positions.iter_mut().zip(&mut self.present) {
            positions.clear();
            positions.reserve(part.n_rows);
            present.clear();
            present.reserve(part.n_rows);
        }
        for row in part.first_row..part.first_row + part.n_rows {
            let markers = &motion.frame(row)[part.first_marker..][..part.n_markers];
            let columns = self.positions.iter_mut().zip(&mut self.present);
            for ((positions, present), &position) in columns.zip(markers) {
                positions.push(position);
                present.push(!is_gap(position));
            }
        }
    }

    /// The rows of each channel.
    fn rows(&self) -> Result<Vec<Rows<'_>>, CodecError> {
        let columns = self.positions.iter().zip(&self.present);
        columns.map(|(positions, present)| Rows::new(positions, present)).collect()
    }
}

/// The bytes that all channels of a take share; empty for live resamplers.
fn shared(motion: &Motion, codec: &Settings) -> Result<Vec<u8>, CodecError> {
    if codec.kind.is_live() {
        return Ok(Vec::new());
    }
    let mut columns = ColumnBuffer::default();
    let (n_rows, n_markers) = (motion.n_frames(), motion.info.markers.len());
    if n_markers > 0 {
        columns.fill(motion, EncodePart { first_row: 0, n_rows, first_marker: 0, n_markers });
    }
    codec.plan(&columns.rows()?)
}
