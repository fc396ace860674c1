//! `view`: files as takes of a viewer on the loopback address, until a signal.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    process::{Child, Stdio},
};

use mocapd_take::motion::{Motion, Position, is_gap};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use super::Folder;
use crate::support::{assert_mentions, jump};

/// A running viewer; killed on drop.
struct Viewing {
    child: Child,
    at: SocketAddr,
    token: String,
    url: String,
}

impl Viewing {
    fn start(folder: &Folder, args: &[&str]) -> Self {
        let mut command = folder.command(&[&["view"], args].concat());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        let url = url.trim().to_owned();
        let (address, token) = url.strip_prefix("http://").unwrap().split_once("#token=").unwrap();
        let at = address.split('/').next().unwrap();
        Self { at: at.parse().unwrap(), token: token.to_owned(), url: url.clone(), child }
    }

    /// Status and body of a request.
    fn get(&self, path: &str, host: &str, token: &str) -> (u16, Vec<u8>) {
        let mut stream = TcpStream::connect(self.at).unwrap();
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nhost: {host}\r\nauthorization: Bearer {token}\r\nconnection: close\r\n\r\n"
        )
        .unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let head = answer.windows(4).position(|end| end == b"\r\n\r\n").unwrap();
        let status = std::str::from_utf8(&answer[9..12]).unwrap().parse().unwrap();
        (status, answer[head + 4..].to_vec())
    }

    fn json(&self, path: &str) -> Value {
        let (status, body) = self.get(path, "localhost", &self.token);
        assert_eq!(status, 200, "{path}");
        serde_json::from_slice(&body).unwrap()
    }

    fn names(&self) -> Vec<String> {
        let takes = self.json("/v1/takes");
        let takes = takes.as_array().unwrap().iter();
        takes.map(|take| take["name"].as_str().unwrap().to_owned()).collect()
    }

    /// Ends it with a signal; its exit code, and what it wrote to stderr.
    fn end(mut self, signal: Signal) -> (Option<i32>, String) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
        let mut said = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        (self.child.wait().unwrap().code(), said)
    }
}

impl Drop for Viewing {
    fn drop(&mut self) {
        // It may have ended.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// The positions of a window.
fn positions(body: &[u8]) -> Vec<Position> {
    let floats: Vec<f32> = body[32..]
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()))
        .collect();
    floats.chunks_exact(3).map(|three| three.try_into().unwrap()).collect()
}

fn assert_same(found: &[Position], motion: &Motion) {
    assert_eq!(found.len(), motion.positions_mm.len());
    for (a, b) in found.iter().zip(&motion.positions_mm) {
        assert!(is_gap(*a) && is_gap(*b) || a.map(f32::to_bits) == b.map(f32::to_bits));
    }
}

#[test]
fn files_of_every_kind_are_a_list_with_their_exact_positions() {
    let folder = Folder::new();
    let motion = jump(1, 100.0, 2.0);
    for name in ["a.csv", "b.trc", "c.tsv", "d.c3d", "jump.csv"] {
        folder.write_motion(name, &motion);
    }
    folder.run(&["import", "jump.csv", "-o", "jump.take", "--lossless"]).with_code(0);
    std::fs::create_dir(folder.path("more")).unwrap();
    std::os::unix::fs::symlink(folder.path("jump.take"), folder.path("more/link.take")).unwrap();
    let viewing = Viewing::start(
        &folder,
        &["jump.take", "a.csv", "b.trc", "c.tsv", "d.c3d", "more/link.take"],
    );
    assert!(viewing.at.ip().is_loopback() && viewing.token.len() == 64, "{}", viewing.url);
    let names = viewing.names();
    assert_eq!(names[..5], ["jump", "a.csv", "b.trc", "c.tsv", "d.c3d"]);
    for name in &names {
        let path = format!("/v1/takes/{name}/window?seconds=3600");
        let (status, body) = viewing.get(&path, "localhost", &viewing.token);
        assert_eq!(status, 200, "{name}");
        // TSV has no gaps but zeros, and text files are read as f32 exactly.
        assert_same(&positions(&body), &motion);
        let overview = viewing.json(&format!("/v1/takes/{name}/overview"));
        assert_eq!(overview["tolerance_mm"], 0.0, "{name}");
        assert_eq!(overview["frames"], 200, "{name}");
    }
    let (code, said) = viewing.end(Signal::INT);
    assert_eq!(code, Some(0), "{said}");
    assert_mentions(&said, &["Ctrl-C"]);
}

