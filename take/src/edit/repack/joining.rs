//! Joins consecutive stretches into one: those that an edit stored as floats, with their neighbours, and those in which
//! nothing moves.

use mocapd_codec::{DecodedRows, GROUP_CHANNELS, ResamplerKind, stated_error_step};

use crate::{
    TakeError,
    edit::{SourceTake, cut::ExactBlocks},
    record::long_stretch_rows,
    statistics::StretchTally,
    stretch::{SAMPLES_MAX, Span, Stretch, StretchHeaderWriter},
    timeline::Timeline,
};

/// Maximum memory for the tallies of stretches that wait, in bytes: those of forty thousand stretches of 64 markers. A
/// crafted stretch of one row and few bytes can have a tally of 1.5 MB.
const TALLY_BYTES_MAX: usize = 1 << 26;

/// A stretch as it is in the source.
pub(super) struct Waiting {
    pub(super) span: Span,
    pub(super) payload: Vec<u8>,
    pub(super) tally: StretchTally,
}

/// A stretch that replaces those that waited.
pub(super) struct Joined {
    pub(super) span: Span,
    pub(super) payload: Vec<u8>,
    pub(super) tally: StretchTally,
}

/// The samples of a channel in the stretches that wait.
#[derive(Default)]
struct WaitingColumn {
    /// Up to the last of these stretches with a sample.
    rows: DecodedRows,
    /// The bits of the last position.
    last: Option<[u32; 3]>,
}

/// Holds stretches until one comes that cannot be joined with them.
pub(super) struct StretchJoiner {
    exact: ExactBlocks,
    stretch_rows: u32,
    /// Maximum number of rows of a joined stretch.
    rows_max: u64,
    /// Maximum number of rows of a joined stretch in which nothing moves.
    still_rows_max: u64,
    waiting: Vec<Waiting>,
    /// Rows of the stretches that wait, bytes of their payloads, and memory of their tallies.
    n_rows: u64,
    n_bytes: usize,
    tally_bytes: usize,
    /// The errors that the blocks of each of them state.
    stated: Vec<u8>,
    /// By channel; `None` for one without samples in them.
    columns: Vec<Option<WaitingColumn>>,
    is_still: bool,
}

impl StretchJoiner {
    /// `None` for a take whose stretches cannot be joined: those of a recording have times, those that continue others
    /// cannot be taken out, and only `dense` encodes floats again to the same floats.
    pub(super) fn new(source: &SourceTake) -> Result<Option<Self>, TakeError> {
        let header = &source.map().header;
        let codec = header.codec()?;
        if codec.kind != ResamplerKind::Dense || header.device.is_some() || header.has_long_keys() {
            return Ok(None);
        }
        // A distance of keys that was chosen is kept.
        let key_rows = header.key_rows().map_or(u64::MAX, |rows| rows as u64);
        let still_rows = long_stretch_rows(header.rate_hz, source.map().channels.len()) as u64;
        Ok(Some(Self {
            exact: ExactBlocks::new(&codec),
            stretch_rows: header.stretch_rows,
            rows_max: key_rows.min(header.stretch_rows.into()),
            still_rows_max: key_rows.min(still_rows),
            waiting: Vec::new(),
            n_rows: 0,
            n_bytes: 0,
            tally_bytes: 0,
            stated: Vec::new(),
            columns: Vec::new(),
            is_still: true,
        }))
    }

    /// Whether a stretch may be joined with those that wait: it states the same errors, and was stored by an edit, or
    /// nothing moves in all of them.
    pub(super) fn continues(
        &self,
        stretch: &Stretch<'_>,
        decoded: &[Option<&DecodedRows>],
        tally: &StretchTally,
    ) -> bool {
        if self.waiting.is_empty() || !can_join(stretch) || !self.stated.iter().eq(&stated(stretch))
        {
            return false;
        }
        let n_rows = self.n_rows + u64::from(stretch.span.n_rows);
        let n_samples = n_rows.saturating_mul(self.stated_channels(decoded) as u64);
        let tally_bytes = self.tally_bytes.saturating_add(tally.heap_bytes());
        if n_samples > SAMPLES_MAX || tally_bytes > TALLY_BYTES_MAX {
            return false;
        }
        let n_bytes: usize = stretch.blocks.iter().map(|block| block.len()).sum();
        is_stored(n_bytes, tally) && n_rows <= self.rows_max
            || self.is_still && n_rows <= self.still_rows_max && self.rests(decoded)
    }

