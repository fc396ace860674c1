//! The server's end of the protocol, sans-io: connections, their bytes and messages of channels go in, bytes for clients come out.

use std::{net::SocketAddr, time::Duration};

use mocapd_drivers::transport::network::server::StreamServer;
use mocapd_take::interchange::foxglove::Message;
use tungstenite::{handshake::server::Request, http::StatusCode};

use super::{
    outbox::{EntryKind, MissedCounts, Outbox},
    protocol::{
        Channel, ClientMessage, SUBPROTOCOLS, Subscription, put_advertise, put_error, put_message,
        put_server_info, put_time, put_unadvertise,
    },
    web_socket::{Received, RefusedHandshake, WebSocket, refuse},
};
use crate::publish::clients::{ClientLimits, NotAccepted};

/// Time for a handshake: a connection that is silent must not occupy a place for ever.
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(10);

/// Letters of a client's bytes that are repeated to a person.
const SHOWN_MAX: usize = 200;

/// Messages about clients that wait for the events; further ones would say the same.
const NEWS_MAX: usize = 64;

/// A connected client, until it is disconnected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ClientId(u64);

/// A client as the status reports it.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClientReport {
    pub(super) peer: SocketAddr,
    /// The subprotocol; empty until it is chosen.
    pub(super) subprotocol: &'static str,
    pub(super) is_streaming: bool,
    pub(super) frames_sent: u64,
    pub(super) missed: MissedCounts,
}

#[derive(Debug)]
struct Client {
    id: ClientId,
    peer: SocketAddr,
    socket: WebSocket,
    subprotocol: &'static str,
    connected: Duration,
    subscriptions: Vec<Subscription>,
    outbox: Outbox,
    /// The messages of the present frame or batch.
    building: Vec<u8>,
    /// The length of the one before, which the next one mostly has.
    last_length: usize,
    /// The last time that it was sent. A viewer takes one that is earlier for a jump, and forgets all it has.
    time_ns: u64,
    /// Whether it was sent something of a frame, or of a batch, since it subscribed.
    has_frames: bool,
    has_batches: bool,
    is_over: bool,
    missed: MissedCounts,
    /// What of that it missed because it read too slowly.
    dropped: MissedCounts,
}

/// A server.
#[derive(Debug)]
pub(super) struct FoxgloveServer {
    name: String,
    session: String,
    limits: ClientLimits,
    /// Web pages whose scripts may connect.
    origins: Vec<String>,
    channels: Vec<(u32, Channel)>,
    next_channel: u32,
    clients: Vec<Client>,
    next_client: u64,
    now: Duration,
    refused: u64,
    /// Frames that clients were sent which are gone, and what these missed.
    gone: (u64, MissedCounts),
    news: Vec<String>,
}

impl FoxgloveServer {
    /// A server of this name; `session` is another for each start of it. Scripts of web pages may connect from `origins`.
    pub(super) fn new(
        name: String,
        session: String,
        limits: ClientLimits,
        origins: Vec<String>,
    ) -> Self {
        Self {
            name,
            session,
            limits,
            origins,
            channels: Vec::new(),
            next_channel: 1,
            clients: Vec::new(),
            next_client: 0,
            now: Duration::ZERO,
            refused: 0,
            gone: (0, MissedCounts::default()),
            news: Vec::new(),
        }
    }

    /// States the time, by any clock that does not jump.
    pub(super) fn set_now(&mut self, now: Duration) {
        self.now = now;
    }

    /// Announces these channels; those that were announced before and are not among them end, and subscriptions to them.
    pub(super) fn set_channels(&mut self, channels: Vec<Channel>) {
        let (kept, ended): (Vec<_>, Vec<_>) =
            self.channels.drain(..).partition(|(_, channel)| channels.contains(channel));
        let ended: Vec<u32> = ended.into_iter().map(|(id, _)| id).collect();
        let mut added = Vec::new();
        for channel in channels {
            if !kept.iter().any(|(_, known)| *known == channel) {
                added.push((self.next_channel, channel));
                self.next_channel += 1;
            }
        }
        let mut bytes = Vec::new();
        put_unadvertise(&ended, &mut bytes);
        put_advertise(added.iter().map(|(id, channel)| (*id, channel)), &mut bytes);
        for client in self.clients.iter_mut().filter(|client| client.socket.is_open()) {
            client.subscriptions.retain(|subscription| !ended.contains(&subscription.channel_id));
            client.put(bytes.clone());
        }
        self.channels = kept;
        self.channels.append(&mut added);
    }