#[test]
fn only_those_who_have_the_address_see_the_takes() {
    let folder = Folder::new();
    folder.write_motion("a.csv", &jump(1, 60.0, 1.0));
    let viewing = Viewing::start(&folder, &["a.csv"]);
    let wrong = format!("{}0", &viewing.token[..63]);
    for token in ["", "x", wrong.as_str()] {
        if token != viewing.token {
            assert_eq!(viewing.get("/v1/takes", "localhost", token).0, 401, "{token}");
        }
    }
    assert_eq!(viewing.get("/v1/takes", "evil.example", &viewing.token).0, 421);
    assert_eq!(viewing.get("/", "evil.example", "").0, 421);
    assert_eq!(viewing.get("/", "127.0.0.1", "").0, 200);
    let other = Viewing::start(&folder, &["a.csv"]);
    assert_ne!((other.token.clone(), other.at), (viewing.token.clone(), viewing.at));
    assert_eq!(viewing.end(Signal::TERM).0, Some(0));
}

#[test]
fn a_port_can_be_chosen_and_one_in_use_is_refused() {
    let folder = Folder::new();
    folder.write_motion("a.csv", &jump(1, 60.0, 1.0));
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let line = folder.refuses(&["view", "a.csv", "--port", &port], 1);
    assert_mentions(&line, &[&port, "another port"]);
    drop(taken);
    let viewing = Viewing::start(&folder, &["a.csv", "--port", &port]);
    assert_eq!(viewing.at.port().to_string(), port);
    folder.refuses(&["view", "a.csv", "--port", "65536"], 2);
    folder.refuses(&["view"], 2);
    folder.refuses(&["view", "none.take"], 1);
    folder.write("a.txt", "text");
    folder.refuses(&["view", "a.txt"], 2);
}

#[test]
fn files_that_cannot_be_shown_are_reported_and_the_others_shown() {
    let folder = Folder::new();
    folder.write_motion("good.csv", &jump(1, 60.0, 1.0));
    folder.write("bad.take", "no take at all");
    folder.write("bad.c3d", "no file at all");
    let line = folder.refuses(&["view", "bad.take"], 1);
    assert_mentions(&line, &["bad.take"]);
    let viewing = Viewing::start(&folder, &["bad.take", "good.csv", "bad.c3d"]);
    assert_eq!(viewing.names(), ["good.csv"]);
    let (code, said) = viewing.end(Signal::INT);
    assert_eq!(code, Some(1), "{said}");
    assert_mentions(&said, &["bad.take", "bad.c3d", "2"]);
}

/// The loads of a window of forces: nine numbers for each frame of one plate.
fn loads(body: &[u8]) -> Vec<Vec<f32>> {
    assert_eq!(&body[..4], b"MPF1");
    let floats: Vec<f32> = body[32..]
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()))
        .collect();
    floats.chunks_exact(9).map(<[f32]>::to_vec).collect()
}

