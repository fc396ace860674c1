//! Divides the columns of a foreign part into groups and these into spans from key block to key block, each of which is
//! encoded independently, on any thread.

use std::io;

use mocapd_codec::{GROUP_CHANNELS, sampled::SampledEncoder};

use super::{SampleContent, SampleSpan, block_rows_max};
use crate::{
    TakeError,
    foreign::content::{Content, ContentSlice},
    interchange::c3d::columns::{
        ANALOG, ColumnReader, MODEL_OUTPUTS, RESIDUALS, SampleHeader, value,
    },
    record::{SampleBounds, SampleForm, SampledChannel, SampledGroup},
};

/// Distance of key blocks in seconds: that of the key stretches of an import, so that a reader that wants a part of a
/// take reads as far ahead for both. Longer spans save nothing: in recorded files, 2.5 seconds need about as many bytes.
const KEY_S: f64 = 10.0;

/// Most blocks between two keys: they hold 32 MiB of float32, which is what a thread buffers.
const KEY_BLOCKS_MAX: u64 = 8;

/// Size of the buffer for reading columns: 4096 samples of 64 channels of floats.
const BUFFER_BYTES: usize = 1 << 20;

/// The kinds of foreign parts whose samples are stored in groups, and the columns of a signal in them.
const KINDS: [(&str, usize); 3] = [(ANALOG, 1), (RESIDUALS, 1), (MODEL_OUTPUTS, 4)];

/// What the samples of a part mean, and where it stands in the take.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PartContext<'b> {
    /// Frames in a second.
    pub(crate) rate_hz: f64,
    /// Whether integers are unsigned.
    pub(crate) is_unsigned: bool,
    /// Number of the first group.
    pub(crate) first_group: u32,
    /// The largest error of each column; empty if all are exact.
    pub(crate) bounds: &'b [f64],
}

/// How the samples of a foreign part are encoded.
#[derive(Debug)]
pub struct SamplesPlan<'a> {
    groups: Vec<SampledGroup>,
    header: SampleHeader,
    columns: ContentSlice<'a>,
    n_samples: usize,
}

impl<'a> SamplesPlan<'a> {
    /// Plans the encoding of a part; `None` for one that is no block of columns with samples, or of another kind.
    /// `describe` gives the channels for the kind and the numbers of its signals.
    ///
    /// # Errors
    /// Those of the scratch file that the part may be in.
    pub(crate) fn new(
        kind: &str,
        content: &'a Content,
        context: PartContext<'_>,
        describe: impl FnOnce(&str, &[u32]) -> Vec<SampledChannel>,
    ) -> io::Result<Option<Self>> {
        let Some(&(_, per_signal)) = KINDS.iter().find(|(known, _)| *known == kind) else {
            return Ok(None);
        };
        let Some((header, rest)) = content.as_slice().split_array()? else { return Ok(None) };
        let Some(header) = SampleHeader::parse(&header) else { return Ok(None) };
        let index_bytes = if per_signal > 1 { 4 * header.n_signals } else { 0 };
        let Some((indices, columns)) = rest.split_at(index_bytes as u64) else { return Ok(None) };
        let Some(n_samples) = header.samples().filter(|&n| n > 0 && header.n_signals > 0) else {
            return Ok(None);
        };
        // Reading them is refused if there are more or fewer than the header states.
        if header.columns(columns, per_signal, 0).is_none() {
            return Ok(None);
        }
        let mut stored = vec![0; index_bytes];
        indices.read_at(0, &mut stored)?;
        let numbers: Vec<u32> = match per_signal {
            1 => (0..header.n_signals as u32).collect(),
            _ => stored.as_chunks().0.iter().map(|&bytes| u32::from_le_bytes(bytes)).collect(),
        };
        let channels = describe(kind, &numbers);
        if channels.len() != header.n_signals * per_signal {
            return Ok(None);
        }
        let group = SampledGroup {
            kind: kind.to_owned(),
            form: form_of(header.width, context.is_unsigned && kind == ANALOG),
            part_channels: channels.len() as u32,
            samples_per_frame: header.ratio as u32,
            rate_hz: context.rate_hz * header.ratio as f64,
            first_frame: header.first_frame,
            n_samples: Some(n_samples as u64),
            ..SampledGroup::default()
        };
        let groups = channels.chunks(GROUP_CHANNELS).zip(0..).map(|(channels, i)| SampledGroup {
            number: context.first_group.saturating_add(i),
            first_channel: i * GROUP_CHANNELS as u32,
            channels: channels.to_vec(),
            bounds: SampleBounds(bounds_of(context.bounds, i as usize)),
            ..group.clone()
        });
        Ok(Some(Self { groups: groups.collect(), header, columns, n_samples }))
    }

    /// The groups, whose descriptions precede all samples.
    #[must_use]
    pub fn groups(&self) -> &[SampledGroup] {
        &self.groups
    }

    /// Memory that the samples of a span take, in bytes.
    #[must_use]
    pub fn span_bytes(&self) -> usize {
        let n_channels = self.groups.first().map_or(0, |group| group.channels.len());
        4 * n_channels * self.key_rows(n_channels).min(self.n_samples)
    }

