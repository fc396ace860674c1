//! Faults of a QTM that are due once: labels that come late or change, and a packet that states a false size.

use std::sync::Arc;

use mocapd_drivers::qtm::ClientId;

use crate::device::FaultCounts;
use crate::faults::{Fault, Kind, Script};

/// The header of a packet that is shorter than its header: nothing tells where the next one begins.
const BROKEN_PACKET: [u8; 8] = [3, 0, 0, 0, 3, 0, 0, 0];

/// The faults that are due once.
#[derive(Debug)]
pub(super) struct Changes {
    script: Arc<Script>,
    done: Vec<usize>,
    /// Whether the last label is still missing.
    hides_last: bool,
    /// Whether the last label was changed.
    pub(super) is_renamed: bool,
    /// The client to which a broken packet goes, and the part of it that was sent.
    broken: Option<(ClientId, usize)>,
}

impl Changes {
    pub(super) fn new(script: Arc<Script>) -> Self {
        let is_late = |fault: &Fault| matches!(fault, Fault::LateModel { .. });
        let hides_last = script.faults.iter().any(|f| is_late(&f.fault));
        Self { script, done: Vec::new(), hides_last, is_renamed: false, broken: None }
    }

    /// Whether the last labelled marker is sent as an unlabelled one.
    pub(super) fn hides_last(&self) -> bool {
        self.hides_last
    }

    /// Applies what is due. `client` is the one with the first stream. Returns whether the settings have changed.
    pub(super) fn apply(
        &mut self,
        since_ns: u64,
        client: Option<ClientId>,
        counts: &mut FaultCounts,
    ) -> bool {
        let before = (self.hides_last, self.is_renamed);
        self.hides_last = false;
        for (index, scheduled) in self.script.faults.iter().enumerate() {
            let is_due = |at_s: f64| (at_s * 1e9) as u64 <= since_ns;
            let kind = scheduled.fault.kind();
            let is_new = !self.done.contains(&index);
            let happens = match scheduled.fault {
                Fault::LateModel { for_s } => {
                    self.hides_last |= !is_due(for_s);
                    is_new
                }
                Fault::ModelChange { at_s } if is_new && is_due(at_s) => {
                    self.is_renamed = true;
                    true
                }
                Fault::BrokenPacket { at_s } if is_new && is_due(at_s) && client.is_some() => {
                    self.broken = client.map(|client| (client, 0));
                    true
                }
                _ => false,
            };
            if happens {
                self.done.push(index);
                counts.add(kind, 1);
            }
        }
        before != (self.hides_last, self.is_renamed)
    }

    /// Whether a packet to this client was broken, so that no frame reaches it.
    pub(super) fn is_broken(&self, client: Option<ClientId>) -> bool {
        self.broken.is_some_and(|(broken, _)| Some(broken) == client)
    }

    /// The rest of the broken packet, behind all that waits for the client.
    pub(super) fn pending(&self, client: ClientId) -> &[u8] {
        match self.broken {
            Some((broken, sent)) if broken == client => {
                BROKEN_PACKET.get(sent..).unwrap_or_default()
            }
            _ => &[],
        }
    }

    /// The connection took so many bytes of it.
    pub(super) fn sent(&mut self, client: ClientId, n: usize) {
        if let Some((broken, sent)) = &mut self.broken
            && *broken == client
        {
            *sent += n;
        }
    }

    /// A client is gone.
    pub(super) fn forget(&mut self, client: ClientId) {
        if self.is_broken(Some(client)) {
            self.broken = None;
        }
    }

    /// All clients are gone.
    pub(super) fn forget_all(&mut self) {
        self.broken = None;
    }
}

/// Whether a fault can happen to a QTM.
pub(super) fn happens(kind: Kind) -> bool {
    super::happens(kind) && !kind.is_of_natnet()
}
