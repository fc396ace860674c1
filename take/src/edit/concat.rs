//! Joins takes one after another.

use std::{
    collections::HashSet,
    io::{self, Read, Seek, Write},
    iter,
};

use super::{CONCAT, CUT, EditContext, Seam, SourceTake, damaged, recorded::JoinedSamples};
use crate::{
    TakeError, TakeEvent, TakeMap, TakeTraversal, TakeWriter,
    record::{Channel, Clock, Event, EventKind, Header, Ledger, SeriesPlace},
    sampled::GroupSamples,
    statistics::StretchTally,
    stretch::{CopiedStretch, NUMBERS, Span, Stretch},
    timeline::{LossCauses, RowRun, Timeline},
    traversal::Decode,
};

/// The result of joining takes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ConcatReport {
    /// Rows of the new take, including lost ones.
    pub rows: u64,
    /// The first row of each take in the new one.
    pub first_rows: Vec<u64>,
    /// What lies before each take but the first.
    pub seams: Vec<Seam>,
    /// Entries of the channel table of the new take.
    pub n_channels: usize,
    /// The ledger of the new take.
    pub ledger: Ledger,
    /// Size of the new take in bytes.
    pub bytes: u64,
    /// What the new take lacks of these takes, one phrase each.
    pub left_out: Vec<String>,
}

/// Why a take cannot follow those before it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{why}")]
pub struct Mismatch {
    /// Which take, from 0.
    pub index: usize,
    /// How it differs from the first.
    pub why: String,
}

/// Checks whether takes can be joined: the same markers, rate, resampler, tolerance, unit and up axis. Markers that
/// appear later may follow those of the takes before.
///
/// # Errors
/// The first difference.
pub fn check_joinable(sources: &[SourceTake]) -> Result<(), Mismatch> {
    let Some((first, others)) = sources.split_first() else { return Ok(()) };
    let mut table: &[Channel] = &first.map().channels;
    for (i, source) in others.iter().enumerate() {
        let difference = header_difference(&first.map().header, &source.map().header)
            .or_else(|| table_difference(table, &source.map().channels))
            .or_else(|| order_difference(first.map(), source.map()));
        if let Some(why) = difference {
            return Err(Mismatch { index: i + 1, why });
        }
        table = &source.map().channels;
    }
    Ok(())
}

/// The first difference between two headers that keeps their takes apart.
fn header_difference(first: &Header, other: &Header) -> Option<String> {
    let kind = |header: &Header| if header.device.is_some() { "a recording" } else { "an import" };
    let unit = |header: &Header| {
        header.source.as_ref().map_or_else(String::new, |s| format!("{} ({} mm)", s.unit, s.factor))
    };
    let tick_hz = |header: &Header| header.device.as_ref().map_or(0, |device| device.tick_hz);
    let fields: [(&str, [String; 2]); 7] = [
        ("it is", [kind(first).to_owned(), kind(other).to_owned()]),
        ("its rate is", [first, other].map(|header| format!("{} Hz", header.rate_hz))),
        ("its resampler is", [first, other].map(|header| header.resampler.clone())),
        ("its tolerance is", [first, other].map(|header| format!("{} mm", header.tolerance_mm))),
        (
            "its up axis is",
            [first, other].map(|h| h.up_axis.name().unwrap_or("unknown").to_owned()),
        ),
        ("its unit is", [first, other].map(unit)),
        ("its device's clock has", [first, other].map(|h| format!("{} ticks/s", tick_hz(h)))),
    ];
    let (what, [first, found]) = fields.into_iter().find(|(_, [a, b])| a != b)?;
    Some(format!("{what} {found}, not {first}"))
}

/// Whether the markers are coded in another order than in the first take; further ones in that of the source.
fn order_difference(first: &TakeMap, other: &TakeMap) -> Option<String> {
    let row = |row: &usize| first.order.column_of(*row) != other.order.column_of(*row);
    (0..first.channels.len().max(other.channels.len())).find(row)?;
    let message =
        "its markers are coded in another order: import the files with an --effort below 9";
    Some(message.to_owned())
}

/// The first difference of a channel table from the one before it, which it may extend.
fn table_difference(table: &[Channel], other: &[Channel]) -> Option<String> {
    let labels = |channels: &[Channel], i: usize| channels.get(i).map(|c| c.label.clone());
    let i = (0..table.len()).find(|&i| labels(table, i) != labels(other, i))?;
    let expected = labels(table, i).unwrap_or_default();
    Some(match labels(other, i) {
        Some(found) => format!("its marker {} is `{found}`, not `{expected}`", i + 1),
        None => format!("it has {i} markers and lacks `{expected}`, marker {}", i + 1),
    })
}

