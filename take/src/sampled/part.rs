//! The samples of a take's groups: where they are, what is lost, and the block of columns that they replace.

use std::{
    convert::Infallible,
    io::{self, Read, Seek, SeekFrom},
    ops::Range,
    sync::Arc,
};

use mocapd_codec::sampled::SampledDecoder;

use super::{
    SampleAnchor, SampleClock, SampleContent, SampleSpan, SampleTimes, SamplesChunk, fits,
    is_recorded,
};
use crate::{
    TakeError,
    foreign::content::{Content, ScratchFile, Spool},
    interchange::c3d::columns::{
        ColumnWriter, MODEL_OUTPUTS, RESIDUALS, SampleHeader, ordered, word,
    },
    record::{GroupLedger, MeasuredErrors, SAMPLES_MAX, SampleForm, SampleLedger, SampledGroup},
    timeline::LossCauses,
};

/// Most SAMPLES chunks that a reader remembers of a part, in 256 MiB: a group of a recording has one in half a second,
/// which makes 24 days, and two of the shortest stretches. Only a crafted file has more.
const CHUNKS_MAX: usize = 1 << 22;

/// Most times of samples that a reader remembers of a group, in 256 MiB: a recorder writes two for each block.
const ANCHORS_MAX: usize = 2 * CHUNKS_MAX;

/// Samples that a take does not have, of all channels of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LostSamples {
    /// The first and the last channel of the group among those of the part, from 1.
    pub channels: [u64; 2],
    /// Number of the first sample, from 0.
    pub first: u64,
    /// Number of samples of each channel.
    pub n: u64,
    /// The causes that the take states; `None` if the samples are missing or damaged in this file.
    pub causes: Option<LossCauses>,
}

/// A group of sampled channels in a take, and where its samples are.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupSamples {
    /// The group.
    pub group: SampledGroup,
    /// In the order of the file.
    chunks: Vec<SamplesChunk>,
    /// The times of some samples, in ascending order of these; only in a recording.
    anchors: Vec<SampleAnchor>,
    /// File offsets of the chunks that state them.
    times_at: Vec<u64>,
    /// The number of samples that a ledger states.
    n_stated: u64,
    /// Size of all its chunks.
    pub stored_bytes: u64,
    /// File offset of the chunk that describes it.
    pub(crate) offset: u64,
}

/// What a recovery writes of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RecoveredSamples {
    /// The chunk at this file offset, as it is.
    Chunk { offset: u64 },
    /// Samples that are lost.
    Lost { first: u64, n: u64 },
}

/// Consecutive samples of a group.
#[derive(Debug, Clone, Copy)]
pub(crate) enum SampleRun<'a> {
    /// A block that can be decoded.
    Block(&'a SamplesChunk),
    /// Samples that are lost, with the causes if the take states them.
    Lost { first: u64, n: u64, causes: Option<LossCauses> },
}

impl GroupSamples {
    /// A group whose chunk is at file offset `offset` and has `chunk_bytes`.
    pub(crate) fn new(group: SampledGroup, offset: u64, chunk_bytes: u64) -> Self {
        let (chunks, anchors, times_at) = (Vec::new(), Vec::new(), Vec::new());
        Self { group, chunks, anchors, times_at, n_stated: 0, stored_bytes: chunk_bytes, offset }
    }

    /// Samples of each channel, lost ones included.
    #[must_use]
    pub fn n_samples(&self) -> u64 {
        let found = self.chunks.last().map_or(0, |chunk| chunk.span.end());
        self.group.n_samples.unwrap_or(found.max(self.n_stated))
    }

    /// Number of its chunks of samples.
    #[must_use]
    pub fn n_chunks(&self) -> usize {
        self.chunks.len()
    }

    /// From its first sample in the file to after its last one.
    pub(crate) fn stored_range(&self) -> Range<u64> {
        let mut stored = self.chunks.iter().map(|chunk| chunk.span);
        let is_block = |span: &SampleSpan| !matches!(span.content, SampleContent::Lost(_));
        let first = stored.clone().find(is_block);
        let last = stored.rfind(is_block);
        first.zip(last).map_or(0..0, |(first, last)| first.first..last.end())
    }

