//! Arbitrary bytes as what LSL's streams send, as their descriptions, and as the URIs that name them.

use std::net::{Ipv4Addr, SocketAddr};

use mocapd_drivers::{
    device::{Command, DeviceEvent, LinkCounters, Protocol},
    link::{GROUPS_MAX, SAMPLED_CHANNELS_MAX},
    lsl::{
        Layout, LslHost, OutletServer, Publisher, StreamDescription, StreamMessage, put_message,
    },
    transport::network::server::StreamServer,
    uri::{DeviceUri, StreamQuery},
};

use crate::Input;

/// Decodes the bytes as messages of a line, whole and in pieces, with equal results, as the samples of a feed, and reads them
/// as a description and as a URI. The first byte selects the pieces.
pub fn read_lsl(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let how = input.byte();
    let wire = input.take(usize::MAX);
    let piece = [wire.len().max(1), 1, 7, 64][usize::from(how & 3)];
    assert_eq!(
        host(wire, wire.len().max(1)),
        host(wire, piece),
        "the pieces change what is decoded"
    );
    for stream in 0..2 {
        let mut data = Vec::new();
        put_message(StreamMessage::Data { stream, read_ns: 1, bytes: wire }, &mut data);
        host(&data, data.len());
    }
    let text = String::from_utf8_lossy(wire);
    outlet(wire, piece);
    description(&text);
    if let Ok(uri) = format!("lsl:{text}").parse::<DeviceUri>() {
        assert_eq!(uri.to_string().parse(), Ok(uri), "a URI that is written otherwise");
    }
}

/// The bytes as a request to one of our streams, and as a question: answers of a bounded size, and samples for one who may read.
fn outlet(wire: &[u8], piece: usize) {
    const PORT: u16 = 16_573;
    let publisher = Publisher { name: "rig", source_id: "rig", program: "mocapd" };
    let mut server = OutletServer::new(16_572, 1);
    server.set_stream(PORT, Some(publisher.positions(&["A"], 100.0)), 1);
    let at = |port| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    assert!(server.answers(at(1), wire, || 1.0).len() <= 1);
    let Ok(id) = server.connect_at(at(1), at(PORT)) else { panic!("there is room") };
    for bytes in wire.chunks(piece) {
        if server.may_receive(id) {
            server.receive(id, bytes);
        }
    }
    server.push(PORT, 1.0, &[1.0, f32::NAN, 3.0]);
    let mut n = 0;
    while !server.pending(id).is_empty() {
        n += server.pending(id).len();
        server.sent(id, 7);
    }
    assert!(n < 4096, "{n} bytes");
}

/// A stream of one marker and one more channel, and one of texts.
pub(crate) fn descriptions() -> [String; 2] {
    let fields = |kind, n, format, rate| {
        format!(
            "<name>{kind}</name><type>{kind}</type><channel_count>{n}</channel_count><channel_format>{format}</channel_format>\
             <nominal_srate>{rate}</nominal_srate><hostname>lab</hostname>"
        )
    };
    let axis = |axis| {
        format!("<channel><marker>A</marker><type>Position{axis}</type><unit>mm</unit></channel>")
    };
    let channels = ["X", "Y", "Z"].map(axis).concat();
    let motion = fields("MoCap", 4, "float32", 100);
    [
        format!("<info>{motion}<desc><channels>{channels}</channels></desc></info>"),
        format!("<info>{}</info>", fields("Markers", 1, "string", 0)),
    ]
}

/// The events of a host that has started, and its counters.
fn host(wire: &[u8], piece: usize) -> (Vec<String>, LinkCounters) {
    let mut host = LslHost::new(StreamQuery::default());
    let mut bytes = Vec::new();
    for (stream, xml) in (0..).zip(descriptions()) {
        put_message(StreamMessage::Description { stream, xml: &xml }, &mut bytes);
    }
    put_message(StreamMessage::Found, &mut bytes);
    host.push(&bytes, &mut |_| {});
    host.command(Command::Start { line_bytes_per_s: 0 }, &mut Vec::new());
    bytes.clear();
    for stream in 0..2 {
        put_message(StreamMessage::Feed { stream, is_big_endian: false }, &mut bytes);
    }
    put_message(StreamMessage::Started, &mut bytes);
    host.push(&bytes, &mut |_| {});
    let mut events = Vec::new();
    for bytes in wire.chunks(piece) {
        host.push(bytes, &mut |event| {
            if let DeviceEvent::Frame(frame) = event {
                let seen = frame.markers.iter().filter(|marker| !marker.occluded);
                assert!(seen.flat_map(|marker| marker.position_mm).all(f32::is_finite));
            }
            if let DeviceEvent::Samples(batch) = event {
                // NaN is not equal to itself.
                let bits: Vec<u32> = batch.samples.iter().map(|value| value.to_bits()).collect();
                events.push(format!("{} {} {bits:?}", batch.group, batch.first));
                return;
            }
            let text = format!("{event:?}");
            if let DeviceEvent::Note(text) = event {
                assert!(!text.contains(char::is_control), "{text}");
            }
            if let DeviceEvent::Mark(mark) = event {
                assert!(!mark.text.contains(char::is_control), "{text}");
            }
            events.push(text);
        });
    }
    let counters = host.counters();
    // Messages that a longer read would complete count when they do.
    (events, LinkCounters { bytes: 0, ..counters })
}

/// What a description becomes has the bounds of a device.
fn description(xml: &str) {
    let Ok(description) = StreamDescription::parse(xml) else { return };
    assert!(description.channels.len() <= description.n_channels);
    assert!(!description.summary().contains(char::is_control));
    let query = StreamQuery { rate_millihertz: Some(100_000), ..StreamQuery::default() };
    match Layout::new(&query, &[description]) {
        Ok(layout) => {
            assert!(layout.groups().count() <= GROUPS_MAX);
            assert!(layout.groups().all(|group| group.channels.len() <= SAMPLED_CHANNELS_MAX));
            assert_eq!(layout.markers.len(), usize::from(layout.hello.markers_max));
        }
        Err(reason) => assert!(!reason.contains(char::is_control), "{reason}"),
    }
}