    fn channel(&self, topic: &str) -> Option<u32> {
        self.channels.iter().find(|(_, channel)| channel.topic == topic).map(|(id, _)| *id)
    }

    /// Whether a client wants messages of a topic.
    pub(super) fn is_wanted(&self, topic: &str) -> bool {
        self.channel(topic).is_some_and(|channel| {
            self.clients.iter().any(|client| client.subscription(channel).is_some())
        })
    }

    /// Adds a message to what the clients that want it are sent next. It is built if there is one.
    pub(super) fn message(&mut self, topic: &str, time_ns: u64, build: impl FnOnce() -> Message) {
        let Some(channel) = self.channel(topic).filter(|_| self.is_wanted(topic)) else { return };
        let message = build();
        for client in &mut self.clients {
            if let Some(id) = client.subscription(channel) {
                if client.building.is_empty() {
                    client.building.reserve(client.last_length);
                }
                // Before each sample of a batch as well: viewers draw a message at the last time that they were sent.
                if time_ns > client.time_ns {
                    client.time_ns = time_ns;
                    put_time(time_ns, &mut client.building);
                }
                put_message(id, time_ns, message.as_bytes(), &mut client.building);
            }
        }
    }

    /// Times begin anew, earlier than before.
    pub(super) fn restart_time(&mut self) {
        self.clients.iter_mut().for_each(|client| client.time_ns = 0);
    }

    /// Ends the frame to which messages were added: clients are sent it whole, or miss it.
    pub(super) fn end_frame(&mut self) {
        self.end(EntryKind::Frame);
    }

    /// The same for a batch of samples.
    pub(super) fn end_batch(&mut self) {
        self.end(EntryKind::Batch);
    }

    fn end(&mut self, kind: EntryKind) {
        for client in self.clients.iter_mut().filter(|client| !client.building.is_empty()) {
            let mut bytes = std::mem::take(&mut client.building);
            client.last_length = bytes.len();
            // What waits is bounded by its length, and so is its memory.
            if bytes.capacity() > bytes.len() + bytes.len() / 8 {
                bytes.shrink_to_fit();
            }
            client.has_frames |= kind == EntryKind::Frame;
            client.has_batches |= kind == EntryKind::Batch;
            let dropped = client.outbox.put_droppable(bytes, kind);
            client.missed.add(dropped);
            client.dropped.add(dropped);
        }
    }

    /// Sends a message that may not be missed to the clients that want it. With `states_time` its time is sent, too: while
    /// nothing else states it.
    pub(super) fn message_alone(
        &mut self,
        topic: &str,
        time_ns: u64,
        message: &Message,
        states_time: bool,
    ) {
        let Some(channel) = self.channel(topic) else { return };
        for client in &mut self.clients {
            if let Some(id) = client.subscription(channel) {
                let mut bytes = Vec::new();
                if states_time && time_ns > client.time_ns {
                    client.time_ns = time_ns;
                    put_time(time_ns, &mut bytes);
                }
                put_message(id, time_ns, message.as_bytes(), &mut bytes);
                client.put(bytes);
            }
        }
    }

    /// Counts frames that did not reach the server: the clients miss them that are sent frames.
    pub(super) fn frames_left_out(&mut self, frames: u64) {
        for client in self.clients.iter_mut().filter(|client| client.has_frames) {
            client.missed.frames += frames;
        }
    }

    /// The same for batches of samples.
    pub(super) fn batches_left_out(&mut self, batches: u64) {
        for client in self.clients.iter_mut().filter(|client| client.has_batches) {
            client.missed.batches += batches;
        }
    }

