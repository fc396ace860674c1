//! The decoded content of a take.

use std::io::Cursor;

use mocapd_codec::Position;
use mocapd_take::{
    ChannelOrder, TakeError, TakeEvent, TakeFrames, TakeMap,
    motion::{Foreign, FrameSource},
    poses::{Pose, PoseState, PosesByRow, RowPoses},
    reader::read_events,
    record::{Channel, Event, GroupLedger, Ledger, SampledGroup},
    statistics::TakeStatistics,
    stretch::{Stretch, StretchDecoder},
    timeline::{LossCauses, RowTime},
};

use super::text::digest;

/// The decoded content of a take.
#[derive(Debug, Default)]
pub(crate) struct Decoded {
    pub(crate) channels: Vec<Channel>,
    /// Of the channels in the source.
    pub(crate) order: ChannelOrder,
    pub(crate) n_rows: u64,
    /// By channel and row: the sample, and whether it was kept.
    pub(crate) tracks: Vec<Vec<Option<(Position, bool)>>>,
    /// The recorded rows.
    pub(crate) times: Vec<(u64, RowTime)>,
    /// First row, rows and causes.
    pub(crate) lost: Vec<(u64, u64, LossCauses)>,
    pub(crate) events: Vec<Event>,
    pub(crate) ledgers: Vec<Ledger>,
    pub(crate) stated_mm: f64,
    /// First row, rows, and whether it is a key.
    pub(crate) stretches: Vec<(u64, u32, bool)>,
    /// The statistics as the take states them.
    pub(crate) statistics: Option<TakeStatistics>,
    pub(crate) groups: Vec<SampledGroup>,
    /// Of a recording: the content of its groups, of the ledger of samples, and the poses by row; see `text.rs`.
    pub(crate) recorded: Vec<String>,
    /// The foreign parts that are stored as groups.
    pub(crate) parts: Vec<Foreign>,
}

impl Decoded {
    /// Decodes a take. Damage panics.
    ///
    /// # Errors
    /// Those of the reader.
    pub(crate) fn read(take: &[u8]) -> Result<Self, TakeError> {
        let mut found = Self::default();
        let mut decoder = None;
        read_events(take, |event| {
            match event {
                TakeEvent::Header(header) => {
                    decoder = Some(StretchDecoder::new(header.codec()?));
                    found.channels = header.channels;
                }
                TakeEvent::Channels(more) => found.channels.extend(more),
                TakeEvent::Order(order) => found.order = order,
                TakeEvent::Stretch(stretch) => {
                    assert!(!stretch.missing_before);
                    let decoder = decoder.as_mut().expect("a header in front");
                    decoder.decode(&stretch)?;
                    found.add(&stretch, decoder);
                }
                TakeEvent::Event(event) => found.events.push(event),
                TakeEvent::Ledger(ledger) => found.ledgers.push(*ledger),
                TakeEvent::Summary(summary) => found.statistics = summary.statistics,
                TakeEvent::Index(entries) => {
                    let keys = found.stretches.iter().filter(|stretch| stretch.2);
                    assert!(keys.map(|key| key.0).eq(entries.iter().map(|entry| entry.first_row)));
                }
                TakeEvent::Footer(footer) => assert_eq!(footer.n_rows, found.n_rows),
                TakeEvent::SampledGroup(group) => found.groups.push(*group),
                TakeEvent::Samples(_) | TakeEvent::SampleTimes(_) => {}
                TakeEvent::SampleLedger(_) | TakeEvent::Foreign(_) => {}
                TakeEvent::End { finished, .. } => assert!(finished),
                other => panic!("{other:?}"),
            }
            Ok(())
        })?;
        let frames = TakeFrames::open_with(Cursor::new(take), |_| true, || unreachable!())?;
        assert_eq!(frames.problems(), []);
        found.recorded = recorded(take);
        let is_sampled = |part: &&Foreign| found.groups.iter().any(|group| group.kind == part.kind);
        found.parts = frames.info().foreign.iter().filter(is_sampled).cloned().collect();
        let n_rows = found.n_rows as usize;
        found.tracks.resize(found.tracks.len().max(found.order.n_channels()), Vec::new());
        found.order.restore_table(&mut found.channels);
        found.order.restore(&mut found.tracks);
        found.tracks.iter_mut().for_each(|track| track.resize(n_rows, None));
        Ok(found)
    }

