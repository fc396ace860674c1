//! Takes for a player: the overview, windows of frames and gaps.

use std::{
    fs,
    io::{self, Cursor, Read, Seek, SeekFrom},
    sync::{Arc, atomic::AtomicU64},
    time::Duration,
};

use mocapd_acquire::pipeline::offline;
use mocapd_service::{
    http::HttpOptions,
    playback::{
        FrameWindow, GapBins, TakeOverview, WINDOW_BYTES_MAX, WindowRequest, map_of_end,
        map_of_ends, read_gaps,
    },
    viewer::TakeViewer,
};
use mocapd_take::{
    TakeMap, import,
    motion::{Motion, MotionEvent, Position, is_gap},
    record::{EventKind, Subject},
};

use serde_json::json;

use super::{
    client::{Answer, ask, exchange, get, post, request},
    local, serve,
};
use crate::{
    cli::subjects::skeleton,
    support::{assert_mentions, config, crowd, dense, jump, record, rows},
};

/// A served take, recorded from a jump of three seconds of which some frames are lost.
fn with_gaps() -> (super::Served, Vec<u8>) {
    let served = serve();
    let motion = jump(4, 120.0, 3.0);
    let wanted = (0..motion.n_frames()).filter(|row| !(100..117).contains(row));
    let (_, take, _) = record(&motion, &config(&motion, dense(0.5)), wanted);
    add(&served, "gaps", &take);
    (served, take)
}

fn add(served: &super::Served, name: &str, take: &[u8]) {
    fs::write(served.folder.path().join(format!("takes/{name}.take")), take).unwrap();
}

/// Header words and positions of a window.
#[derive(Debug)]
struct Window {
    n_markers: usize,
    first: u64,
    every: u32,
    flags: u32,
    frames: Vec<Vec<Position>>,
}

fn parse(answer: &Answer) -> Window {
    let body = &answer.body;
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(body));
    assert_eq!(answer.header("content-type"), Some("application/octet-stream"));
    assert!(body.len() as u64 <= WINDOW_BYTES_MAX, "{} bytes", body.len());
    assert_eq!(&body[..4], b"MPW1");
    let word = |at: usize| u32::from_le_bytes(body[at..at + 4].try_into().unwrap());
    let n_markers = word(4) as usize;
    let floats: Vec<f32> = body[32..]
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()))
        .collect();
    let positions: Vec<Position> =
        floats.chunks_exact(3).map(|three| three.try_into().unwrap()).collect();
    assert_eq!(positions.len(), word(16) as usize * n_markers);
    assert_eq!(word(28), 0);
    Window {
        n_markers,
        first: u64::from_le_bytes(body[8..16].try_into().unwrap()),
        every: word(20),
        flags: word(24),
        frames: positions.chunks(n_markers).map(<[Position]>::to_vec).collect(),
    }
}

fn is_same(a: &[Position], b: &[Position]) -> bool {
    let bits = |row: &[Position]| {
        row.iter()
            .map(|at| if is_gap(*at) { None } else { Some(at.map(f32::to_bits)) })
            .collect::<Vec<_>>()
    };
    bits(a) == bits(b)
}

#[test]
fn a_window_has_the_decoded_positions_bit_by_bit() {
    let (served, take) = with_gaps();
    let (decoded, _) = rows(&take);
    for (query, first, every, n) in [
        ("", 0, 1, 360),
        ("?from=0&seconds=1", 0, 1, 120),
        ("?from=1.5&seconds=0.25", 180, 1, 30),
        ("?from=0.8&seconds=0.3&every=7", 96, 7, 6),
        ("?from=2.9&seconds=100", 348, 1, 12),
        ("?seconds=1e-9", 0, 1, 1),
        ("?from=2.991&seconds=1e-9", 359, 1, 1),
        ("?every=10000", 0, 10_000, 1),
        ("?from=0.016666666666666666&seconds=0.008333333333333333", 2, 1, 1),
        ("?from=0.058333333333333334&seconds=0.016666666666666666", 7, 1, 2),
    ] {
        let window = parse(&get(served.at, &format!("/v1/takes/gaps/window{query}")));
        assert_eq!((window.first, window.every, window.flags), (first, every, 0), "{query}");
        assert_eq!((window.n_markers, window.frames.len()), (decoded[0].len(), n), "{query}");
        for (i, frame) in window.frames.iter().enumerate() {
            let row = first as usize + i * every as usize;
            assert!(is_same(frame, &decoded[row]), "{query}, row {row}");
        }
    }
    let lost = parse(&get(served.at, "/v1/takes/gaps/window?from=0.875&seconds=0.02"));
    assert!(lost.frames.iter().flatten().all(|at| is_gap(*at)), "a lost frame is all gaps");
}

