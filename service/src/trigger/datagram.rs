//! The datagrams: parses those that come, and encodes the triggers that announce our takes to other programs.

use std::{fmt, time::Duration};

use roxmltree::{Document, Node, ParsingOptions};

use super::{About, Capture, StopResult, Trigger, TriggerError};
use crate::config::{NAME_BYTES_MAX, is_refused_in_name};

/// Largest trigger in bytes: no UDP datagram is larger.
pub const DATAGRAM_BYTES_MAX: usize = 64 << 10;

/// Maximum number of elements, texts and comments: programs send six to ten elements, with white space between them.
const NODES_MAX: u32 = 128;

/// Maximum number of equals signs, one per attribute: XML parsers compare each attribute of an element with the
/// previous ones.
const ATTRIBUTES_MAX: usize = 256;

/// Longest text that is kept, in bytes, such as notes: an event of a take is one line.
pub const TEXT_BYTES_MAX: usize = 1024;

/// Maximum number of other elements that are kept.
const FIELDS_MAX: usize = 16;

/// Longest delay, which also limits `trigger.delay_max`: a larger number cannot be a lead time.
pub const DELAY_MAX: Duration = Duration::from_secs(60);

/// Longest quotation of a value in a message, in characters.
const SHOWN_MAX: usize = 60;

/// Parses a datagram.
///
/// # Errors
/// It is not a trigger, or one of its values is invalid.
pub fn parse(datagram: &[u8]) -> Result<Trigger, TriggerError> {
    if datagram.len() > DATAGRAM_BYTES_MAX {
        return Err(TriggerError::TooLong(datagram.len()));
    }
    let text = text(datagram)?;
    if text.bytes().filter(|byte| *byte == b'=').count() > ATTRIBUTES_MAX {
        return Err(TriggerError::Xml(format!("more than {ATTRIBUTES_MAX} attributes")));
    }
    // Document types are refused, and with them entities that would expand.
    let options =
        ParsingOptions { allow_dtd: false, nodes_limit: NODES_MAX, entity_resolver: None };
    let document = Document::parse_with_options(text, options)
        .map_err(|error| TriggerError::Xml(cut(&error.to_string(), 200)))?;
    let root = document.root_element();
    let element = root.tag_name().name();
    match element {
        "CaptureStart" => Ok(Trigger::Start(Capture { result: None, ..capture(root)? })),
        "CaptureStop" => capture(root).map(Trigger::Stop),
        "CaptureComplete" => capture(root).map(Trigger::Complete),
        _ => Err(TriggerError::Element(cut(element, SHOWN_MAX))),
    }
}

/// Decodes the text, without a final 0 or a byte order mark.
fn text(datagram: &[u8]) -> Result<&str, TriggerError> {
    let text = std::str::from_utf8(datagram).map_err(|error| {
        TriggerError::Encoding(format!("byte {} is not UTF-8", error.valid_up_to()))
    })?;
    let is_space = |c: char| " \t\r\n".contains(c);
    let text = text.trim_end_matches(|c| c == '\0' || is_space(c));
    let text = text.trim_start_matches('\u{feff}').trim_start_matches(is_space);
    if text.contains('\0') {
        return Err(TriggerError::Encoding("a 0 byte within the text".to_owned()));
    }
    let Some(encoding) = declared_encoding(text) else { return Ok(text) };
    let is = |names: &[&str]| names.iter().any(|name| encoding.eq_ignore_ascii_case(name));
    // Their ASCII characters are encoded as in UTF-8.
    let agrees = text.is_ascii() && is(&["iso-8859-1", "windows-1252"]);
    if agrees || is(&["utf-8", "utf8", "us-ascii", "ascii"]) {
        return Ok(text);
    }
    Err(TriggerError::Encoding(format!("declared as {}", cut(encoding, SHOWN_MAX))))
}