    /// Messages about clients since the last call.
    pub(super) fn take_news(&mut self) -> Vec<String> {
        let mut news = self.limits.take_news();
        news.append(&mut self.news);
        news
    }

    /// Connections that were refused, and the limit on simultaneous clients.
    pub(super) fn limits(&self) -> (u64, usize) {
        (self.limits.refused() + self.refused, self.limits.clients_max())
    }

    /// Frames that clients were sent, and what they missed, also those that are gone.
    pub(super) fn totals(&self) -> (u64, MissedCounts) {
        self.clients.iter().fold(self.gone, |(sent, mut missed), client| {
            missed.add(client.missed);
            (sent + client.outbox.frames_sent(), missed)
        })
    }

    pub(super) fn reports(&self) -> Vec<ClientReport> {
        self.clients.iter().map(Client::report).collect()
    }

    fn client(&mut self, id: ClientId) -> Option<&mut Client> {
        self.clients.iter_mut().find(|client| client.id == id)
    }

    fn refuse(&mut self, peer: SocketAddr, why: &str) {
        self.refused += 1;
        if self.news.len() < NEWS_MAX {
            let ip = peer.ip().to_canonical();
            self.news.push(format!("Foxglove client {ip} refused: {why}"));
        }
    }

    fn execute(&mut self, id: ClientId, received: Received) {
        match received {
            Received::Opened => {
                let mut bytes = Vec::new();
                put_server_info(&self.name, &self.session, &mut bytes);
                let channels = self.channels.iter().map(|(id, channel)| (*id, channel));
                put_advertise(channels, &mut bytes);
                if let Some(client) = self.client(id) {
                    client.put(bytes);
                }
            }
            Received::Text(text) => match serde_json::from_str(&text) {
                Ok(ClientMessage::Subscribe { subscriptions }) => {
                    subscriptions.into_iter().for_each(|request| self.subscribe(id, request));
                }
                Ok(ClientMessage::Unsubscribe { subscription_ids }) => {
                    if let Some(client) = self.client(id) {
                        client.subscriptions.retain(|known| !subscription_ids.contains(&known.id));
                    }
                }
                Ok(ClientMessage::Other) => {
                    self.error(id, "mocapd only publishes: it has the capability 'time' alone");
                }
                Err(error) => {
                    // It may quote the message.
                    let error: String = error.to_string().chars().take(SHOWN_MAX).collect();
                    self.error(id, &format!("this is no message of the protocol: {error}"));
                }
            },
            Received::Binary => {
                self.error(id, "mocapd only publishes: it takes no messages of clients");
            }
            Received::Closed => {
                if let Some(client) = self.client(id) {
                    client.close();
                }
            }
        }
    }

    fn subscribe(&mut self, id: ClientId, request: Subscription) {
        let Subscription { id: number, channel_id } = request;
        let is_known = self.channels.iter().any(|(id, _)| *id == channel_id);
        let Some(client) = self.client(id) else { return };
        // At most one for each channel, so that their number is bounded.
        if !is_known {
            self.error(id, &format!("there is no channel {channel_id}"));
        } else if client.subscription(channel_id).is_some() {
            self.error(id, &format!("channel {channel_id} is subscribed to already"));
        } else if client.subscriptions.iter().any(|known| known.id == number) {
            self.error(id, &format!("subscription {number} exists already"));
        } else {
            client.subscriptions.push(request);
        }
    }

    fn error(&mut self, id: ClientId, message: &str) {
        let mut bytes = Vec::new();
        put_error(message, &mut bytes);
        if let Some(client) = self.client(id) {
            client.put(bytes);
        }
    }
}