    /// The numbers of the samples that the file has, in order.
    pub(crate) fn stored_ranges(&self) -> Vec<Range<u64>> {
        let mut all: Vec<Range<u64>> = Vec::new();
        let Ok(()) = self.runs(|run| {
            let SampleRun::Block(chunk) = run else { return Ok(()) };
            match all.last_mut().filter(|last| last.end == chunk.span.first) {
                Some(last) => last.end = chunk.span.end(),
                None => all.push(chunk.span.first..chunk.span.end()),
            }
            Ok::<_, Infallible>(())
        });
        all
    }

    /// A ledger states that the take had this many samples by then.
    fn state(&mut self, ledger: &GroupLedger) {
        if is_recorded(&self.group.kind) && ledger.taken <= SAMPLES_MAX {
            self.n_stated = self.n_stated.max(ledger.taken);
        }
    }

    /// Adds a chunk. Returns whether it belongs to the group: its samples follow those before.
    fn push(&mut self, chunk: SamplesChunk, chunk_bytes: u64) -> bool {
        let end = self.chunks.last().map_or(0, |last| last.span.end());
        let belongs = chunk.span.first >= end && fits(&self.group, &chunk.span);
        if belongs {
            self.stored_bytes += chunk_bytes;
            self.chunks.push(chunk);
        }
        belongs
    }

    /// Adds times of its samples. Returns whether they belong to the group: they follow those before.
    fn push_times(&mut self, times: &SampleTimes, offset: u64, chunk_bytes: u64) -> bool {
        let place = |anchor: &SampleAnchor| (anchor.run_start, anchor.number);
        let (Some(first), Some(last)) = (times.anchors.first(), times.anchors.last()) else {
            return false;
        };
        let belongs = is_recorded(&self.group.kind)
            && last.run_start <= first.number
            && self.anchors.last().is_none_or(|known| {
                known.run_start <= first.run_start
                    && known.number < first.number
                    // A run begins behind the samples of the one before.
                    && (known.run_start == first.run_start || known.number < first.run_start)
            })
            && self.anchors.len().saturating_add(times.anchors.len()) <= ANCHORS_MAX;
        debug_assert!(times.anchors.is_sorted_by_key(place));
        if belongs {
            self.stored_bytes += chunk_bytes;
            self.times_at.push(offset);
            self.anchors.extend_from_slice(&times.anchors);
        }
        belongs
    }

    /// The stated times of samples, in order.
    #[must_use]
    pub fn anchors(&self) -> &[SampleAnchor] {
        &self.anchors
    }

