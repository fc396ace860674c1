//! The answers of the simulated system, byte by byte, and its log.

use mocapd_take::motion::{GAP, Marker, MotionInfo};

use super::*;

const MS: u64 = 1_000_000;

/// Two markers, three frames at 100 Hz; the second marker is hidden in the second frame.
fn motion() -> Motion {
    let marker = |label: &str| Marker { label: label.to_owned(), labelled: true };
    let markers = vec![marker("tool"), marker("stray")];
    let info = MotionInfo { rate_hz: 100.0, n_frames: 3, markers, ..MotionInfo::default() };
    let stray = [4.0, 5.0, -6.0];
    let positions_mm =
        vec![[1.0, 2.0, -3.0], stray, [1.5, 2.0, -3.0], GAP, [12_345.0, 2.0, -3.0], stray];
    Motion { info, positions_mm }
}

fn system(settings: NdiSettings) -> NdiDevice {
    NdiDevice::new(motion(), NdiSettings { tools: vec!["tool".to_owned()], ..settings }).unwrap()
}

/// Sends a request, with its checksum appended, and returns the answer.
fn ask(device: &mut NdiDevice, text: &str, now_ns: u64) -> Vec<u8> {
    let crc = mocapd_drivers::ndi::crc16(text.as_bytes());
    let wire = if text.contains(':') { format!("{text}{crc:04X}\r") } else { format!("{text}\r") };
    send(device, wire.as_bytes(), now_ns)
}

fn send(device: &mut NdiDevice, bytes: &[u8], now_ns: u64) -> Vec<u8> {
    device.poll(now_ns);
    device.on_bytes(bytes, now_ns);
    let answer = device.pending().to_vec();
    device.sent(answer.len());
    answer
}

/// Sends a request and returns the text of the answer, without its checksum.
fn asked(device: &mut NdiDevice, text: &str, now_ns: u64) -> String {
    let answer = String::from_utf8(ask(device, text, now_ns)).unwrap();
    let (text, digits) = answer.trim_end().split_at(answer.len() - 5);
    assert_eq!(digits, format!("{:04X}", mocapd_drivers::ndi::crc16(text.as_bytes())));
    text.to_owned()
}

fn tracking(device: &mut NdiDevice, now_ns: u64) {
    for text in ["INIT:", "PINIT:01", "PENA:01D", "TSTART:"] {
        assert_eq!(asked(device, text, now_ns), "OKAY", "{text}");
    }
}

#[test]
fn fixed_answers() {
    let mut device = system(NdiSettings::default());
    assert_eq!(send(&mut device, b"INIT:E3A5\r", 0), b"OKAYA896\r");
    device.on_break(0);
    assert_eq!(device.pending(), b"RESETBE6F\r");
    device.sent(10);
    assert_eq!(asked(&mut device, "PHSR:00", 0), "ERROR10", "a break undoes INIT");
    assert_eq!(send(&mut device, b"INIT:E3A6\r", 0), b"ERROR046802\r");
}

#[test]
fn a_new_speed_applies_after_the_answer() {
    let mut device = system(NdiSettings { baud_max: 921_600, ..NdiSettings::default() });
    ask(&mut device, "INIT:", 0);
    device.on_bytes(b"COMM:60000000C\r", 0);
    assert_eq!(device.baud(), Some(9_600));
    device.sent(8);
    assert_eq!(device.baud(), Some(9_600), "a byte is left");
    device.sent(1);
    assert_eq!(device.baud(), Some(921_600));
    assert_eq!(asked(&mut device, "COMM:70000", 0), "ERROR06", "more than it may");
    assert_eq!(asked(&mut device, "COMM:60200", 0), "ERROR06", "even parity");
    assert_eq!(asked(&mut device, "COMM:6000", 0), "ERROR07");
    ask(&mut device, "RESET:0", 0);
    assert_eq!(device.baud(), Some(9_600));
}