/// The subprotocol for a request, or why it is refused.
fn accept(request: &Request, origins: &[String]) -> Result<&'static str, RefusedHandshake> {
    // The script of any web page could connect from this machine, which may. Programs have no origin, or one of another scheme:
    // installed viewers that are web pages inside, and in some browsers pages that were saved as files, which a person has opened.
    for origin in request.headers().get_all("Origin") {
        let origin = String::from_utf8_lossy(origin.as_bytes());
        let is_ascii = origin.chars().all(|c| c.is_ascii_graphic());
        let is_of_page =
            origin == "null" || origin.starts_with("http:") || origin.starts_with("https:");
        if (is_of_page || !is_ascii) && !origins.iter().any(|known| *known == origin) {
            let shown: String = origin.chars().take(SHOWN_MAX).collect();
            return Err((
                StatusCode::FORBIDDEN,
                format!("{shown} is not in publish.foxglove.origins"),
            ));
        }
    }
    let header =
        |name: &str| request.headers().get_all(name).iter().filter_map(|v| v.to_str().ok());
    let offered: Vec<&str> = header("Sec-WebSocket-Protocol")
        .flat_map(|value| value.split(','))
        .map(str::trim)
        .collect();
    SUBPROTOCOLS.into_iter().find(|ours| offered.contains(ours)).ok_or_else(|| {
        let text =
            format!("mocapd speaks the subprotocols {}: request one", SUBPROTOCOLS.join(" and "));
        (StatusCode::BAD_REQUEST, text)
    })
}

impl Client {
    fn subscription(&self, channel: u32) -> Option<u32> {
        let mut all = self.subscriptions.iter();
        all.find(|subscription| subscription.channel_id == channel).map(|found| found.id)
    }

    /// Adds what may not be missed. A client that does not read is disconnected.
    fn put(&mut self, bytes: Vec<u8>) {
        if !self.is_over && !self.outbox.put(bytes) {
            self.end();
        }
    }

    /// Sends it nothing more but the answer to its close, and disconnects it then.
    fn close(&mut self) {
        self.subscriptions.clear();
        self.building.clear();
        self.missed.add(self.outbox.drop_all_droppable());
        self.is_over = true;
    }

    /// Disconnects it; what waits is missed.
    fn end(&mut self) {
        self.close();
        // A frame of which it was sent a part.
        let cut = self.outbox.clear();
        self.missed.add(cut);
    }

    fn report(&self) -> ClientReport {
        ClientReport {
            peer: self.peer,
            subprotocol: self.subprotocol,
            is_streaming: !self.subscriptions.is_empty(),
            frames_sent: self.outbox.frames_sent(),
            missed: self.missed,
        }
    }
}

impl StreamServer for FoxgloveServer {
    type Id = ClientId;

    fn connect(&mut self, peer: SocketAddr) -> Result<ClientId, Vec<u8>> {
        self.limits.check(peer, self.clients.len()).map_err(|refusal| {
            let (status, why) = match refusal {
                NotAccepted::Address => {
                    (StatusCode::FORBIDDEN, "this address is not in publish.foxglove.allow_from")
                }
                NotAccepted::Full => (
                    StatusCode::SERVICE_UNAVAILABLE,
                    "publish.foxglove.clients_max are connected already",
                ),
            };
            let mut bytes = Vec::new();
            refuse(status, why, &mut bytes);
            bytes
        })?;
        let id = ClientId(self.next_client);
        self.next_client += 1;
        self.clients.push(Client {
            id,
            peer,
            socket: WebSocket::default(),
            subprotocol: "",
            connected: self.now,
            subscriptions: Vec::new(),
            outbox: Outbox::default(),
            building: Vec::new(),
            last_length: 0,
            time_ns: 0,
            has_frames: false,
            has_batches: false,
            is_over: false,
            missed: MissedCounts::default(),
            dropped: MissedCounts::default(),
        });
        Ok(id)
    }

    fn disconnect(&mut self, id: ClientId) {
        let Some(at) = self.clients.iter().position(|client| client.id == id) else { return };
        let mut client = self.clients.swap_remove(at);
        client.end();
        let ClientReport { peer, frames_sent, .. } = client.report();
        self.gone.0 += frames_sent;
        self.gone.1.add(client.missed);
        let MissedCounts { frames, batches } = client.dropped;
        if (frames > 0 || batches > 0) && self.news.len() < NEWS_MAX {
            let n = frames_sent + client.missed.frames;
            self.news.push(format!(
                "Foxglove client {peer} has left: it read too slowly, and missed {frames} of {n} frames and {batches} batches of samples"
            ));
        }
    }