/// The encoding in the XML declaration, which the parser does not check.
fn declared_encoding(text: &str) -> Option<&str> {
    let (declaration, _) = text.trim_start().strip_prefix("<?xml")?.split_once("?>")?;
    let (_, rest) = declaration.split_once("encoding")?;
    let rest = rest.trim_start().strip_prefix('=')?.trim_start();
    let quote = rest.chars().next().filter(|c| ['"', '\''].contains(c))?;
    rest[1..].split(quote).next()
}

/// Reads the child elements. If an element is repeated, the first counts, and the others are kept as texts.
fn capture(root: Node<'_, '_>) -> Result<Capture, TriggerError> {
    let (mut name, mut delay, mut about) = (None, None, About::default());
    for node in root.children().filter(Node::is_element) {
        let element = node.tag_name().name();
        let value = attribute(node, "VALUE").unwrap_or_else(|| node.text().unwrap_or_default());
        match element {
            _ if value.trim().is_empty() => {}
            "Name" if name.is_none() => name = Some(take_name(value, &mut about)?),
            "Delay" if delay.is_none() => delay = Some(milliseconds(value)?),
            "PacketID" if about.packet_id.is_none() => about.packet_id = Some(packet_id(value)?),
            _ => keep_field(element, value, &mut about),
        }
    }
    let result = attribute(root, "RESULT").map(|word| match word.trim() {
        "SUCCESS" => StopResult::Success,
        "FAIL" => StopResult::Fail,
        "CANCEL" => StopResult::Cancel,
        other => StopResult::Other(cut(&printable(other), SHOWN_MAX)),
    });
    Ok(Capture { name, result, delay: delay.unwrap_or_default(), about })
}

/// Programs write attributes in capitals; lower case is accepted, too.
fn attribute<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    let mut attributes = node.attributes();
    Some(attributes.find(|found| found.name().eq_ignore_ascii_case(name))?.value())
}

fn take_name(value: &str, about: &mut About) -> Result<TakeName, TriggerError> {
    let sent = cut(&printable(value), SHOWN_MAX);
    let Some(name) = TakeName::of(value) else { return Err(TriggerError::Name(sent)) };
    if name.was_changed() {
        about.changed.push(format!("the name \"{sent}\" was changed to {name}"));
    }
    Ok(name)
}

fn packet_id(value: &str) -> Result<u64, TriggerError> {
    let text = value.trim();
    let is_number = text.bytes().all(|byte| byte.is_ascii_digit());
    let id = text.parse().ok().filter(|_| is_number);
    id.ok_or_else(|| number_error("PacketID", value, "send a whole number"))
}

fn milliseconds(value: &str) -> Result<Duration, TriggerError> {
    let found = value.trim().parse::<f64>().ok();
    let delay = found.filter(|ms| (0.0..=DELAY_MAX.as_millis() as f64).contains(ms));
    let delay = delay.map(|ms| Duration::from_secs_f64(ms / 1000.0));
    delay.ok_or_else(|| number_error("Delay", value, "send milliseconds, 0 to 60000"))
}

fn number_error(what: &'static str, value: &str, wanted: &'static str) -> TriggerError {
    TriggerError::Number { what, found: cut(&printable(value), SHOWN_MAX), wanted }
}

fn keep_field(element: &str, value: &str, about: &mut About) {
    let element = cut(element, SHOWN_MAX);
    if about.fields.len() == FIELDS_MAX {
        let message = format!("more than {FIELDS_MAX} elements, the others were dropped");
        if about.changed.last() != Some(&message) {
            about.changed.push(message);
        }
        return;
    }
    let text = printable(value);
    let kept = cut(&text, TEXT_BYTES_MAX);
    if kept.len() != text.len() {
        about.changed.push(format!("{element} was cut from {} bytes", value.len()));
    }
    about.fields.push((element, kept));
}