#[test]
fn handles_go_through_their_states() {
    let mut device = system(NdiSettings::default());
    ask(&mut device, "INIT:", 0);
    let mut step = |text: &str, answer: &str| {
        assert_eq!(asked(&mut device, text, 0), answer, "{text}");
    };
    step("PHSR:00", "0101001");
    step("PENA:01D", "ERROR0E");
    step("PHRQ:*********1****", "0A");
    step("PINIT:0A", "ERROR0D");
    let page = format!("PVWR:0A0000{}", "4e".repeat(64));
    step(&page, "OKAY");
    step(&page.replace("0000", "0400"), "ERROR23");
    step("PINIT:0A", "OKAY");
    step("PINIT:01", "OKAY");
    step("PHSR:02", "00");
    step("PHSR:03", "02010110A011");
    step("PENA:0Ad", "ERROR09");
    step("PENA:0AD", "OKAY");
    step("PHSR:04", "010A031");
    step("PDIS:0A", "OKAY");
    step("PHF:0A", "OKAY");
    step("PHF:0A", "ERROR2B");
    step("PHSR:00", "0101011");
    for _ in 0..32 {
        assert_ne!(asked(&mut device, "PHRQ:*********1****", 0), "ERROR2D");
    }
    assert_eq!(asked(&mut device, "PHRQ:*********1****", 0), "ERROR2D", "handles are bounded");
    ask(&mut device, "INIT:", 0);
    assert_eq!(asked(&mut device, "PHSR:00", 0), "0101001", "INIT frees what was loaded");
}

#[test]
fn tx_and_bx_of_the_same_frames() {
    let mut device = system(NdiSettings::default());
    tracking(&mut device, 0);
    let tool = "0101+10000+00000+00000+00000+000100+000200-000300+025000000003100000000\n";
    assert_eq!(asked(&mut device, "TX:1001", 0), format!("{tool}010+000400+000500-0006000000"));
    let bx = ask(&mut device, "BX:1001", 0);
    assert_eq!(bx[..4], [0xC4, 0xA5, 1 + 42 + 1 + 1 + 12 + 2, 0]);
    assert_eq!(bx[6..9], [1, 1, 1]);
    // In the second frame the stray is hidden; the third is too far away for the text's digits.
    assert!(asked(&mut device, "TX:1001", 10 * MS).ends_with("00000001\n000000"));
    let far = asked(&mut device, "TX:0001", 20 * MS);
    assert_eq!(far, "0101MISSING0000003100000002\n0000");
    let log = device.log();
    assert_eq!((log.total.frames_produced, log.frames_sent, log.total.frames_dropped), (3, 3, 0));
}

#[test]
fn bx2_reports_each_frame_once() {
    let mut device = system(NdiSettings::default());
    tracking(&mut device, 0);
    let first = ask(&mut device, "BX2 --6d=tools --3d=strays", 0);
    // Container, frame, item, container, 6D with a tool, 3D with a stray, and around it.
    assert_eq!(first.len(), 8 + 4 + 12 + 16 + 4 + 12 + 36 + 12 + 4 + 16);
    assert_eq!(ask(&mut device, "BX2 --6d=tools --3d=strays", 5 * MS)[6..10], [1, 0, 0, 0]);
    assert_eq!(ask(&mut device, "BX2", 10 * MS).len(), first.len() - 32);
    assert_eq!(asked(&mut device, "BX2 --6d=everything", 10 * MS), "ERROR07");
    let mut old = system(NdiSettings { bx2: false, ..NdiSettings::default() });
    tracking(&mut old, 0);
    assert_eq!(asked(&mut old, "BX2", 0), "ERROR01");
}

#[test]
fn unfetched_frames_are_dropped_and_the_end_is_reported() {
    let mut device = system(NdiSettings::default());
    device.keep_frame_log();
    tracking(&mut device, 0);
    ask(&mut device, "BX:1001", 0);
    assert!(!device.has_ended());
    // The second frame is gone; the last one stays available until it is fetched.
    let last = ask(&mut device, "BX:1001", 40 * MS);
    assert_eq!(last[..2], [0xC4, 0xA5]);
    assert_eq!(asked(&mut device, "BX:1001", 41 * MS), "ERROR0C", "it left tracking by itself");
    assert!(device.has_ended());
    let frames = device.take_frames();
    let fates: Vec<_> = frames.iter().map(|f| (f.seq, f.present, f.dropped)).collect();
    assert_eq!(fates, [(0, 2, false), (1, 1, true), (2, 2, false)]);
    let log = device.log();
    assert_eq!((log.run.frames_dropped, log.run.samples, log.ends), (1, 4, 1));
    assert_eq!((log.run.frames_unasked, log.frames_waiting, log.frames_sent), (0, 0, 2));
    // Again, with the frame counter set back.
    assert_eq!(asked(&mut device, "TSTART:80", 50 * MS), "OKAY");
    assert!(!device.has_ended());
    assert!(asked(&mut device, "TX:0001", 50 * MS).contains("00000000\n"));
    assert_eq!(asked(&mut device, "TSTOP:", 51 * MS), "OKAY");
    assert!(device.has_ended());
}

