//! Frames on their way to the clients that request them: on their connections, or in datagrams.

use std::{net::SocketAddr, sync::Arc};

use super::{Client, ClientId, QtmServer, Role, Stream};
use crate::qtm::{
    bodies::{BodiesToSend, ServedBody},
    command::{Components, StreamRate},
    frame::{
        AnyComponent, ComponentToSend, FRAME_HEADER_BYTES, FrameHeader, MarkerComponentKind,
        WireMarker, put_components,
    },
};

/// Largest datagram of UDP over IPv4.
const DATAGRAM_BYTES_MAX: usize = 65_507;

/// The reply to a request for datagrams that frames do not fit into.
pub(super) const TOO_LARGE: &str = "Frames are too large for UDP, request them by TCP";

/// Clients whose frames do not fit that are kept for the owner: its messages about them are few.
const TOO_LARGE_KEPT: usize = 16;

/// Frames that wait for a client of a recorder, in seconds: more would be too old to be of use.
const BACKLOG_S: f64 = 1.0;

/// Frames left out that are compared with the rate of a stream one by one: more than any queue in front of a server holds.
const LEFT_OUT_MAX: u64 = 1 << 20;

/// A datagram to send.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagram {
    /// The client that requested it.
    pub client: ClientId,
    /// Its destination.
    pub to: SocketAddr,
    /// Its content.
    pub bytes: Vec<u8>,
    /// Whether it has a part of a frame, and not the end of a measurement.
    pub is_of_frame: bool,
    /// Whether a frame ends with it.
    pub ends_frame: bool,
}

/// A frame to send to all who want it.
#[derive(Debug, Clone, Copy, Default)]
pub struct ServedFrame<'a> {
    /// Its number and time.
    pub header: FrameHeader,
    /// 2D frames lost, and out of sync, per thousand.
    pub rates: [u16; 2],
    /// The labelled markers, in the order of the labels.
    pub labelled: &'a [WireMarker],
    /// The unlabelled markers that are visible.
    pub unlabelled: &'a [WireMarker],
    /// The rigid bodies, in the order of the settings.
    pub bodies: &'a [ServedBody],
    /// Whether they are not known, because the frame is from before a client wanted them.
    pub lacks_bodies: bool,
}

/// What became of a frame for the stream that was started first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// It is queued on the connection, up to this many bytes ever queued.
    Queued {
        /// The client.
        client: ClientId,
        /// Bytes ever queued for it, with this frame.
        end: u64,
    },
    /// Its datagrams are the next ones to take, so many.
    Datagrams(usize),
    /// The client reads too slowly, or the frame does not fit into datagrams.
    Dropped,
    /// The stream has another rate, and leaves it out.
    NotRequested,
    /// Nobody requests frames.
    NoStream,
}

/// A frame as it was encoded for earlier clients: for these components, and samples from these places on.
type Encoded = Vec<(Components, Vec<u64>, Arc<[u8]>)>;

impl QtmServer {
    /// Sends a frame to all who want it.
    pub fn frame(&mut self, frame: &ServedFrame<'_>) -> Delivery {
        let first = self.first_stream();
        let mut delivery = Delivery::NoStream;
        let (hz, mut clients) = (self.settings.frequency_hz, std::mem::take(&mut self.clients));
        let mut encoded = Encoded::new();
        for client in &mut clients {
            // One frame with bodies is the next that has them.
            let has_all = |wanted: &mut Components| !(frame.lacks_bodies && wanted.has_bodies());
            if let Some(components) = client.one_frame.take_if(has_all) {
                let content = self.content(frame, components, None);
                client.outbox.put(|out| put_components(frame.header, &content, out));
            }
            let Some(stream) = &mut client.stream else { continue };
            stream.frames += 1;
            let stream = *stream;
            let outcome = if stream.rate.includes(stream.frames - 1, hz) {
                self.deliver(client, &stream, (frame, &mut encoded))
            } else {
                Delivery::NotRequested
            };
            if outcome != Delivery::NotRequested && stream.components.has_samples() {
                client.samples_missed += self.samples_gone(stream.components, &client.samples_from);
                self.set_sample_ends(&mut client.samples_from);
            }
            client.frames_missed += u64::from(outcome == Delivery::Dropped);
            if outcome == Delivery::Dropped && stream.target.is_some() {
                self.note_too_large(client);
            }
            if Some(stream.number) == first {
                delivery = outcome;
            }
        }
        self.clients = clients;
        self.end_frame();
        delivery
    }

