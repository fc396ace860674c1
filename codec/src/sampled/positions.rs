//! `lossless:predictive`: the positions of markers as sampled channels, three of each marker.
//!
//! Only samples that are present are coded, one after another; a reference channel contributes the last sample that it
//! had in each of these rows. Where a gap precedes a sample, nothing is predicted from what lies before it. A marker
//! starts with the weights that the marker before it learnt, so that short blocks need not learn everything again.

use super::{
    Group,
    fit::{EarlierChannels, Fit},
    prediction::REFERENCES,
    representation::{Cells, Head},
    walk::{ChannelWalk, ReferenceChannel},
};
use crate::{
    BlockReport, CodecError, DecodedRows, GROUP_CHANNELS, Result, Rows,
    coding::{
        Bytes,
        range::{BinaryCoder, RangeDecoder, RangeEncoder},
    },
    ensure,
    frame::{Payload, PayloadDecoder, PayloadEncoder},
    lossless::{Histories, Raw},
};

/// Coordinates of a position.
const AXES: usize = 3;

/// Bits of the index of a channel among those of a group.
const INDEX_BITS: u32 = (AXES * GROUP_CHANNELS).next_power_of_two().ilog2();

/// First byte of a payload: columns without history, as in `lossless`, or samples that were predicted.
const COLUMNS: u8 = 0;
const PREDICTED: u8 = 1;

/// The samples of one channel in one block, and those of its references in the same rows.
#[derive(Debug, Default)]
struct PresentSamples {
    /// Rows with a sample of the marker, ascending.
    rows: Vec<u32>,
    /// Indices of those after gaps.
    after_gaps: Vec<u32>,
    samples: Vec<f32>,
    references: [Vec<f32>; REFERENCES],
}

impl PresentSamples {
    fn prepare(&mut self, n_rows: usize) {
        for memory in [&mut self.rows, &mut self.after_gaps] {
            memory.reserve(n_rows.saturating_sub(memory.len()));
        }
        for memory in self.references.iter_mut().chain([&mut self.samples]) {
            memory.reserve(n_rows.saturating_sub(memory.len()));
        }
    }

    /// Finds the rows of a marker; `continues` if it had a sample in the row before the block.
    fn find(&mut self, present: &[bool], continues: bool) {
        self.rows.clear();
        self.after_gaps.clear();
        let mut was_present = continues;
        for (row, &is_present) in present.iter().enumerate() {
            if is_present {
                if !was_present {
                    self.after_gaps.push(self.rows.len() as u32);
                }
                self.rows.push(row as u32);
            }
            was_present = is_present;
        }
    }

    /// Codes the samples of a channel of the group; `wanted` is the encoder's choice. Then the group holds one sample of
    /// it per row.
    fn code<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        group: &mut Group,
        (channel, n_rows): (usize, usize),
        wanted: (Head, &Cells),
    ) -> Result<()> {
        let (tracks_before, tracks) = group.tracks.split_at_mut(channel);
        let (before, rest) = group.samples.split_at_mut(channel * n_rows);
        let (Some(track), Some(held)) = (tracks.first_mut(), rest.get_mut(..n_rows)) else {
            return Ok(());
        };
        let state = (&mut track.head, &mut track.cells);
        group.heads.code(coder, !track.is_started, state, wanted)?;
        let mut references = [ReferenceChannel::default(); REFERENCES];
        let n_references = usize::from(track.head.n_references);
        let slots = references.iter_mut().zip(&mut self.references).zip(&track.head.references);
        for ((slot, samples), &index) in slots.take(n_references) {
            let missing = CodecError::Corrupt("a reference that does not come before its channel");
            let other = tracks_before.get(usize::from(index)).ok_or(missing)?;
            let of_other = before.chunks_exact(n_rows).nth(index.into()).unwrap_or_default();
            samples.clear();
            samples.extend(self.rows.iter().filter_map(|&row| of_other.get(row as usize)));
            *slot = ReferenceChannel {
                samples,
                last: other.last_before,
                per_unit: other.head.per_unit(),
            };
        }
        // The same axis of the marker before, or the axis before.
        let likes = [channel.checked_sub(AXES), channel.checked_sub(1)];
        let like = likes.into_iter().flatten().next().and_then(|like| tracks_before.get(like));
        group.isa.run(ChannelWalk {
            coder,
            model: &mut group.model,
            track,
            previous: None,
            references,
            samples: &mut self.samples,
            after_gaps: &self.after_gaps,
            like: like.filter(|like| like.is_started),
        })?;
        ensure(self.samples.iter().all(|sample| sample.is_finite()), "a non-finite value")?;
        let mut last = track.last_before[0];
        let mut next = 0;
        for (&row, &sample) in self.rows.iter().zip(&self.samples) {
            let row = row as usize;
            held[next..row].fill(last);
            (held[row], last, next) = (sample, sample, row + 1);
        }
        held[next..].fill(last);
        Ok(())
    }
}

/// Encoder and decoder of one group.
#[derive(Debug)]
pub(crate) struct Predictive {
    group: Group,
    fit: Fit,
    current: PresentSamples,
    /// Whether each marker had a sample in the row before the block.
    continues: [bool; GROUP_CHANNELS],
    /// The payload as columns, which is written where it is smaller.
    packed: Vec<u8>,
    columns: Raw,
}

impl Predictive {
    pub(crate) fn new() -> Self {
        Self {
            group: Group::new(INDEX_BITS),
            fit: Fit::with_shared_quantum(),
            current: PresentSamples::default(),
            continues: [false; GROUP_CHANNELS],
            packed: Vec::new(),
            columns: Raw::default(),
        }
    }

