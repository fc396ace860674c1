//! The state that coding the rows of one channel in a span changes: saved, and restored before other points are tried.

use std::ops::RangeInclusive;

use super::{
    SPAN,
    contexts::KINDS,
    cross_channel::SpanResiduals,
    distance_correction::KindShares,
    level::Channels,
    level_prediction::{AnchorErrors, PADDED_SPAN},
    segment_lengths::PartnerDistances,
    track::Steps,
};

/// The state of one channel in a span.
#[derive(Debug, Clone)]
pub(super) struct ChannelState {
    points: [[f64; 3]; SPAN],
    steps: [Steps; SPAN],
    span: [[f64; PADDED_SPAN]; 3],
    packed_steps: [u64; PADDED_SPAN],
    activity: [[i32; 4]; KINDS],
    anchor_errors: AnchorErrors,
    shares: KindShares,
    distances: PartnerDistances,
    residuals: SpanResiduals,
}

impl ChannelState {
    /// The state of a channel with the rows `rows` of its span.
    pub(super) fn of(channels: &Channels, channel: usize, rows: RangeInclusive<usize>) -> Self {
        let track = &channels.tracks[channel];
        let (mut points, mut steps) = ([[f64::NAN; 3]; SPAN], [Steps::default(); SPAN]);
        for (i, row) in rows.take(SPAN).enumerate() {
            (points[i], steps[i]) = (track.points[row], track.steps[row]);
        }
        Self {
            points,
            steps,
            span: track.span,
            packed_steps: track.packed_steps,
            activity: track.activity,
            anchor_errors: track.anchor_errors.clone(),
            shares: *channels.correction.shares(channel),
            distances: *channels.segments.partner_distances(channel),
            residuals: *channels.cross_channel.residuals(channel),
        }
    }

    /// Restores the state.
    pub(super) fn restore(
        &self,
        channels: &mut Channels,
        channel: usize,
        rows: RangeInclusive<usize>,
    ) {
        let track = &mut channels.tracks[channel];
        for (i, row) in rows.take(SPAN).enumerate() {
            (track.points[row], track.steps[row]) = (self.points[i], self.steps[i]);
        }
        track.span = self.span;
        track.packed_steps = self.packed_steps;
        track.activity = self.activity;
        track.anchor_errors.clone_from(&self.anchor_errors);
        *channels.correction.shares_mut(channel) = self.shares;
        *channels.segments.partner_distances_mut(channel) = self.distances;
        *channels.cross_channel.residuals_mut(channel) = self.residuals;
    }
}