    /// The times of all samples of a recording, by the device's clock, which has `tick_hz`.
    #[must_use]
    pub fn clock(&self, tick_hz: u64) -> SampleClock<'_> {
        SampleClock::new(&self.anchors, &self.chunks, self.group.rate_hz, tick_hz)
    }

    /// The same times with other anchors, which are some of its own.
    pub(crate) fn clock_by<'a>(
        &'a self,
        anchors: &'a [SampleAnchor],
        tick_hz: u64,
    ) -> SampleClock<'a> {
        SampleClock::new(anchors, &self.chunks, self.group.rate_hz, tick_hz)
    }

    /// The numbers of the samples in the block that has this one; `None` where it is lost.
    pub(crate) fn block_of(&self, number: u64) -> Option<Range<u64>> {
        let at = self.chunks.partition_point(|chunk| chunk.span.first <= number).checked_sub(1)?;
        let span = self.chunks.get(at)?.span;
        let is_in = number < span.end() && !matches!(span.content, SampleContent::Lost(_));
        is_in.then(|| span.first..span.end())
    }

    /// File offsets of the chunks with samples of this range.
    pub(crate) fn offsets_of(&self, range: Range<u64>) -> impl Iterator<Item = u64> {
        let from = self.chunks.partition_point(|chunk| chunk.span.end() <= range.start);
        let inside = self.chunks.get(from..).unwrap_or_default().iter();
        let end = range.end;
        inside.take_while(move |chunk| chunk.span.first < end).map(|chunk| chunk.offset)
    }

    /// The counts of its chunks whose file offset `counts`: those of a ledger, except duplicates and jumps.
    pub(crate) fn ledger(&self, counts: impl Fn(u64) -> bool) -> GroupLedger {
        let mut ledger = GroupLedger { group: self.group.number, ..GroupLedger::default() };
        for chunk in self.chunks.iter().filter(|chunk| counts(chunk.offset)) {
            ledger.count(chunk.span.content, chunk.span.n);
        }
        ledger
    }

    /// The ledger that its chunks give, except duplicates and jumps, which they do not show.
    #[must_use]
    pub fn found_ledger(&self) -> GroupLedger {
        self.ledger(|_| true)
    }

    /// The largest errors of its poses: those that were measured, if the ledger with them covers all samples, else the
    /// bounds. `None` for poses as the device sent them, and other samples.
    #[must_use]
    pub fn pose_errors(&self, stated: Option<&SampleLedger>) -> Option<MeasuredErrors> {
        let bounds = self.group.pose_bounds()?;
        let number = self.group.number;
        let stated = stated.and_then(|of| of.groups.iter().find(|group| group.group == number));
        let covers = |stated: &&GroupLedger| stated.stored >= self.found_ledger().stored;
        let measured = stated.filter(covers).and_then(|stated| stated.errors);
        Some(measured.unwrap_or_else(|| MeasuredErrors::at_most(bounds)))
    }

    /// Its chunks of samples: what each holds, and the file offset and size of its block.
    pub(crate) fn stored(&self) -> impl Iterator<Item = (SampleSpan, u64, u64)> {
        self.chunks.iter().map(|chunk| (chunk.span, chunk.block_at, chunk.block_bytes))
    }

    /// Decodes all samples of the group. `each` receives the number of the first sample, the number of samples of each
    /// channel and the samples, channel after channel, or `None` where they are lost.
    ///
    /// # Errors
    /// `Io`, and those of `each`.
    pub fn read(
        &self,
        input: &mut (impl Read + Seek),
        mut each: impl FnMut(u64, u64, Option<&[f32]>) -> io::Result<()>,
    ) -> Result<Vec<LostSamples>, TakeError> {
        let mut first = 0;
        self.decode(input, |n, samples| {
            each(first, n, samples)?;
            first += n;
            Ok(())
        })
    }

    /// Decodes the samples with these numbers, from the key block before them on. `each` receives the number of a first
    /// sample, the number of samples of each channel and the samples, channel after channel, or `None` where they are lost
    /// or cannot be decoded; some of them may lie outside of the range.
    ///
    /// # Errors
    /// `Io`, and those of `each`.
    pub fn read_range(
        &self,
        input: &mut (impl Read + Seek),
        numbers: &Range<u64>,
        mut each: impl FnMut(u64, u64, Option<&[f32]>) -> io::Result<()>,
    ) -> Result<(), TakeError> {
        let reached = self.chunks.partition_point(|chunk| chunk.span.first <= numbers.start);
        let before = self.chunks.get(..reached).unwrap_or_default();
        let is_key = |chunk: &SamplesChunk| chunk.span.content == SampleContent::Key;
        let from = before.iter().rfind(|chunk| is_key(chunk)).map_or(0, |key| key.span.first);
        let mut reader = self.reader();
        reader.skip_to(from);
        while let Some((span, samples)) = reader.next(input)? {
            if span.first >= numbers.end {
                break;
            }
            if span.end() > numbers.start {
                each(span.first, span.n, samples)?;
            }
        }
        Ok(())
    }

    /// All samples in order. `each` receives them run by run.
    pub(crate) fn runs<E>(
        &self,
        mut each: impl FnMut(SampleRun<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let (mut next, mut is_in_step) = (0, false);
        for chunk in &self.chunks {
            let SampleSpan { first, n, content, .. } = chunk.span;
            if first > next {
                each(SampleRun::Lost { first: next, n: first - next, causes: None })?;
                is_in_step = false;
            }
            let run = match content {
                SampleContent::Lost(causes) => SampleRun::Lost { first, n, causes: Some(causes) },
                SampleContent::Continued if !is_in_step => {
                    SampleRun::Lost { first, n, causes: None }
                }
                SampleContent::Key | SampleContent::Continued => SampleRun::Block(chunk),
            };
            is_in_step = matches!(run, SampleRun::Block(_));
            each(run)?;
            next = chunk.span.end();
        }
        match self.n_samples().saturating_sub(next) {
            0 => Ok(()),
            n => each(SampleRun::Lost { first: next, n, causes: None }),
        }
    }

    /// Its first and its last channel among those of the part, from 1.
    fn channels(&self) -> [u64; 2] {
        let before = u64::from(self.group.first_channel);
        [before + 1, before + self.group.channels.len() as u64]
    }

    /// The samples that are missing or damaged in this file, or that the take states as lost.
    #[must_use]
    pub fn lost(&self) -> Vec<LostSamples> {
        let mut all: Vec<LostSamples> = Vec::new();
        let Ok(()) = self.runs(|run| {
            let SampleRun::Lost { first, n, causes } = run else { return Ok(()) };
            let follows =
                |last: &&mut LostSamples| last.first + last.n == first && last.causes == causes;
            match all.last_mut().filter(follows) {
                Some(last) => last.n += n,
                None => all.push(LostSamples { channels: self.channels(), first, n, causes }),
            }
            Ok::<_, Infallible>(())
        });
        all
    }

    /// File offsets of its chunks of samples.
    pub(crate) fn chunk_offsets(&self) -> impl Iterator<Item = u64> {
        self.chunks.iter().map(|chunk| chunk.offset).chain(self.times_offsets())
    }

    /// File offsets of its chunks of times.
    pub(crate) fn times_offsets(&self) -> impl Iterator<Item = u64> {
        self.times_at.iter().copied()
    }

    /// What a recovery writes of the group, given the samples whose blocks cannot be decoded.
    pub(crate) fn recovered(&self, undecodable: &[LostSamples]) -> Vec<RecoveredSamples> {
        let (mut kept, mut next, mut is_in_step) = (Vec::new(), 0, false);
        let lose = |kept: &mut Vec<RecoveredSamples>, from: u64, end: u64| match kept.last_mut() {
            _ if end <= from => {}
            Some(RecoveredSamples::Lost { n, .. }) => *n += end - from,
            _ => kept.push(RecoveredSamples::Lost { first: from, n: end - from }),
        };
        for chunk in &self.chunks {
            let SampleSpan { first, content, .. } = chunk.span;
            is_in_step &= first == next;
            lose(&mut kept, next, first);
            next = chunk.span.end();
            let is_decodable = undecodable.binary_search_by_key(&first, |lost| lost.first).is_err();
            let is_kept = match content {
                SampleContent::Lost(_) => true,
                SampleContent::Key => is_decodable,
                SampleContent::Continued => is_decodable && is_in_step,
            };
            is_in_step = is_kept && !matches!(content, SampleContent::Lost(_));
            if is_kept {
                kept.push(RecoveredSamples::Chunk { offset: chunk.offset });
            } else {
                lose(&mut kept, first, next);
            }
        }
        lose(&mut kept, next, self.n_samples());
        kept
    }

    /// Decodes its samples run by run, from the last key block at or before a sample on.
    pub(crate) fn reader_from(&self, number: u64) -> GroupReader<'_> {
        let mut reader = self.reader();
        let runs = reader.runs.as_slice();
        let behind = runs.partition_point(|(span, _)| span.first <= number);
        let is_key =
            |(span, _): &(SampleSpan, Option<(u64, u64)>)| span.content == SampleContent::Key;
        let key = runs.get(..behind).and_then(|before| before.iter().rposition(is_key));
        for _ in 0..key.unwrap_or(0) {
            reader.runs.next();
        }
        reader
    }

    /// Decodes its samples run by run.
    pub(crate) fn reader(&self) -> GroupReader<'_> {
        let mut runs = Vec::new();
        let Ok(()) = self.runs(|run| {
            runs.push(match run {
                SampleRun::Block(chunk) => (chunk.span, Some((chunk.block_at, chunk.block_bytes))),
                SampleRun::Lost { first, n, causes } => {
                    let content = SampleContent::Lost(causes.unwrap_or(LossCauses::DAMAGED));
                    (SampleSpan { group: self.group.number, first, n, content }, None)
                }
            });
            Ok::<_, Infallible>(())
        });
        let (decoder, block) = (SampledDecoder::new(), Vec::new());
        GroupReader { group: self, runs: runs.into_iter(), decoder, block }
    }

    /// Decodes all samples in order. `each` receives the number of samples of each channel and the samples, channel
    /// after channel, or `None` where they are lost. Returns those whose blocks cannot be decoded.
    pub(crate) fn decode(
        &self,
        input: &mut (impl Read + Seek),
        mut each: impl FnMut(u64, Option<&[f32]>) -> io::Result<()>,
    ) -> Result<Vec<LostSamples>, TakeError> {
        let mut decoder = SampledDecoder::new();
        let (mut block, mut undecodable) = (Vec::new(), Vec::new());
        self.runs(|run| {
            let chunk = match run {
                SampleRun::Lost { n, .. } => return Ok(each(n, None)?),
                SampleRun::Block(chunk) => chunk,
            };
            let SampleSpan { first, n, content, .. } = chunk.span;
            input.seek(SeekFrom::Start(chunk.block_at))?;
            block.clear();
            input.by_ref().take(chunk.block_bytes).read_to_end(&mut block)?;
            // The number of channels is bounded before the decoder allocates memory for them.
            let n_channels = block.first().map(|head| usize::from(head & 0x7f));
            let is_key = content == SampleContent::Key;
            let decoded = match n_channels == Some(self.group.channels.len()) {
                true => decoder.decode(&block, n as usize, is_key).ok(),
                false => decoder.decode(&[], n as usize, is_key).ok(),
            };
            let decoded = decoded.filter(|samples| are_of_form(samples, self.group.form));
            if decoded.is_none() {
                let channels = self.channels();
                undecodable.push(LostSamples { channels, first, n, causes: None });
            }
            each(n, decoded)?;
            Ok::<_, TakeError>(())
        })?;
        Ok(undecodable)
    }
}