#[test]
fn a_window_that_does_not_fit_ends_earlier_and_says_so() {
    let served = serve();
    let motion = crowd(1, 240.0, 3.0);
    let n_frames = motion.n_frames();
    let (_, take, _) = record(&motion, &config(&motion, dense(0.5)), 0..n_frames);
    add(&served, "crowd", &take);
    let window = parse(&get(served.at, "/v1/takes/crowd/window?seconds=3600"));
    let overview = get(served.at, "/v1/takes/crowd/overview").json();
    assert_eq!(window.flags, 1);
    assert_eq!(overview["window_frames_max"], window.frames.len());
    assert!(window.frames.len() < n_frames, "{}", window.frames.len());
    // The next window begins where this one ends.
    let from = window.frames.len() as f64 / 240.0;
    let next = parse(&get(served.at, &format!("/v1/takes/crowd/window?from={from}&seconds=0.1")));
    assert_eq!((next.first, next.flags), (window.frames.len() as u64, 0));
    let thinned = parse(&get(served.at, "/v1/takes/crowd/window?seconds=3600&every=2"));
    assert_eq!((thinned.flags, thinned.frames.len()), (0, n_frames / 2));
}

#[test]
fn the_overview_describes_the_take() {
    let (served, take) = with_gaps();
    let overview = get(served.at, "/v1/takes/gaps/overview").json();
    let (decoded, _) = rows(&take);
    for (field, value) in [
        ("name", json!("gaps")),
        ("frames", json!(360)),
        ("rate_hz", json!(120.0)),
        ("seconds", json!(3.0)),
        ("markers", json!(decoded[0].len())),
        ("tolerance_mm", json!(0.5)),
        ("frames_lost", json!(17)),
        ("problems_total", json!(0)),
    ] {
        assert_eq!(overview[field], value, "{field} of {overview}");
    }
    assert_eq!(overview["labels"].as_array().unwrap().len(), decoded[0].len());
    assert!(!overview["bones"].as_array().unwrap().is_empty());
    let missing = decoded.iter().enumerate().filter(|(row, _)| !(100..117).contains(row));
    let missing = missing.flat_map(|(_, row)| row).filter(|at| is_gap(**at)).count();
    assert_eq!(overview["samples_missing"], missing);
}

