//! Functions shared by the examples that measure sizes and speeds.

use std::{
    error::Error,
    fs,
    io::Write,
    process::{Command, Stdio},
};

pub(crate) type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Size of `xz -9`; 0 if there is no xz.
pub(crate) fn xz(content: &[u8]) -> Result<usize> {
    let mut command = Command::new("xz");
    let spawned = command.args(["-9", "-c"]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
    let Ok(mut child) = spawned else { return Ok(0) };
    let mut input = child.stdin.take().ok_or("no pipe")?;
    let content = content.to_vec();
    let writer = std::thread::Builder::new().spawn(move || input.write_all(&content))?;
    let bytes = child.wait_with_output()?.stdout.len();
    writer.join().map_err(|_| "the writer failed")??;
    Ok(bytes)
}

/// Processor time of this thread so far, in seconds.
pub(crate) fn processor_s() -> Result<f64> {
    let text = fs::read_to_string("/proc/thread-self/schedstat")?;
    let ns: f64 = text.split(' ').next().unwrap_or_default().parse()?;
    Ok(ns / 1e9)
}