/// A run of samples, and the samples channel after channel, if they are there.
pub(crate) type DecodedRun<'a> = (SampleSpan, Option<&'a [f32]>);

/// Decodes the samples of a group one run after another, so that two groups can be read in step.
#[derive(Debug)]
pub(crate) struct GroupReader<'a> {
    group: &'a GroupSamples,
    /// With the place of the block, unless the samples are lost.
    runs: std::vec::IntoIter<(SampleSpan, Option<(u64, u64)>)>,
    decoder: SampledDecoder,
    block: Vec<u8>,
}

impl GroupReader<'_> {
    /// Leaves out the runs before a sample. The run that begins with it must not depend on those.
    fn skip_to(&mut self, number: u64) {
        let before = self.runs.as_slice().partition_point(|(span, _)| span.first < number);
        if let Some(last) = before.checked_sub(1) {
            self.runs.nth(last);
        }
    }

    /// The next run: its span and its samples, channel after channel, or `None` where they are lost or cannot be decoded.
    pub(crate) fn next(
        &mut self,
        input: &mut (impl Read + Seek),
    ) -> Result<Option<DecodedRun<'_>>, TakeError> {
        let Some((span, place)) = self.runs.next() else { return Ok(None) };
        let Some((at, bytes)) = place else { return Ok(Some((span, None))) };
        input.seek(SeekFrom::Start(at))?;
        self.block.clear();
        input.by_ref().take(bytes).read_to_end(&mut self.block)?;
        let n_channels = self.block.first().map(|head| usize::from(head & 0x7f));
        let fits = n_channels == Some(self.group.group.channels.len());
        let block = if fits { &self.block[..] } else { &[] };
        let is_key = span.content == SampleContent::Key;
        let decoded = self.decoder.decode(block, span.n as usize, is_key).ok();
        let form = self.group.group.form;
        Ok(Some((span, decoded.filter(|samples| are_of_form(samples, form)))))
    }
}

