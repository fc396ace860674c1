//! The protocol of LSL's streams, without a network: what a line reports goes in, events come out.

#![expect(clippy::unwrap_used, reason = "a test stops where it fails")]

use labstream_core::wire::{ByteOrder, Codec, Format, Sample, Value};
use mocapd_drivers::{
    device::{Command, DeviceEvent, Protocol},
    lsl::{LineRequest, LslHost, StreamMessage, put_message},
    uri::StreamQuery,
};
use mocapd_testkit::random::Random;

const SECOND_NS: u64 = 1_000_000_000;

/// What a test looks at.
#[derive(Debug, Clone, PartialEq)]
enum Seen {
    Hello(String, u32),
    Markers(Vec<String>),
    Group(u8, Vec<String>),
    Frame(u32, u64, Vec<Option<[f32; 3]>>),
    Samples(u8, u64, Vec<f32>),
    Mark(u64, String),
    Note(String),
    Pong(u64, u64),
    Started,
    End(u64, u64),
    Other,
}

fn seen(event: DeviceEvent<'_>) -> Seen {
    match event {
        DeviceEvent::Hello(hello) => Seen::Hello(hello.model.clone(), hello.rate_millihertz),
        DeviceEvent::Markers(markers) => {
            Seen::Markers(markers.iter().map(|marker| marker.label.clone()).collect())
        }
        DeviceEvent::SampledGroup(group) => {
            let names = group.channels.iter().map(|channel| channel.name.clone()).collect();
            Seen::Group(group.id, names)
        }
        DeviceEvent::Frame(frame) => {
            let place = |marker: &mocapd_drivers::device::MarkerSample| {
                (!marker.occluded).then_some(marker.position_mm)
            };
            Seen::Frame(frame.seq, frame.device_ticks, frame.markers.iter().map(place).collect())
        }
        DeviceEvent::Samples(batch) => {
            Seen::Samples(batch.group, batch.first, batch.samples.to_vec())
        }
        DeviceEvent::Mark(mark) => Seen::Mark(mark.device_ticks, mark.text.to_owned()),
        DeviceEvent::Note(text) => Seen::Note(text.to_owned()),
        DeviceEvent::Pong(pong) => Seen::Pong(pong.host_ns, pong.device_ticks),
        DeviceEvent::Started(_) => Seen::Started,
        DeviceEvent::EndOfStream(status) => {
            Seen::End(status.frames_produced, status.frames_dropped)
        }
        _ => Seen::Other,
    }
}

fn description(name: &str, fields: &str, channels: &str) -> String {
    format!(
        "<info><name>{name}</name><source_id>id {name}</source_id><hostname>lab</hostname><uid>u</uid>{fields}\
         <desc><channels>{channels}</channels></desc></info>"
    )
}

/// One marker in metres, and a channel beside it.
fn motion() -> String {
    let axis = |axis: &str| {
        format!(
            "<channel><label>A.{axis}</label><marker>A</marker><type>Position{axis}</type><unit>m</unit></channel>"
        )
    };
    let fields = "<type>MoCap</type><channel_count>4</channel_count><channel_format>float32</channel_format>\
                  <nominal_srate>100</nominal_srate>";
    let other = "<channel><label>confidence</label><type>Confidence</type></channel>";
    description("Rig", fields, &(["X", "Y", "Z"].map(axis).concat() + other))
}

fn texts() -> String {
    let fields = "<type>Markers</type><channel_count>1</channel_count><channel_format>string</channel_format>\
                  <nominal_srate>0</nominal_srate>";
    description("Marks", fields, "")
}

/// A host, and the messages that its line would send.
struct Streams {
    host: LslHost,
    seen: Vec<Seen>,
}

impl Streams {
    fn new(descriptions: &[String]) -> Self {
        let names = vec!["Rig".to_owned(), "Marks".to_owned()];
        let host = LslHost::new(StreamQuery { names, ..StreamQuery::default() });
        let mut streams = Self { host, seen: Vec::new() };
        for (stream, xml) in descriptions.iter().enumerate() {
            streams.put(StreamMessage::Description { stream: stream as u8, xml });
        }
        streams.put(StreamMessage::Found);
        streams
    }

    fn push(&mut self, bytes: &[u8]) {
        let seen_so_far = &mut self.seen;
        self.host.push(bytes, &mut |event| seen_so_far.push(seen(event)));
    }

