//! `SAMPLED_GROUP`: a group of scalar channels that have a rate of their own, such as those of force plates and electrodes.

use bincode::{Decode, Encode, de::Decoder, enc::Encoder, error::DecodeError, error::EncodeError};
use mocapd_codec::{GROUP_CHANNELS, poses::POSE_CHANNELS};

use super::{CONFIG, Record, deflate, inflate};
use crate::{TakeError, chunk::types};

/// The numbers that the samples of a channel were before they became float32, which an export restores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Encode, Decode)]
pub enum SampleForm {
    /// Float32.
    #[default]
    Float32,
    /// Signed integers of 16 bits.
    Int16,
    /// Unsigned integers of 16 bits.
    Uint16,
}

impl SampleForm {
    /// The name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Float32 => "float32",
            Self::Int16 => "int16",
            Self::Uint16 => "uint16",
        }
    }
}

/// A scalar channel: a component of a force plate, an electrode, an axis of an inertial sensor.
#[derive(Debug, Clone, PartialEq, Default, Encode, Decode)]
pub struct SampledChannel {
    /// Its name; may be empty, and may repeat.
    pub name: String,
    /// The unit of its values, as written in the source; may be empty.
    pub unit: String,
    /// Its number in the source; of a model output the number of its point.
    pub index: u32,
    /// Units per unit of the stored samples.
    pub scale: f64,
    /// The stored sample whose value is 0.
    pub offset: f64,
}

/// The largest error of each channel of a group, in stored samples; empty if all samples are those of the source. It is
/// not part of version 1 of the record, which is that of exact groups; version 2 has it after all else.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SampleBounds(pub Vec<f64>);

bincode::impl_borrow_decode!(SampleBounds);

impl Encode for SampleBounds {
    fn encode<E: Encoder>(&self, _: &mut E) -> Result<(), EncodeError> {
        Ok(())
    }
}

impl<C> Decode<C> for SampleBounds {
    fn decode<D: Decoder<Context = C>>(_: &mut D) -> Result<Self, DecodeError> {
        Ok(Self::default())
    }
}

/// Up to 64 channels that are sampled together and coded in common blocks. Groups of one kind that follow each other
/// form a part: the first of them has the channels from 0 on.
#[derive(Debug, Clone, PartialEq, Default, Encode, Decode)]
pub struct SampledGroup {
    /// The device or file that it comes from; 0, because a take has only one source.
    pub source: u16,
    /// Its number, by which SAMPLES refer to it. No two groups of a take have the same.
    pub number: u32,
    /// The kind of the foreign part that the group belongs to, such as `c3d/analog`; empty for channels of a
    /// recording, and [`POSES`](crate::sampled::POSES) for those of rigid bodies.
    pub kind: String,
    /// The form of the samples in the source.
    pub form: SampleForm,
    /// Number of the group's first channel among those of its part.
    pub first_channel: u32,
    /// Number of channels of the part.
    pub part_channels: u32,
    /// Samples of a channel in each frame; 0 if the samples have no relation to frames.
    pub samples_per_frame: u32,
    /// Samples of a channel in a second.
    pub rate_hz: f64,
    /// Number of the frame that the first samples belong to, as in the source.
    pub first_frame: u64,
    /// Samples of a channel, if they were counted before they were written.
    pub n_samples: Option<u64>,
    /// The channels.
    pub channels: Vec<SampledChannel>,
    /// Their largest errors.
    pub bounds: SampleBounds,
}

impl Record for SampledGroup {
    const NAME: &'static str = "group of sampled channels";
    const KIND: u8 = types::SAMPLED_GROUP;
    const VERSION: u16 = 1;
}

/// The version of a group with bounds.
const BOUNDED: u16 = 2;

/// The version of a group of poses, with bounds or without: readers of versions 1 and 2 skip it.
const OF_POSES: u16 = 3;

/// Most samples of a channel, so that no sum overflows: 36 years at 1 MHz.
pub(crate) const SAMPLES_MAX: u64 = 1 << 50;