/// Whether the samples are numbers of the form.
fn are_of_form(samples: &[f32], form: SampleForm) -> bool {
    let is_bits = |number: f32, sample: f32| number.to_bits() == sample.to_bits();
    match form {
        SampleForm::Float32 => true,
        SampleForm::Int16 => samples.iter().all(|&s| is_bits(f32::from(s as i16), s)),
        SampleForm::Uint16 => samples.iter().all(|&s| is_bits(f32::from(s as u16), s)),
    }
}

/// A foreign part whose samples are in groups.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledPart {
    groups: Vec<GroupSamples>,
    n_chunks: usize,
}

impl SampledPart {
    /// The part that begins with a group.
    pub(crate) fn new(group: GroupSamples) -> Self {
        Self { groups: vec![group], n_chunks: 0 }
    }

    /// Its groups.
    #[must_use]
    pub fn groups(&self) -> &[GroupSamples] {
        &self.groups
    }

    fn first(&self) -> Option<&SampledGroup> {
        self.groups.first().map(|first| &first.group)
    }

    /// The kind of the part.
    pub(crate) fn kind(&self) -> &str {
        self.first().map_or("", |first| &first.kind)
    }

    /// The largest error of each channel; empty if all are exact.
    pub(crate) fn bounds(&self) -> Vec<f64> {
        if self.groups.iter().all(|found| found.group.bounds.0.is_empty()) {
            return Vec::new();
        }
        let of_group = |found: &GroupSamples| {
            (0..found.group.channels.len()).map(|i| found.group.bound(i)).collect::<Vec<_>>()
        };
        self.groups.iter().flat_map(of_group).collect()
    }