#[test]
fn the_ends_of_a_take_state_all_of_its_overview_but_events_and_problems() {
    let served = serve();
    let mut motion = jump(4, 120.0, 3.0);
    let mut subject = Subject { name: "S01".to_owned(), documents: Vec::new() };
    subject.set(Subject::SKELETON, skeleton(&motion).into_bytes());
    motion.info.subject = Some(subject);
    motion.info.events =
        vec![MotionEvent { frame: 200, kind: EventKind::Mark, text: "heel".to_owned() }];
    let take = imported(&motion);
    let overview = |name: &str, query: &str| -> TakeOverview {
        let path = format!("/v1/takes/{name}/overview{query}");
        serde_json::from_value(get(served.at, &path).json()).unwrap()
    };
    add(&served, "whole", &take);
    let ends = overview("whole", "?ends_only=true");
    let complete = overview("whole", "?ends_only=false");
    assert!(!ends.is_complete && ends.events.is_empty() && ends.limbs.len() > 5, "{ends:?}");
    assert_eq!((complete.events.len(), complete.events_total), (1, 1));
    let stated = TakeOverview {
        events: Vec::new(),
        events_total: 0,
        is_complete: false,
        ..complete.clone()
    };
    assert_eq!(ends, stated);
    // What is known need not be read again.
    assert_eq!(overview("whole", "?ends_only=true"), complete);
    assert_eq!(overview("whole", ""), complete);
    for query in ["ends_only=1", "ends_only=", "ends_only=true&ends_only=true"] {
        get(served.at, &format!("/v1/takes/whole/overview?{query}")).refused(400, "invalid");
    }

    // A take whose ends do not state enough is read completely at once.
    let mut beginning = take.clone();
    beginning[12] ^= 0x21;
    for (name, bytes) in [("cut", &take[..take.len() - 40]), ("beginning", &beginning[..])] {
        add(&served, name, bytes);
        let ends = get(served.at, &format!("/v1/takes/{name}/overview?ends_only=true"));
        let whole = get(served.at, &format!("/v1/takes/{name}/overview"));
        assert_eq!((ends.status, &ends.body), (whole.status, &whole.body), "{name}");
    }
    assert!(overview("cut", "?ends_only=true").problems_total > 0);
}

#[test]
fn gaps_are_those_of_the_decoded_frames_whole_and_in_parts() {
    let (served, take) = with_gaps();
    let (decoded, _) = rows(&take);
    let bins: GapBins =
        serde_json::from_value(get(served.at, "/v1/takes/gaps/gaps").json()).unwrap();
    assert_eq!((bins.first_frame, bins.end_frame, bins.bin_frames), (0, 360, 1));
    for (row, frame) in decoded.iter().enumerate() {
        let is_lost = (100..117).contains(&row);
        let missing = if is_lost { 0 } else { frame.iter().filter(|at| is_gap(**at)).count() };
        assert_eq!(bins.missing_samples[row], missing as u64, "row {row}");
        assert_eq!(bins.lost_frames[row], u64::from(is_lost), "row {row}");
    }
    let rest: GapBins =
        serde_json::from_value(get(served.at, "/v1/takes/gaps/gaps?from=1.25").json()).unwrap();
    assert_eq!((rest.first_frame, rest.first_bin), (150, 150));
    assert_eq!(rest.missing_samples, bins.missing_samples[150..]);
    let end: GapBins =
        serde_json::from_value(get(served.at, "/v1/takes/gaps/gaps?from=1e9").json()).unwrap();
    assert_eq!((end.first_frame, end.end_frame, end.missing_samples.len()), (360, 360, 0));
}

#[test]
fn hostile_queries_are_refused() {
    let (served, _) = with_gaps();
    for query in [
        "from=-1",
        "from=NaN",
        "from=inf",
        "from=1e10",
        "from=1e308",
        "from=",
        "from=x",
        "from=1&from=2",
        "seconds=0",
        "seconds=-1",
        "seconds=NaN",
        "seconds=3601",
        "seconds=1e999",
        "every=0",
        "every=-1",
        "every=10001",
        "every=1.5",
        "every=99999999999999999999",
    ] {
        get(served.at, &format!("/v1/takes/gaps/window?{query}")).refused(400, "invalid");
    }
    for query in ["from=-1", "from=NaN", "from=x", "from=1&from=1"] {
        get(served.at, &format!("/v1/takes/gaps/gaps?{query}")).refused(400, "invalid");
    }
    let behind = get(served.at, "/v1/takes/gaps/window?from=3").refused(416, "range");
    assert_mentions(&behind, &["3.000 s"]);
    get(served.at, "/v1/takes/gaps/window?from=1e9").refused(416, "range");
    post(served.at, "/v1/takes/gaps/window", "{}").refused(405, "method_not_allowed");
    for what in ["overview", "window", "gaps"] {
        for name in ["none", "..", "../x", "..%2fx", "%00", ".hidden", &"x".repeat(300)] {
            let asked = request("GET", &format!("/v1/takes/{name}/{what}"), &[], "");
            Answer::parse(&exchange(served.at, &asked)).refused(404, "not_found");
        }
        get(served.at, &format!("/v1/takes/%ff/{what}")).refused(400, "invalid");
    }
}

