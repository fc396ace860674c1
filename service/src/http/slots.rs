//! Slots for the connections of one listener: limits their number, and decides which one is evicted when all are in
//! use.
//!
//! A connection that does nothing useful must not keep others out. If all slots are in use, a new connection replaces
//! one that has never made an authorized request, or otherwise one that is idle or still sending its request. A
//! connection is never closed while an authorized request of it is being executed, or before the kernel has accepted
//! its reply.

use std::{
    cmp::Reverse,
    collections::HashMap,
    net::{IpAddr, Ipv6Addr},
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll},
};

use axum::body::{Body, Bytes};
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::{sync::Notify, time::Instant};

/// The client of a connection, for counting connections together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Peer {
    /// A user of this machine, on the Unix socket; `None` if the kernel does not report it.
    User(Option<u32>),
    /// An address. For IPv6 its first 64 bits: a host may use all of the others.
    Address(IpAddr),
}

impl Peer {
    pub(super) fn of_address(address: IpAddr) -> Self {
        Self::Address(match address.to_canonical() {
            IpAddr::V6(address) => {
                let network = u128::from(address) >> 64 << 64;
                Ipv6Addr::from(network).into()
            }
            address @ IpAddr::V4(_) => address,
        })
    }
}

/// The connections of one listener.
#[derive(Debug)]
pub(super) struct ConnectionSlots {
    max: usize,
    open: Mutex<Vec<Arc<ConnectionSlot>>>,
}

/// The slot of one connection.
#[derive(Debug)]
pub(super) struct ConnectionSlot {
    peer: Peer,
    state: Mutex<SlotState>,
    evicted: Notify,
}

#[derive(Debug, Clone, Copy)]
struct SlotState {
    /// Whether it has made a request that needs authorization, and was allowed.
    is_authorized: bool,
    /// Whether a request has been received completely, and its reply has not been sent.
    is_busy: bool,
    /// Whether the reply is in hyper's buffer, which drops the body before its last bytes are sent.
    is_flushing: bool,
    /// Whether it has been sent a reply, or part of one.
    has_answered: bool,
    /// Since when it is neither busy nor evicted.
    since: Instant,
}

/// A slot in use; freed when dropped.
#[derive(Debug)]
pub(super) struct SlotGuard {
    slots: Arc<ConnectionSlots>,
    slot: Arc<ConnectionSlot>,
}

impl ConnectionSlots {
    pub(super) fn new(max: usize) -> Arc<Self> {
        Arc::new(Self { max, open: Mutex::new(Vec::with_capacity(max)) })
    }

