//! Encodes the triggers that announce our takes to other programs.

use super::{StopResult, TEXT_BYTES_MAX, TakeName, Trigger};

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