    fn add(&mut self, stretch: &Stretch<'_>, decoder: &StretchDecoder) {
        let span = stretch.span;
        self.n_rows = self.n_rows.max(span.end_row());
        self.stretches.push((span.first_row, span.n_rows, span.key));
        if let Some(timeline) = &stretch.timeline {
            self.times.extend(timeline.recorded());
            let mut row = timeline.first_row;
            for run in &timeline.runs {
                self.lost.extend(run.lost.map(|causes| (row, run.rows, causes)));
                row += run.rows;
            }
        }
        for (channel, rows) in decoder.rows().enumerate() {
            let Some(rows) = rows.filter(|rows| rows.has_samples()) else { continue };
            if self.tracks.len() <= channel {
                self.tracks.resize_with(channel + 1, Vec::new);
            }
            let track = &mut self.tracks[channel];
            track.resize(span.first_row as usize, None);
            let flags = rows.present.iter().zip(&rows.kept);
            let samples = rows.positions.iter().zip(flags);
            track.extend(samples.map(|(&at, (&present, &kept))| present.then_some((at, kept))));
            self.stated_mm = self.stated_mm.max(rows.max_error_mm);
        }
    }
}

/// Of a group each sample, of a body each pose, and of a row the poses of all bodies, as lines.
fn recorded(take: &[u8]) -> Vec<String> {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let mut lines = Vec::new();
    let input = || Cursor::new(take);
    for group in map.sample_groups() {
        let (number, width) = (group.group.number, group.group.channels.len());
        let mut columns = vec![Vec::new(); width];
        let undecodable = group.read(&mut input(), |_, n, samples| {
            for (channel, column) in columns.iter_mut().enumerate() {
                let from = channel * n as usize;
                let block = samples.map(|samples| &samples[from..from + n as usize]);
                let bits = |i: usize| block.map_or(f32::NAN, |block| block[i]).to_bits();
                column.extend((0..n as usize).flat_map(|i| bits(i).to_le_bytes()));
            }
            Ok(())
        });
        assert_eq!(undecodable.unwrap(), []);
        let n = columns.first().map_or(0, |column| column.len() / 4);
        lines.push(format!(
            "samples of group {number}: {n}, {}",
            digest(columns.concat().into_iter())
        ));
    }
    for group in map.pose_groups() {
        let (mut bytes, n_bodies) = (Vec::new(), group.group.bodies().count());
        let undecodable = group.read_poses(&mut input(), |_, n, poses| {
            let lost = vec![Pose::without(PoseState::Missing); n as usize * n_bodies];
            poses.unwrap_or(&lost).iter().for_each(|pose| put(pose, &mut bytes));
            Ok(())
        });
        assert_eq!(undecodable.unwrap(), []);
        let number = group.group.number;
        lines.push(format!("poses of group {number}: {}", digest(bytes.into_iter())));
    }
    if let Some(by_row) = PosesByRow::read(input(), &map).unwrap() {
        let (mut bytes, mut poses) = (Vec::new(), Vec::new());
        let mut rows = by_row.rows(0..by_row.n_rows());
        while rows.next(&mut input(), RowPoses::ROWS_AT_ONCE, &mut poses).unwrap().is_some() {
            poses.iter().for_each(|pose| put(pose, &mut bytes));
        }
        lines.push(format!("rows of poses: {}", digest(bytes.into_iter())));
    }
    if let Some(ledger) = &map.sample_ledger {
        lines.push(format!("sample ledger: refused {}", ledger.batches_refused));
        let of = |group: &GroupLedger| {
            let counts = [group.taken, group.stored, group.lost(), group.duplicates, group.jumps];
            let errors = group.errors.map(|of| [of.position_nm, of.angle_nanodegrees]);
            format!("sample ledger of group {}: {counts:?} {errors:?}", group.group)
        };
        lines.extend(ledger.groups.iter().map(of));
        let (plates, why_not) = map.force_plates();
        assert_eq!(why_not, [""; 0]);
        lines.extend(plates.iter().map(|plate| format!("sample ledger: plate {plate:?}")));
    }
    lines
}

/// The number of its state, and eight float32.
fn put(pose: &Pose, out: &mut Vec<u8>) {
    out.push(pose.state.code());
    let numbers = pose.position_mm.into_iter().chain(pose.quaternion).chain([pose.residual_mm]);
    let bits = numbers.map(|x| if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() });
    out.extend(bits.flat_map(u32::to_le_bytes));
}