#[test]
fn the_force_plates_of_a_c3d_file_are_served_as_loads() {
    let folder = Folder::new();
    folder.write("walk.c3d", super::forces::plate([1, 10]));
    folder.run(&["import", "walk.c3d", "-o", "walk.take"]).with_code(0);
    folder.run(&["import", "walk.c3d", "-o", "bare.take", "--drop-foreign"]).with_code(0);
    let viewing = Viewing::start(&folder, &["walk.take", "walk.c3d", "bare.take"]);
    for name in ["walk", "walk.c3d"] {
        let list = viewing.json(&format!("/v1/takes/{name}/plates"));
        assert_eq!(list["plates"][0]["name"], "1", "{list}");
        assert_eq!(list["plates"][0]["corners_mm"][0], serde_json::json!([1200.0, 800.0, 0.0]));
        let get = |query: &str| {
            let path = format!("/v1/takes/{name}/forces{query}");
            let (status, body) = viewing.get(&path, "localhost", &viewing.token);
            assert_eq!(status, 200, "{path}");
            loads(&body)
        };
        let all = get("?seconds=10");
        assert_eq!(all.len(), 20);
        // 5 N of drift downwards: too little for a centre of pressure.
        assert_eq!(all[9][..3], [0.0, 0.0, -5.0]);
        assert!(all[9][3..7].iter().all(|value| value.is_nan()), "{:?}", all[9]);
        assert_eq!(all[9][7..], [-5.0, -5.0]);
        let arm = 1000.0 + 70_000.0 / 695.0;
        for (found, expected) in
            all[10].iter().zip([0.0, 0.0, 695.0, arm, 500.0, 0.0, 0.0, 695.0, 695.0])
        {
            assert!((found - expected).abs() < 0.01, "{:?}", all[10]);
        }
        // A part, and every fourth frame with the ends of the forces in all four.
        assert_eq!(get("?from=0.1&seconds=0.05"), all[10..15]);
        let thinned = get("?seconds=10&every=4");
        assert_eq!(thinned.len(), 5);
        assert_eq!((thinned[2][2], &thinned[2][7..]), (-5.0, &[-5.0, 695.0][..]));
    }
    assert_eq!(viewing.json("/v1/takes/bare/plates")["plates"], serde_json::json!([]));
    let (status, body) = viewing.get("/v1/takes/bare/forces", "localhost", &viewing.token);
    assert_eq!((status, body.len()), (200, 32));
    assert_eq!(viewing.get("/v1/takes/walk/forces?from=9", "localhost", &viewing.token).0, 416);
}

#[test]
fn a_take_is_compared_with_its_original() {
    let folder = Folder::new();
    let motion = jump(1, 100.0, 2.0);
    folder.write_motion("a.c3d", &motion);
    folder.run(&["import", "a.c3d", "-o", "a.take", "--tolerance", "2mm"]).with_code(0);
    let report = folder.run(&["verify", "a.take", "--against", "a.c3d", "--json"]).with_code(0);
    let report: Value = serde_json::from_str(&report.stdout).unwrap();
    let viewing = Viewing::start(&folder, &["a.take", "--against", "a.c3d"]);
    assert_mentions(&viewing.url, &["/?take=a&against=a.c3d#token="]);
    let found = viewing.json("/v1/takes/a/difference?against=a.c3d");
    assert_eq!((&found["first_frame"], &found["frames"]), (&0.into(), &200.into()), "{found}");
    let n = |name: &str| found[name].as_f64().unwrap();
    let rms_mm = (n("sum_of_squares_mm2") / n("samples")).sqrt();
    let expected = &report["against"];
    assert!((rms_mm - expected["rms_error_mm"].as_f64().unwrap()).abs() < 1e-9, "{report}");
    let largest = &found["largest"];
    assert_eq!(largest["error_mm"], expected["max_error_mm"], "{report}");
    assert_eq!(largest["frame"], expected["worst_frame"]);
    assert_eq!(found["gaps_differing"], 0);
    let other = viewing.json("/v1/takes/a.c3d/difference?against=a.c3d");
    assert_eq!(other["largest"]["error_mm"], 0.0);
    let get = |path: &str| viewing.get(path, "localhost", &viewing.token).0;
    assert_eq!(get("/v1/takes/a/difference?against=none"), 404);
    assert_eq!(get("/v1/takes/a/difference"), 400);
    drop(viewing);
    let refused = folder.refuses(&["view", "a.take", "a.c3d", "--against", "a.c3d"], 2);
    assert_mentions(&refused, &["--against", "one file"]);
    folder.write_motion("fast.csv", &jump(1, 200.0, 1.0));
    let viewing = Viewing::start(&folder, &["a.take", "--against", "fast.csv"]);
    let (status, body) =
        viewing.get("/v1/takes/a/difference?against=fast.csv", "localhost", &viewing.token);
    assert_eq!(status, 409);
    assert_mentions(&String::from_utf8_lossy(&body), &["100 and 200 Hz", "same rate"]);
}
