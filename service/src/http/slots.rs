//! The places of one listener: a bounded number of connections, and which of them makes room when all are taken.
//!
//! A connection that holds its place without doing anything useful must not keep others out. When every place is taken,
//! a new connection takes the place of one that has never made an authorized request; where there is none, of one that
//! is idle or still sending its request. A connection whose authorized request is being carried out, or whose answer the
//! kernel has not taken yet, is never closed.

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

/// The other end of a connection, as far as connections are counted together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Peer {
    /// A user of this machine, on the Unix socket. `None`: the kernel does not say.
    User(Option<u32>),
    /// An address. Of IPv6 the first 64 bits: a host has all of the others to itself.
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

/// One connection's place.
#[derive(Debug)]
pub(super) struct ConnectionSlot {
    peer: Peer,
    state: Mutex<SlotState>,
    evicted: Notify,
}

#[derive(Debug, Clone, Copy)]
struct SlotState {
    /// A request of it was allowed, and not only one that everybody may make.
    is_authorized: bool,
    /// A request has arrived whole, and its answer is not sent.
    is_busy: bool,
    /// The answer is written to hyper's buffer, which drops a body with its last bytes unsent.
    is_flushing: bool,
    /// A request was answered, or is being answered.
    has_answered: bool,
    /// Since when it is neither busy nor evicted.
    since: Instant,
}

/// A taken place, given back when it is dropped.
#[derive(Debug)]
pub(super) struct SlotGuard {
    slots: Arc<ConnectionSlots>,
    slot: Arc<ConnectionSlot>,
}

impl ConnectionSlots {
    pub(super) fn new(max: usize) -> Arc<Self> {
        Arc::new(Self { max, open: Mutex::new(Vec::with_capacity(max)) })
    }

    /// A place for a connection of this peer. `None` when every other one is busy.
    pub(super) fn take(self: &Arc<Self>, peer: Peer) -> Option<SlotGuard> {
        let mut open = self.lock();
        if open.len() >= self.max {
            // Its task hears of it a moment later: for so long one connection more than `max` is open.
            let at = evictable(&open)?;
            open.swap_remove(at).evicted.notify_one();
        }
        let state = SlotState {
            is_authorized: false,
            is_busy: false,
            is_flushing: false,
            has_answered: false,
            since: Instant::now(),
        };
        let slot =
            Arc::new(ConnectionSlot { peer, state: Mutex::new(state), evicted: Notify::new() });
        open.push(Arc::clone(&slot));
        Some(SlotGuard { slots: Arc::clone(self), slot })
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Arc<ConnectionSlot>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Which connection makes room: of the peer that holds most places that may be taken, the one that has held its place
/// for longest.
fn evictable(open: &[Arc<ConnectionSlot>]) -> Option<usize> {
    let states: Vec<SlotState> = open.iter().map(|slot| *slot.lock()).collect();
    let is_unauthorized = |state: &SlotState| !state.is_authorized;
    let only_unauthorized = states.iter().any(is_unauthorized);
    let candidates: Vec<usize> = (0..open.len())
        .filter(|&at| match only_unauthorized {
            true => is_unauthorized(&states[at]),
            false => !states[at].is_busy,
        })
        .collect();
    let mut held: HashMap<Peer, usize> = HashMap::new();
    for &at in &candidates {
        *held.entry(open[at].peer).or_default() += 1;
    }
    let rank = |at: usize| (held.get(&open[at].peer), Reverse(states[at].since));
    candidates.into_iter().max_by_key(|&at| rank(at))
}

impl SlotGuard {
    /// What routes see of it.
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
    /// A request was allowed that not everybody may make.
    pub(super) fn authorize(&self) {
        self.lock().is_authorized = true;
    }

    /// Resolves when another connection has taken the place.
    pub(super) async fn evicted(&self) {
        self.evicted.notified().await;
    }

    /// Whether a request was answered on this connection.
    pub(super) fn has_answered(&self) -> bool {
        self.lock().has_answered
    }

    /// The request with its progress noted here.
    pub(super) fn request_body(self: &Arc<Self>, body: Body) -> Body {
        if body.is_end_stream() {
            self.arrived();
            return body;
        }
        Body::new(Tracked { body, slot: Arc::clone(self), direction: Direction::Request })
    }

    /// The answer with its progress noted here.
    pub(super) fn response_body(self: &Arc<Self>, body: Body) -> Body {
        self.lock().has_answered = true;
        Body::new(Tracked { body, slot: Arc::clone(self), direction: Direction::Response })
    }

    /// Everything that was written to the connection is with the kernel.
    pub(super) fn flushed(&self) {
        let mut state = self.lock();
        if state.is_flushing {
            state.is_flushing = false;
            state.is_busy = false;
            state.since = Instant::now();
        }
    }

    /// A request is there to its end. An answer that is still being sent then belongs to the one before it.
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

/// A body that notes in a place when it has arrived, or when it is written.
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
    fn unauthorized_connections_are_evicted_first_and_most_of_all_those_of_one_peer() {
        let slots = ConnectionSlots::new(4);
        let known = slots.take(address(1)).unwrap();
        known.slot.authorize();
        let single = slots.take(address(2)).unwrap();
        let crowd = [slots.take(address(3)).unwrap(), slots.take(address(3)).unwrap()];
        let newcomer = slots.take(address(4)).unwrap();
        let evicted = [&known, &single, &crowd[0], &crowd[1], &newcomer].map(is_evicted);
        assert_eq!(evicted, [false, false, true, false, false]);
        // What was evicted gives nothing back that is not its own.
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
