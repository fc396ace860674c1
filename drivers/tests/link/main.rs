//! The link protocol: both ends against each other, and against hostile bytes.

#[cfg(test)]
mod document;
#[cfg(test)]
mod examples;
#[cfg(test)]
mod limits;
#[cfg(test)]
mod poses;
#[cfg(test)]
mod properties;
#[cfg(test)]
mod samples;
#[cfg(test)]
mod sweeps;

use mocapd_drivers::{
    device::Protocol,
    link::{DeviceLink, FrameForm, HostLink},
};

#[cfg(test)]
const FORMS: [FrameForm; 3] = [FrameForm::Float, FrameForm::Micrometres, FrameForm::Compact];

/// The events that a host decodes from bytes, each as its debug text (in which NaN equals NaN).
#[cfg(test)]
fn host_events(host: &mut HostLink, bytes: &[u8]) -> Vec<String> {
    let mut events = Vec::new();
    host.push(bytes, &mut |event| events.push(format!("{event:?}")));
    events
}

/// The commands that a device decodes from bytes, as debug text.
#[cfg(test)]
fn device_commands(device: &mut DeviceLink, bytes: &[u8]) -> Vec<String> {
    let mut commands = Vec::new();
    device.push(bytes, &mut |command| commands.push(format!("{command:?}")));
    commands
}

/// A message on the wire with a valid checksum and any payload.
#[cfg(test)]
fn with_envelope(version: u8, kind: u8, payload: &[u8]) -> Vec<u8> {
    let mut message = vec![version, kind];
    message.extend_from_slice(payload);
    message.extend_from_slice(&crc32fast::hash(&message).to_le_bytes());
    let mut wire = vec![0; cobs::max_encoding_length(message.len())];
    let n = cobs::encode(&message, &mut wire);
    wire.truncate(n);
    wire.push(0);
    wire
}