    /// Whether another stretch may be joined with this one. Its samples are held until then.
    pub(super) fn may_begin(
        &self,
        stretch: &Stretch<'_>,
        decoded: &[Option<&DecodedRows>],
    ) -> bool {
        let n_rows = u64::from(stretch.span.n_rows);
        let is_still = || decoded.iter().flatten().all(|decoded| is_still(decoded));
        can_join(stretch) && (n_rows < self.rows_max || n_rows < self.still_rows_max && is_still())
    }

    /// Adds a stretch that [continues](Self::continues) those that wait, or [begins](Self::may_begin).
    pub(super) fn add(
        &mut self,
        waiting: Waiting,
        stated: Vec<u8>,
        decoded: &[Option<&DecodedRows>],
    ) {
        self.is_still = self.is_still && self.rests(decoded);
        for (i, decoded) in decoded.iter().enumerate() {
            let Some(decoded) = decoded.filter(|decoded| decoded.has_samples()) else { continue };
            if self.columns.len() <= i {
                self.columns.resize_with(i + 1, || None);
            }
            if let Some(column) = self.columns.get_mut(i) {
                column.get_or_insert_default().append(decoded, self.n_rows as usize);
            }
        }
        self.n_rows += u64::from(waiting.span.n_rows);
        self.n_bytes += waiting.payload.len();
        self.tally_bytes += waiting.tally.heap_bytes();
        self.stated = stated;
        self.waiting.push(waiting);
    }

    /// The stretches that waited, and the one with number `number` that replaces them, if there is one of fewer bytes.
    /// None wait after it.
    pub(super) fn take(&mut self, number: u8) -> Result<(Vec<Waiting>, Option<Joined>), TakeError> {
        let waiting = std::mem::take(&mut self.waiting);
        let n_rows = std::mem::take(&mut self.n_rows) as u32;
        let n_bytes = std::mem::take(&mut self.n_bytes);
        let mut columns = std::mem::take(&mut self.columns);
        (self.tally_bytes, self.is_still) = (0, true);
        let [first, _, ..] = waiting.as_slice() else { return Ok((waiting, None)) };
        let span = Span { n_rows, number, ..first.span };
        columns.iter_mut().flatten().for_each(|column| column.pad(n_rows as usize));
        let rows: Vec<_> =
            columns.iter().map(|column| column.as_ref().map(|column| &column.rows)).collect();
        let alone = rows.len() <= GROUP_CHANNELS;
        let mut payload = Vec::new();
        let mut front = StretchHeaderWriter::new(self.stretch_rows);
        front.put(span, &Timeline::default(), &[], alone, &mut payload);
        let (tally, _) = self.exact.put(&rows, &(0..n_rows as usize), alone, &mut payload)?;
        let joined = (payload.len() < n_bytes).then_some(Joined { span, payload, tally });
        Ok((waiting, joined))
    }

    /// Whether each marker of a stretch stays where it was when last seen.
    fn rests(&self, decoded: &[Option<&DecodedRows>]) -> bool {
        decoded.iter().enumerate().all(|(i, decoded)| {
            let Some(decoded) = decoded else { return true };
            let before = self.columns.get(i).and_then(|column| column.as_ref()?.last);
            let first = positions(decoded).next();
            is_still(decoded) && (before.is_none() || first.is_none() || before == first)
        })
    }

    /// The number of channels that the blocks of a stretch state if it joins those that wait with this one: in each
    /// group, up to the last one with samples.
    fn stated_channels(&self, decoded: &[Option<&DecodedRows>]) -> usize {
        let has_samples = |i: usize| {
            let decoded = decoded.get(i).copied().flatten();
            self.columns.get(i).is_some_and(Option::is_some)
                || decoded.is_some_and(DecodedRows::has_samples)
        };
        let n = self.columns.len().max(decoded.len());
        let groups = (0..n).step_by(GROUP_CHANNELS);
        let stated = |first: usize| {
            let last = (first..n.min(first + GROUP_CHANNELS)).rfind(|&i| has_samples(i));
            last.map_or(0, |last| last + 1 - first)
        };
        groups.map(stated).sum()
    }
}