    /// Adds the next group of the part. Returns it if it belongs to another part.
    #[expect(clippy::result_large_err, reason = "it is no error: the group begins another part")]
    pub(crate) fn push_group(&mut self, group: GroupSamples) -> Result<(), GroupSamples> {
        let end = self.groups.last().map_or(0, |last| last.channels()[1]);
        if is_recorded(self.kind())
            || group.group.kind != self.kind()
            || u64::from(group.group.first_channel) < end
        {
            return Err(group);
        }
        self.groups.push(group);
        Ok(())
    }

    /// Adds a chunk of samples if it is of one of the groups. Returns whether it is.
    pub(crate) fn push(&mut self, chunk: SamplesChunk, chunk_bytes: u64) -> bool {
        // Most chunks are those of the last group.
        let mut groups = self.groups.iter_mut().rev();
        let found = groups.find(|found| found.group.number == chunk.span.group);
        let Some(group) = found.filter(|_| self.n_chunks < CHUNKS_MAX) else { return false };
        let belongs = group.push(chunk, chunk_bytes);
        self.n_chunks += usize::from(belongs);
        belongs
    }

    /// Adds times of samples if they are of one of the groups. Returns whether they are.
    pub(crate) fn push_times(&mut self, times: &SampleTimes, offset: u64, bytes: u64) -> bool {
        let mut groups = self.groups.iter_mut();
        let found = groups.find(|found| found.group.number == times.group);
        found.is_some_and(|group| group.push_times(times, offset, bytes))
    }

    /// Adds what a ledger states of its groups.
    pub(crate) fn state(&mut self, ledger: &SampleLedger) {
        for group in &mut self.groups {
            let stated = ledger.groups.iter().find(|of| of.group == group.group.number);
            stated.into_iter().for_each(|stated| group.state(stated));
        }
    }

    /// Samples of each channel, lost ones included.
    fn n_samples(&self) -> u64 {
        self.groups.iter().map(GroupSamples::n_samples).max().unwrap_or(0)
    }

    /// Size of all its chunks.
    pub(crate) fn stored_bytes(&self) -> u64 {
        self.groups.iter().map(|group| group.stored_bytes).sum()
    }

    /// The samples that are missing or damaged in this file, or that the take states as lost.
    #[must_use]
    pub fn lost(&self) -> Vec<LostSamples> {
        self.groups.iter().flat_map(GroupSamples::lost).collect()
    }

