//! What stands beside every figure: the same bytes with nothing done to them.

use std::time::{Duration, Instant};

use anyhow::Context;
use mocapd_drivers::{device::Command, registry, uri::DeviceUri};
use mocapd_service::process;

/// Reads a device for `length` and throws the bytes away: the processor time, in percent of one core,
/// that the line alone costs.
pub(super) fn bare_read_cpu_percent(uri: &DeviceUri, length: Duration) -> anyhow::Result<f64> {
    let mut opened = registry::open(uri)?;
    let mut command = Vec::new();
    opened.protocol.command(Command::Start { line_bytes_per_s: 0 }, &mut command);
    opened.transport.write_all(&command)?;
    let before = process::usage(None).context("/proc does not tell the processor time")?;
    let mut buffer = vec![0; 64 << 10];
    let started = Instant::now();
    while started.elapsed() < length {
        opened.transport.read(&mut buffer)?;
    }
    let after = process::usage(None).context("/proc does not tell the processor time")?;
    command.clear();
    opened.protocol.command(Command::Stop, &mut command);
    opened.transport.write_all(&command)?;
    Ok(100.0 * (after.cpu_s - before.cpu_s) / started.elapsed().as_secs_f64())
}

/// Copies `bytes` once: GB a second.
pub(super) fn copy_gb_per_s(bytes: &[u8]) -> f64 {
    let started = Instant::now();
    let copy = std::hint::black_box(bytes.to_vec());
    let seconds = started.elapsed().as_secs_f64();
    copy.len() as f64 / seconds / 1e9
}
