//! Streams: frames, their ends, changes of state, and a QTM that is silent or idle.

use mocapd_drivers::{
    device::{Command, MarkerSample, Protocol},
    qtm::{
        ClientId, ComponentToSend, Event, FrameHeader, MISSING, MarkerComponentKind, PacketKind,
        QtmHost, WireMarker, put_event, put_frame, put_packet, put_text,
    },
    transport::{Transport, TransportError},
};

use crate::pair::{LABELS, MS, Pair, marker};

const LABELLED: MarkerComponentKind = MarkerComponentKind::LabelledWithResiduals;
const UNLABELLED: MarkerComponentKind = MarkerComponentKind::UnlabelledWithResiduals;

fn ids(samples: &[MarkerSample]) -> Vec<u16> {
    samples.iter().map(|sample| sample.id).collect()
}

fn packet(
    header: FrameHeader,
    components: &[(MarkerComponentKind, [u16; 2], &[WireMarker])],
) -> Vec<u8> {
    let components: Vec<_> = components
        .iter()
        .map(|(kind, rates, markers)| ComponentToSend { kind: *kind, rates: *rates, markers })
        .collect();
    let mut bytes = Vec::new();
    put_frame(header, &components, &mut bytes);
    bytes
}

fn header(number: u32) -> FrameHeader {
    FrameHeader { time_us: u64::from(number) * 10_000, number }
}