    fn receive(&mut self, id: ClientId, bytes: &[u8]) {
        let Some(client) = self.clients.iter_mut().find(|client| client.id == id) else { return };
        let (mut out, mut chosen) = (Vec::new(), Ok(client.subprotocol));
        let was_open = client.socket.is_open();
        let choose = |request: &Request| {
            chosen = accept(request, &self.origins);
            chosen.clone()
        };
        let received = client.socket.receive(bytes, choose, &mut out);
        client.put(out);
        let peer = client.peer;
        let is_refused = !was_open && received.as_slice() == [Received::Closed];
        match chosen {
            Ok(subprotocol) => {
                client.subprotocol = subprotocol;
                self.refused += u64::from(is_refused);
            }
            Err((_, why)) => self.refuse(peer, &why),
        }
        for received in received {
            self.execute(id, received);
        }
    }

    fn may_receive(&self, id: ClientId) -> bool {
        let client = self.clients.iter().find(|client| client.id == id);
        client.is_some_and(|client| !client.is_over && !client.outbox.is_full())
    }

    fn is_over(&self, id: ClientId) -> bool {
        self.clients.iter().any(|client| {
            let is_late = !client.socket.is_open()
                && self.now.saturating_sub(client.connected) > HANDSHAKE_WITHIN;
            client.id == id && (client.is_over || is_late)
        })
    }

    fn pending(&self, id: ClientId) -> &[u8] {
        self.clients
            .iter()
            .find(|client| client.id == id)
            .map_or(&[], |client| client.outbox.next())
    }

    fn sent(&mut self, id: ClientId, n: usize) {
        if let Some(client) = self.client(id) {
            client.outbox.sent(n);
        }
    }
}

#[cfg(test)]
mod tests {
    use mocapd_take::interchange::foxglove::{LogLevel, log};

    use super::*;
    use crate::publish::PublisherName;

    const NAME: PublisherName = PublisherName { id: "foxglove", title: "Foxglove" };

    fn channel(topic: &str) -> Channel {
        Channel { topic: topic.to_owned(), schema_name: "x.Y".to_owned(), schema: vec![7; 100] }
    }

    fn server(topics: &[&str]) -> FoxgloveServer {
        let limits = ClientLimits::new(NAME, &[], 3);
        let mut server = FoxgloveServer::new("rig".to_owned(), "1".to_owned(), limits, Vec::new());
        server.set_channels(topics.iter().map(|topic| channel(topic)).collect());
        server
    }

    fn connected(server: &mut FoxgloveServer) -> ClientId {
        let id = server.connect("127.0.0.1:5000".parse().unwrap()).unwrap();
        let request = "GET / HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
            Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: other, foxglove.sdk.v1\r\n\r\n";
        server.receive(id, request.as_bytes());
        id
    }

    fn send(server: &mut FoxgloveServer, id: ClientId, text: &str) {
        let length = (text.len() as u16).to_be_bytes();
        let header = [&[0x81, 0x80 | 126], &length[..], &[0; 4]].concat();
        server.receive(id, &[&header, text.as_bytes()].concat());
    }