/// Makes a text one line without control characters.
fn printable(text: &str) -> String {
    let shown = |c: char| match c {
        '\n' | '\r' | '\t' => ' ',
        c if c.is_control() => char::REPLACEMENT_CHARACTER,
        c => c,
    };
    text.trim().chars().map(shown).collect()
}

/// Shortens a text to a number of bytes, with dots appended.
fn cut(text: &str, bytes_max: usize) -> String {
    if text.len() <= bytes_max {
        return text.to_owned();
    }
    format!("{}...", &text[..text.floor_char_boundary(bytes_max)])
}

/// A take name without `.take`: a file name that is never a path, not hidden, without control characters, of bounded
/// length.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TakeName {
    text: String,
    was_changed: bool,
}

impl TakeName {
    /// Derives a valid name from a text; `None` if nothing of it is usable.
    #[must_use]
    pub fn of(sent: &str) -> Option<Self> {
        let text: String =
            sent.chars().map(|c| if is_refused_in_name(c) { '_' } else { c }).collect();
        let begins = |c: char| c == '.' || c == '-' || c.is_whitespace();
        let text = ended(&text).trim_start_matches(begins);
        let text = ended(text);
        let text = ended(&text[..text.floor_char_boundary(NAME_BYTES_MAX)]).to_owned();
        let is_name = text.chars().any(|c| c != '_');
        is_name.then(|| Self { was_changed: text != sent, text })
    }

    /// The name.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Whether the name differs from the text that was sent.
    #[must_use]
    pub fn was_changed(&self) -> bool {
        self.was_changed
    }
}

/// Removes endings that a name may not have. `.take` is added once later.
fn ended(mut text: &str) -> &str {
    loop {
        let trimmed = text.trim_end_matches(|c: char| c == '.' || c.is_whitespace());
        let at = trimmed.len().saturating_sub(".take".len());
        let shorter = match trimmed.get(at..) {
            Some(ending) if ending.eq_ignore_ascii_case(".take") => &trimmed[..at],
            _ => trimmed,
        };
        if shorter == text {
            return text;
        }
        text = shorter;
    }
}

impl fmt::Display for TakeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// Packet numbers stay below this: some programs accept ten digits at most.
const PACKET_IDS_END: u64 = 10_000_000_000;

/// Packet numbers per second of the day: no program sends more triggers.
const IDS_PER_SECOND: u64 = 100_000;

/// The first packet number. It differs every second of a day, so that a restarted service does not repeat numbers.
#[must_use]
pub fn first_packet_id(unix_seconds: u64) -> u64 {
    unix_seconds % 86_400 * IDS_PER_SECOND + 1
}

/// Makes our datagrams and numbers them.
#[derive(Debug)]
pub struct Announcer {
    rig: String,
    instance_id: u64,
    next_packet_id: u64,
}

impl Announcer {
    /// An announcer for the rig `rig`. `instance_id` is a random number by which the [`Listener`](super::Listener)
    /// recognises our own datagrams.
    #[must_use]
    pub fn new(rig: &str, instance_id: u64, first_packet_id: u64) -> Self {
        let next_packet_id = first_packet_id % PACKET_IDS_END;
        Self { rig: rig.to_owned(), instance_id, next_packet_id }
    }

    /// A take has started.
    #[must_use]
    pub fn start(&mut self, name: &TakeName, notes: &str) -> Vec<u8> {
        self.datagram("CaptureStart", None, name, Some(notes))
    }

    /// A take has stopped.
    #[must_use]
    pub fn stop(&mut self, name: &TakeName, result: &StopResult) -> Vec<u8> {
        self.datagram("CaptureStop", Some(result), name, None)
    }

    /// A take is completely on the disk.
    #[must_use]
    pub fn complete(&mut self, name: &TakeName) -> Vec<u8> {
        self.datagram("CaptureComplete", None, name, None)
    }

