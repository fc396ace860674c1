//! Asking a device who it is and which markers it tracks.

use anyhow::bail;
use mocapd_drivers::{
    device::{Command, DeviceEvent, Hello, MarkerInfo, Protocol},
    transport::Transport,
    uri::DeviceUri,
};

use super::{READ_BYTES, Rig, TRIES, monotonic_ns};

impl Rig {
    pub(super) fn identify(
        uri: DeviceUri,
        family: &'static str,
        transport: Box<dyn Transport>,
        protocol: Box<dyn Protocol>,
    ) -> anyhow::Result<Self> {
        let mut rig = Self {
            uri,
            family,
            transport,
            protocol,
            buffer: vec![0; READ_BYTES],
            outbox: Vec::with_capacity(256),
            hello: Hello::default(),
            markers: Vec::new(),
            not_finite_before: 0,
        };
        for _ in 0..TRIES {
            // A device that is still sending from an earlier host must not fill the table's place.
            rig.say(Command::Stop)?;
            let damaged = rig.protocol.counters().messages_damaged;
            let mut hello = None;
            let mut markers = Vec::new();
            rig.say(Command::Identify)?;
            let host_ns = monotonic_ns();
            rig.ask(Command::Ping { host_ns }, |event| {
                match event {
                    DeviceEvent::Hello(said) => {
                        hello = Some(said.clone());
                        markers.clear();
                    }
                    DeviceEvent::Markers(more) => add(&mut markers, more),
                    // An answer says that everything asked before it was said.
                    DeviceEvent::Pong(pong) if pong.host_ns == host_ns => return Some(()),
                    _ => {}
                }
                None
            })?;
            if let Some(hello) = hello
                && rig.protocol.counters().messages_damaged == damaged
            {
                rig.hello = hello;
                rig.markers = markers;
                return Ok(rig);
            }
        }
        bail!("{} answers, but its messages arrive damaged: check cable and baud rate", rig.uri)
    }
}

/// A marker said twice counts once: commands are repeated when an answer is late.
fn add(table: &mut Vec<MarkerInfo>, more: &[MarkerInfo]) {
    for marker in more {
        match table.iter_mut().find(|known| known.id == marker.id) {
            Some(known) => known.clone_from(marker),
            None => table.push(marker.clone()),
        }
    }
}