    /// Begins a block of `n_markers` markers.
    fn begin(&mut self, n_markers: usize, n_rows: usize) {
        let Group { tracks, samples, .. } = &mut self.group;
        if tracks.len() < AXES * n_markers {
            tracks.resize_with(AXES * n_markers, super::SampledChannelState::new);
        }
        samples.clear();
        samples.resize(AXES * n_markers * n_rows, 0.0);
    }

    /// Finds the samples of a marker; `false` if it has none.
    fn find(&mut self, marker: usize, present: &[bool]) -> bool {
        let Self { current, continues, group, .. } = self;
        let Some(continues) = continues.get_mut(marker) else { return false };
        current.find(present, *continues);
        *continues = present.last() == Some(&true);
        if !current.rows.is_empty() {
            return true;
        }
        let channels = AXES * marker..AXES * (marker + 1);
        for (channel, track) in channels.clone().zip(&mut group.tracks[channels]) {
            track.skip();
            let held = channel * present.len()..(channel + 1) * present.len();
            group.samples[held].fill(track.last[0]);
        }
        false
    }

    fn encode_predicted(
        &mut self,
        channels: &[Rows<'_>],
        coder: &mut RangeEncoder<'_>,
    ) -> Result<()> {
        let n_rows = channels.first().map_or(0, Rows::len);
        self.begin(channels.len(), n_rows);
        for (marker, rows) in channels.iter().enumerate() {
            if !self.find(marker, rows.present()) {
                continue;
            }
            for axis in 0..AXES {
                let channel = AXES * marker + axis;
                let Self { current, group, fit, .. } = &mut *self;
                current.samples.clear();
                let position = |&row: &u32| rows.positions()[row as usize][axis];
                current.samples.extend(current.rows.iter().map(position));
                let before = EarlierChannels {
                    samples: &group.samples[..channel * n_rows],
                    n_rows,
                    rows: Some(&current.rows),
                };
                let wanted = fit.choose(&group.tracks[channel], &current.samples, before);
                current.code(coder, group, (channel, n_rows), wanted)?;
                let is_same = |(&row, sample): (&u32, &f32)| {
                    rows.positions()[row as usize][axis].to_bits() == sample.to_bits()
                };
                let mut samples = current.rows.iter().zip(&current.samples);
                ensure(samples.all(is_same), "a sample that is not coded exactly")?;
            }
        }
        Ok(())
    }

    fn decode_predicted(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        let mut coder = RangeDecoder::new(payload);
        let cells = Cells::default();
        let n_rows = channels.first().map_or(0, |rows| rows.present.len());
        self.begin(channels.len(), n_rows);
        for (marker, decoded) in channels.iter_mut().enumerate() {
            if !self.find(marker, &decoded.present) {
                continue;
            }
            for axis in 0..AXES {
                let Self { current, group, .. } = &mut *self;
                current.samples.clear();
                current.samples.resize(current.rows.len(), 0.0);
                let wanted = (Head::default(), &cells);
                current.code(&mut coder, group, (AXES * marker + axis, n_rows), wanted)?;
                for (&row, &sample) in current.rows.iter().zip(&current.samples) {
                    decoded.positions[row as usize][axis] = sample;
                }
            }
            decoded.kept.copy_from_slice(&decoded.present);
        }
        coder.finish()
    }
}

impl Payload for Predictive {
    const EXACT: bool = true;

    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.group.prepare(AXES * n_channels, n_rows);
        self.fit.prepare(n_rows);
        self.current.prepare(n_rows);
        self.columns.reserve(n_rows);
        let n_bytes = n_channels * Raw::max_bytes(n_rows);
        self.packed.reserve(n_bytes.saturating_sub(self.packed.len()));
    }

    fn reset(&mut self) {
        self.group.forget();
        self.fit.forget();
        self.forget_rows();
    }

    fn forget_rows(&mut self) {
        self.continues = [false; GROUP_CHANNELS];
    }
}

impl PayloadEncoder for Predictive {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        1 + n_channels * Raw::max_bytes(n_rows)
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        _exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        self.packed.clear();
        for (rows, report) in channels.iter().zip(reports).filter(|(_, r)| r.samples > 0) {
            self.columns.write(*rows, &mut Histories::default(), &mut self.packed);
            report.keep_all(*rows, kept_rows);
        }
        let start = out.len();
        out.push(PREDICTED);
        let mut coder = RangeEncoder::new(out, self.packed.len());
        let encoded = self.encode_predicted(channels, &mut coder);
        let is_smaller = coder.finish();
        debug_assert!(encoded.is_ok(), "{encoded:?}");
        if encoded.is_err() || !is_smaller {
            self.reset();
            out.truncate(start);
            out.push(COLUMNS);
            out.extend_from_slice(&self.packed);
        }
        Ok(())
    }
}

impl PayloadDecoder for Predictive {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        let mut input = Bytes::new(payload);
        match input.byte("the coding of the samples")? {
            PREDICTED => self.decode_predicted(input.rest(), channels),
            COLUMNS => {
                for rows in channels.iter_mut().filter(|rows| rows.has_samples()) {
                    self.columns.read(&mut input, &mut Histories::default(), rows)?;
                }
                self.reset();
                input.finish()
            }
            _ => Err(CodecError::Corrupt("an unknown coding of samples")),
        }
    }
}