/// Joins whole takes in this order. `open` opens one of them, by its index. Stretches are copied, and moved to rows after
/// those of the takes before. Where the clocks show that frames of one recording lie between two takes, these are lost
/// rows; where nothing shows that a take continues the one before, an event marks its first row.
///
/// # Errors
/// `InvalidArgument` if the takes [cannot be joined](check_joinable); `Io`; those of [`TakeWriter`].
pub fn concat<R: Read + Seek, W: Write>(
    sources: &[SourceTake],
    mut open: impl FnMut(usize) -> io::Result<R>,
    out: W,
    context: &EditContext<'_>,
) -> Result<ConcatReport, TakeError> {
    let invalid = |message: String| TakeError::InvalidArgument(message);
    check_joinable(sources)
        .map_err(|found| invalid(format!("take {}: {found}", found.index + 1)))?;
    let (Some(first), Some(last)) = (sources.first(), sources.last()) else {
        return Err(invalid("there is no take to join".to_owned()));
    };
    let plan =
        JoinPlan::new(sources).ok_or_else(|| invalid("too many frames to join".to_owned()))?;
    let header = header_of_joined(sources, context)?;
    let mut take = TakeWriter::new(out, &header)?;
    let mut left_out: Vec<String> = sources.iter().flat_map(SourceTake::left_out).collect();
    let mut listed = HashSet::new();
    left_out.retain(|what| listed.insert(what.clone()));
    first.map().subject.iter().try_for_each(|subject| take.subject(subject))?;
    take.order(&first.map().order)?;
    take.describe_as(first.map())?;
    if sources.iter().any(|source| source.map().subject != first.map().subject) {
        left_out.push("the subjects of later takes, which differ from the first take's".to_owned());
    }
    let (mut samples, not_joined) = JoinedSamples::begin(sources, &mut take)?;
    left_out.extend(not_joined);
    let frames_continue = plan.seams.iter().all(|seam| *seam == Seam::Continuous);
    let parts = super::join_parts(sources, &mut open, frames_continue, context)?;
    parts.parts.iter().try_for_each(|found| take.foreign_with_lost(&found.part, &found.lost))?;
    left_out.extend(parts.left_out);
    for event in plan.events(sources) {
        take.event(&event)?;
    }
    let mut joiner = Joiner {
        take,
        channels: &last.map().channels,
        n_channels: header.channels.len(),
        stretch_rows: header.stretch_rows,
        number: 0,
        announced: 0,
        payload: Vec::new(),
    };
    let (clocks, segments) = clocks(sources);
    for (i, source) in sources.iter().enumerate() {
        let (first_row, missing) = (plan.first_rows[i], plan.rows_before(i));
        joiner.add(source, open(i)?, first_row, missing, context)?;
        samples.add(source.map(), &mut open(i)?, segments[i], &mut joiner.take)?;
    }
    samples.finish(&mut joiner.take)?;
    for clock in clocks {
        joiner.take.clock(&clock)?;
    }
    let ledger = plan.ledger(sources, joiner.announced);
    joiner.take.close(&ledger, last.map().ending.clone())?;
    let bytes = joiner.take.bytes();
    let JoinPlan { rows, first_rows, seams } = plan;
    let n_channels = last.map().channels.len();
    Ok(ConcatReport { rows, first_rows, seams, n_channels, ledger, bytes, left_out })
}

/// Where the takes stand in the joined one.
struct JoinPlan {
    rows: u64,
    first_rows: Vec<u64>,
    seams: Vec<Seam>,
}

impl JoinPlan {
    /// `None` if there are more rows than a number can count.
    fn new(sources: &[SourceTake]) -> Option<Self> {
        let mut plan = Self { rows: 0, first_rows: Vec::new(), seams: Vec::new() };
        for (i, source) in sources.iter().enumerate() {
            if let Some(before) = i.checked_sub(1).and_then(|i| sources.get(i)) {
                let seam = Seam::between(before, source);
                plan.rows = plan.rows.checked_add(seam.rows())?;
                plan.seams.push(seam);
            }
            plan.first_rows.push(plan.rows);
            plan.rows = plan.rows.checked_add(source.map().n_rows)?;
        }
        Some(plan)
    }