    /// The first and the last channel, from 1, whose group is missing; `None` if there is none.
    pub(crate) fn missing_channels(&self) -> Option<[u64; 2]> {
        let mut next = 0;
        for group in &self.groups {
            let [first, last] = group.channels();
            if first > next + 1 {
                return Some([next + 1, first - 1]);
            }
            next = last;
        }
        let n_channels = self.first().map_or(0, |first| u64::from(first.part_channels));
        (next < n_channels).then_some([next + 1, n_channels])
    }

    /// Whether the groups form a block of columns: none is missing, and all have the same layout.
    pub(crate) fn is_block(&self) -> bool {
        self.layout().is_some()
    }

    /// Size of the block of columns.
    pub(crate) fn data_bytes(&self) -> u64 {
        self.bytes_of_width(self.width())
    }

    /// Size of the block of columns if no sample were missing. Limits apply to it: a lost sample doubles the size of
    /// integers, and must not cost the part.
    pub(crate) fn source_bytes(&self) -> u64 {
        self.bytes_of_width(self.form_width())
    }

    fn bytes_of_width(&self, width: usize) -> u64 {
        let Some((front, n_columns, length)) = self.layout() else { return 0 };
        (front.len() as u64).saturating_add(self.column_bytes(width, length, n_columns))
    }

    fn column_bytes(&self, width: usize, length: usize, n_columns: usize) -> u64 {
        (width as u64).saturating_mul(length as u64).saturating_mul(n_columns as u64)
    }

    /// Samples of each channel of a block of columns: incomplete frames are completed.
    fn n_completed(&self) -> u64 {
        let ratio = self.first().map_or(1, |first| u64::from(first.samples_per_frame.max(1)));
        self.n_samples().div_ceil(ratio).saturating_mul(ratio)
    }

    /// Bytes of a sample: 2 for integers, unless some are missing, which only floats can express.
    fn width(&self) -> usize {
        let n_samples = self.n_completed();
        let is_missing =
            |group: &GroupSamples| group.n_samples() < n_samples || !group.lost().is_empty();
        if self.groups.iter().any(is_missing) { 4 } else { self.form_width() }
    }

    /// Bytes of a sample in the source.
    fn form_width(&self) -> usize {
        let is_float = |group: &GroupSamples| group.group.form == SampleForm::Float32;
        if self.groups.iter().any(is_float) { 4 } else { 2 }
    }

    /// What precedes the columns, the number of columns, and the samples of each; `None` for groups that are no block
    /// of columns.
    fn layout(&self) -> Option<(Vec<u8>, usize, usize)> {
        let first = self.first()?;
        let shape = |group: &SampledGroup| {
            (group.form, group.part_channels, group.samples_per_frame, group.first_frame)
        };
        let is_like = |other: &GroupSamples| shape(&other.group) == shape(first);
        let ratio = u64::from(first.samples_per_frame);
        if ratio == 0 || !self.groups.iter().all(is_like) || self.missing_channels().is_some() {
            return None;
        }
        let n_columns = first.part_channels as usize;
        let per_signal = if first.kind == MODEL_OUTPUTS { 4 } else { 1 };
        let n_frames = usize::try_from(self.n_samples().div_ceil(ratio)).ok()?;
        let header = SampleHeader {
            width: self.width(),
            n_signals: n_columns / per_signal,
            ratio: ratio as usize,
            first_frame: first.first_frame,
            n_frames,
        };
        let mut front = header.encode();
        if per_signal > 1 {
            let channels = self.groups.iter().flat_map(|group| &group.group.channels);
            let indices = channels.step_by(per_signal).flat_map(|first| first.index.to_le_bytes());
            front.extend(indices);
        }
        let length = header.samples()?;
        n_columns.is_multiple_of(per_signal).then_some((front, n_columns, length))
    }

    /// Reads the part as a block of columns, with NaN, or the residual 0, in place of lost samples. Returns also those
    /// whose blocks cannot be decoded.
    ///
    /// # Errors
    /// `Corrupt` if a description is missing; `Io`.
    pub(crate) fn read<F>(
        &self,
        input: &mut (impl Read + Seek),
        spool: &mut Spool<F>,
    ) -> Result<(Content, Vec<LostSamples>), TakeError>
    where
        F: Fn() -> io::Result<Arc<dyn ScratchFile>>,
    {
        let (content, undecodable) = self.read_with(self.width(), input, spool)?;
        if undecodable.is_empty() || self.width() == 4 {
            return Ok((content, undecodable));
        }
        self.read_with(4, input, spool)
    }

