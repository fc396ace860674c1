//! The examples of docs/triggers.md, byte for byte.

use super::*;

const PAGE: &str = include_str!("../../../../docs/triggers.md");

/// The code blocks of a kind, such as ```` ```xml heard ````.
fn blocks(kind: &str) -> Vec<&'static str> {
    let fence = format!("```{kind}\n");
    PAGE.split(fence.as_str()).skip(1).filter_map(|rest| rest.split("\n```").next()).collect()
}

#[test]
fn examples_of_received_triggers() {
    let (heard, notes) = (blocks("xml heard"), blocks("text note"));
    assert_eq!((heard.len(), notes.len()), (3, 3));
    for (text, note) in heard.iter().zip(notes) {
        assert_eq!(parse(text.as_bytes()).unwrap().note(FROM), note);
        assert_eq!(parse(format!("{text}\0").as_bytes()).unwrap().note(FROM), note);
    }
}

#[test]
fn examples_of_sent_triggers() {
    let mut announcer = Announcer::new("left", 0x0123_4567_89ab_cdef, first_packet_id(43_215));
    let name = TakeName::of("walk_03").unwrap();
    let sent = [
        announcer.start(&name, "barefoot & tired"),
        announcer.stop(&name, &StopResult::Success),
        announcer.complete(&name),
    ];
    let shown: Vec<&str> = blocks("xml sent").into_iter().flat_map(str::lines).collect();
    assert_eq!(shown.len(), sent.len());
    for (shown, sent) in shown.iter().zip(sent) {
        assert_eq!(String::from_utf8(sent).unwrap(), format!("{shown}\0"));
    }
}

#[test]
fn the_limits_are_those_of_the_code() {
    for message in [
        format!("at most {} KiB", DATAGRAM_BYTES_MAX >> 10),
        format!("0 to {}", DELAY_MAX.as_millis()),
        format!("| {DELAYED_MAX} in all | {DUE_MAX} in all |"),
        format!(
            "| 1 of each sender, {DELAYED_OTHERS_MAX} in all | {DUE_EACH_MAX} of each sender, {DUE_MAX} in all |"
        ),
        format!("with {TEXT_BYTES_MAX} bytes each"),
        format!("the last {IDS_MAX} numbers of each sender, for the last {SENDERS_MAX} senders"),
        format!("cut after {} bytes", crate::config::NAME_BYTES_MAX),
    ] {
        assert!(PAGE.contains(&message), "docs/triggers.md does not say '{message}'");
    }
    assert_eq!(REMEMBERED, Duration::from_secs(60), "the page says a minute");
}