impl WaitingColumn {
    /// Adds the rows of a stretch that begins `before` rows after the first.
    fn append(&mut self, decoded: &DecodedRows, before: usize) {
        self.pad(before);
        self.rows.positions.extend_from_slice(&decoded.positions);
        self.rows.present.extend_from_slice(&decoded.present);
        self.rows.max_error_mm = self.rows.max_error_mm.max(decoded.max_error_mm);
        self.last = positions(decoded).next_back();
    }

    /// Adds rows without a sample, up to `n_rows`.
    fn pad(&mut self, n_rows: usize) {
        self.rows.positions.resize(n_rows, [0.0; 3]);
        self.rows.present.resize(n_rows, false);
    }
}

/// Whether the stretch can be joined: it has rows and no times, and does not continue another stretch.
fn can_join(stretch: &Stretch<'_>) -> bool {
    stretch.span.key && stretch.timeline.is_none() && stretch.span.n_rows > 0
}

/// The errors that the blocks of a stretch state.
pub(super) fn stated(stretch: &Stretch<'_>) -> Vec<u8> {
    stretch.blocks.iter().map(|block| stated_error_step(block)).collect()
}

/// Whether the blocks of a stretch are about as large as its samples.
fn is_stored(n_bytes: usize, tally: &StretchTally) -> bool {
    n_bytes as u64 * 10 > tally.n_samples() * 12 * 8
}

/// The bits of the positions of a channel's samples.
fn positions(rows: &DecodedRows) -> impl DoubleEndedIterator<Item = [u32; 3]> {
    let present = rows.positions.iter().zip(&rows.present).filter(|(_, present)| **present);
    present.map(|(position, _)| position.map(f32::to_bits))
}

/// Whether all samples of a channel are at one position.
fn is_still(rows: &DecodedRows) -> bool {
    let first = positions(rows).next();
    positions(rows).all(|position| Some(position) == first)
}

#[cfg(test)]
mod tests {
    use mocapd_codec::Tolerance;

    use super::*;
    use crate::{
        TakeMap,
        record::{CODEC_VERSION, Header},
    };

    /// Two stretches of `n_rows` rows with a sample of one channel, number `at` of each of 128 groups. Whether the second
    /// continues the first.
    fn joins(n_rows: u32, at: usize) -> bool {
        let n_groups = 128;
        let mut header = Header {
            codec_version: CODEC_VERSION,
            rate_hz: 100.0,
            stretch_rows: 1 << 17,
            ..Header::default()
        };
        let tolerance = Tolerance::from_mm(1.0).unwrap();
        header.set_codec(&mocapd_codec::Settings { kind: ResamplerKind::Dense, tolerance });
        let map = TakeMap { header, ..TakeMap::default() };
        let mut joiner =
            StretchJoiner::new(&SourceTake { map, ..SourceTake::default() }).unwrap().unwrap();
        let mut present = vec![false; n_rows as usize];
        present[0] = true;
        let mut rows = DecodedRows::default();
        (rows.positions, rows.present) = (vec![[1.0; 3]; n_rows as usize], present);
        let channel = |i: usize| (i % GROUP_CHANNELS == at).then_some(&rows);
        let decoded: Vec<_> = (0..n_groups * GROUP_CHANNELS).map(channel).collect();
        let block = [3; 20];
        let stretch = Stretch {
            span: Span { first_row: 0, n_rows, key: true, number: 0 },
            missing_before: false,
            timeline: None,
            shared: &[],
            blocks: vec![&block; n_groups],
            sizes: crate::stretch::StretchSizes::default(),
            payload: &[],
        };
        let tally = StretchTally::of_decoded(&stretch, decoded.iter().copied());
        assert!(joiner.may_begin(&stretch, &decoded));
        let waiting = Waiting { span: stretch.span, payload: Vec::new(), tally: tally.clone() };
        joiner.add(waiting, stated(&stretch), &decoded);
        assert_eq!(joiner.columns.iter().flatten().count(), n_groups, "only those with samples");
        joiner.continues(&stretch, &decoded, &tally)
    }

    #[test]
    fn a_joined_stretch_has_no_more_samples_than_a_reader_accepts() {
        let n_rows_max = SAMPLES_MAX as u32 / (128 * 64) / 2;
        assert!(joins(n_rows_max, 63));
        assert!(!joins(n_rows_max + 1, 63));
        assert!(joins(n_rows_max + 1, 62), "its blocks state 63 channels");
    }
}
