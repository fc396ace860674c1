//! HEADER and CHANNELS as they are stored: their fields in order, the channel table as its own bytes.

use bincode::{
    Decode, Encode,
    de::Decoder,
    enc::Encoder,
    error::{DecodeError, EncodeError},
};

use super::{Channel, Device, Header, ImportSource, MoreChannels, channel_table};

impl Encode for Header {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        self.software.encode(encoder)?;
        self.take_id.encode(encoder)?;
        self.created_unix_ms.encode(encoder)?;
        self.resampler.encode(encoder)?;
        self.codec_version.encode(encoder)?;
        self.tolerance_mm.encode(encoder)?;
        self.rate_hz.encode(encoder)?;
        self.up_axis.encode(encoder)?;
        self.device.encode(encoder)?;
        self.source.encode(encoder)?;
        channel_table::write(&self.channels).encode(encoder)?;
        self.stretch_rows.encode(encoder)?;
        self.settings.encode(encoder)
    }
}

impl Decode<()> for Header {
    fn decode<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Self, DecodeError> {
        // Fields are decoded in the order in which they stand here.
        Ok(Self {
            software: String::decode(decoder)?,
            take_id: <[u8; 16]>::decode(decoder)?,
            created_unix_ms: i64::decode(decoder)?,
            resampler: String::decode(decoder)?,
            codec_version: u16::decode(decoder)?,
            tolerance_mm: f64::decode(decoder)?,
            rate_hz: f64::decode(decoder)?,
            up_axis: u8::decode(decoder)?,
            device: Option::<Device>::decode(decoder)?,
            source: Option::<ImportSource>::decode(decoder)?,
            channels: channels(decoder)?,
            stretch_rows: u32::decode(decoder)?,
            settings: Vec::<(String, String)>::decode(decoder)?,
        })
    }
}

impl Encode for MoreChannels {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        channel_table::write(&self.0).encode(encoder)
    }
}

impl Decode<()> for MoreChannels {
    fn decode<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Self, DecodeError> {
        channels(decoder).map(Self)
    }
}

fn channels<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Vec<Channel>, DecodeError> {
    let bytes = Vec::<u8>::decode(decoder)?;
    channel_table::read(&bytes).map_err(DecodeError::Other)
}