    /// Takes a slot for a connection of this peer; `None` if all slots are busy.
    pub(super) fn take(self: &Arc<Self>, peer: Peer) -> Option<SlotGuard> {
        let mut open = self.lock();
        if open.len() >= self.max {
            // The evicted connection's task learns of it a moment later: until then, `max` + 1 connections are open.
            let at = evictable(&open)?;
            open.swap_remove(at).evicted.notify_one();
        }
        let state = Mutex::new(SlotState {
            is_authorized: false,
            is_busy: false,
            is_flushing: false,
            has_answered: false,
            since: Instant::now(),
        });
        let slot = Arc::new(ConnectionSlot { peer, state, evicted: Notify::new() });
        open.push(Arc::clone(&slot));
        Some(SlotGuard { slots: Arc::clone(self), slot })
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Arc<ConnectionSlot>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Selects the connection to evict: of the peer with the most evictable slots, the connection that has held its slot
/// for longest.
fn evictable(open: &[Arc<ConnectionSlot>]) -> Option<usize> {
    let states: Vec<SlotState> = open.iter().map(|slot| *slot.lock()).collect();
    let only_unauthorized = states.iter().any(|state| !state.is_authorized);
    let is_kept = |s: &SlotState| if only_unauthorized { s.is_authorized } else { s.is_busy };
    let candidates: Vec<usize> = (0..open.len()).filter(|&at| !is_kept(&states[at])).collect();
    let mut held: HashMap<Peer, usize> = HashMap::new();
    for &at in &candidates {
        *held.entry(open[at].peer).or_default() += 1;
    }
    let rank = |at: usize| (held.get(&open[at].peer), Reverse(states[at].since));
    candidates.into_iter().max_by_key(|&at| rank(at))
}

impl SlotGuard {
    /// The slot, as routes see it.
    pub(super) fn slot(&self) -> &Arc<ConnectionSlot> {
        &self.slot
    }
}

impl Drop for SlotGuard {
    fn drop(&mut self) {
        self.slots.lock().retain(|slot| !Arc::ptr_eq(slot, &self.slot));
    }
}

impl ConnectionSlot {
    /// A request that needs authorization was allowed.
    pub(super) fn authorize(&self) {
        self.lock().is_authorized = true;
    }

    /// Resolves when another connection has taken the slot.
    pub(super) async fn evicted(&self) {
        self.evicted.notified().await;
    }

    /// Whether a reply was sent on this connection.
    pub(super) fn has_answered(&self) -> bool {
        self.lock().has_answered
    }

    /// The request's body, whose progress is tracked in the slot.
    pub(super) fn request_body(self: &Arc<Self>, body: Body) -> Body {
        if body.is_end_stream() {
            self.arrived();
            return body;
        }
        Body::new(Tracked { body, slot: Arc::clone(self), direction: Direction::Request })
    }

    /// The reply's body, whose progress is tracked in the slot.
    pub(super) fn response_body(self: &Arc<Self>, body: Body) -> Body {
        self.lock().has_answered = true;
        Body::new(Tracked { body, slot: Arc::clone(self), direction: Direction::Response })
    }

    /// The kernel has accepted everything written to the connection.
    pub(super) fn flushed(&self) {
        let mut state = self.lock();
        if state.is_flushing {
            state.is_flushing = false;
            state.is_busy = false;
            state.since = Instant::now();
        }
    }

    /// A request has been received completely. A reply that is still being sent belongs to the previous one.
    fn arrived(&self) {
        let mut state = self.lock();
        state.is_busy = true;
        state.is_flushing = false;
    }

    fn lock(&self) -> MutexGuard<'_, SlotState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Direction {
    Request,
    Response,
}

/// A body that notifies its slot when it has been received or written.
#[derive(Debug)]
struct Tracked {
    body: Body,
    slot: Arc<ConnectionSlot>,
    direction: Direction,
}

impl HttpBody for Tracked {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(cx);
        let is_whole = matches!(polled, Poll::Ready(None)) || self.body.is_end_stream();
        if is_whole && self.direction == Direction::Request {
            self.slot.arrived();
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for Tracked {
    fn drop(&mut self) {
        if self.direction == Direction::Response {
            self.slot.lock().is_flushing = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> Peer {
        Peer::of_address(IpAddr::from([192, 0, 2, last]))
    }

    fn is_evicted(guard: &SlotGuard) -> bool {
        !guard.slots.lock().iter().any(|slot| Arc::ptr_eq(slot, &guard.slot))
    }

    #[test]
    fn unauthorized_connections_are_evicted_first() {
        let slots = ConnectionSlots::new(4);
        let known = slots.take(address(1)).unwrap();
        known.slot.authorize();
        let single = slots.take(address(2)).unwrap();
        let crowd = [slots.take(address(3)).unwrap(), slots.take(address(3)).unwrap()];
        let newcomer = slots.take(address(4)).unwrap();
        let evicted = [&known, &single, &crowd[0], &crowd[1], &newcomer].map(is_evicted);
        assert_eq!(evicted, [false, false, true, false, false]);
        // A guard whose connection was evicted frees no slot of another one.
        drop(crowd);
        assert_eq!(slots.lock().len(), 3);
    }

    #[test]
    fn a_busy_connection_is_never_evicted_and_an_idle_one_is() {
        let slots = ConnectionSlots::new(2);
        let guards: Vec<SlotGuard> = (0..2).map(|_| slots.take(address(1)).unwrap()).collect();
        for guard in &guards {
            guard.slot.authorize();
            drop(guard.slot.request_body(Body::empty()));
        }
        assert!(slots.take(address(2)).is_none());
        drop(guards[1].slot.response_body(Body::empty()));
        assert!(slots.take(address(2)).is_none(), "its answer is not sent");
        guards[0].slot.flushed();
        guards[1].slot.flushed();
        let newcomer = slots.take(address(2)).unwrap();
        assert!(!is_evicted(&guards[0]) && is_evicted(&guards[1]) && !is_evicted(&newcomer));
    }

    #[test]
    fn a_request_is_busy_when_its_body_is_whole() {
        let slots = ConnectionSlots::new(1);
        let guard = slots.take(address(1)).unwrap();
        guard.slot.authorize();
        let mut body = guard.slot.request_body(Body::from("{}"));
        assert!(!guard.slot.lock().is_busy);
        let mut cx = Context::from_waker(std::task::Waker::noop());
        assert!(Pin::new(&mut body).poll_frame(&mut cx).is_ready());
        assert!(guard.slot.lock().is_busy);
    }

    #[test]
    fn a_host_of_ipv6_is_one_peer() {
        let peer = |address: &str| Peer::of_address(address.parse().unwrap());
        assert_eq!(peer("2001:db8::1"), peer("2001:db8::ffff:1"));
        assert_ne!(peer("2001:db8::1"), peer("2001:db8:0:1::1"));
        assert_eq!(peer("::ffff:192.0.2.1"), address(1));
    }
}