impl SampledGroup {
    /// Encodes the payload of its chunk: the record, with everything after its version deflated.
    ///
    /// # Errors
    /// `InvalidArgument` for a group that a reader would refuse.
    pub fn to_chunk_payload(&self) -> Result<Vec<u8>, TakeError> {
        self.check().map_err(|why| {
            TakeError::InvalidArgument(format!("a {} cannot be stored: {why}", Self::NAME))
        })?;
        let payload = self.to_payload()?;
        let (version, body) = payload.split_at(2);
        if self.bounds.0.is_empty() && !self.has_poses() {
            return Ok(deflate(version.to_vec(), body)?);
        }
        let version = if self.has_poses() { OF_POSES } else { BOUNDED };
        let bounds = self.bounds.0.iter().flat_map(|bound| bound.to_le_bytes());
        let body: Vec<u8> = body.iter().copied().chain(bounds).collect();
        Ok(deflate(version.to_le_bytes().to_vec(), &body)?)
    }

    /// Decodes the payload of the chunk at file offset `offset`, whose CRC matched.
    ///
    /// # Errors
    /// `Unsupported` for a later version, `Corrupt` for invalid content.
    pub fn from_chunk_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |why| TakeError::corrupt(Self::NAME, offset, why);
        let Some((version, deflated)) = payload.split_first_chunk::<2>() else {
            return Err(corrupt("shorter than its version"));
        };
        let (found, supported) = (u16::from_le_bytes(*version), Self::VERSION);
        if ![supported, BOUNDED, OF_POSES].contains(&found) {
            let supported = OF_POSES;
            return Err(TakeError::Unsupported { what: Self::NAME, found, supported });
        }
        let body = inflate(deflated).ok_or_else(|| corrupt("invalid DEFLATE data"))?;
        let group = if found == supported {
            Self::from_payload(&[&version[..], &body].concat(), offset)?
        } else {
            Self::with_bounds(&body).map_err(corrupt)?
        };
        if (found == OF_POSES) != group.has_poses()
            || (found == BOUNDED && group.bounds.0.is_empty())
        {
            return Err(corrupt("its version is not that of its content"));
        }
        group.check().map_err(corrupt)?;
        Ok(group)
    }

    /// Parses the record of a group with bounds: a float64 of each channel after all else.
    fn with_bounds(body: &[u8]) -> Result<Self, &'static str> {
        let (mut group, used): (Self, usize) =
            bincode::decode_from_slice(body, CONFIG).map_err(|_| "cannot be decoded")?;
        let (bounds, rest) = body.get(used..).unwrap_or_default().as_chunks::<8>();
        if !rest.is_empty() {
            return Err("its bounds are incomplete");
        }
        group.bounds.0 = bounds.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect();
        Ok(group)
    }

    /// The largest error of a channel of the group, in stored samples; 0 if it is exact.
    #[must_use]
    pub fn bound(&self, channel: usize) -> f64 {
        self.bounds.0.get(channel).copied().unwrap_or(0.0)
    }

    fn check(&self) -> Result<(), &'static str> {
        let n_channels = self.channels.len() as u64;
        let last = u64::from(self.first_channel) + n_channels;
        if n_channels == 0 || n_channels > GROUP_CHANNELS as u64 {
            Err("a group has 1 to 64 channels")
        } else if last > self.part_channels.into() {
            Err("it has more channels than its part")
        } else if !self.rate_hz.is_finite() || self.rate_hz <= 0.0 {
            Err("its rate is not a positive number")
        } else if self.n_samples.is_some_and(|n| n > SAMPLES_MAX) {
            Err("it has more samples than a take can hold")
        } else if !matches!(self.bounds.0.len() as u64, n if n == 0 || n == n_channels) {
            Err("it does not have one bound for each channel")
        } else if self.has_poses() && !n_channels.is_multiple_of(POSE_CHANNELS as u64) {
            Err("its channels are not those of bodies")
        } else if !self.bounds.0.iter().all(|bound| bound.is_finite() && *bound >= 0.0) {
            Err("a bound is negative or not finite")
        } else if self.form != SampleForm::Float32
            && self.bounds.0.iter().any(|bound| bound.fract() != 0.0)
        {
            Err("a bound of integer samples is not an integer")
        } else {
            Ok(())
        }
    }
}