    /// Rows between take `i` and the one before it.
    fn rows_before(&self, i: usize) -> u64 {
        let seam = i.checked_sub(1).and_then(|i| self.seams.get(i));
        seam.map_or(0, |seam| seam.rows())
    }

    /// The events of all takes, and one for each seam that is not continuous.
    fn events(&self, sources: &[SourceTake]) -> impl Iterator<Item = Event> {
        sources.iter().enumerate().flat_map(|(i, source)| {
            let first_row = self.first_rows[i];
            let moved = move |event: &Event| Event {
                row: event.row.saturating_add(first_row),
                ..event.clone()
            };
            self.seam_event(i, source).into_iter().chain(source.map().events.iter().map(moved))
        })
    }

    fn seam_event(&self, i: usize, source: &SourceTake) -> Option<Event> {
        let (seam, row) = (*self.seams.get(i.checked_sub(1)?)?, self.first_rows[i]);
        let id = source.map().header.take_id_text();
        let text = match seam {
            Seam::Continuous => return None,
            Seam::Missing(rows) => {
                let frames = if rows == 1 { "frame before it is" } else { "frames before it are" };
                format!("the take {id} begins here; {rows} {frames} in none of the joined takes")
            }
            Seam::Unknown => {
                format!("the take {id} begins here; the time since the previous take is unknown")
            }
        };
        Some(Event { row, ..Event::new(EventKind::Host, 0, text) })
    }

    /// The sum of all ledgers. `announced`: samples that the joined take announces.
    fn ledger(&self, sources: &[SourceTake], announced: u64) -> Ledger {
        let mut sum = Ledger { finished: true, ..Ledger::default() };
        for ledger in sources.iter().filter_map(|source| source.map().ledger.as_ref()) {
            sum.add_counters(ledger);
            sum.contradictions.extend_from_slice(&ledger.contradictions);
            sum.clock = ledger.clock.or(sum.clock);
        }
        let missing = self.seams.iter().fold(0, |rows: u64, seam| rows.saturating_add(seam.rows()));
        // Whether the device produced them is not known from these takes.
        sum.unknown_after_disconnect = sum.unknown_after_disconnect.saturating_add(missing);
        sum.frames_sent = sum.frames_sent.saturating_add(missing);
        // A marker that a later take does not announce at its start counts as occluded there.
        let more = announced.saturating_sub(sum.samples_announced);
        sum.samples_announced = sum.samples_announced.saturating_add(more);
        sum.samples_occluded = sum.samples_occluded.saturating_add(more);
        sum
    }
}

/// The header of the first take, with an id that depends on all takes.
fn header_of_joined(
    sources: &[SourceTake],
    context: &EditContext<'_>,
) -> Result<Header, TakeError> {
    let headers: Vec<&Header> = sources.iter().map(|source| &source.map().header).collect();
    let ids: Vec<String> = headers.iter().map(|header| header.take_id_text()).collect();
    let mut header = headers.first().map_or_else(Header::default, |&header| header.clone());
    // Keys that are far apart in one take are so in the joined one.
    let versions = headers.iter().map(|header| header.codec_version);
    header.codec_version = versions.max().unwrap_or(header.codec_version);
    // The rows are no longer those that it states.
    header.settings.retain(|(key, _)| key != CUT);
    let note = format!("by {}: the takes {}", context.software, ids.join(", "));
    header.settings.push((CONCAT.to_owned(), note));
    header.unset_source_bytes();
    SeriesPlace::join(&mut header, is_one_series(sources));
    let bytes: Vec<u8> = headers.iter().flat_map(|header| header.take_id).collect();
    let subject = sources.first().and_then(|source| source.map().subject.as_ref());
    header.set_import_id(&bytes[..], subject)?;
    Ok(header)
}

/// Whether the takes are parts of one divided recording, in their order.
fn is_one_series(sources: &[SourceTake]) -> bool {
    let places = |pair: &[SourceTake]| match pair {
        [before, after] => SeriesPlace::rows_between(before.place(), after.place()).is_some(),
        _ => false,
    };
    sources.windows(2).all(places)
}

