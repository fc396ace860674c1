mod document;
mod network;
mod sweep;

use std::net::IpAddr;

use super::*;

const FROM: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(192, 0, 2, 7));

fn start(inside: &str) -> String {
    format!("<CaptureStart>{inside}</CaptureStart>")
}

fn refused(datagram: impl AsRef<[u8]>) -> TriggerError {
    let refusal = parse(datagram.as_ref()).unwrap_err();
    let reason = refusal.to_string();
    assert!(reason.chars().count() < 300 && !reason.contains(char::is_control), "{reason:?}");
    refusal
}

#[test]
fn a_trigger_is_parsed() {
    let text = "\u{feff} <?xml version='1.0' encoding='utf-8'?>\r\n<CaptureStart>\n\
                <Name VALUE=\"walk_03\"/><Notes VALUE=\"two\nlines &lt;&#233;&gt;\"/><Delay VALUE=\" 12.5 \"/>\
                <PacketID VALUE=\"18446744073709551615\"/></CaptureStart>\n\0\0";
    let Trigger::Start(start) = parse(text.as_bytes()).unwrap() else { panic!("no start") };
    assert_eq!(start.name.unwrap().text(), "walk_03");
    assert_eq!(start.delay, Duration::from_micros(12_500));
    assert_eq!(start.about.packet_id, Some(u64::MAX));
    // A line end in an attribute is a space by the rules of XML.
    assert_eq!(start.about.fields, [("Notes".to_owned(), "two lines <é>".to_owned())]);
    assert_eq!(start.about.changed, [""; 0]);

    for (word, result) in [
        ("SUCCESS", StopResult::Success),
        ("FAIL", StopResult::Fail),
        ("CANCEL", StopResult::Cancel),
        ("MAYBE", StopResult::Other("MAYBE".to_owned())),
    ] {
        let text = format!("<CaptureStop RESULT=\"{word}\"/>");
        let Trigger::Stop(stop) = parse(text.as_bytes()).unwrap() else { panic!("no stop") };
        assert_eq!((stop.name, stop.result), (None, Some(result)));
    }
    assert!(matches!(parse(b"<CaptureComplete/>"), Ok(Trigger::Complete(_))));
    assert_eq!(parse(b"<CaptureStart/>"), Ok(Trigger::Start(Capture::default())));
    let latin = "<?xml version='1.0' encoding='ISO-8859-1'?><CaptureStart/>";
    assert!(parse(latin.as_bytes()).is_ok(), "all of it is ASCII");
}

#[test]
fn nothing_is_dropped_silently() {
    let twice = "<Name VALUE='a'/><Name VALUE='b'/><Notes>inside</Notes>";
    let trigger = parse(start(twice).as_bytes()).unwrap();
    let note = trigger.note(FROM);
    assert_eq!(note, "CaptureStart from 192.0.2.7, Name \"b\", Notes \"inside\"");

    let long = start(&format!("<Notes VALUE='{}'/>", "é".repeat(TEXT_BYTES_MAX)));
    let about = parse(long.as_bytes()).unwrap().capture().about.clone();
    let [changed] = &about.changed[..] else { panic!("{:?}", about.changed) };
    assert!(changed.contains("Notes") && changed.contains("2048"), "{changed}");
    assert_eq!(about.fields[0].1, format!("{}...", "é".repeat(TEXT_BYTES_MAX / 2)));

    let many: String = (0..40).map(|n| format!("<A{n} VALUE='x'/>")).collect();
    let about = parse(start(&many).as_bytes()).unwrap().capture().about.clone();
    assert_eq!((about.fields.len(), about.changed.len()), (16, 1));
    assert!(about.changed[0].contains("16"), "{:?}", about.changed);

    let path = parse(start("<DatabasePath VALUE='/etc/&#x85;x'/>").as_bytes()).unwrap();
    assert_eq!(path.capture().name, None);
    assert!(path.note(FROM).ends_with("DatabasePath \"/etc/\u{fffd}x\""), "{}", path.note(FROM));
}