    /// Reads the part as a block of columns in the form of the source, with any number in place of lost samples. Returns
    /// also these, and those whose blocks cannot be decoded.
    ///
    /// # Errors
    /// Those of [`read`](Self::read).
    pub(crate) fn read_source_form<F>(
        &self,
        input: &mut (impl Read + Seek),
        spool: &mut Spool<F>,
    ) -> Result<(Content, Vec<LostSamples>, Vec<LostSamples>), TakeError>
    where
        F: Fn() -> io::Result<Arc<dyn ScratchFile>>,
    {
        let n_samples = self.n_completed();
        let short = self.groups.iter().filter(|group| group.n_samples() < n_samples);
        let short = short.map(|group| LostSamples {
            channels: group.channels(),
            first: group.n_samples(),
            n: n_samples - group.n_samples(),
            causes: None,
        });
        let lost = self.lost().into_iter().chain(short).collect();
        let (content, undecodable) = self.read_with(self.form_width(), input, spool)?;
        Ok((content, lost, undecodable))
    }

    /// Samples of each channel in a frame.
    pub(crate) fn samples_per_frame(&self) -> u64 {
        self.first().map_or(1, |first| u64::from(first.samples_per_frame))
    }

    fn read_with<F>(
        &self,
        width: usize,
        input: &mut (impl Read + Seek),
        spool: &mut Spool<F>,
    ) -> Result<(Content, Vec<LostSamples>), TakeError>
    where
        F: Fn() -> io::Result<Arc<dyn ScratchFile>>,
    {
        let Some((mut front, n_columns, length)) = self.layout() else {
            let message = "its description does not fit a block of columns";
            return Err(TakeError::InvalidArgument(format!("{}: {message}", self.kind())));
        };
        if let Some(stated) = front.get_mut(1) {
            *stated = width as u8;
        }
        let column_bytes = self.column_bytes(width, length, 1);
        let all_bytes = column_bytes.saturating_mul(n_columns as u64);
        let mut data = spool.zeros(all_bytes.saturating_add(front.len() as u64))?;
        data.write_at(0, &front)?;
        let is_residual = self.kind() == RESIDUALS;
        let fill = |width: usize| match width {
            4 => ordered(if is_residual { 0 } else { f32::NAN.to_bits() }),
            _ => 0,
        };
        let mut undecodable = Vec::new();
        for group in &self.groups {
            let first = u64::from(group.group.first_channel);
            let mut columns = vec![ColumnWriter::new(width); group.group.channels.len()];
            let mut write = |n: u64, samples: Option<&[f32]>| {
                let mut samples = samples.map(|samples| samples.chunks_exact(n as usize));
                for (column, at) in columns.iter_mut().zip(first..) {
                    let from = front.len() as u64 + at * column_bytes;
                    match samples.as_mut().and_then(Iterator::next) {
                        Some(samples) => {
                            let words = samples.iter().map(|&sample| word(width, sample));
                            column.write(&mut data, from, length, words)?;
                        }
                        None => {
                            let lost = std::iter::once(fill(width));
                            column.write(&mut data, from, length, lost)?;
                            column.repeat(n as usize - 1);
                        }
                    }
                }
                Ok(())
            };
            undecodable.extend(group.decode(input, &mut write)?);
            // Incomplete frames are completed, and so are groups that are shorter than others.
            let missing = (length as u64).saturating_sub(group.n_samples());
            if missing > 0 {
                write(missing, None)?;
            }
        }
        Ok((data, undecodable))
    }

    /// Decodes all samples. Returns those whose blocks cannot be decoded.
    ///
    /// # Errors
    /// `Io`.
    pub fn check(&self, input: &mut (impl Read + Seek)) -> Result<Vec<LostSamples>, TakeError> {
        let groups = self.groups.iter().map(|group| group.decode(input, |_, _| Ok(())));
        Ok(groups.collect::<Result<Vec<_>, _>>()?.concat())
    }
}