#[test]
fn frames_arrive_with_labels_ids_and_residuals() {
    for port in [None, Some(5000)] {
        let mut pair = Pair::new(port);
        pair.start();
        let request = match port {
            None => "StreamFrames AllFrames 3DRes 3DNoLabelsRes",
            Some(_) => "StreamFrames AllFrames UDP:5000 3DRes 3DNoLabelsRes",
        };
        assert!(pair.driver.sent.iter().any(|sent| sent == request), "{:?}", pair.driver.sent);
        for number in 0..5 {
            pair.frame(
                number,
                u64::from(number) * 10_000,
                &[77, 99][..usize::from(number != 2) + 1],
            );
            pair.step();
        }
        let frames = &pair.driver.reported.frames;
        assert_eq!(frames.iter().map(|frame| frame.0).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        for (number, (_, ticks, samples)) in frames.iter().enumerate() {
            assert_eq!(*ticks, number as u64 * 10_000);
            let expected =
                if number == 2 { vec![0, 1, 2, 4096] } else { vec![0, 1, 2, 4096, 4097] };
            assert_eq!(ids(samples), expected);
            assert_eq!(samples[0].position_mm, marker(number as u32, 0).position_mm);
            assert_eq!(samples[3].position_mm, marker(number as u32, 77).position_mm);
            assert!(samples.iter().all(|s| s.residual_10um == 25 && !s.occluded));
        }
        assert_eq!(pair.driver.host_counters().messages_damaged, 0);
    }
}

#[test]
fn a_missing_marker_is_occluded_and_an_infinite_one_is_counted() {
    let mut pair = Pair::new(None);
    pair.start();
    let mut markers = [marker(1, 0); 3];
    markers[0].position_mm = [MISSING; 3];
    markers[1].position_mm[2] = f32::INFINITY;
    markers[2].residual_mm = f32::NAN;
    let lost = WireMarker { position_mm: [f32::NAN; 3], ..marker(1, 5) };
    let bytes = packet(header(1), &[(LABELLED, [0; 2], &markers), (UNLABELLED, [0; 2], &[lost])]);
    pair.driver.push(&bytes, false);
    let (_, _, samples) = &pair.driver.reported.frames[0];
    assert_eq!(samples.iter().map(|s| s.occluded).collect::<Vec<_>>(), [true, true, false]);
    assert_eq!(samples[2].residual_10um, 0);
    assert_eq!(pair.driver.host_counters().samples_not_finite, 1);
}

#[test]
fn a_stop_ends_the_stream_behind_its_last_frame() {
    let mut pair = Pair::new(None);
    pair.start();
    (0..10).for_each(|number| pair.frame(number, u64::from(number) * 10_000, &[]));
    pair.driver.command(Command::Stop);
    pair.step();
    pair.frame(10, 100_000, &[]);
    pair.steps(2);
    assert_eq!(pair.driver.reported.frames.len(), 10);
    assert_eq!(pair.driver.reported.ended.unwrap().frames_produced, 10);
    // And again.
    pair.driver.command(Command::Start { line_bytes_per_s: 0 });
    pair.steps(2);
    pair.frame(11, 110_000, &[]);
    pair.step();
    assert_eq!(pair.driver.reported.frames.len(), 11);
}

#[test]
fn a_file_that_is_over_ends_the_stream() {
    for port in [None, Some(5000)] {
        let mut pair = Pair::new(port);
        pair.start();
        pair.frame(0, 0, &[]);
        pair.frame(3, 30_000, &[]);
        pair.server.end_measurement();
        pair.steps(20);
        let reported = &pair.driver.reported;
        assert_eq!(reported.frames.len(), 2);
        assert_eq!(reported.ended.unwrap().frames_produced, 4, "by their numbers");
        assert!(reported.notes.iter().any(|note| note.contains("RT From File Stopped")));
        assert_eq!(pair.driver.lost, None);
    }
}

#[test]
fn datagrams_behind_the_end_still_count() {
    let mut pair = Pair::new(Some(5000));
    pair.start();
    pair.frame(0, 0, &[]);
    pair.step();
    let mut end = Vec::new();
    put_event(Event::RtFromFileStopped, &mut end);
    pair.driver.push(&end, false);
    pair.driver.now_ns += 100 * MS;
    let bytes =
        packet(header(1), &[(LABELLED, [0; 2], &[marker(1, 0); 3]), (UNLABELLED, [0; 2], &[])]);
    pair.driver.push(&bytes, true);
    assert_eq!((pair.driver.reported.frames.len(), pair.driver.reported.ended), (2, None));
    pair.steps(20);
    assert_eq!(pair.driver.reported.ended.unwrap().frames_produced, 2);
}

#[test]
fn a_live_measurement_that_is_over_is_an_outage_with_its_cause() {
    let mut no_more_data = Vec::new();
    put_packet(PacketKind::NoMoreData, &mut no_more_data, |_| {});
    let event = |event| {
        let mut bytes = Vec::new();
        put_event(event, &mut bytes);
        bytes
    };
    for (bytes, cause) in [
        (no_more_data, "no more data"),
        (event(Event::ConnectionClosed), "Connection Closed"),
        (event(Event::ShuttingDown), "shuts down"),
    ] {
        let mut pair = Pair::new(None);
        control(&mut pair, &["TakeControl", "New"]);
        pair.start();
        pair.frame(0, 0, &[]);
        pair.step();
        pair.driver.push(&bytes, false);
        pair.step();
        let lost = pair.driver.lost.unwrap();
        assert!(lost.contains(cause), "{lost}");
        assert_eq!(pair.driver.reported.ended, None);
    }
}

/// Another client changes what the server plays.
fn control(pair: &mut Pair, commands: &[&str]) -> ClientId {
    let master = pair.server.connect("127.0.0.1:41000".parse().unwrap()).unwrap();
    for command in commands {
        let mut bytes = Vec::new();
        put_text(PacketKind::Command, command, &mut bytes);
        pair.server.receive(master, &bytes);
    }
    master
}

#[test]
fn an_idle_qtm_is_not_a_silent_one() {
    // Nothing is open: QTM answers every check.
    let mut idle = Pair::new(None);
    control(&mut idle, &["TakeControl", "Close"]);
    idle.start();
    idle.steps(1000);
    let notes = &idle.driver.reported.notes;
    assert_eq!(notes.iter().filter(|note| note.contains("no measurement is running")).count(), 1);
    assert_eq!((idle.driver.lost, idle.driver.failed), (None, None));
    // Nothing is sent, and nothing answered.
    let mut silent = Pair::new(None);
    silent.start();
    silent.frame(0, 0, &[]);
    silent.step();
    let began_ns = silent.driver.now_ns;
    while silent.driver.lost.is_none() {
        silent.driver.now_ns += 20 * MS;
        silent.driver.push(&[], false);
        silent.driver.written();
        assert!(silent.driver.now_ns < began_ns + 6_000 * MS);
    }
    assert!(silent.driver.lost.unwrap().contains("not answered for"));
    assert_eq!(silent.driver.sent.last().unwrap(), "ByteOrder");
}

#[test]
fn datagrams_that_never_come_are_explained() {
    let mut pair = Pair::new(Some(5000));
    pair.start();
    for _ in 0..200 {
        pair.step();
    }
    let notes = pair.driver.reported.notes.join("\n");
    assert!(notes.contains("firewall") && notes.contains("5000"), "{notes}");
}

#[test]
fn changes_of_state_are_notes_and_bounded() {
    let mut pair = Pair::new(None);
    pair.start();
    for event in [Event::CaptureStarted, Event::Trigger, Event::CaptureStopped] {
        pair.server.send_event(event);
    }
    pair.step();
    let notes = pair.driver.reported.notes.join("\n");
    for text in ["Capture Started", "Trigger", "Capture Stopped"] {
        assert!(notes.contains(text), "{notes}");
    }
    (0..1000).for_each(|_| pair.server.send_event(Event::WaitingForTrigger));
    pair.step();
    assert!(pair.driver.reported.notes.len() <= 64);
}

#[test]
fn the_vendors_account_of_loss_is_kept() {
    let mut pair = Pair::new(None);
    pair.start();
    for (number, rates) in [(0, [0, 0]), (1, [12, 0]), (2, [30, 4]), (3, [0, 0])] {
        let markers = [marker(number, 0); 3];
        let both = [(LABELLED, rates, &markers[..]), (UNLABELLED, rates, &[])];
        pair.driver.push(&packet(header(number), &both), false);
    }
    pair.driver.command(Command::Stop);
    pair.steps(3);
    let notes = pair.driver.reported.notes.join("\n");
    assert!(
        notes.contains("up to 30 per thousand 2D frames lost between cameras and QTM, in 2 frames"),
        "{notes}"
    );
    assert!(
        notes.contains("up to 4 per thousand 2D frames out of step")
            && notes.contains("in 1 frame"),
        "{notes}"
    );
    assert_eq!(pair.driver.reported.ended.unwrap().frames_dropped, 0, "no frames of ours");
}

#[test]
fn a_frame_in_several_datagrams_is_one_frame() {
    let mut pair = Pair::new(Some(5000));
    pair.start();
    let unlabelled = [marker(1, 70)];
    for number in 0..3 {
        let labelled = [marker(number, 0); 3];
        let parts = [
            packet(header(number), &[(LABELLED, [0; 2], &labelled)]),
            packet(header(number), &[(UNLABELLED, [0; 2], &unlabelled)]),
        ];
        // Of the second frame only one half arrives, and of the third the halves change places.
        match number {
            0 => parts.iter().for_each(|part| pair.driver.push(part, true)),
            1 => pair.driver.push(&parts[0], true),
            _ => parts.iter().rev().for_each(|part| pair.driver.push(part, true)),
        }
    }
    assert_eq!(pair.driver.reported.frames.len(), 1, "the other half may still come");
    pair.driver.now_ns += 20 * MS;
    pair.driver.push(&[], false);
    let frames = &pair.driver.reported.frames;
    assert_eq!(frames.iter().map(|frame| frame.0).collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!(ids(&frames[0].2), [0, 1, 2, 4096]);
    assert_eq!(ids(&frames[1].2), [0, 1, 2]);
    assert_eq!(ids(&frames[2].2), [4096, 0, 1, 2]);
    // A half that stays alone is a frame as soon as nothing follows.
    let labelled = [marker(9, 0); 3];
    pair.driver.push(&packet(header(9), &[(LABELLED, [0; 2], &labelled)]), true);
    // A stranger's datagram, or nothing, does not hurry it.
    pair.driver.push(&[], false);
    assert_eq!(pair.driver.reported.frames.len(), 3);
    pair.driver.now_ns += 20 * MS;
    pair.driver.push(&[], false);
    assert_eq!(pair.driver.reported.frames.len(), 4);
    pair.driver.command(Command::Stop);
    pair.steps(20);
    let notes = pair.driver.reported.notes.join("\n");
    assert!(notes.contains("2 frames are incomplete"), "{notes}");
}

#[test]
fn datagrams_of_two_frames_that_change_places_are_two_whole_frames() {
    // Number and half of each datagram; numbers and markers of the frames.
    type Case<'a> = (&'a [(u32, usize)], &'a [(u32, usize)]);
    let cases: [Case<'_>; 4] = [
        (&[(1, 0), (2, 0), (1, 1), (2, 1), (3, 0), (3, 1)], &[(1, 4), (2, 4), (3, 4)]),
        (&[(1, 0), (2, 1), (2, 0), (1, 1), (3, 0), (3, 1)], &[(1, 4), (2, 4), (3, 4)]),
        // The other half is lost: the frame waits for it until a third one begins.
        (&[(1, 0), (2, 0), (2, 1), (3, 0), (3, 1)], &[(1, 3), (2, 4), (3, 4)]),
        (&[(1, 0), (2, 0), (3, 0), (2, 1), (3, 1)], &[(1, 3), (2, 4), (3, 4)]),
    ];
    for (datagrams, expected) in cases {
        let mut pair = Pair::new(Some(5000));
        pair.start();
        for (number, half) in datagrams {
            let both = [
                (LABELLED, [0; 2], &[marker(*number, 0); 3][..]),
                (UNLABELLED, [0; 2], &[marker(1, 70)]),
            ];
            pair.driver.push(&packet(header(*number), &both[*half..=*half]), true);
        }
        let found = pair.driver.reported.frames.iter().map(|frame| (frame.0, frame.2.len()));
        assert_eq!(found.collect::<Vec<_>>(), expected, "{datagrams:?}");
    }
}

#[test]
fn datagrams_in_the_middle_of_the_stream_do_not_disturb_it() {
    let mut pair = Pair::new(Some(5000));
    pair.start();
    let mut event = Vec::new();
    put_event(Event::CaptureStarted, &mut event);
    let labelled = [marker(1, 0); 3];
    let datagram = packet(header(1), &[(LABELLED, [0; 2], &labelled), (UNLABELLED, [0; 2], &[])]);
    pair.driver.push(&event[..5], false);
    pair.driver.push(&datagram, true);
    pair.driver.push(&datagram[..30], true);
    pair.driver.push(&event[5..], false);
    assert_eq!(pair.driver.reported.frames.len(), 1);
    assert!(pair.driver.reported.notes.iter().any(|note| note.contains("Capture Started")));
    assert_eq!(pair.driver.host_counters().messages_damaged, 1);
}

#[test]
fn frames_with_another_number_of_labels_wait_for_the_new_list() {
    let mut pair = Pair::new(None);
    pair.start();
    let four = [0, 1, 2, 3].map(|k| WireMarker { position_mm: [k as f32; 3], ..marker(1, 0) });
    for number in 1..3 {
        let both = [(LABELLED, [0; 2], &four[..]), (UNLABELLED, [0; 2], &[])];
        pair.driver.push(&packet(header(number), &both), false);
    }
    assert_eq!(pair.driver.reported.frames.len(), 0, "they wait for their labels");
    let asked = pair.driver.written();
    let n = pair.driver.sent.iter().filter(|sent| *sent == "GetParameters 3D").count();
    assert_eq!(n, 2, "{asked:?}");
    let mut xml = "<Q><The_3D><Labels>4</Labels>".to_owned();
    for label in ["new", LABELS[2], LABELS[1], LABELS[0]] {
        let label = label.replace('&', "&amp;").replace('<', "&lt;");
        xml.push_str(&format!("<Label><Name>{label}</Name></Label>"));
    }
    xml.push_str("</The_3D></Q>");
    let mut bytes = Vec::new();
    put_text(PacketKind::Xml, &xml, &mut bytes);
    pair.driver.push(&bytes, false);
    let both = [(LABELLED, [0; 2], &four[..]), (UNLABELLED, [0; 2], &[])];
    pair.driver.push(&packet(header(3), &both), false);
    let frames = &pair.driver.reported.frames;
    assert_eq!(frames.iter().map(|frame| frame.0).collect::<Vec<_>>(), [1, 2, 3]);
    assert!(frames.iter().all(|frame| ids(&frame.2) == [3, 2, 1, 0]), "a label keeps its channel");
    assert_eq!(pair.driver.reported.markers[0].label, "new");
}

#[test]
fn an_identify_during_the_stream_stops_it_and_it_can_be_started_again() {
    let mut pair = Pair::new(None);
    pair.start();
    pair.frame(0, 0, &[]);
    pair.step();
    pair.driver.reported.hello = None;
    pair.driver.command(Command::Identify);
    pair.frame(1, 10_000, &[]);
    pair.steps(20);
    assert!(pair.driver.reported.hello.is_some());
    pair.frame(2, 20_000, &[]);
    pair.step();
    assert_eq!(pair.driver.reported.frames.len(), 1);
    pair.driver.command(Command::Start { line_bytes_per_s: 0 });
    pair.steps(2);
    pair.frame(3, 30_000, &[]);
    pair.step();
    assert_eq!(pair.driver.reported.frames.len(), 2);
}

#[test]
fn labels_that_qtm_does_not_state_cost_no_frame_and_few_requests() {
    let mut pair = Pair::new(None);
    pair.start();
    let four = [marker(1, 0); 4];
    let mut refusal = Vec::new();
    put_text(PacketKind::Error, "Parameters not available", &mut refusal);
    for number in 0..300 {
        let both = [(LABELLED, [0; 2], &four[..]), (UNLABELLED, [0; 2], &[])];
        pair.driver.push(&packet(header(number), &both), false);
        if !pair.driver.written().is_empty() {
            pair.driver.push(&refusal, false);
        }
        pair.driver.now_ns += 10 * MS;
    }
    assert_eq!((pair.driver.reported.frames.len(), &pair.driver.failed), (300, &None));
    let n = pair.driver.sent.iter().filter(|sent| *sent == "GetParameters 3D").count();
    assert!((3..6).contains(&n), "{n}: one for the start, and one a second");
    assert!(
        pair.driver.reported.notes.iter().any(|note| note.contains("Parameters not available"))
    );
}

#[test]
fn a_request_for_frames_that_is_refused_is_an_error() {
    let mut pair = Pair::new(None);
    pair.driver.command(Command::Identify);
    pair.steps(30);
    pair.driver.command(Command::Start { line_bytes_per_s: 0 });
    pair.driver.push(&[], false);
    let mut refusal = Vec::new();
    put_text(PacketKind::Error, "Parse error", &mut refusal);
    pair.driver.push(&refusal, false);
    pair.driver.written();
    assert!(pair.driver.failed.unwrap().contains("does not send frames (Parse error)"));
}

#[test]
fn a_qtm_that_has_closed_its_measurement_when_it_is_asked_again_is_waited_for() {
    let mut pair = Pair::new(None);
    pair.start();
    pair.frame(0, 0, &[]);
    pair.step();
    pair.driver.command(Command::Identify);
    // Stop and ByteOrder are answered; the settings are gone.
    pair.driver.written();
    let mut bytes = Vec::new();
    put_text(PacketKind::Command, "Byte order is little endian", &mut bytes);
    put_event(Event::ConnectionClosed, &mut bytes);
    put_text(PacketKind::Error, "Parameters not available", &mut bytes);
    pair.driver.push(&bytes, false);
    pair.driver.written();
    assert_eq!(pair.driver.failed, None);
    assert!(pair.driver.lost.unwrap().contains("no measurement"));
}

#[test]
fn labels_that_arrive_when_the_driver_asks_again_are_not_taken_for_a_byte_order() {
    let mut pair = Pair::new(None);
    pair.start();
    let both = [(LABELLED, [0; 2], &[marker(1, 0); 4][..]), (UNLABELLED, [0; 2], &[])];
    pair.driver.push(&packet(header(1), &both), false);
    pair.driver.command(Command::Identify);
    let xml = "<Q><The_3D><Labels>1</Labels><Label><Name>big toe</Name></Label></The_3D></Q>";
    let mut bytes = Vec::new();
    put_text(PacketKind::Xml, xml, &mut bytes);
    pair.driver.push(&bytes, false);
    pair.steps(20);
    assert_eq!((pair.driver.failed, pair.driver.lost), (None, None));
    assert!(pair.driver.reported.hello.is_some());
}

#[test]
fn frames_whose_labels_never_come_are_recorded_as_unlabelled_markers() {
    let mut pair = Pair::new(None);
    pair.start();
    let four = [0, 1, 2, 3].map(|k| WireMarker { position_mm: [k as f32; 3], ..marker(1, 0) });
    for number in 0..100 {
        let both = [(LABELLED, [0; 2], &four[..]), (UNLABELLED, [0; 2], &[])];
        pair.driver.push(&packet(header(number), &both), false);
    }
    let frames = &pair.driver.reported.frames;
    assert_eq!(frames.len(), 100);
    assert!(frames.iter().all(|frame| ids(&frame.2) == [4096, 4097, 4098, 4099]));
}

#[test]
fn a_part_that_comes_twice_or_is_damaged_costs_no_other() {
    let mut pair = Pair::new(Some(5000));
    pair.start();
    let labelled = [marker(1, 0); 3];
    let unlabelled = [marker(1, 70)];
    let first = packet(header(1), &[(LABELLED, [0; 2], &labelled)]);
    let second = packet(header(1), &[(UNLABELLED, [0; 2], &unlabelled)]);
    let mut damaged = first.clone();
    damaged[24] ^= 1;
    for part in [&first, &first, &damaged, &second] {
        pair.driver.push(part, true);
    }
    let frames = &pair.driver.reported.frames;
    assert_eq!(frames.len(), 1);
    assert_eq!(ids(&frames[0].2), [0, 1, 2, 4096]);
    // By TCP two components of one sort in a packet are damage.
    let mut pair = Pair::new(None);
    pair.start();
    let twice = packet(header(1), &[(LABELLED, [0; 2], &labelled), (LABELLED, [0; 2], &labelled)]);
    pair.driver.push(&twice, false);
    assert_eq!(pair.driver.host_counters().messages_damaged, 1);
    assert_eq!(pair.driver.reported.frames.len(), 0);
}

#[test]
fn a_datagram_is_no_reply_and_no_event() {
    let mut pair = Pair::new(Some(5000));
    pair.start();
    let text = |kind, text: &str| {
        let mut bytes = Vec::new();
        put_text(kind, text, &mut bytes);
        bytes
    };
    let mut event = Vec::new();
    put_event(Event::ShuttingDown, &mut event);
    pair.driver.command(Command::Stop);
    for forged in [
        text(PacketKind::Error, "Parse error"),
        text(PacketKind::Command, "Byte order is little endian"),
        text(PacketKind::Xml, "<Q/>"),
        event,
    ] {
        pair.driver.push(&forged, true);
    }
    assert_eq!((&pair.driver.lost, &pair.driver.failed), (&None, &None));
    assert_eq!(pair.driver.reported.ended, None);
    assert_eq!(pair.driver.host_counters().messages_unknown, 4);
}

#[test]
fn the_reply_to_an_earlier_check_does_not_end_the_stream() {
    let mut pair = Pair::new(None);
    pair.start();
    pair.frame(0, 0, &[]);
    pair.step();
    // A silence of 2 s, and a check that is answered late.
    pair.driver.now_ns += 2_100 * MS;
    pair.driver.push(&[], false);
    assert_eq!(pair.driver.sent.last().unwrap(), "ByteOrder");
    pair.driver.command(Command::Stop);
    let mut bytes = Vec::new();
    put_text(PacketKind::Command, "Byte order is little endian", &mut bytes);
    pair.driver.push(&bytes, false);
    assert_eq!(pair.driver.reported.ended, None);
    let both = [(LABELLED, [0; 2], &[marker(1, 0); 3][..]), (UNLABELLED, [0; 2], &[])];
    pair.driver.push(&packet(header(1), &both), false);
    pair.driver.push(&bytes, false);
    assert_eq!(pair.driver.reported.frames.len(), 2);
    assert_eq!(pair.driver.reported.ended.unwrap().frames_produced, 2);
}

#[test]
fn a_packet_that_never_completes_is_silence() {
    let mut pair = Pair::new(None);
    pair.start();
    pair.driver.push(&[0, 0, 16, 0, 3, 0, 0, 0], false);
    let began_ns = pair.driver.now_ns;
    while pair.driver.lost.is_none() {
        pair.driver.now_ns += 500 * MS;
        pair.driver.push(&[0], false);
        pair.driver.written();
        assert!(pair.driver.now_ns < began_ns + 8_000 * MS);
    }
}

#[test]
fn a_file_that_is_over_ends_the_stream_whatever_happened_before() {
    let mut pair = Pair::new(None);
    pair.driver.command(Command::Identify);
    // While it is set up, and when it is ready, the state changes.
    for event in [Event::RtFromFileStarted, Event::CameraSettingsChanged, Event::Trigger] {
        pair.steps(3);
        pair.server.send_event(event);
    }
    pair.steps(30);
    pair.driver.command(Command::Start { line_bytes_per_s: 0 });
    pair.steps(3);
    pair.driver.push(&packet(header(1), &[(LABELLED, [0; 2], &[marker(1, 0); 3])]), false);
    let mut end = Vec::new();
    put_packet(PacketKind::NoMoreData, &mut end, |_| {});
    pair.driver.push(&end, false);
    pair.steps(3);
    assert!(pair.driver.reported.ended.is_some());
}

/// A line from which one read returns these bytes.
#[derive(Debug)]
struct OneRead(Vec<u8>);

impl Transport for OneRead {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, TransportError> {
        let bytes = std::mem::take(&mut self.0);
        buf[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn write_all(&mut self, _: &[u8]) -> Result<(), TransportError> {
        Ok(())
    }
}

#[test]
fn a_measurement_that_is_gone_after_a_reconnect_is_waited_for_too() {
    let mut pair = Pair::new(None);
    pair.start();
    let mut replies = Vec::new();
    for text in [
        "QTM RT Interface connected",
        "Version set to 1.28",
        "QTM Version is 1",
        "Byte order is little endian",
    ] {
        put_text(PacketKind::Command, text, &mut replies);
    }
    put_event(Event::ConnectionClosed, &mut replies);
    put_text(PacketKind::Error, "Parameters not available", &mut replies);
    let reconnect = |host: &mut QtmHost| {
        let mut line = host.attach(Box::new(OneRead(replies.clone())));
        host.command(Command::Identify, &mut Vec::new());
        let mut buf = [0; 4096];
        loop {
            match line.read(&mut buf) {
                Ok(n) => host.push(&buf[..n], &mut |_| {}),
                Err(error) => return error,
            }
        }
    };
    // Nothing came yet: trying again is of no use.
    let error = reconnect(&mut pair.driver.host);
    assert!(matches!(&error, TransportError::Refused(text) if text.contains("no measurement")));
    let mut pair = Pair::new(None);
    pair.start();
    pair.frame(0, 0, &[]);
    pair.step();
    let error = reconnect(&mut pair.driver.host);
    assert!(error.is_gone(), "{error}");
}
