//! Listing, downloading and verifying takes, and no other file of the disk.

use std::{
    fs,
    io::{Read, Write},
    os::unix::fs::symlink,
};

use mocapd_take::{interchange::Format, motion::is_gap};

use super::{
    client::{Answer, ask, connect, exchange, get, post, request},
    serve,
};
use crate::support::{assert_mentions, config, crowd, dense, record};

fn with_take(name: &str) -> super::Served {
    let served = serve();
    post(served.at, "/v1/start", &format!(r#"{{"name": "{name}"}}"#));
    assert_eq!(post(served.at, "/v1/stop", "{}").status, 200);
    served
}

#[test]
fn takes_are_listed_within_their_limit() {
    let served = with_take("a");
    post(served.at, "/v1/save-last", r#"{"name": "b", "seconds": 1}"#);
    let names = |path: &str| {
        let list = get(served.at, path).json();
        let names = list.as_array().unwrap().iter();
        names.map(|take| take["name"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(names("/v1/takes"), ["b", "a"]);
    assert_eq!(names("/v1/takes?limit=1"), ["b"]);
    for limit in ["0", "1001", "-1", "x", "", "1e3"] {
        get(served.at, &format!("/v1/takes?limit={limit}")).refused(400, "invalid");
    }
}

#[test]
fn a_take_is_downloaded_completely_and_by_range() {
    let served = with_take("jump");
    let path = "/v1/takes/jump/download";
    let file = fs::read(served.folder.path().join("takes/jump.take")).unwrap();
    let whole = get(served.at, path);
    assert_eq!((whole.status, &whole.body), (200, &file));
    assert_eq!(whole.header("content-length"), Some(file.len().to_string().as_str()));
    assert_eq!(whole.header("accept-ranges"), Some("bytes"));
    assert!(whole.header("content-disposition").unwrap().contains("filename=\"jump.take\""));
    let tag = whole.header("etag").unwrap();

    let ranged = |range: &str, more: &[(&str, &str)]| {
        ask(served.at, "GET", path, &[&[("range", range)], more].concat(), "")
    };
    let part = ranged("bytes=10-19", &[]);
    assert_eq!((part.status, &part.body[..]), (206, &file[10..20]));
    let range = format!("bytes 10-19/{}", file.len());
    assert_eq!(part.header("content-range"), Some(range.as_str()));
    assert_eq!(ranged("bytes=-4", &[]).body, file[file.len() - 4..]);
    assert_eq!(ranged("bytes=5-", &[("if-range", tag)]).body, file[5..]);
    assert_eq!(ranged("bytes=5-", &[("if-range", "\"other\"")]).body, file);
    assert_eq!(ranged("bytes=0-1,4-5", &[]).status, 200, "several ranges are not supported");
    let behind = ranged("bytes=99999999-", &[]);
    behind.refused(416, "range");
    assert_eq!(behind.header("content-range"), Some(format!("bytes */{}", file.len()).as_str()));
    assert_eq!(ask(served.at, "GET", path, &[("if-none-match", tag)], "").status, 304);
    let head = ask(served.at, "HEAD", path, &[], "");
    assert_eq!((head.status, head.body.len()), (200, 0));
    assert_eq!(head.header("content-length"), Some(file.len().to_string().as_str()));
}

#[test]
fn a_download_of_a_growing_take_has_what_is_durable() {
    let served = serve();
    post(served.at, "/v1/start", r#"{"name": "live"}"#);
    let path = served.folder.path().join("takes/live.take");
    let durable = fs::read(&path).unwrap();
    // Preallocated space after the data.
    fs::OpenOptions::new().append(true).open(&path).unwrap().write_all(&[0; 1000]).unwrap();
    let growing = get(served.at, "/v1/takes/live/download");
    assert_eq!((growing.status, &growing.body), (200, &durable));
    assert_eq!(growing.header("etag"), None, "the file is still growing");
    post(served.at, "/v1/takes/live/verify", "{}").refused(409, "conflict");
    post(served.at, "/v1/stop", "{}");
    let rest = format!("bytes={}-", durable.len());
    let rest = ask(served.at, "GET", "/v1/takes/live/download", &[("range", &rest)], "");
    assert_eq!([durable, rest.body].concat(), fs::read(&path).unwrap());
}

#[test]
fn verification_reports_what_is_wrong() {
    let served = with_take("jump");
    let check = |name: &str| post(served.at, &format!("/v1/takes/{name}/verify"), "{}").json();
    let good = check("jump");
    assert_eq!((&good["health"], &good["frames"]), (&"complete".into(), &120.into()), "{good}");
    assert_eq!(good["ledger"]["closes"], true);
    let file = |name: &str| served.folder.path().join(format!("takes/{name}.take"));
    let mut bytes = fs::read(file("jump")).unwrap();
    fs::write(file("cut"), &bytes[..bytes.len() - 200]).unwrap();
    assert_eq!(check("cut")["health"], "cut off");
    let middle = bytes.len() / 2;
    bytes[middle..middle + 8].fill(0x55);
    fs::write(file("hurt"), &bytes).unwrap();
    let hurt = check("hurt");
    assert_eq!(hurt["health"], "damaged");
    assert!(!hurt["problems"].as_array().unwrap().is_empty());
    fs::write(file("noise"), "no take at all").unwrap();
    assert_eq!(check("noise")["health"], "unreadable");
    post(served.at, "/v1/takes/none/verify", "{}").refused(404, "not_found");
    get(served.at, "/v1/takes/jump/verify").refused(405, "method_not_allowed");
    ask(served.at, "POST", "/v1/takes/jump/verify", &[("content-type", "")], "")
        .refused(415, "unsupported_media_type");
}

#[test]
fn no_other_file_can_be_downloaded() {
    let served = with_take("jump");
    let takes = served.folder.path().join("takes");
    fs::write(served.folder.path().join("secret.take"), "secret").unwrap();
    symlink("../secret.take", takes.join("link.take")).unwrap();
    symlink("/etc", takes.join("folder")).unwrap();
    fs::create_dir(takes.join("dir.take")).unwrap();
    let fifo = std::process::Command::new("mkfifo").arg(takes.join("pipe.take")).status();
    assert!(fifo.unwrap().success());
    for name in [
        "..",
        ".",
        "../secret",
        "..%2fsecret",
        "%2e%2e%2fsecret",
        "%2e%2e/secret",
        "%252e%252e%252fsecret",
        "..%5csecret",
        "jump%00",
        "%00",
        "%2fetc%2fpasswd",
        "/etc/passwd",
        "%0ajump",
        "folder%2fpasswd",
        "link",
        "dir",
        "pipe",
        ".hidden",
        "",
        "jump.take",
        "JUMP",
        &"x".repeat(300),
    ] {
        let asked = request("GET", &format!("/v1/takes/{name}/download"), &[], "");
        Answer::parse(&exchange(served.at, &asked)).refused(404, "not_found");
        let asked = request("POST", &format!("/v1/takes/{name}/verify"), &[], "{}");
        let checked = Answer::parse(&exchange(served.at, &asked));
        assert_eq!(checked.status, 404, "{name}");
    }
    get(served.at, "/v1/takes/%ff/download").refused(400, "invalid");
    for path in ["/../Cargo.toml", "/%2e%2e/Cargo.toml", "/index.html/..", "//etc/passwd", "/web"] {
        get(served.at, path).refused(404, "not_found");
    }
}

#[test]
fn a_client_that_stops_reading_costs_a_slot_and_no_memory() {
    let options = mocapd_service::http::HttpOptions {
        limits: super::short_limits(),
        connections_max: 8,
        ..super::local()
    };
    let served = super::serve_with(options);
    // Larger than any socket buffer.
    let big = fs::File::create(served.folder.path().join("takes/big.take")).unwrap();
    big.set_len(1 << 30).unwrap();
    let held: Vec<_> = (0..4)
        .map(|_| {
            let mut stream = connect(served.at);
            stream.write_all(&request("GET", "/v1/takes/big/download", &[], "")).unwrap();
            stream.read_exact(&mut [0; 1000]).unwrap();
            stream
        })
        .collect();
    let refused = get(served.at, "/v1/takes/big/download").refused(503, "unavailable");
    assert_mentions(&refused, &["streams", "downloads"]);
    assert_eq!(get(served.at, "/v1/status").status, 200);
    // The clients read nothing for longer than the limit: their slots are free again.
    std::thread::sleep(std::time::Duration::from_millis(2000));
    assert_eq!(ask(served.at, "HEAD", "/v1/takes/big/download", &[], "").status, 200);
    for mut stream in held {
        let mut rest = Vec::new();
        stream.read_to_end(&mut rest).ok();
        assert!(rest.len() < 64 << 20, "{} bytes were on their way", rest.len());
    }
}

#[test]
fn a_take_is_downloaded_in_the_formats_of_other_programs() {
    let served = serve();
    fs::write(served.folder.path().join("takes/knee-1.take"), super::take()).unwrap();
    let path = "/v1/takes/knee-1/download";
    let bytes = fs::read(served.folder.path().join("takes/knee-1.take")).unwrap();
    let decoded = crate::support::rows(&bytes).0;
    let file = |format: &str| get(served.at, &format!("{path}?format={format}"));
    for (format, read, media_type) in [
        ("c3d", Format::C3d, "application/octet-stream"),
        ("trc", Format::Trc, "text/tab-separated-values; charset=utf-8"),
        ("csv", Format::Csv, "text/csv; charset=utf-8"),
    ] {
        let answer = file(format);
        assert_eq!(answer.status, 200, "{format}");
        assert_eq!(answer.header("content-type"), Some(media_type));
        assert_eq!(answer.header("accept-ranges"), Some("none"));
        assert_eq!(answer.header("content-length"), None);
        let name = format!("filename*=UTF-8''knee-1.{format}");
        assert_mentions(answer.header("content-disposition").unwrap(), &["attachment", &name]);
        let motion = read.read(&answer.body).unwrap();
        assert_eq!((motion.info.n_frames, motion.info.rate_hz), (120, 120.0), "{format}");
        let n = motion.info.markers.len();
        for (row, expected) in decoded.iter().enumerate() {
            for (a, b) in motion.positions_mm[row * n..(row + 1) * n].iter().zip(expected) {
                assert_eq!(is_gap(*a), is_gap(*b), "{format} {row}");
                let is_near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-4 * b.abs().max(1.0);
                assert!(is_gap(*a) || a.iter().zip(b).all(is_near), "{format} {row}: {a:?} {b:?}");
            }
        }
    }
    // As it is; and what is no format.
    assert_eq!(file("take").body, bytes);
    assert_eq!(fs::read(served.folder.path().join("takes/knee-1.take")).unwrap(), bytes);
    assert_mentions(&file("html").refused(400, "invalid"), &["c3d", "trc", "csv"]);
    get(served.at, &format!("{path}?format=c3d&format=trc")).refused(400, "invalid");
    get(served.at, "/v1/takes/none/download?format=c3d").refused(404, "not_found");
    fs::write(served.folder.path().join("takes/noise.take"), "no take at all").unwrap();
    get(served.at, "/v1/takes/noise/download?format=csv").refused(409, "conflict");
    post(served.at, "/v1/start", r#"{"name":"live"}"#);
    let refused = get(served.at, "/v1/takes/live/download?format=c3d").refused(409, "conflict");
    assert_mentions(&refused, &["live", "being recorded"]);
}

#[test]
fn a_client_that_leaves_during_a_conversion_ends_it() {
    let options =
        mocapd_service::http::HttpOptions { limits: super::short_limits(), ..super::local() };
    let served = super::serve_with(options);
    let motion = crowd(1, 240.0, 20.0);
    let (_, take, _) = record(&motion, &config(&motion, dense(0.5)), 0..motion.n_frames());
    fs::write(served.folder.path().join("takes/long.take"), take).unwrap();
    // More clients than conversions can run or wait, which read nothing: the last ones are refused, and 0.8 s later,
    // when the others have been cut off, nothing of them is left.
    let path = "/v1/takes/long/download?format=csv";
    let mut held: Vec<_> = (0..6)
        .map(|_| {
            let mut stream = connect(served.at);
            stream.write_all(&request("GET", path, &[], "")).unwrap();
            stream
        })
        .collect();
    std::thread::sleep(std::time::Duration::from_millis(300));
    assert_mentions(&get(served.at, path).refused(503, "unavailable"), &["converted"]);
    assert_eq!(get(served.at, "/v1/status").status, 200);
    held.clear();
    let began = std::time::Instant::now();
    loop {
        let answer = get(served.at, "/v1/takes/long/download?format=trc");
        if answer.status == 200 {
            assert_eq!(Format::Trc.read(&answer.body).unwrap().n_frames(), motion.n_frames());
            break;
        }
        assert!(began.elapsed().as_secs() < 10, "the conversions go on");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
}