#[test]
fn a_take_that_is_being_written_is_not_played() {
    let served = serve();
    post(served.at, "/v1/start", r#"{"name": "live"}"#);
    for what in ["overview", "window", "gaps"] {
        let refused = get(served.at, &format!("/v1/takes/live/{what}")).refused(409, "conflict");
        assert_mentions(&refused, &["live", "stop it first"]);
    }
    post(served.at, "/v1/stop", "{}");
    assert_eq!(get(served.at, "/v1/takes/live/window").status, 200);
}

#[test]
fn what_can_be_read_of_a_damaged_take_is_played() {
    let served = serve();
    let motion = jump(2, 120.0, 30.0);
    let n_frames = motion.n_frames();
    let (_, mut take, _) = record(&motion, &config(&motion, dense(0.5)), 0..n_frames);
    let (whole, _) = rows(&take);
    let cut = take[..take.len() * 2 / 3].to_vec();
    let middle = take.len() / 2;
    take[middle..middle + 8].fill(0x55);
    add(&served, "hurt", &take);
    add(&served, "cut", &cut);
    add(&served, "noise", b"no take at all");
    let (decoded, problems) = rows(&take);
    assert!(!problems.is_empty());
    let mut flags = 0;
    let mut row = 0;
    while row < decoded.len() {
        let query = format!("from={}&seconds=2", row as f64 / 120.0);
        let window = parse(&get(served.at, &format!("/v1/takes/hurt/window?{query}")));
        assert_eq!(window.first, row as u64);
        for frame in &window.frames {
            // A gap where it cannot be read, and nothing wrong anywhere.
            let is_empty = frame.iter().all(|at| is_gap(*at));
            assert!(is_empty || is_same(frame, &whole[row]), "row {row}");
            assert!(!is_empty || is_same(frame, &decoded[row]) || window.flags == 2, "row {row}");
            row += 1;
        }
        flags |= window.flags;
    }
    assert_eq!(flags, 2, "a window says that it is damaged");
    let bins: GapBins =
        serde_json::from_value(get(served.at, "/v1/takes/hurt/gaps").json()).unwrap();
    assert!(bins.is_damaged && bins.lost_frames.iter().sum::<u64>() > 0, "{bins:?}");

    let overview = get(served.at, "/v1/takes/cut/overview").json();
    let problems = overview["problems"].to_string();
    assert!(problems.contains("cut off"), "{problems}");
    let window = parse(&get(served.at, "/v1/takes/cut/window?from=5&seconds=1"));
    assert!(window.frames.iter().zip(&whole[600..]).all(|(a, b)| is_same(a, b)));
    for what in ["overview", "window", "gaps"] {
        let refused = get(served.at, &format!("/v1/takes/noise/{what}")).refused(409, "conflict");
        assert_mentions(&refused, &["noise", "mocapd verify"]);
    }
}

/// Counts the bytes that are read.
struct Counted {
    input: Cursor<Vec<u8>>,
    read: u64,
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.input.read(buffer)?;
        self.read += n as u64;
        Ok(n)
    }
}

impl Seek for Counted {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.input.seek(to)
    }
}

fn imported(motion: &Motion) -> Vec<u8> {
    let header = import::header_of(&motion.info, &dense(0.5), "test", "long.c3d".to_owned());
    offline::write_take(motion, &header, 2, &AtomicU64::new(0), Vec::new()).unwrap().1
}

/// A jump that is repeated to so many seconds, imported.
fn long(seconds: usize) -> Vec<u8> {
    let Motion { mut info, positions_mm } = jump(1, 120.0, 5.0);
    let n_repeats = seconds / 5;
    info.n_frames *= n_repeats as u64;
    let positions_mm = positions_mm.repeat(n_repeats);
    imported(&Motion { info, positions_mm })
}