    /// The components of a frame that a client wants, with the samples from these places on, or else those of the frame.
    fn content<'a>(
        &'a self,
        frame: &ServedFrame<'a>,
        wanted: Components,
        from: Option<&[u64]>,
    ) -> Vec<AnyComponent<'a>> {
        let rates = frame.rates;
        let markers = wanted.markers().map(|kind: MarkerComponentKind| {
            let markers = if kind.is_labelled() { frame.labelled } else { frame.unlabelled };
            AnyComponent::Markers(ComponentToSend { kind, rates, markers })
        });
        let bodies = wanted
            .bodies()
            .map(|kind| AnyComponent::Bodies(BodiesToSend { kind, rates, bodies: frame.bodies }));
        let samples = self.sampled_components(wanted, from).map(AnyComponent::Samples);
        // A system without bodies has no such component.
        let bodies = bodies.filter(|_| !self.settings.bodies.is_empty());
        markers.chain(bodies).chain(samples).collect()
    }

    /// Whether a component of these streams fits into no datagram: as many labelled markers and bodies as the settings state, and the
    /// samples of a frame by their rates. Unlabelled markers, and samples that come in lumps, may still be too many.
    pub(super) fn is_too_large(&self, wanted: Components, rate: StreamRate) -> bool {
        let missing = WireMarker { position_mm: [f32::NAN; 3], id: 0, residual_mm: 0.0 };
        let labelled = vec![missing; self.settings.labels.len()];
        let bodies = vec![ServedBody::LOST; self.settings.bodies.len()];
        let frame = ServedFrame { labelled: &labelled, bodies: &bodies, ..ServedFrame::default() };
        // Samples are not taken from those that there are.
        let ends: Vec<u64> = self.sample_ends().collect();
        let content = self.content(&frame, wanted, Some(&ends));
        let samples = self.sample_bytes(wanted, self.stream_hz(rate));
        let bytes = content.iter().map(AnyComponent::bytes).chain(samples);
        bytes.max().is_some_and(|bytes| FRAME_HEADER_BYTES + bytes > DATAGRAM_BYTES_MAX)
    }

    /// Keeps a client whose frames do not fit, once for each of its streams.
    fn note_too_large(&mut self, client: &mut Client) {
        let Some(stream) = &mut client.stream else { return };
        if !std::mem::replace(&mut stream.is_too_large, true)
            && self.too_large.len() < TOO_LARGE_KEPT
        {
            self.too_large.push(client.peer);
        }
    }

    /// The clients that miss frames, since the last call, which do not fit into datagrams.
    pub fn take_too_large(&mut self) -> Vec<SocketAddr> {
        std::mem::take(&mut self.too_large)
    }

    /// Frames a second of a stream.
    fn stream_hz(&self, rate: StreamRate) -> f64 {
        let hz = self.settings.frequency_hz;
        match rate {
            StreamRate::Frequency(wanted) => hz.min(f64::from(wanted)),
            StreamRate::Divisor(n) => hz / f64::from(n),
            StreamRate::All => hz,
        }
    }

    fn deliver(
        &mut self,
        client: &mut Client,
        stream: &Stream,
        (frame, encoded): (&ServedFrame<'_>, &mut Encoded),
    ) -> Delivery {
        let (wanted, from) = (stream.components, &client.samples_from[..]);
        if let Some(to) = stream.target {
            let content = self.content(frame, wanted, Some(from));
            let Some(parts) = divided(frame.header, &content) else { return Delivery::Dropped };
            let n = parts.len();
            let datagram = |(at, bytes)| Datagram {
                client: client.id,
                to,
                bytes,
                is_of_frame: true,
                ends_frame: at + 1 == n,
            };
            self.datagrams.extend(parts.into_iter().enumerate().map(datagram));
            return Delivery::Datagrams(n);
        }
        // Without samples all streams of the same components are equal.
        let from = if wanted.has_samples() { from } else { &[] };
        let known = encoded.iter().find(|(of, since, _)| *of == wanted && since == from);
        let bytes = match known {
            Some((.., bytes)) => Arc::clone(bytes),
            None => {
                let mut bytes = Vec::new();
                put_components(frame.header, &self.content(frame, wanted, Some(from)), &mut bytes);
                let bytes: Arc<[u8]> = bytes.into();
                encoded.push((wanted, from.to_vec(), Arc::clone(&bytes)));
                bytes
            }
        };
        if !self.make_room(client, bytes.len()) {
            return Delivery::Dropped;
        }
        client.outbox.put_frame(bytes);
        Delivery::Queued { client: client.id, end: client.outbox.queued() }
    }

    /// Whether a frame of so many bytes may wait for a client. For one of a recorder, the oldest frames make room.
    fn make_room(&self, client: &mut Client, bytes: usize) -> bool {
        if let Role::Recorder { .. } = self.role {
            let hz = self.stream_hz(client.stream.map_or(StreamRate::All, |stream| stream.rate));
            let frames_max = ((BACKLOG_S * hz) as usize).max(1);
            while client.outbox.frames_waiting() >= frames_max || !client.outbox.has_room_for(bytes)
            {
                if !client.outbox.drop_oldest_frame() {
                    break;
                }
                client.frames_missed += 1;
            }
        }
        client.outbox.has_room_for(bytes)
    }

    /// Frames did not reach this server, of which each client misses those that it requested.
    pub fn left_out(&mut self, n: u64) {
        let hz = self.settings.frequency_hz;
        for client in &mut self.clients {
            let Some(stream) = &mut client.stream else { continue };
            let missed = (0..n.min(LEFT_OUT_MAX))
                .filter(|passed| stream.rate.includes(stream.frames + passed, hz))
                .count();
            stream.frames += n;
            client.frames_missed += missed as u64;
        }
    }

    /// The system took a datagram, or not.
    pub fn datagram_sent(&mut self, datagram: &Datagram, is_sent: bool) {
        let Some(client) = self.client(datagram.client) else { return };
        client.is_part_lost |= !is_sent && datagram.is_of_frame;
        if datagram.ends_frame {
            let is_whole = !std::mem::take(&mut client.is_part_lost);
            client.datagram_frames += u64::from(is_whole);
            client.frames_missed += u64::from(!is_whole);
        }
    }
}

