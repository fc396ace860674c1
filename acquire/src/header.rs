//! The header of a new take.

use std::time::SystemTime;

use anyhow::Context;
use mocapd_codec::Settings;
pub use mocapd_take::motion_encoder::channels;
use mocapd_take::record::{CODEC_VERSION, Header};
use rustix::rand::{GetRandomFlags, getrandom};

/// The software version stored in takes.
pub const SOFTWARE: &str = concat!("mocapd ", env!("CARGO_PKG_VERSION"));

/// The header of a recording that starts now, without channels and device.
///
/// # Errors
/// When the system provides no random bytes.
pub fn new(codec: &Settings, rate_hz: f64) -> anyhow::Result<Header> {
    let take_id = new_take_id()?;
    let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let created_unix_ms = i64::try_from(since_1970.as_millis()).unwrap_or(i64::MAX);
    Ok(Header { take_id, created_unix_ms, ..of_import(codec, rate_hz) })
}

/// A random id.
///
/// # Errors
/// When the system provides no random bytes.
pub fn new_take_id() -> anyhow::Result<[u8; 16]> {
    let mut take_id = [0; 16];
    getrandom(&mut take_id, GetRandomFlags::empty()).context("cannot get random bytes")?;
    Ok(take_id)
}

/// The header of an import, without channels, source and id. It has no time of its own, and its id is set last
/// ([`Header::set_import_id`]): the same import gives the same take.
#[must_use]
pub fn of_import(codec: &Settings, rate_hz: f64) -> Header {
    let software = SOFTWARE.to_owned();
    let mut header =
        Header { software, codec_version: CODEC_VERSION, rate_hz, ..Header::default() };
    header.set_codec(codec);
    header
}