    fn subscribe(server: &mut FoxgloveServer, id: ClientId, number: u32, topic: &str) {
        let channel = server.channel(topic).unwrap();
        let list = format!(r#"[{{"id":{number},"channelId":{channel}}}]"#);
        send(server, id, &format!(r#"{{"op":"subscribe","subscriptions":{list}}}"#));
    }

    /// What a client that reads is sent.
    fn read(server: &mut FoxgloveServer, id: ClientId) -> Vec<u8> {
        let mut bytes = Vec::new();
        while !server.pending(id).is_empty() {
            let n = server.pending(id).len();
            bytes.extend_from_slice(server.pending(id));
            server.sent(id, n);
        }
        bytes
    }

    fn text(bytes: &[u8]) -> String {
        String::from_utf8_lossy(bytes).into_owned()
    }

    fn frame(server: &mut FoxgloveServer, topic: &str, n_bytes: usize) {
        server.message(topic, 9, || log(LogLevel::Info, "", &"x".repeat(n_bytes), 9));
        server.end_frame();
    }

    #[test]
    fn a_client_is_told_of_channels_and_gets_those_that_it_subscribes_to() {
        let mut server = server(&["/a", "/b"]);
        let id = connected(&mut server);
        let greeting = text(&read(&mut server, id));
        assert!(greeting.contains(r#""op":"serverInfo","name":"rig""#), "{greeting}");
        assert!(greeting.contains(r#""id":2,"topic":"/b","encoding":"protobuf""#), "{greeting}");
        assert_eq!(server.reports()[0].subprotocol, "foxglove.sdk.v1");
        frame(&mut server, "/a", 1);
        assert_eq!(read(&mut server, id), b"", "it has not subscribed to it");
        subscribe(&mut server, id, 77, "/a");
        assert!(server.is_wanted("/a") && !server.is_wanted("/b"));
        frame(&mut server, "/a", 1);
        frame(&mut server, "/b", 1);
        let found = read(&mut server, id);
        assert_eq!(found[..11], [0x82, 9, 2, 9, 0, 0, 0, 0, 0, 0, 0], "the time");
        assert_eq!(found[13..26], [1, 77, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0], "a message");
        // Another device: /a is as before, and the subscription goes on.
        server.set_channels(vec![channel("/a"), channel("/c")]);
        let news = text(&read(&mut server, id));
        assert!(news.contains(r#"{"op":"unadvertise","channelIds":[2]}"#), "{news}");
        assert!(news.contains(r#""id":3,"topic":"/c""#) && !news.contains("/a"), "{news}");
        assert!(server.is_wanted("/a"));
        send(&mut server, id, r#"{"op":"unsubscribe","subscriptionIds":[77]}"#);
        assert!(!server.is_wanted("/a"));
    }

    #[test]
    fn what_is_not_possible_is_answered() {
        let mut server = server(&["/a"]);
        let id = connected(&mut server);
        subscribe(&mut server, id, 1, "/a");
        read(&mut server, id);
        for (sent, expected) in [
            (
                r#"{"op":"subscribe","subscriptions":[{"id":2,"channelId":9}]}"#,
                "there is no channel 9",
            ),
            (r#"{"op":"subscribe","subscriptions":[{"id":2,"channelId":1}]}"#, "already"),
            (r#"{"op":"getParameters","parameterNames":[]}"#, "mocapd only publishes"),
            (r#"{"op":7}"#, "no message of the protocol"),
            ("[[[[", "no message of the protocol"),
        ] {
            send(&mut server, id, sent);
            let answer = text(&read(&mut server, id));
            assert!(answer.contains(r#""op":"status","level":2"#), "{sent}: {answer}");
            assert!(answer.contains(expected), "{sent}: {answer}");
        }
        assert!(!server.is_over(id), "it stays connected");
    }

    #[test]
    fn every_frame_is_sent_or_counted_as_missed() {
        let mut server = server(&["/a"]);
        let [reads, stuck] = [(); 2].map(|()| connected(&mut server));
        for id in [reads, stuck] {
            subscribe(&mut server, id, 1, "/a");
        }
        for _ in 0..100 {
            frame(&mut server, "/a", 100_000);
            read(&mut server, reads);
        }
        server.frames_left_out(5);
        let [of_reads, of_stuck] = [0, 1].map(|at| server.reports()[at]);
        assert_eq!((of_reads.frames_sent, of_reads.missed.frames), (100, 5));
        // 41 of 100 kB are in 4 MiB.
        assert_eq!((of_stuck.frames_sent, of_stuck.missed.frames), (0, 59 + 5));
        server.disconnect(stuck);
        let (sent, missed) = server.totals();
        assert_eq!((sent, missed.frames), (100, 5 + 100 + 5));
        let news = server.take_news();
        assert!(news.len() == 1 && news[0].contains("missed 59 of 105 frames"), "{news:?}");
    }

    #[test]
    fn clients_that_are_silent_or_do_not_read_their_replies_are_disconnected() {
        let mut server = server(&["/a"]);
        let silent = server.connect("127.0.0.1:5001".parse().unwrap()).unwrap();
        server.set_now(Duration::from_secs(9));
        let id = connected(&mut server);
        assert!(!server.is_over(silent));
        server.set_now(Duration::from_secs(11));
        assert!(server.is_over(silent) && !server.is_over(id));
        let mut n = 0;
        while server.may_receive(id) {
            send(&mut server, id, "garbage");
            n += 1;
        }
        assert!((1000..100_000).contains(&n), "it may send {n} messages without reading");
        assert!(!server.is_over(id), "it is only not read");
        for number in 0..10_000 {
            server.set_channels(vec![channel(&format!("/{number}"))]);
        }
        assert!(server.is_over(id) && server.pending(id).is_empty());
    }

    #[test]
    fn the_number_of_clients_is_bounded() {
        let mut server = server(&[]);
        let peer = "127.0.0.1:5000".parse().unwrap();
        (0..3).for_each(|_| assert!(server.connect(peer).is_ok()));
        let answer = text(&server.connect(peer).unwrap_err());
        assert!(answer.starts_with("HTTP/1.1 503 ") && answer.contains("clients_max"), "{answer}");
        let answer = text(&server.connect("10.0.0.1:1".parse().unwrap()).unwrap_err());
        assert!(answer.starts_with("HTTP/1.1 403 ") && answer.contains("allow_from"), "{answer}");
        assert_eq!(server.limits(), (2, 3));
    }

    #[test]
    fn behind_a_close_nothing_is_sent() {
        let mut server = server(&["/a"]);
        for close in [[0x88, 0x80, 0, 0, 0, 0], [0xf1, 0x80, 0, 0, 0, 0]] {
            let id = connected(&mut server);
            subscribe(&mut server, id, 1, "/a");
            read(&mut server, id);
            (0..3).for_each(|_| frame(&mut server, "/a", 1000));
            server.sent(id, 10);
            server.receive(id, &close);
            frame(&mut server, "/a", 1000);
            server.message_alone("/a", 9, &log(LogLevel::Info, "", "x", 9), true);
            assert!(server.is_over(id) && !server.may_receive(id));
            let found = read(&mut server, id);
            let answer = if close[0] == 0x88 { &[0x88, 0][..] } else { &[] };
            assert!(
                found.ends_with(answer) && found.len() < 1100,
                "the frame that was begun, and the answer: {}",
                found.len()
            );
            server.disconnect(id);
        }
        assert_eq!(server.totals().1.frames, 4, "what was dropped is missed");
    }

    #[test]
    fn a_frame_that_ends_in_the_middle_is_missed() {
        let mut server = server(&["/a"]);
        let id = connected(&mut server);
        subscribe(&mut server, id, 1, "/a");
        read(&mut server, id);
        (0..3).for_each(|_| frame(&mut server, "/a", 1000));
        server.sent(id, 10);
        server.disconnect(id);
        let (sent, missed) = server.totals();
        assert_eq!((sent, missed.frames, missed.batches), (0, 3, 0));
    }

    #[test]
    fn times_that_are_sent_never_fall() {
        let mut server = server(&["/a", "/b"]);
        let id = connected(&mut server);
        subscribe(&mut server, id, 1, "/a");
        subscribe(&mut server, id, 2, "/b");
        read(&mut server, id);
        let entry = || log(LogLevel::Info, "", "", 0);
        let times = |of: &[u64], server: &mut FoxgloveServer| {
            of.iter().for_each(|time_ns| server.message("/a", *time_ns, entry));
            server.end_batch();
            let found = read(server, id);
            found.windows(3).filter(|three| *three == [0x82, 9, 2]).count()
        };
        assert_eq!(times(&[50], &mut server), 1, "a frame");
        assert_eq!(times(&[30, 40, 50, 60, 70], &mut server), 2, "a batch that began before it");
        server.restart_time();
        assert_eq!(times(&[10], &mut server), 1, "another device");
    }
}