#[test]
fn the_ends_of_a_long_take_are_as_few_bytes_as_those_of_a_short_one() {
    for seconds in [15, 900] {
        let take = long(seconds);
        let n_bytes = take.len() as u64;
        let mut input = Counted { input: Cursor::new(take), read: 0 };
        assert!(map_of_ends(&mut input).unwrap().is_some());
        // Two pieces of a buffered file, and the index.
        assert!(input.read < 40 << 10, "{} of {n_bytes} bytes", input.read);
        assert!(seconds < 900 || input.read * 8 < n_bytes, "{} of {n_bytes} bytes", input.read);
    }
}

#[test]
fn a_window_anywhere_in_a_long_take_is_read_from_its_key_stretch() {
    let take = long(900);
    let n_bytes = take.len() as u64;
    for from_s in [0.0, 300.0, 600.0, 890.0] {
        let mut input = Counted { input: Cursor::new(take.clone()), read: 0 };
        let request = WindowRequest { from_s, length_s: 2.0, every: 1 };
        let map = map_of_end(&mut input).unwrap().unwrap();
        FrameWindow::read(&mut input, &map, &request).unwrap();
        assert!(input.read * 8 < n_bytes, "{} of {n_bytes} bytes at {from_s} s", input.read);
    }
    let map = TakeMap::open(&mut Cursor::new(&take)).unwrap();
    let overview = TakeOverview::of("long", &map);
    assert_eq!(overview.frames, 108_000);
    let mut parts = 0;
    let mut frame = 0;
    while frame < overview.frames {
        let from = frame as f64 / overview.rate_hz;
        let bins = read_gaps(&mut Cursor::new(&take), &map, from).unwrap();
        assert_eq!(bins.first_frame, frame);
        assert!(bins.missing_samples.len() <= 1025 && bins.end_frame > frame);
        frame = bins.end_frame;
        parts += 1;
    }
    assert!((2..10).contains(&parts), "{parts}");
}

#[test]
fn a_viewer_serves_the_player_to_everybody_and_takes_to_those_with_its_token() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.take");
    fs::write(&path, super::take()).unwrap();
    let mut viewer = TakeViewer::default();
    viewer.add("x", path);
    let token = TakeViewer::token().unwrap();
    let options = HttpOptions { token: Some(token.clone()), is_viewer: true, ..local() };
    let server = mocapd_service::http::HttpServer::start(options, Arc::new(viewer)).unwrap();
    let at = server.tcp_address().unwrap();
    let page = get(at, "/");
    assert_eq!(page.status, 200);
    assert!(String::from_utf8(page.body).unwrap().contains("player_page.js"));
    assert_eq!(get(at, "/player.js").status, 200);
    ask(at, "GET", "/", &[("host", "evil.example")], "").refused(421, "forbidden");
    for path in ["/v1/takes", "/v1/takes/x/window", "/v1/status", "/metrics", "/openapi.json"] {
        get(at, path).refused(401, "unauthorized");
    }
    for wrong in [&token[..63], "", "x"] {
        let sent = format!("Bearer {wrong}");
        ask(at, "GET", "/v1/takes", &[("authorization", &sent)], "").refused(401, "unauthorized");
    }
    let sent = format!("Bearer {token}");
    let with = |method: &str, path: &str| ask(at, method, path, &[("authorization", &sent)], "{}");
    let takes = with("GET", "/v1/takes").json();
    assert_eq!((&takes[0]["name"], &takes[0]["health"]), (&json!("x"), &json!("complete")));
    assert_eq!(parse(&with("GET", "/v1/takes/x/window")).frames.len(), 120);
    let refused = with("POST", "/v1/start").refused(409, "conflict");
    assert_mentions(&refused, &["no device"]);
    server.stop(Duration::from_secs(5)).unwrap();
}