    fn put(&mut self, message: StreamMessage<'_>) {
        let mut bytes = Vec::new();
        put_message(message, &mut bytes);
        self.push(&bytes);
    }

    fn command(&mut self, command: Command) -> Vec<LineRequest> {
        let mut out = Vec::new();
        self.host.command(command, &mut out);
        self.push(&[]);
        LineRequest::all(&out).collect()
    }

    fn start(&mut self, n: u8) {
        assert_eq!(self.command(Command::Start { line_bytes_per_s: 0 }), [LineRequest::Begin]);
        for stream in 0..n {
            self.put(StreamMessage::Feed { stream, is_big_endian: false });
        }
        self.put(StreamMessage::Started);
    }

    /// A sample of the marker, read when it was taken.
    fn sample(&mut self, time_s: f64, values: [f32; 4]) {
        let values = values.map(Value::F32).to_vec();
        self.send(0, Codec::new(Format::Float32, 4, ByteOrder::Little), time_s, values);
    }

    fn text(&mut self, time_s: f64, text: &str) {
        let codec = Codec::new(Format::String, 1, ByteOrder::Little);
        self.send(1, codec, time_s, vec![Value::Str(text.into())]);
    }

    /// A sample of the marker, read at this time.
    fn read_at(&mut self, timestamp: f64, read_ns: u64) {
        let codec = Codec::new(Format::Float32, 4, ByteOrder::Little);
        let sample = Sample { timestamp, values: vec![Value::F32(0.0); 4] };
        let bytes = codec.encode_to_vec(&sample).unwrap();
        self.put(StreamMessage::Data { stream: 0, read_ns, bytes: &bytes });
    }

    fn send(&mut self, stream: u8, codec: Codec, timestamp: f64, values: Vec<Value>) {
        let bytes = codec.encode_to_vec(&Sample { timestamp, values }).unwrap();
        let read_ns = (timestamp * 1e9) as u64;
        self.put(StreamMessage::Data { stream, read_ns, bytes: &bytes });
    }

    fn take(&mut self) -> Vec<Seen> {
        std::mem::take(&mut self.seen)
    }
}

#[test]
fn streams_are_described_as_one_device() {
    let mut streams = Streams::new(&[motion(), texts()]);
    assert_eq!(streams.command(Command::Identify), []);
    assert_eq!(streams.command(Command::Ping { host_ns: 5 }), []);
    let confidence = Seen::Group(0, vec!["confidence".to_owned()]);
    let expected = [
        Seen::Hello("LSL Rig+Marks".to_owned(), 100_000),
        Seen::Markers(vec!["A".to_owned()]),
        confidence,
        Seen::Pong(5, 0),
    ];
    assert_eq!(streams.take(), expected);
    streams.command(Command::SetRate(120_000));
    assert_eq!(streams.take(), [Seen::Other], "the rate is the sender's");
}

#[test]
fn samples_become_frames_samples_and_marks_in_the_order_in_which_they_come() {
    let mut streams = Streams::new(&[motion(), texts()]);
    streams.start(2);
    streams.sample(10.0, [0.1, 0.2, 0.3, 0.9]);
    streams.text(10.005, "go");
    streams.sample(10.01, [f32::NAN, 0.2, 0.3, 0.8]);
    let mm = |metres: f32| (f64::from(metres) * 1000.0) as f32;
    let expected = [
        Seen::Started,
        Seen::Frame(0, 10 * SECOND_NS, vec![Some([mm(0.1), mm(0.2), mm(0.3)])]),
        Seen::Samples(0, 0, vec![0.9]),
        Seen::Mark(10 * SECOND_NS + 5_000_000, "go".to_owned()),
        Seen::Frame(1, 10 * SECOND_NS + 10_000_000, vec![None]),
        Seen::Samples(0, 1, vec![0.8]),
    ];
    assert_eq!(streams.take(), expected);
    assert_eq!(streams.command(Command::Stop), [LineRequest::End]);
    streams.put(StreamMessage::Ended);
    assert_eq!(streams.take(), [Seen::End(2, 0)]);
}

