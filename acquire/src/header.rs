//! The header of a new take.

use std::time::SystemTime;

use anyhow::Context;
use mocapd_codec::Settings;
pub use mocapd_take::whole::channels;
use mocapd_take::{
    motion::UpAxis,
    record::{CODEC_VERSION, Header},
};
use rustix::rand::{GetRandomFlags, getrandom};

/// What a take says wrote it.
pub const SOFTWARE: &str = concat!("mocapd ", env!("CARGO_PKG_VERSION"));

/// The header of a recording that begins now, with everything but channels and device.
///
/// # Errors
/// When the system gives no random bytes.
pub fn new(codec: &Settings, rate_hz: f64) -> anyhow::Result<Header> {
    let mut take_id = [0; 16];
    getrandom(&mut take_id, GetRandomFlags::empty()).context("cannot get random bytes")?;
    let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let created_unix_ms = i64::try_from(since_1970.as_millis()).unwrap_or(i64::MAX);
    Ok(Header { take_id, created_unix_ms, ..of_import(codec, rate_hz) })
}

/// The header of an import with everything but channels, source and id: it has no time of its own, and
/// its id comes last ([`Header::set_import_id`]), so that the same import is the same take.
#[must_use]
pub fn of_import(codec: &Settings, rate_hz: f64) -> Header {
    let mut header = Header {
        software: SOFTWARE.to_owned(),
        take_id: [0; 16],
        created_unix_ms: 0,
        resampler: String::new(),
        codec_version: CODEC_VERSION,
        tolerance_mm: 0.0,
        rate_hz,
        up_axis: UpAxis::Unknown,
        device: None,
        source: None,
        channels: Vec::new(),
        stretch_rows: 0,
        settings: Vec::new(),
    };
    header.set_codec(codec);
    header
}
