//! The sampled channels of a take in the report of `info`.

use std::fmt::Write;

use mocapd_take::{
    foreign::ForeignPart,
    record::SampledChannel,
    sampled::{GroupSamples, LostSamples, SampledPart},
};
use serde::Serialize;

use crate::cli::{
    output::plain,
    values::{LABEL_COLUMNS_MAX, bytes, count, rate, thousands},
};

/// A group of channels that are sampled and stored together.
#[derive(Debug, Serialize)]
pub(super) struct SampledGroupReport {
    pub(super) kind: String,
    number: u32,
    form: &'static str,
    rate_hz: f64,
    samples_per_frame: u32,
    first_frame: u64,
    /// Samples of each channel, lost ones included.
    samples: u64,
    samples_lost: u64,
    stored_bytes: u64,
    channels: Vec<SampledChannelReport>,
}

#[derive(Debug, Serialize)]
struct SampledChannelReport {
    name: String,
    unit: String,
    scale: f64,
    offset: f64,
    /// In the channel's unit; 0 for exact samples.
    max_error: f64,
}

impl SampledGroupReport {
    /// The groups of all parts, except those of poses.
    pub(super) fn all(parts: &[ForeignPart]) -> Vec<Self> {
        let sampled = parts.iter().filter_map(ForeignPart::sampled);
        let groups = sampled.flat_map(SampledPart::groups);
        groups.filter(|group| !group.group.has_poses()).map(Self::new).collect()
    }

    fn new(found: &GroupSamples) -> Self {
        let lost = found.lost();
        let group = &found.group;
        let channel = |(i, channel): (usize, &SampledChannel)| SampledChannelReport {
            name: channel.name.clone(),
            unit: channel.unit.clone(),
            scale: channel.scale,
            offset: channel.offset,
            max_error: group.bound(i) * channel.scale.abs(),
        };
        Self {
            kind: group.kind.clone(),
            number: group.number,
            form: group.form.name(),
            rate_hz: group.rate_hz,
            samples_per_frame: group.samples_per_frame,
            first_frame: group.first_frame,
            samples: found.n_samples(),
            samples_lost: lost
                .iter()
                .fold(0, |sum: u64, LostSamples { n, .. }| sum.saturating_add(*n)),
            stored_bytes: found.stored_bytes,
            channels: group.channels.iter().enumerate().map(channel).collect(),
        }
    }
}

/// The text after the size of a part: its number of channels and their rate, and its size in the take; empty for a part
/// without channels.
pub(super) fn shape(groups: &[&SampledGroupReport]) -> String {
    let Some(first) = groups.first() else { return String::new() };
    let n_channels = groups.iter().map(|group| group.channels.len() as u64).sum();
    let stored = groups.iter().map(|group| group.stored_bytes).sum();
    let samples_lost: u64 = groups.iter().map(|group| group.samples_lost).max().unwrap_or(0);
    let lost = match samples_lost {
        0 => String::new(),
        n => format!(", {} of each lost", count(n, "sample")),
    };
    format!(
        ": {} at {}, {} of each{lost}, {} in the take",
        count(n_channels, "channel"),
        rate(first.rate_hz),
        count(first.samples, "sample"),
        bytes(stored),
    )
}

/// Appends a table of all sampled channels.
pub(super) fn table(groups: &[SampledGroupReport], out: &mut String) {
    let all = || groups.iter().flat_map(|group| group.channels.iter().map(move |of| (group, of)));
    if all().next().is_none() {
        return;
    }
    let names: Vec<String> = all().map(|(_, channel)| plain(&channel.name).to_string()).collect();
    let widths = names.iter().map(|name| name.chars().count());
    let width = widths.max().unwrap_or(0).clamp(15, LABEL_COLUMNS_MAX);
    let (rate_hz, samples) = ("rate Hz", "samples");
    writeln!(
        out,
        "{:<width$} {rate_hz:>10} {samples:>10} {:>13} {:>11}  unit",
        "sampled channel", "scale", "max error"
    )
    .ok();
    for (name, (group, channel)) in names.iter().zip(all()) {
        let (samples, unit) = (thousands(group.samples), plain(&channel.unit));
        let (rate_hz, scale) = (group.rate_hz, channel.scale);
        let error = match channel.max_error {
            0.0 => "exact".to_owned(),
            error => format!("{error:.3e}"),
        };
        writeln!(
            out,
            "{name:<width$} {rate_hz:>10} {samples:>10} {scale:>13.6e} {error:>11}  {unit}"
        )
        .ok();
    }
}
