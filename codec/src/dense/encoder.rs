//! The encoder of a group: coded, raw and stored channels, and the check of the error bound.

#[cfg(feature = "training")]
use super::tally::Tally;
use super::{
    Dense, P_CODED,
    effort::{Effort, SearchDepth},
    planner::Planner,
    row_encoder::RowEncoder,
};
#[cfg(feature = "training")]
use crate::frame::count_finite;
use crate::{
    BlockReport, DecodedRows, GROUP_CHANNELS, Result, Rows, Tolerance,
    coding::range::{BinaryCoder, RangeEncoder},
    frame::{Payload, PayloadDecoder, PayloadEncoder},
};

/// The largest magnitude of a coordinate in a channel of finite samples; `None` when it has no samples.
fn largest(rows: Rows<'_>) -> Option<f32> {
    // Without their signs, the bits of floats have the order of the numbers.
    let (mut some, mut bits) = (false, 0);
    for (position, &present) in rows.positions().iter().zip(rows.present()) {
        let counted = if present { !(1 << 31) } else { 0 };
        let most = position.map(|coordinate| coordinate.to_bits() & counted);
        bits = most.into_iter().fold(bits, u32::max);
        some |= present;
    }
    some.then(|| f32::from_bits(bits))
}

impl PayloadEncoder for Dense {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        // A block stored as a whole: its samples, and the end of the range coder.
        n_channels * n_rows * 12 + 8
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        if exact {
            self.store_all(channels, out, reports, kept_rows);
        } else {
            self.encode_planned(channels, out, (reports, kept_rows), None);
        }
        Ok(())
    }
}

impl Dense {
    /// Appends a payload like [`PayloadEncoder::encode`], with the points of a planner, if there is one.
    fn encode_planned(
        &mut self,
        channels: &[Rows<'_>],
        out: &mut Vec<u8>,
        (reports, kept_rows): (&mut [BlockReport], &mut [bool]),
        planner: Option<&mut Planner>,
    ) {
        let start = out.len();
        // A larger block is stored as a whole.
        let limit = reports.iter().map(|report| report.samples as usize * 12).sum();
        let n_rows = channels.first().map_or(0, Rows::len);
        let coder = RangeEncoder::new(out, limit);
        let mut codec = RowEncoder::new(channels, self.grid, coder, (reports, kept_rows), planner);
        codec.coder.split(P_CODED, false);
        let mut present: [Option<&[bool]>; GROUP_CHANNELS] = [None; GROUP_CHANNELS];
        for (channel, rows) in channels.iter().enumerate() {
            let Some(max_mm) = largest(*rows) else {
                present[channel] = Some(rows.present());
                continue;
            };
            let fineness = self.grid.fineness(max_mm);
            if self.storage(&mut codec.coder, channel, fineness).is_some() {
                present[channel] = Some(rows.present());
            } else {
                store(&mut codec.coder, *rows);
                codec.reports[channel].keep_all(*rows, codec.kept_rows);
            }
        }
        let coded = self.block(&mut codec, n_rows, &present[..channels.len()]);
        if !codec.finish() || coded.is_err() {
            out.truncate(start);
            self.store_all(channels, out, reports, kept_rows);
        }
    }

    /// Stores a block as a whole, sample by sample; resets all state.
    fn store_all(
        &mut self,
        channels: &[Rows<'_>],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) {
        self.reset();
        let mut coder = RangeEncoder::new(out, usize::MAX);
        coder.split(P_CODED, true);
        for (rows, report) in channels.iter().zip(reports) {
            store(&mut coder, *rows);
            report.keep_all(*rows, kept_rows);
        }
        let finished = coder.finish();
        debug_assert!(finished, "there is no limit");
    }
}

/// An encoder that plans the points of each span before it codes them.
#[derive(Debug)]
pub(crate) struct PlanningEncoder {
    group: Dense,
    planner: Option<Planner>,
}

impl PlanningEncoder {
    pub(crate) fn new(tolerance: Tolerance, effort: Effort) -> Self {
        let planner = |depth: SearchDepth| Planner::new(Dense::new(tolerance), depth);
        Self { group: Dense::new(tolerance), planner: effort.depth().map(planner) }
    }
}

impl Payload for PlanningEncoder {
    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.group.prepare(n_channels, n_rows);
    }

    fn reset(&mut self) {
        self.group.reset();
    }

    fn forget_rows(&mut self) {
        self.group.forget_rows();
    }
}

impl PayloadEncoder for PlanningEncoder {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        Dense::max_payload_bytes(n_channels, n_rows)
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        if exact {
            return self.group.encode(channels, exact, out, reports, kept_rows);
        }
        let planner = self.planner.as_mut();
        self.group.encode_planned(channels, out, (reports, kept_rows), planner);
        Ok(())
    }
}

impl PayloadDecoder for PlanningEncoder {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        self.group.decode(payload, channels)
    }
}

/// Writes the samples of a channel as plain float32 bits.
fn store(coder: &mut impl BinaryCoder, rows: Rows<'_>) {
    for sample in (0..rows.len()).filter_map(|row| rows.get(row)) {
        for coordinate in sample {
            coder.plain(u64::from(coordinate.to_bits()), 32);
        }
    }
}

/// Codes the channels of a group in key blocks of `stretch_rows` rows and returns the statistics of all contexts.
///
/// # Errors
/// `InvalidArgument` under the conditions of [`BlockEncoder::encode`](crate::BlockEncoder::encode).
#[cfg(feature = "training")]
pub fn tally<'a>(
    tolerance: Tolerance,
    channels: &[Rows<'a>],
    stretch_rows: usize,
) -> Result<Tally> {
    let mut encoder = Dense::new(tolerance);
    let mut bytes = 0;
    let n_rows = channels.first().map_or(0, Rows::len);
    for first in (0..n_rows).step_by(stretch_rows.max(1)) {
        let last = (first + stretch_rows).min(n_rows);
        let part = |rows: &Rows<'a>| {
            Rows::new(&rows.positions()[first..last], &rows.present()[first..last])
        };
        let rows = channels.iter().map(part).collect::<Result<Vec<_>>>()?;
        let report = |rows: &Rows<'_>| -> Result<_> {
            Ok(BlockReport { samples: count_finite(*rows)? as u32, ..BlockReport::default() })
        };
        let mut reports = rows.iter().map(report).collect::<Result<Vec<_>>>()?;
        encoder.reset();
        let mut out = Vec::new();
        let mut kept_rows = vec![false; last - first];
        encoder.encode(&rows, false, &mut out, &mut reports, &mut kept_rows)?;
        bytes += out.len();
    }
    let mut tally = encoder.channels.model.tally;
    tally.bytes = bytes;
    Ok(tally)
}
