//! Asking a device who it is and which markers it tracks.

use std::time::Duration;

use anyhow::bail;
use mocapd_drivers::{
    device::{Command, DeviceEvent, Hello, MarkerInfo},
    registry::OpenedDevice,
    uri::DeviceUri,
};

use super::{READ_BYTES, Rig, TRIES, Tap, monotonic_ns};

impl Rig {
    pub(super) fn identify(
        uri: DeviceUri,
        opened: OpenedDevice,
        raw_log: Option<Tap>,
    ) -> anyhow::Result<Self> {
        let OpenedDevice { transport, protocol, family, identity } = opened;
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
            identity,
            patience: Duration::ZERO,
            risk: None,
            raw_log,
        };
        rig.introduce(&|| false)?;
        Ok(rig)
    }

    /// Asks the device who it is, whatever it was doing.
    pub(super) fn introduce(&mut self, give_up: &dyn Fn() -> bool) -> anyhow::Result<()> {
        let damaged_before = self.protocol.counters().messages_damaged;
        for _ in 0..TRIES {
            // A device that is still sending from an earlier host must not fill the table's place.
            self.say(Command::Stop)?;
            let damaged = self.protocol.counters().messages_damaged;
            let mut hello = None;
            let mut markers = Vec::new();
            self.say(Command::Identify)?;
            let host_ns = monotonic_ns();
            self.ask(Command::Ping { host_ns }, give_up, |event| {
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
                && self.protocol.counters().messages_damaged == damaged
            {
                self.hello = hello;
                self.markers = markers;
                return Ok(());
            }
        }
        if self.protocol.counters().messages_damaged == damaged_before {
            bail!(
                "{} answers, but does not get to say who it is: it may be starting up, or a tool on it does not answer; \
                 wait, unplug its tools, and try again",
                self.uri
            );
        }
        bail!("{} answers, but its messages arrive damaged: check cable and baud rate", self.uri)
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