impl StreamRate {
    /// Whether a stream has the frame `index` of a measurement at `hz`, counted from 0.
    fn includes(self, index: u64, hz: f64) -> bool {
        match self {
            Self::All => true,
            Self::Divisor(n) => index.is_multiple_of(u64::from(n)),
            Self::Frequency(wanted) if f64::from(wanted) < hz => {
                let due = |index: u64| (index as f64 * f64::from(wanted) / hz).floor();
                index == 0 || due(index) > due(index - 1)
            }
            Self::Frequency(_) => true,
        }
    }
}

/// The datagrams of a frame: as many components in each as fit. `None` when one does not fit into any.
fn divided(header: FrameHeader, components: &[AnyComponent<'_>]) -> Option<Vec<Vec<u8>>> {
    let mut parts = Vec::new();
    let mut rest = components;
    loop {
        let mut bytes = FRAME_HEADER_BYTES;
        let fits = |component: &&AnyComponent<'_>| {
            bytes += component.bytes();
            bytes <= DATAGRAM_BYTES_MAX
        };
        let n = rest.iter().take_while(fits).count();
        if n == 0 && !rest.is_empty() {
            return None;
        }
        let (now, later) = rest.split_at(n);
        let mut part = Vec::new();
        put_components(header, now, &mut part);
        parts.push(part);
        if later.is_empty() {
            return Some(parts);
        }
        rest = later;
    }
}
