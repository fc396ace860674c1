//! Divides the columns of a foreign part into groups, and each group into spans from one key block to the next. Each
//! span is encoded independently, on any thread.

use std::io;

use mocapd_codec::{GROUP_CHANNELS, sampled::SampledEncoder};

use super::{LostSamples, SampleContent, SampleSpan, block_rows_max};
use crate::{
    TakeError,
    foreign::content::{Content, ContentSlice},
    interchange::c3d::columns::{
        ANALOG, ColumnReader, MODEL_OUTPUTS, RESIDUALS, SampleHeader, value,
    },
    motion::Foreign,
    record::{SampleBounds, SampleForm, SampledChannel, SampledGroup},
    timeline::LossCauses,
};

/// Maximum interval between key blocks in seconds: that of the key stretches of an import, so that a reader that wants
/// a part of a take reads as far ahead for both.
const KEY_S: f64 = 10.0;

/// Interval between key blocks in seconds, if it holds [`KEY_ROWS`] samples: in recorded files, 2.5 seconds of
/// analog samples need between 4 % fewer and 1 % more bytes than ten. Damage to a block then costs 2.5 seconds, and
/// the memory is a quarter.
const SHORT_KEY_S: f64 = 2.5;

/// Samples of a channel from key block to key block, unless they last more than [`KEY_S`]. The head of a channel after
/// a key and its first sample are some nine bytes, a fiftieth of a bit per sample.
const KEY_ROWS: f64 = 4096.0;

/// Maximum number of blocks between two keys: they hold 8 MiB of float32, which is what a thread buffers.
const KEY_BLOCKS_MAX: u64 = 2;

/// Size of the buffer for reading columns: 4096 samples of 64 channels of floats.
const BUFFER_BYTES: usize = 1 << 20;

/// The kinds of foreign parts whose samples are stored in groups, and the columns of a signal in them.
const KINDS: [(&str, usize); 3] = [(ANALOG, 1), (RESIDUALS, 1), (MODEL_OUTPUTS, 4)];

/// The interpretation of the samples of a part, and its place in the take.
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
    /// Samples that the columns do not have.
    lost: Vec<LostSamples>,
}

/// The layout of a part that is a block of columns with samples.
struct PartLayout<'a> {
    header: SampleHeader,
    /// Columns of a signal.
    per_signal: usize,
    /// Samples of each column.
    n_samples: usize,
    indices: ContentSlice<'a>,
    columns: ContentSlice<'a>,
}

impl<'a> PartLayout<'a> {
    /// `None` for a part of another kind, and for one without samples.
    fn of(kind: &str, content: &'a Content) -> io::Result<Option<Self>> {
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
        Ok(Some(Self { header, per_signal, n_samples, indices, columns }))
    }
}

/// Samples of a foreign part that are encoded in groups, those of all channels; 0 for a part that has none.
///
/// # Errors
/// Those of the scratch file that the part may be in.
pub fn sample_count(part: &Foreign) -> io::Result<u64> {
    let layout = PartLayout::of(&part.kind, &part.data)?;
    Ok(layout.map_or(0, |PartLayout { header, per_signal, n_samples, .. }| {
        (header.n_signals * per_signal) as u64 * n_samples as u64
    }))
}

impl<'a> SamplesPlan<'a> {
    /// Plans the encoding of a part; `None` for one that is not a block of columns with samples, or of another kind.
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
        let Some(layout) = PartLayout::of(kind, content)? else { return Ok(None) };
        let PartLayout { header, per_signal, n_samples, indices, columns } = layout;
        let mut stored = vec![0; indices.len() as usize];
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
        let (groups, lost) = (groups.collect(), Vec::new());
        Ok(Some(Self { groups, header, columns, n_samples, lost }))
    }

    /// Records these samples as lost, and ignores the values that the columns have for them.
    pub(crate) fn lose(&mut self, lost: &[LostSamples]) {
        self.lost.extend_from_slice(lost);
    }

    /// The first lost samples of a group that end after the sample `next`.
    fn lost_from(&self, group: &SampledGroup, next: usize) -> Option<&LostSamples> {
        let before = u64::from(group.first_channel);
        let end = before + group.channels.len() as u64;
        let of_group =
            self.lost.iter().filter(|lost| lost.channels[0] <= end && lost.channels[1] > before);
        let ahead = of_group.filter(|lost| lost.first.saturating_add(lost.n) > next as u64);
        ahead.min_by_key(|lost| lost.first)
    }

    /// The groups, whose descriptions precede all samples.
    #[must_use]
    pub fn groups(&self) -> &[SampledGroup] {
        &self.groups
    }

    /// Samples of each channel from a key block to the next.
    fn key_rows(&self, n_channels: usize) -> usize {
        let rate_hz = self.groups.first().map_or(1.0, |group| group.rate_hz);
        let rows_max = KEY_BLOCKS_MAX * block_rows_max(n_channels);
        // A float that is too large becomes the largest integer.
        let rows = (SHORT_KEY_S * rate_hz).max(KEY_ROWS).min(KEY_S * rate_hz);
        (rows as u64).clamp(1, rows_max) as usize
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
    /// Channel after channel; empty if they are lost.
    samples: Vec<f32>,
    /// Why the samples are lost, if they are.
    lost: Option<LossCauses>,
}

impl KeySpan {
    /// Number of samples, those of all channels.
    #[must_use]
    pub fn n_samples(&self) -> u64 {
        self.n_rows as u64 * self.n_channels as u64
    }
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
        let ahead = plan.n_samples - self.next;
        let (mut n_rows, mut lost) = (plan.key_rows(n_channels).min(ahead), None);
        if let Some(found) = plan.lost_from(group, self.next) {
            match found.first.saturating_sub(self.next as u64) {
                0 => {
                    let n = found.first.saturating_add(found.n) - self.next as u64;
                    n_rows = usize::try_from(n).unwrap_or(usize::MAX).min(ahead);
                    lost = Some(found.causes.unwrap_or(LossCauses::DAMAGED));
                }
                before => n_rows = n_rows.min(usize::try_from(before).unwrap_or(usize::MAX)),
            }
        }
        let samples = match lost {
            Some(_) => {
                reader.skip(n_rows)?;
                Vec::new()
            }
            None => {
                let is_unsigned = group.form == SampleForm::Uint16;
                read_rows(reader, [n_rows, n_channels], plan.header.width, is_unsigned)?
            }
        };
        let first = self.next as u64;
        let span = KeySpan { group: group.number, first, n_rows, n_channels, samples, lost };
        self.next += n_rows;
        Ok(Some(span))
    }
}

/// Reads the next samples of a group, channel after channel.
fn read_rows(
    reader: &mut ColumnReader<'_>,
    [n_rows, n_channels]: [usize; 2],
    width: usize,
    is_unsigned: bool,
) -> io::Result<Vec<f32>> {
    let mut samples = vec![0.0; n_rows * n_channels];
    for row in 0..n_rows {
        let words = reader.next()?.ok_or(io::ErrorKind::UnexpectedEof)?;
        let places = samples.iter_mut().skip(row).step_by(n_rows);
        for (place, &word) in places.zip(words) {
            *place = value(width, word, is_unsigned);
        }
    }
    Ok(samples)
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
        if let Some(causes) = span.lost {
            let (group, first, n) = (span.group, span.first, span.n_rows as u64);
            let mut payload = Vec::new();
            SampleSpan { group, first, n, content: SampleContent::Lost(causes) }.put(&mut payload);
            encoded.0.push(payload);
            return Ok(encoded);
        }
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