#[test]
fn invalid_triggers_are_refused() {
    let is_no_xml = |datagram: &str| match refused(datagram) {
        TriggerError::Xml(why) => why,
        other => panic!("{other:?}"),
    };
    for datagram in ["", "start", "<CaptureStart>"] {
        is_no_xml(datagram);
    }
    assert_eq!(refused("<CapturePause/>"), TriggerError::Element("CapturePause".to_owned()));
    let long = refused(format!("<{}/>", "x".repeat(60_000)));
    assert!(matches!(&long, TriggerError::Element(name) if name.ends_with("xxx...")), "{long:?}");
    assert_eq!(refused(vec![b' '; DATAGRAM_BYTES_MAX + 1]), TriggerError::TooLong(65_537));
    let encoding = |datagram: &[u8], fact: &str| match refused(datagram) {
        TriggerError::Encoding(why) => assert!(why.contains(fact), "'{fact}' is not in: {why}"),
        other => panic!("{other:?}"),
    };
    encoding(b"<CaptureStart><Name VALUE=\"L\xe4ufer\"/></CaptureStart>", "byte 28");
    encoding(b"\xff\xfe<\0", "byte 0");
    encoding(b"<CaptureStart>\0</CaptureStart>", "0");
    encoding(b"<?xml version='1.0' encoding='UTF-16'?><CaptureStart/>", "UTF-16");
    let latin =
        "<?xml version='1.0' encoding='ISO-8859-1'?><CaptureStart><Name VALUE='é'/></CaptureStart>";
    encoding(latin.as_bytes(), "ISO-8859-1");
    let number = |element: &str, value: &str| {
        let refusal = refused(start(&format!("<{element} VALUE='{value}'/>")));
        assert!(
            matches!(&refusal, TriggerError::Number { what, found, .. } if (*what, found.as_str()) == (element, value)),
            "{refusal:?}"
        );
        refusal.to_string()
    };
    for id in ["-1", "+1", "18446744073709551616"] {
        number("PacketID", id);
    }
    for delay in ["-1", "60001", "nan", "inf", "1e300", "soon"] {
        let reason = number("Delay", delay);
        assert!(reason.contains(&DELAY_MAX.as_millis().to_string()), "{reason}");
    }
    assert_eq!(refused(start("<Name VALUE='...'/>")), TriggerError::Name("...".to_owned()));
    let bomb = "<!DOCTYPE x [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]>\
                <CaptureStart><Name VALUE='&b;'/></CaptureStart>";
    is_no_xml(bomb);
    is_no_xml(&start("<Name VALUE='&b;'/>"));
    let file =
        "<!DOCTYPE x [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><CaptureStart>&a;</CaptureStart>";
    is_no_xml(file);
    is_no_xml(&start(&"<x/>".repeat(200)));
    is_no_xml(&"<a>".repeat(10_000));
    let attributes: String = (0..5000).map(|n| format!(" a{n}='1'")).collect();
    let many = is_no_xml(&format!("<CaptureStart{attributes}/>"));
    assert!(many.contains("256"), "{many}");
}

fn receive(
    listener: &mut Listener,
    text: &str,
    from: &str,
    at_s: u64,
) -> Result<Incoming, TriggerError> {
    let now = Duration::from_secs(at_s);
    listener.receive(from.parse().unwrap(), text.as_bytes(), now, &|name| name == "old")
}

fn packet(id: u64) -> String {
    start(&format!("<PacketID VALUE='{id}'/>"))
}

#[test]
fn repeats_do_nothing() {
    let mut listener = Listener::new(Vec::new(), DELAY_MAX, 1);
    let mut receive =
        |text: &str, from: &str, at_s| receive(&mut listener, text, from, at_s).unwrap();
    assert!(matches!(receive(&packet(5), "10.0.0.1", 0), Incoming::Trigger(_)));
    assert_eq!(receive(&packet(5), "10.0.0.1", 1), Incoming::Repeat);
    // The same address, received over IPv6.
    assert_eq!(receive(&packet(5), "::ffff:10.0.0.1", 1), Incoming::Repeat);
    assert!(matches!(receive(&packet(5), "10.0.0.2", 1), Incoming::Trigger(_)), "another sender's");
    assert!(matches!(receive(&packet(6), "10.0.0.1", 1), Incoming::Trigger(_)), "another number");
    let stop = "<CaptureStop><PacketID VALUE='5'/></CaptureStop>";
    assert!(matches!(receive(stop, "10.0.0.1", 1), Incoming::Trigger(_)), "another element");
    // A minute after it was last received, it is a new trigger.
    assert_eq!(receive(&packet(5), "10.0.0.1", 50), Incoming::Repeat);
    assert_eq!(receive(&packet(5), "10.0.0.1", 110), Incoming::Repeat);
    assert!(matches!(receive(&packet(5), "10.0.0.1", 171), Incoming::Trigger(_)));
    // Without a packet number the bytes decide.
    assert!(matches!(receive("<CaptureStart/>", "10.0.0.1", 171), Incoming::Trigger(_)));
    assert_eq!(receive("<CaptureStart/>", "10.0.0.1", 172), Incoming::Repeat);
    assert!(matches!(receive("<CaptureStart />", "10.0.0.1", 172), Incoming::Trigger(_)));
}

#[test]
fn memory_of_repeats_is_bounded() {
    let mut seen = queue::RecentTriggers::default();
    let mut repeat = |from: u32, id: u64, at_s| {
        let from = IpAddr::V4(from.into());
        let trigger = parse(packet(id).as_bytes()).unwrap();
        let is_repeat = seen.is_repeat(from, &trigger, b"", Duration::from_secs(at_s));
        let (n_senders, n_ids) = seen.sizes();
        assert!(n_senders <= SENDERS_MAX && n_ids <= SENDERS_MAX * IDS_MAX);
        is_repeat
    };
    for id in 0..1000 {
        assert!(!repeat(1, id, 0));
    }
    assert!(repeat(1, 999, 0) && repeat(1, 1000 - IDS_MAX as u64, 0));
    assert!(!repeat(1, 0, 0), "the oldest is forgotten");
    // A flood of senders displaces the one that was silent for longest, and no other.
    assert!(!repeat(2, 1, 1));
    for from in 3..1000 {
        assert!(!repeat(from, 1, 2));
        assert!(repeat(2, 1, 3), "{from}");
    }
    assert!(!repeat(1, 0, 3));
}