#[test]
fn samples_that_are_missing_are_counted_and_their_numbers_left_out() {
    let mut streams = Streams::new(&[motion()]);
    streams.start(1);
    for number in [0, 1, 2, 5, 6] {
        streams.sample(10.0 + f64::from(number) * 0.01, [0.0; 4]);
    }
    let frames = streams.take().into_iter().filter_map(|seen| match seen {
        Seen::Frame(seq, ..) => Some(seq),
        _ => None,
    });
    assert_eq!(frames.collect::<Vec<_>>(), [0, 1, 2, 5, 6]);
    streams.command(Command::Stop);
    streams.put(StreamMessage::Ended);
    assert_eq!(streams.take(), [Seen::End(7, 2)]);
}

#[test]
fn a_sample_behind_a_gap_waits_for_the_next_or_the_end() {
    let mut streams = Streams::new(&[motion()]);
    streams.start(1);
    streams.sample(10.0, [0.0; 4]);
    streams.sample(10.01, [0.0; 4]);
    streams.take();
    streams.sample(10.05, [0.0; 4]);
    assert_eq!(streams.take(), []);
    streams.command(Command::Stop);
    streams.put(StreamMessage::Ended);
    assert!(matches!(
        streams.take()[..],
        [Seen::Frame(5, ..), Seen::Samples(0, 5, _), Seen::End(6, 3)]
    ));
}

#[test]
fn a_stream_that_is_over_does_not_end_the_others() {
    let mut streams = Streams::new(&[motion(), texts()]);
    streams.start(2);
    streams.text(10.0, "before");
    streams.take();
    streams.put(StreamMessage::Lost { stream: 1 });
    streams.sample(10.0, [0.0; 4]);
    streams.put(StreamMessage::Feed { stream: 1, is_big_endian: false });
    streams.text(12.0, "after");
    let seen = streams.take();
    assert!(matches!(&seen[0], Seen::Note(text) if text.contains("'Marks' is over")), "{seen:?}");
    assert!(matches!(&seen[1..3], [Seen::Frame(0, ..), Seen::Samples(..)]), "{seen:?}");
    assert!(matches!(&seen[3], Seen::Note(text) if text.contains("'Marks' is back")), "{seen:?}");
    assert_eq!(seen[4], Seen::Mark(12 * SECOND_NS, "after".to_owned()));
}

#[test]
fn an_event_that_is_too_long_is_cut_and_a_damaged_stream_of_events_is_given_up() {
    let mut streams = Streams::new(&[motion(), texts()]);
    streams.start(2);
    streams.text(10.0, &"long ".repeat(20_000));
    assert!(matches!(&streams.take()[1], Seen::Mark(_, text) if text.len() == 1024));
    streams.put(StreamMessage::Data { stream: 1, read_ns: 10 * SECOND_NS, bytes: &[77, 1, 2] });
    let seen = streams.take();
    assert!(
        matches!(&seen[..], [Seen::Note(text)] if text.contains("goes on without it")),
        "{seen:?}"
    );
    streams.text(10.1, "not any more");
    streams.sample(10.0, [0.0; 4]);
    assert!(matches!(streams.take()[..], [Seen::Frame(..), Seen::Samples(..)]));
}

/// A reply to a probe: the sender's clock is half a second ahead.
fn reply(at_ns: u64) -> StreamMessage<'static> {
    let sender_s = at_ns as f64 * 1e-9 + 0.5;
    StreamMessage::Time { host_ns: at_ns, sender_s, read_ns: at_ns + 1000 }
}

#[test]
fn replies_to_probes_are_pongs_once_a_frame_has_shown_their_clock() {
    let mut streams = Streams::new(&[motion()]);
    streams.start(1);
    let probe = Command::Ping { host_ns: 9 * SECOND_NS };
    assert_eq!(streams.command(probe), [LineRequest::Probe { host_ns: 9 * SECOND_NS }]);
    streams.take();
    streams.put(reply(9 * SECOND_NS));
    assert_eq!(streams.take(), [], "whose clock it is is not known");
    streams.sample(10.0, [0.0; 4]);
    streams.take();
    streams.put(reply(10 * SECOND_NS));
    let pong = Seen::Pong(10 * SECOND_NS, 10 * SECOND_NS + SECOND_NS / 2);
    assert_eq!(streams.take(), [pong]);
    // A minute and more without a frame, a stamp that is no number, and a backlog: the clock is the same.
    for (time_s, read_s) in [(90.0, 90), (f64::NAN, 91), (92.0, 170), (169.9, 170)] {
        streams.read_at(time_s, read_s * SECOND_NS);
    }
    streams.take();
    streams.put(reply(170 * SECOND_NS));
    assert_eq!(streams.take().len(), 1);
}

