//! Compares the analog samples of a take with those of its original.

use serde::Serialize;

use crate::{
    TakeError,
    foreign::analog::parameters,
    interchange::c3d::{self, PartSamples},
    motion::{Foreign, MotionInfo},
};

/// How the analog samples of a take differ from those of its original, in frames that both have.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct AnalogDifference {
    /// Samples compared, of all channels.
    pub samples: u64,
    /// Samples that the take lost to damage; these are not compared.
    pub samples_lost: u64,
    /// Samples that are not bit-identical to those of the original.
    pub samples_differing: u64,
    /// Samples whose error exceeds the one that the take states for their channel.
    pub beyond_stated: u64,
    /// Channels that only one of the two has.
    pub channels_missing: usize,
    /// The channels that both have.
    pub channels: Vec<ChannelDifference>,
}

/// The errors of an analog channel, in its unit.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ChannelDifference {
    /// Its name.
    pub name: String,
    /// The unit of its values.
    pub unit: String,
    /// The largest error that the take states; 0 for exact samples.
    pub stated_max_error: f64,
    /// The largest error found; infinite where only one of the two has a finite number.
    pub max_error: f64,
}

impl AnalogDifference {
    /// Whether no sample has a larger error than the take states, and no channel is missing.
    #[must_use]
    pub fn is_within(&self) -> bool {
        self.beyond_stated == 0 && self.channels_missing == 0
    }
}

/// Compares frames of equal numbers; `None` unless both have analog samples. In a damaged take, samples that are NaN
/// count as lost.
///
/// # Errors
/// Those of reading the parts, which must be in memory or a scratch file:
/// [`is_needed`](crate::foreign::analog::is_needed) says which.
pub fn compare_analog(
    take: &MotionInfo,
    original: &MotionInfo,
    is_damaged: bool,
) -> Result<Option<AnalogDifference>, TakeError> {
    let frames = |info: &MotionInfo| {
        let first = info.source.first_frame;
        first..first.saturating_add(info.n_frames)
    };
    let (ours, theirs) = (frames(take), frames(original));
    let frames = ours.start.max(theirs.start)..ours.end.min(theirs.end);
    let samples_of = |info: &MotionInfo| parameters(info).map(Option::unwrap_or_default);
    let (take_parameters, original_parameters) = (samples_of(take)?, samples_of(original)?);
    let read = |info| PartSamples::analog(info, frames.start);
    let (Some(mut ours), Some(mut theirs)) = (read(&take.foreign)?, read(&original.foreign)?)
    else {
        return Ok(None);
    };
    let [our_channels, their_channels] = [ours.header.n_signals, theirs.header.n_signals];
    let n_channels = our_channels.min(their_channels);
    let numbers: Vec<u32> = (0..n_channels as u32).collect();
    let described =
        c3d::describe_sampled(c3d::ANALOG, &numbers, &take_parameters, |_| String::new());
    let [stated, of_original] = [take, original].map(|info| bounds(info, n_channels));
    let mut largest = vec![0.0_f64; n_channels];
    let mut found = AnalogDifference {
        channels_missing: our_channels.max(their_channels) - n_channels,
        ..AnalogDifference::default()
    };
    let are_unsigned = [&take_parameters, &original_parameters].map(c3d::is_analog_unsigned);
    let widths = [ours.header.width, theirs.header.width];
    let ratio = ours.header.ratio;
    if ratio != theirs.header.ratio {
        // The samples of the two cannot be matched.
        found.channels_missing = our_channels.max(their_channels);
        return Ok(Some(found));
    }
    for _ in frames {
        let have = [ours.begin_frame(), theirs.begin_frame()];
        for _ in 0..ratio {
            if have != [true; 2] {
                // A part may begin at a later frame.
                let passed = if have[0] { ours.next()? } else { None };
                let passed = if have[1] { theirs.next()? } else { passed };
                if passed.is_none() { break } else { continue }
            }
            let (Some(ours), Some(theirs)) = (ours.next()?, theirs.next()?) else { break };
            for (channel, (&our, &their)) in ours.iter().zip(theirs).enumerate() {
                let our = c3d::sample_value(widths[0], our, are_unsigned[0]);
                let their = c3d::sample_value(widths[1], their, are_unsigned[1]);
                let error = error(our, their);
                if is_damaged && our.is_nan() && error > 0.0 {
                    found.samples_lost += 1;
                    continue;
                }
                found.samples += 1;
                found.samples_differing += u64::from(our.to_bits() != their.to_bits());
                let bound =
                    stated.get(channel).unwrap_or(&0.0) + of_original.get(channel).unwrap_or(&0.0);
                found.beyond_stated += u64::from(error > bound);
                if let Some(largest) = largest.get_mut(channel) {
                    *largest = largest.max(error);
                }
            }
        }
    }
    let channels = described.into_iter().zip(largest).zip(stated);
    found.channels = channels
        .map(|((channel, largest), stated)| ChannelDifference {
            stated_max_error: stated * channel.scale.abs(),
            max_error: largest * channel.scale.abs(),
            name: channel.name,
            unit: channel.unit,
        })
        .collect();
    Ok(Some(found))
}

/// The largest errors of the channels that a motion states, in stored samples.
fn bounds(info: &MotionInfo, n_channels: usize) -> Vec<f64> {
    let part = info.foreign.iter().find(|part| part.kind == c3d::ANALOG);
    let stated = part.map(|Foreign { bounds, .. }| bounds.clone()).unwrap_or_default();
    stated.into_iter().chain(std::iter::repeat(0.0)).take(n_channels).collect()
}

/// The error of a sample; infinite if only one is finite, or both are not and differ.
fn error(ours: f32, theirs: f32) -> f64 {
    if ours.to_bits() == theirs.to_bits() {
        0.0
    } else if ours.is_finite() && theirs.is_finite() {
        (f64::from(ours) - f64::from(theirs)).abs()
    } else {
        f64::INFINITY
    }
}