    fn datagram(
        &mut self,
        element: &str,
        result: Option<&StopResult>,
        name: &TakeName,
        notes: Option<&str>,
    ) -> Vec<u8> {
        let packet_id = self.next_packet_id;
        self.next_packet_id = (packet_id + 1) % PACKET_IDS_END;
        let result = result.map(|result| format!(" RESULT=\"{}\"", escaped(result.word())));
        let notes = notes.map(|notes| format!("<Notes VALUE=\"{}\"/>", escaped(notes)));
        let [result, notes] = [result, notes].map(Option::unwrap_or_default);
        // The path of our takes is not disclosed, and no delay is needed: the take has already begun.
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"no\"?><{element}{result}>\
             <Name VALUE=\"{}\"/>{notes}<Description VALUE=\"{}\"/><DatabasePath VALUE=\"\"/>\
             <Delay VALUE=\"0\"/><PacketID VALUE=\"{packet_id}\"/></{element}>\0",
            escaped(name.text()),
            escaped(&description(&self.rig, self.instance_id)),
        )
        .into_bytes()
    }
}

/// The description of the sender, with the instance id at its end.
fn description(rig: &str, instance_id: u64) -> String {
    format!("mocapd {rig} {instance_id:016x}")
}

/// Whether a trigger comes from the announcer with this instance id.
pub(super) fn is_from_instance(trigger: &Trigger, instance_id: u64) -> bool {
    let instance_id = format!(" {instance_id:016x}");
    let is_ours = |(what, text): &(String, String)| {
        what == "Description" && text.starts_with("mocapd ") && text.ends_with(&instance_id)
    };
    trigger.capture().about.fields.iter().any(is_ours)
}

/// Escapes a text as an XML attribute of bounded length, and replaces characters that XML does not allow.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\n' | '\r' | '\t' => out.push(' '),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => {
                out.push(char::REPLACEMENT_CHARACTER);
            }
            c => out.push(c),
        }
        if out.len() >= TEXT_BYTES_MAX {
            break;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_kept_and_a_path_is_changed() {
        for name in ["walk_03", "S01 walk 3", "Läufer.2", "歩く"] {
            let kept = TakeName::of(name).unwrap();
            assert_eq!((kept.text(), kept.was_changed()), (name, false));
        }
        for (sent, name) in [
            ("../../etc/passwd", "_.._etc_passwd"),
            ("/etc/passwd", "_etc_passwd"),
            ("C:\\takes\\a", "C__takes_a"),
            (".hidden", "hidden"),
            ("-rf", "rf"),
            ("  a. ", "a"),
            ("a\0b\nc\u{1b}[2J", "a_b_c_[2J"),
            ("ab\u{202e}ekat.", "ab_ekat"),
            ("walk.take", "walk"),
            ("walk.TAKE", "walk"),
            ("walk.take.take", "walk"),
            ("walk.take. .", "walk"),
            ("w\u{fffd}lk", "w_lk"),
        ] {
            let kept = TakeName::of(sent).unwrap();
            assert_eq!((kept.text(), kept.was_changed()), (name, true), "{sent:?}");
        }
        for nothing in ["", ".", "..", "///", " \t ", "-", ".take", "____"] {
            assert_eq!(TakeName::of(nothing), None, "{nothing:?}");
        }
    }

    #[test]
    fn a_name_is_cut_between_letters() {
        let kept = TakeName::of(&"ä".repeat(1000)).unwrap();
        assert_eq!(kept.text(), "ä".repeat(NAME_BYTES_MAX / 2));
        let kept = TakeName::of(&format!("a{}", "ä".repeat(1000))).unwrap();
        assert_eq!(kept.text().len(), NAME_BYTES_MAX - 1);
        // The cut must not leave a dot at the end.
        let kept = TakeName::of(&format!("{}{}x", "a".repeat(190), ".".repeat(20))).unwrap();
        assert_eq!(kept.text(), "a".repeat(190));
        let kept = TakeName::of(&format!("{}.take.x", "a".repeat(195))).unwrap();
        assert_eq!(kept.text(), "a".repeat(195));
    }
}
