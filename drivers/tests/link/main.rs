//! The link protocol, both ends against each other and against hostile bytes.

#[cfg(test)]
mod document;
#[cfg(test)]
mod examples;
#[cfg(test)]
mod limits;
#[cfg(test)]
mod properties;
#[cfg(test)]
mod sweeps;

use mocapd_drivers::{
    device::Protocol,
    link::{DeviceLink, FrameForm, HostLink},
};

#[cfg(test)]
const FORMS: [FrameForm; 3] = [FrameForm::Float, FrameForm::Micrometres, FrameForm::Compact];

/// What a host makes of bytes, each event as its debug text (which also tells NaN from NaN).
#[cfg(test)]
fn host_hears(host: &mut HostLink, bytes: &[u8]) -> Vec<String> {
    let mut events = Vec::new();
    host.push(bytes, &mut |event| events.push(format!("{event:?}")));
    events
}

/// What a device makes of bytes.
#[cfg(test)]
fn device_hears(device: &mut DeviceLink, bytes: &[u8]) -> Vec<String> {
    let mut commands = Vec::new();
    device.push(bytes, &mut |command| commands.push(format!("{command:?}")));
    commands
}

/// A message on the wire with a right checksum, whatever is in it.
#[cfg(test)]
fn sealed(version: u8, kind: u8, payload: &[u8]) -> Vec<u8> {
    let mut message = vec![version, kind];
    message.extend_from_slice(payload);
    message.extend_from_slice(&crc32fast::hash(&message).to_le_bytes());
    let mut wire = vec![0; cobs::max_encoding_length(message.len())];
    let n = cobs::encode(&message, &mut wire);
    wire.truncate(n);
    wire.push(0);
    wire
}