    /// Samples of each channel from a key block to the next.
    fn key_rows(&self, n_channels: usize) -> usize {
        let rate_hz = self.groups.first().map_or(1.0, |group| group.rate_hz);
        let rows_max = KEY_BLOCKS_MAX * block_rows_max(n_channels);
        // A float that is too large becomes the largest integer.
        ((KEY_S * rate_hz) as u64).clamp(1, rows_max) as usize
    }

    /// The spans of all groups, in the order in which a take has them.
    #[must_use]
    pub fn spans(&self) -> KeySpans<'_> {
        KeySpans { plan: self, group: 0, reader: None, next: 0 }
    }

    fn reader(&self, group: &SampledGroup) -> Option<ColumnReader<'a>> {
        let column_bytes = (self.header.width * self.n_samples) as u64;
        let (_, rest) = self.columns.split_at(u64::from(group.first_channel) * column_bytes)?;
        let (columns, _) = rest.split_at(group.channels.len() as u64 * column_bytes)?;
        let (width, n_channels) = (self.header.width, group.channels.len());
        ColumnReader::new(columns, width, n_channels, self.n_samples, BUFFER_BYTES)
    }
}

/// The bounds of a group of the part, by its place among the groups; empty if it is exact.
fn bounds_of(bounds: &[f64], group: usize) -> Vec<f64> {
    let bounds = bounds.chunks(GROUP_CHANNELS).nth(group).unwrap_or_default();
    if bounds.iter().all(|bound| *bound == 0.0) { Vec::new() } else { bounds.to_vec() }
}

fn form_of(width: usize, is_unsigned: bool) -> SampleForm {
    match (width, is_unsigned) {
        (4, _) => SampleForm::Float32,
        (_, false) => SampleForm::Int16,
        (_, true) => SampleForm::Uint16,
    }
}

/// The samples of a group from a key block to the next: what is encoded independently.
#[derive(Debug, Clone)]
pub struct KeySpan {
    group: u32,
    first: u64,
    n_rows: usize,
    n_channels: usize,
    /// Channel after channel.
    samples: Vec<f32>,
}

/// The spans of a part, read from its columns.
#[derive(Debug)]
pub struct KeySpans<'a> {
    plan: &'a SamplesPlan<'a>,
    /// Index of the group that is read.
    group: usize,
    reader: Option<ColumnReader<'a>>,
    /// The next sample of the group.
    next: usize,
}

impl KeySpans<'_> {
    fn read(&mut self) -> io::Result<Option<KeySpan>> {
        let plan = self.plan;
        if self.next >= plan.n_samples {
            (self.group, self.next, self.reader) = (self.group + 1, 0, None);
        }
        let Some(group) = plan.groups.get(self.group) else { return Ok(None) };
        let changed = || io::Error::from(io::ErrorKind::UnexpectedEof);
        let reader = match &mut self.reader {
            Some(reader) => reader,
            none => none.insert(plan.reader(group).ok_or_else(changed)?),
        };
        let n_channels = group.channels.len();
        let n_rows = plan.key_rows(n_channels).min(plan.n_samples - self.next);
        let mut samples = vec![0.0; n_rows * n_channels];
        let is_unsigned = group.form == SampleForm::Uint16;
        for row in 0..n_rows {
            let words = reader.next()?.ok_or_else(changed)?;
            let places = samples.iter_mut().skip(row).step_by(n_rows);
            for (place, &word) in places.zip(words) {
                *place = value(plan.header.width, word, is_unsigned);
            }
        }
        let span =
            KeySpan { group: group.number, first: self.next as u64, n_rows, n_channels, samples };
        self.next += n_rows;
        Ok(Some(span))
    }
}

impl Iterator for KeySpans<'_> {
    type Item = Result<KeySpan, TakeError>;

    fn next(&mut self) -> Option<Self::Item> {
        let span = self.read().map_err(TakeError::from).transpose();
        if let Some(Err(_)) = span {
            // Nothing follows an error.
            self.group = self.plan.groups.len();
        }
        span
    }
}

/// Encodes spans, in any order.
#[derive(Debug, Default)]
pub struct SpanEncoder(SampledEncoder);

/// The payloads of the SAMPLES chunks of a span.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct EncodedSpan(pub(crate) Vec<Vec<u8>>);

impl SpanEncoder {
    /// Encodes a span, beginning with a key block.
    ///
    /// # Errors
    /// `Codec`.
    pub fn encode(&mut self, span: &KeySpan) -> Result<EncodedSpan, TakeError> {
        let rows_max = block_rows_max(span.n_channels) as usize;
        let mut encoded = EncodedSpan::default();
        for start in (0..span.n_rows).step_by(rows_max) {
            let rows = start..span.n_rows.min(start + rows_max);
            let content = if start == 0 { SampleContent::Key } else { SampleContent::Continued };
            let block = SampleSpan {
                group: span.group,
                first: span.first + start as u64,
                n: rows.len() as u64,
                content,
            };
            let channels = span.samples.chunks_exact(span.n_rows);
            let channels: Vec<&[f32]> =
                channels.filter_map(|samples| samples.get(rows.clone())).collect();
            let mut payload = Vec::new();
            block.put(&mut payload);
            self.0.encode(&channels, start == 0, &mut payload)?;
            encoded.0.push(payload);
        }
        Ok(encoded)
    }
}