#[test]
fn unlisted_senders_are_refused_before_anything_is_parsed() {
    let networks = ["10.0.0.0/24", "fe80::/10"].map(|text| text.parse().unwrap());
    let mut listener = Listener::new(networks.into(), DELAY_MAX, 1);
    for from in ["10.0.0.1", "::ffff:10.0.0.2", "fe80::1"] {
        assert!(receive(&mut listener, &packet(1), from, 0).is_ok(), "{from}");
    }
    let refusal = receive(&mut listener, "garbage", "10.0.1.1", 0).unwrap_err();
    assert_eq!(refusal, TriggerError::NotAllowed("10.0.1.1".parse().unwrap()));
    let reason = refusal.to_string();
    assert!(reason.contains("10.0.1.1") && reason.contains("trigger.allow_from"), "{reason}");
    let mut listener = Listener::new(Vec::new(), DELAY_MAX, 1);
    assert!(receive(&mut listener, &packet(1), "10.0.1.1", 0).is_ok());
}

#[test]
fn an_existing_name_is_refused_and_reported_once() {
    let mut listener = Listener::new(Vec::new(), DELAY_MAX, 1);
    let old = start("<Name VALUE='old'/><PacketID VALUE='1'/>");
    let refusal = receive(&mut listener, &old, "10.0.0.1", 0).unwrap_err();
    assert_eq!(refusal, TriggerError::NameTaken("old".to_owned()));
    assert_eq!(receive(&mut listener, &old, "10.0.0.1", 0), Ok(Incoming::Repeat));
    // The name counts as it would become; and a stop of it is not a start.
    let same = start("<Name VALUE='.old.take'/><PacketID VALUE='2'/>");
    assert!(matches!(
        receive(&mut listener, &same, "10.0.0.1", 0),
        Err(TriggerError::NameTaken(_))
    ));
    let stop = "<CaptureStop><Name VALUE='old'/></CaptureStop>";
    assert!(matches!(receive(&mut listener, stop, "10.0.0.1", 0), Ok(Incoming::Trigger(_))));
}

#[test]
fn our_own_triggers_come_back_and_do_nothing() {
    let mut announcer = Announcer::new("left", 7, 1);
    let name = TakeName::of("new").unwrap();
    let sent = [
        announcer.start(&name, "a \"note\" <&>\u{1}\u{ffff}"),
        announcer.stop(&name, &StopResult::Success),
        announcer.complete(&name),
    ];
    let (mut own, mut others) =
        (Listener::new(Vec::new(), DELAY_MAX, 7), Listener::new(Vec::new(), DELAY_MAX, 8));
    for (datagram, id) in sent.iter().zip(1..) {
        let receive = |listener: &mut Listener| {
            listener.receive(FROM, datagram, Duration::ZERO, &|_| false).unwrap()
        };
        assert_eq!(receive(&mut own), Incoming::Own);
        let Incoming::Trigger(trigger) = receive(&mut others) else { panic!("heard nothing") };
        assert_eq!(trigger.capture().name.as_ref().unwrap().text(), "new");
        assert_eq!(trigger.capture().about.packet_id, Some(id));
        assert_eq!(trigger.capture().about.changed, [""; 0]);
        assert!(
            trigger
                .capture()
                .about
                .fields
                .contains(&("Description".to_owned(), "mocapd left 0000000000000007".to_owned()))
        );
    }
    let text = String::from_utf8(sent[0].clone()).unwrap();
    assert!(text.contains("a &quot;note&quot; &lt;&amp;&gt;\u{fffd}\u{fffd}"), "{text}");
    // The longest trigger fits into one datagram and is accepted.
    let longest = TakeName::of(&"&".repeat(1000)).unwrap();
    let datagram = announcer.start(&longest, &"&".repeat(100_000));
    assert!(datagram.len() < 4096 && parse(&datagram).is_ok(), "{}", datagram.len());
}

#[test]
fn numbers_grow_and_have_ten_digits() {
    assert_eq!(first_packet_id(0), 1);
    assert_eq!(first_packet_id(86_400 + 43_215), 4_321_500_001);
    assert!(first_packet_id(u64::MAX) < 10_000_000_000);
    let name = TakeName::of("a").unwrap();
    let mut announcer = Announcer::new("left", 7, 9_999_999_998);
    let mut id = || parse(&announcer.complete(&name)).unwrap().capture().about.packet_id;
    assert_eq!([id(), id(), id()], [Some(9_999_999_998), Some(9_999_999_999), Some(0)]);
}