#[test]
fn time_stamps_of_another_clock_are_noted_and_end_the_pongs() {
    let mut streams = Streams::new(&[motion()]);
    streams.start(1);
    streams.put(reply(10 * SECOND_NS));
    for number in 0..20_u32 {
        streams.read_at(
            1.7e9 + f64::from(number) * 0.2,
            10 * SECOND_NS + u64::from(number) * SECOND_NS / 5,
        );
    }
    let seen = streams.take();
    let notes: Vec<&Seen> = seen.iter().filter(|seen| matches!(seen, Seen::Note(_))).collect();
    assert!(
        matches!(&notes[..], [Seen::Note(text)] if text.contains("another clock")),
        "{notes:?}"
    );
    assert_eq!(streams.command(Command::Ping { host_ns: 1 }), [], "not asked any more");
    streams.put(reply(20 * SECOND_NS));
    assert_eq!(streams.take(), []);
}

#[test]
fn events_of_another_clock_leave_the_frames_theirs() {
    let mut streams = Streams::new(&[motion(), texts()]);
    streams.start(2);
    streams.put(reply(10 * SECOND_NS));
    streams.sample(10.0, [0.0; 4]);
    let codec = Codec::new(Format::String, 1, ByteOrder::Little);
    let sample = Sample { timestamp: 1.7e9, values: vec![Value::Str(b"go".to_vec())] };
    let bytes = codec.encode_to_vec(&sample).unwrap();
    streams.put(StreamMessage::Data { stream: 1, read_ns: 10 * SECOND_NS, bytes: &bytes });
    let noted = |seen: &Seen| matches!(seen, Seen::Note(text) if text.contains("'Marks'"));
    assert_eq!(streams.take().iter().filter(|seen| noted(seen)).count(), 1);
    streams.put(reply(11 * SECOND_NS));
    assert!(matches!(streams.take()[..], [Seen::Pong(..)]));
}

/// A seed per mutation, so that a failure can be repeated.
const SEED: u64 = 0x6C73_6C00;

#[test]
fn mutated_messages_cause_no_panic_and_frames_have_finite_positions() {
    let mut bytes = Vec::new();
    put_message(StreamMessage::Feed { stream: 0, is_big_endian: false }, &mut bytes);
    put_message(StreamMessage::Feed { stream: 1, is_big_endian: true }, &mut bytes);
    put_message(StreamMessage::Started, &mut bytes);
    let float = Codec::new(Format::Float32, 4, ByteOrder::Little);
    let string = Codec::new(Format::String, 1, ByteOrder::Big);
    for number in 0..12 {
        let timestamp = 10.0 + f64::from(number) * 0.01;
        let sample = Sample { timestamp, values: vec![Value::F32(number as f32); 4] };
        let data = float.encode_to_vec(&sample).unwrap();
        put_message(
            StreamMessage::Data { stream: 0, read_ns: 10 * SECOND_NS, bytes: &data },
            &mut bytes,
        );
        let sample = Sample { timestamp, values: vec![Value::Str(b"text".to_vec())] };
        let data = string.encode_to_vec(&sample).unwrap();
        put_message(
            StreamMessage::Data { stream: 1, read_ns: 10 * SECOND_NS, bytes: &data },
            &mut bytes,
        );
        put_message(StreamMessage::Time { host_ns: 1, sender_s: 10.0, read_ns: 2 }, &mut bytes);
    }
    for case in 0..5_000 {
        let mut random = Random::new(SEED + case);
        let mut mutated = bytes.clone();
        for _ in 0..1 + random.below(4) {
            let at = random.below(mutated.len());
            match random.below(3) {
                0 => mutated.truncate(at.max(1)),
                1 => mutated.insert(at, random.below(256) as u8),
                _ => mutated[at] ^= 1 << random.below(8),
            }
        }
        let mut streams = Streams::new(&[motion(), texts()]);
        streams.command(Command::Start { line_bytes_per_s: 0 });
        for piece in mutated.chunks(1 + random.below(200)) {
            streams.push(piece);
        }
        for seen in streams.take() {
            if let Seen::Frame(_, _, places) = seen {
                let is_finite = |place: &[f32; 3]| place.iter().all(|value| value.is_finite());
                assert!(places.iter().flatten().all(is_finite), "case {case}");
            }
        }
    }
}