#[test]
fn frames_after_the_last_request_count_as_unasked() {
    let mut device = system(NdiSettings { looping: true, ..NdiSettings::default() });
    device.keep_frame_log();
    tracking(&mut device, 0);
    device.poll(500 * MS);
    assert_eq!(device.log().total.frames_produced, 0, "it begins with the first request");
    let adds_up = |device: &NdiDevice| {
        let log = device.log();
        let left = log.frames_sent + log.frames_waiting + log.frames_discarded;
        let account = left + log.total.frames_dropped + log.total.frames_unasked;
        assert_eq!(account, log.total.frames_produced, "{log:?}");
        log
    };
    for at_ms in [500, 510, 545, 549] {
        ask(&mut device, "BX:1001", at_ms * MS);
        adds_up(&device);
    }
    device.poll(585 * MS);
    assert_eq!(adds_up(&device).frames_waiting, 4, "a request may come after them");
    assert_eq!(asked(&mut device, "TSTOP:", 590 * MS), "OKAY");
    let log = adds_up(&device);
    assert_eq!(
        (log.run.frames_produced, log.run.frames_dropped, log.run.frames_unasked),
        (10, 2, 5)
    );
    let frames = device.take_frames();
    let fates: Vec<_> = frames.iter().map(|f| (f.dropped, f.unasked)).collect();
    let (fetched, dropped, unasked) = ((false, false), (true, false), (false, true));
    let mut expected = vec![fetched, fetched, dropped, dropped, fetched];
    expected.resize(10, unasked);
    assert_eq!(fates, expected);
    assert!(frames.is_sorted_by(|a, b| b.seq == a.seq + 1));
}

#[test]
fn the_last_frame_is_not_kept_for_ever_and_missed_ones_are_bounded() {
    let mut device = system(NdiSettings::default());
    tracking(&mut device, 0);
    ask(&mut device, "BX:1001", 0);
    device.poll(1_029 * MS);
    assert!(device.is_running());
    device.poll(1_030 * MS);
    let log = device.log();
    assert!(!device.is_running());
    assert_eq!((log.run.frames_dropped, log.run.frames_unasked), (0, 2));
    let mut device = system(NdiSettings { looping: true, ..NdiSettings::default() });
    tracking(&mut device, 0);
    ask(&mut device, "BX:1001", 0);
    device.poll(60_000 * MS);
    let log = device.log();
    assert_eq!((log.run.frames_produced, log.run.frames_dropped), (6001, 4096));
    assert_eq!(log.frames_waiting, 6001 - 4096 - 1);
}

#[test]
fn unsuitable_motions_and_settings_are_refused() {
    let with = |tools: &[&str]| NdiSettings {
        tools: tools.iter().map(|label| (*label).to_owned()).collect(),
        ..NdiSettings::default()
    };
    let refused = |motion, settings| NdiDevice::new(motion, settings).unwrap_err();
    let no_wand =
        |known: &str| NdiError::NoSuchTool { label: "wand".to_owned(), known: known.to_owned() };
    assert_eq!(refused(motion(), with(&["wand"])), no_wand("tool, stray"));
    let marker = |index: usize| Marker { label: format!("m{index}"), labelled: index > 0 };
    let mut many = motion();
    many.info.markers = (0..21).map(marker).collect();
    many.positions_mm = vec![GAP; 63];
    let error = refused(many, with(&["wand"]));
    let NdiError::NoSuchTool { known, .. } = &error else { panic!("{error:?}") };
    assert!(known.starts_with("m1, m2, m3, m4, m5, m6, m7, m8") && known.contains("12"), "{known}");
    let too_many = NdiError::TooManyTools { found: 33 };
    assert_eq!(refused(motion(), with(&["tool"; 33])), too_many);
    assert!(too_many.to_string().contains("32"), "{too_many}");
    let slow = NdiSettings { rate_hz: Some(0.5), ..NdiSettings::default() };
    assert_eq!(refused(motion(), slow), DeviceError::Rate { found_hz: 0.5 }.into());
    let marker = |_| Marker { label: String::new(), labelled: false };
    let mut crowd = motion();
    crowd.info.markers = (0..256).map(marker).collect();
    crowd.positions_mm = vec![GAP; 256];
    let error = refused(crowd, NdiSettings::default());
    assert_eq!(error, NdiError::TooManyStrays { found: 256 });
}

#[test]
fn labels_become_part_numbers() {
    let mut motion = motion();
    motion.info.markers[0].label = "Handgelenk links außen, oben".to_owned();
    let tools = vec![motion.info.markers[0].label.clone()];
    let mut device =
        NdiDevice::new(motion, NdiSettings { tools, ..NdiSettings::default() }).unwrap();
    assert_eq!(device.warnings().len(), 1);
    ask(&mut device, "INIT:", 0);
    assert!(asked(&mut device, "PHINF:010004", 0).starts_with("Handgelenk links au_"));
}
