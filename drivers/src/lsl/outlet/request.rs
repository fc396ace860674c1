//! What a program asks of a stream when it connects, and the answer.

use labstream_core::{
    net::{Node, StreamInfo},
    proto::{
        header::parse_block,
        negotiate::{Accepted, FeedRequest, LITTLE, Outcome, ServerStream, negotiate},
    },
    wire::{ByteOrder, Codec, Format, TEST_PATTERN_OFFSETS, test_pattern},
};

/// Bytes of a request: its headers have some hundred.
pub(super) const REQUEST_BYTES_MAX: usize = 1 << 14;

/// Bytes of a question for streams: those of liblsl have some hundred.
const QUESTION_BYTES_MAX: usize = 1 << 10;

/// Parentheses, other symbols and spaces of a question outside its texts: those of liblsl have some twenty. The parser and the
/// evaluation call themselves for each, and some thousand would overflow the stack.
const PARENTHESES_MAX: usize = 16;
const SYMBOLS_MAX: usize = 64;

/// How fast we convert the order of bytes, which decides whose order is used: as fast as any, so that a reader with another
/// order gets its own.
const ENDIAN_PERFORMANCE: f64 = 1000.0;

/// How a reader wants its samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FeedForm {
    pub(super) is_big_endian: bool,
    /// Whether the smallest numbers are sent as 0.
    pub(super) suppresses_subnormals: bool,
    /// Samples that may wait, as it wants.
    pub(super) held_max: usize,
}

/// The answer to a request.
#[derive(Debug, PartialEq)]
pub(super) enum Answer {
    /// These bytes, and the end.
    Last(Vec<u8>),
    /// These bytes, and samples.
    Feed(Vec<u8>, FeedForm),
}

/// Answers a request, once all of it is there.
pub(super) fn answer(bytes: &[u8], stream: &Described, has_room: bool) -> Option<Answer> {
    let info = &stream.info;
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    let rest = bytes.get(end + 1..)?;
    let line = String::from_utf8_lossy(bytes.get(..end)?);
    let line = line.trim();
    if line == "LSL:fullinfo" {
        return Some(Answer::Last(info.to_fullinfo_xml().into_bytes()));
    }
    if line == "LSL:shortinfo" {
        let end = rest.iter().position(|byte| *byte == b'\n')?;
        let question = String::from_utf8_lossy(rest.get(..end)?);
        let found = stream.is_meant(question.trim()).then(|| info.to_shortinfo_xml());
        return Some(Answer::Last(found.unwrap_or_default().into_bytes()));
    }
    let Some(feed) = line.strip_prefix("LSL:streamfeed/") else {
        // Also the feed of protocol 1.00, which no liblsl of the last ten years asks for.
        return Some(Answer::Last(Vec::new()));
    };
    let is_complete = rest.starts_with(b"\r\n") || rest.windows(4).any(|four| four == b"\r\n\r\n");
    is_complete.then(|| open_feed(feed, rest, info, has_room))
}

fn open_feed(line: &str, headers: &[u8], info: &StreamInfo, has_room: bool) -> Answer {
    let (version, uid) = line.split_once(' ').unwrap_or((line, ""));
    let (headers, _) = parse_block(headers).unwrap_or_default();
    let mut server = ServerStream::new(&info.uid, info.format, LITTLE, ENDIAN_PERFORMANCE);
    if info.format == Format::String {
        server.channel_bytes = 0;
    }
    let version = version.trim().parse().unwrap_or(0);
    let request = FeedRequest::from_headers(version, uid.trim(), &headers, server.channel_bytes);
    let accepted = match negotiate(&request, &server) {
        Outcome::Refuse(status) => return Answer::Last(status.to_wire().into_bytes()),
        Outcome::Accept(accepted) => accepted,
    };
    if !has_room {
        let refusal = format!("LSL/{} 503 Too many inlets\r\n\r\n", server.configured_version);
        return Answer::Last(refusal.into_bytes());
    }
    let order = accepted.codec_order().filter(|_| accepted.data_protocol_version >= 110);
    // A sample that nobody can read is not begun.
    let Some((order, patterns)) = order.and_then(|order| Some((order, patterns(info, order)?)))
    else {
        return Answer::Last(Vec::new());
    };
    let mut bytes = accepted.to_wire(server.configured_version, &info.uid).into_bytes();
    bytes.extend(patterns);
    match form(&accepted, order) {
        Some(form) => Answer::Feed(bytes, form),
        None => Answer::Last(bytes),
    }
}

/// The form of samples; `None` for a reader that wants none.
fn form(accepted: &Accepted, order: ByteOrder) -> Option<FeedForm> {
    let held_max = usize::try_from(accepted.max_buffer_length).ok().filter(|n| *n > 0)?;
    Some(FeedForm {
        is_big_endian: order == ByteOrder::Big,
        suppresses_subnormals: accepted.suppress_subnormals,
        held_max,
    })
}

/// The two samples with which every feed begins.
fn patterns(info: &StreamInfo, order: ByteOrder) -> Option<Vec<u8>> {
    let n_channels = info.channel_count as usize;
    let codec = Codec::new(info.format, n_channels, order);
    let mut bytes = Vec::new();
    for offset in TEST_PATTERN_OFFSETS {
        codec.encode(&test_pattern(info.format, n_channels, offset), &mut bytes).ok()?;
    }
    Some(bytes)
}

/// A stream, and what its short description states.
#[derive(Debug)]
pub(super) struct Described {
    pub(super) info: StreamInfo,
    short: StreamInfo,
}

impl Described {
    pub(super) fn new(info: StreamInfo) -> Self {
        let mut short = info.clone();
        short.desc = Node::element("desc");
        Self { info, short }
    }

    /// Whether a question means it. It is compared with what the short description states.
    ///
    /// A question with conditions in brackets, `//` or `*` is not answered: a hostile one takes longer with each of them.
    pub(super) fn is_meant(&self, question: &str) -> bool {
        let is_costly = ["[", "//", "*"].iter().any(|part| question.contains(part));
        let is_simple = question.len() <= QUESTION_BYTES_MAX && is_flat(question) && !is_costly;
        is_simple && self.short.matches(question)
    }
}

fn is_flat(question: &str) -> bool {
    let (mut quote, mut n_opened, mut n_symbols) = (None, 0, 0);
    for c in question.chars() {
        match quote {
            Some(end) if c == end => quote = None,
            Some(_) => {}
            None if matches!(c, '\'' | '"') => quote = Some(c),
            None => {
                n_opened += usize::from(c == '(');
                n_symbols += usize::from(!c.is_alphanumeric());
            }
        }
    }
    n_opened <= PARENTHESES_MAX && n_symbols <= SYMBOLS_MAX
}