/// The observations of the clocks in all takes. Those of a take count as segments of their own, as after a jump: each line
/// is fitted to the observations of its own take. Takes that were cut from one have the same records, which are kept
/// once. Returns also the number that the first segment of each take has.
fn clocks(sources: &[SourceTake]) -> (Vec<Clock>, Vec<u32>) {
    let mut all: Vec<Clock> = Vec::new();
    let mut kept: Option<&[Clock]> = None;
    let mut firsts = Vec::new();
    let (mut first, mut next) = (0, 0_u32);
    for source in sources {
        if !source.clocks.is_empty() && kept == Some(&source.clocks) {
            firsts.push(first);
            continue;
        }
        first = next;
        // Samples may be of a segment for which there was no time to observe its clock.
        let of_samples = source.map().sample_groups().flat_map(GroupSamples::anchors);
        let segments = source.clocks.iter().map(|clock| clock.segment);
        let last = segments.chain(of_samples.map(|anchor| anchor.segment)).max();
        next = last.map_or(first, |last| first.saturating_add(last).saturating_add(1));
        let renumbered = source
            .clocks
            .iter()
            .map(|clock| Clock { segment: clock.segment.saturating_add(first), ..clock.clone() });
        all.extend(renumbered);
        kept = Some(&source.clocks);
        firsts.push(first);
    }
    (all, firsts)
}

/// Writes the stretches of the takes.
struct Joiner<'a, W> {
    take: TakeWriter<W>,
    /// The channel table of the last take, which all others begin.
    channels: &'a [Channel],
    /// Entries that were written.
    n_channels: usize,
    stretch_rows: u32,
    number: u8,
    /// Samples that are announced: channels times recorded rows.
    announced: u64,
    payload: Vec<u8>,
}

impl<W: Write> Joiner<'_, W> {
    /// Writes the stretches of a take from row `first_row` on; `missing` rows before it are in no take.
    fn add(
        &mut self,
        source: &SourceTake,
        input: impl Read + Seek,
        first_row: u64,
        missing: u64,
        context: &EditContext<'_>,
    ) -> Result<(), TakeError> {
        let mut missing = Some(missing).filter(|rows| *rows > 0);
        let mut found_rows = 0;
        // It is decoded for the statistics.
        let traversal = TakeTraversal::from_map(input, source.map(), Decode::All)?;
        traversal.run(|found, progress| {
            let TakeEvent::Stretch(stretch) = &found.event else { return Ok(()) };
            if let Some(problem) = progress.take.problems.first() {
                return Err(damaged(problem));
            }
            self.grow(source.channels_at(stretch.from_row()))?;
            let tally = StretchTally::of_decoded(stretch, progress.coded_rows());
            self.stretch(source, stretch, (first_row, missing.take()), &tally)?;
            found_rows = stretch.span.end_row();
            (context.on_rows)(first_row.saturating_add(found_rows));
            Ok(())
        })?;
        if found_rows == source.map().n_rows {
            // Channels may be announced after the last stretch.
            return self.grow(source.map().channels.len());
        }
        Err(TakeError::InvalidArgument(
            "another program changed a take while it was being read".into(),
        ))
    }

    /// Writes the channels that appear up to entry `n_channels`.
    fn grow(&mut self, n_channels: usize) -> Result<(), TakeError> {
        let more = self.channels.get(self.n_channels..n_channels).unwrap_or_default();
        if !more.is_empty() {
            self.take.channels(more)?;
            self.n_channels = n_channels;
        }
        Ok(())
    }

    fn stretch(
        &mut self,
        source: &SourceTake,
        stretch: &Stretch<'_>,
        (first_row, missing): (u64, Option<u64>),
        tally: &StretchTally,
    ) -> Result<(), TakeError> {
        // Without a time line, rows are lost where no stretch has them.
        let missing = missing.filter(|_| stretch.timeline.is_some());
        let lost = missing.map(|rows| RowRun { rows, lost: Some(LossCauses::DISCONNECTED) });
        let runs = stretch.timeline.as_ref().map(|timeline| {
            iter::chain(lost, timeline.runs.iter().copied()).collect::<Vec<RowRun>>()
        });
        let recorded = stretch.timeline.as_ref().map(Timeline::n_recorded);
        let recorded = recorded.unwrap_or(stretch.span.n_rows.into());
        let announced = recorded.saturating_mul(self.n_channels as u64);
        self.announced = self.announced.saturating_add(announced);
        let span = Span {
            first_row: stretch.span.first_row.saturating_add(first_row),
            number: self.number,
            ..stretch.span
        };
        let from_row = stretch.from_row().saturating_add(first_row) - missing.unwrap_or(0);
        let stretch_rows = [source.map().header.stretch_rows, self.stretch_rows];
        self.payload.clear();
        CopiedStretch { span, from_row, runs, stretch_rows }
            .put(stretch.payload, &mut self.payload)?;
        self.take.stretch(span, &self.payload, tally)?;
        self.number = (self.number + 1) % NUMBERS;
        Ok(())
    }
}
