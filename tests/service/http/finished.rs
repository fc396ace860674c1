//! The routes of finished takes: their contract, hostile names and hostile bodies.

use std::{fs, os::unix::fs::symlink};

use serde_json::json;

use super::{
    client::{Answer, ask, exchange, get, post, request},
    serve,
};
use crate::support::assert_mentions;

fn with_take(name: &str) -> super::Served {
    let served = serve();
    post(served.at, "/v1/start", &format!(r#"{{"name": "{name}"}}"#));
    assert_eq!(post(served.at, "/v1/stop", "{}").status, 200);
    served
}

#[test]
fn a_take_is_rated_renamed_trashed_and_restored() {
    let served = with_take("jump");
    let at = served.at;
    get(at, "/v1/takes/jump/notes").refused(404, "not_found");
    let notes =
        post(at, "/v1/takes/jump/notes", r#"{"rating": "good", "text": "left\nshoe"}"#).json();
    assert_eq!((&notes["rating"], &notes["text"]), (&json!("good"), &json!("left\nshoe")));
    let file = get(at, "/v1/takes/jump/notes");
    assert_eq!((file.status, file.header("content-type")), (200, Some("application/json")));
    assert_eq!(file.body, fs::read(served.folder.path().join("takes/jump.notes.json")).unwrap());
    assert_eq!(get(at, "/v1/takes").json()[0]["notes"], notes);
    let moved = post(at, "/v1/takes/jump/rename", r#"{"to": "knie \u00e9"}"#).json();
    assert_eq!(moved["name"], "knie \u{e9}");
    let trashed = post(at, "/v1/takes/knie%20%C3%A9/trash", "{}").json();
    assert_eq!(get(at, "/v1/trash").json(), json!([trashed]));
    assert_eq!(get(at, "/v1/takes").json(), json!([]));
    let id = trashed["id"].as_str().unwrap().replace(' ', "%20").replace('\u{e9}', "%C3%A9");
    let restored = post(at, &format!("/v1/trash/{id}/restore"), "{}").json();
    assert_eq!(restored["name"], "knie \u{e9}");
    assert_eq!(get(at, "/v1/trash").json(), json!([]));
    assert_eq!(get(at, "/v1/takes").json()[0]["notes"], notes);
    post(at, "/v1/trash/none/restore", "{}").refused(404, "not_found");
    post(at, "/v1/takes/none/trash", "{}").refused(404, "not_found");
    for limit in ["0", "1001", "-1", "x", ""] {
        get(at, &format!("/v1/trash?limit={limit}")).refused(400, "invalid");
    }
}

#[test]
fn hostile_names_lead_nowhere() {
    let served = with_take("jump");
    let takes = served.folder.path().join("takes");
    fs::write(served.folder.path().join("secret.take"), super::take()).unwrap();
    symlink("../secret.take", takes.join("link.take")).unwrap();
    fs::create_dir(takes.join("dir.take")).unwrap();
    for name in [
        "..",
        "../secret",
        "..%2fsecret",
        "%2e%2e%2fsecret",
        "%252e%252e%252fsecret",
        "..%5csecret",
        "jump%00",
        "%2fetc%2fpasswd",
        "%0ajump",
        "link",
        "dir",
        ".hidden",
        ".trash",
        "JUMP",
        &"x".repeat(300),
    ] {
        for (route, body) in [
            (format!("/v1/takes/{name}/notes"), r#"{"rating": "good"}"#),
            (format!("/v1/takes/{name}/rename"), r#"{"to": "x"}"#),
            (format!("/v1/takes/{name}/trash"), "{}"),
            (format!("/v1/trash/{name}/restore"), "{}"),
        ] {
            let asked = request("POST", &route, &[], body);
            let answer = Answer::parse(&exchange(served.at, &asked));
            assert!([400, 404].contains(&answer.status), "{route}: {}", answer.status);
        }
        let asked = request("GET", &format!("/v1/takes/{name}/notes"), &[], "");
        let answer = Answer::parse(&exchange(served.at, &asked));
        assert!([400, 404].contains(&answer.status), "{name}: {}", answer.status);
    }
    for to in [
        "../x",
        "/tmp/x",
        ".x",
        "a/b",
        "a\\b",
        "a\0b",
        "a\u{202e}b",
        "NUL",
        "com1.x",
        "",
        &"x".repeat(201),
    ] {
        let body = json!({"to": to}).to_string();
        let refused = post(served.at, "/v1/takes/jump/rename", &body);
        assert_eq!(refused.status, 400, "{to:?}");
    }
    let names: Vec<_> = takes.read_dir().unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names.len(), 3, "{names:?}");
    assert!(served.folder.path().join("secret.take").exists());
}

#[test]
fn hostile_bodies_change_nothing() {
    let served = with_take("jump");
    let at = served.at;
    let path = "/v1/takes/jump/notes";
    for body in [
        "[]",
        "null",
        r#"{"rating": 5}"#,
        r#"{"rating": null, "stars": 5}"#,
        r#"{"rating": ["good"]}"#,
        r#"{"text": 1}"#,
        r#"{"take": "x"}"#,
        r#"{"rating": "good", "rating": "bad"}"#,
    ] {
        post(at, path, body).refused(400, "invalid");
    }
    for body in ["{}", r#"{"to": 1}"#, r#"{"to": "x", "replace": true}"#] {
        post(at, "/v1/takes/jump/rename", body).refused(400, "invalid");
    }
    post(at, "/v1/takes/jump/trash", r#"{"force": true}"#).refused(400, "invalid");
    post(at, path, &" ".repeat((64 << 10) + 1)).refused(413, "too_large");
    ask(at, "POST", path, &[("content-type", "text/plain")], r#"{"rating": "good"}"#)
        .refused(415, "unsupported_media_type");
    ask(at, "POST", "/v1/takes/jump/trash", &[("origin", "http://evil.example")], "{}")
        .refused(403, "forbidden");
    get(at, path).refused(404, "not_found");
    let start = |body: &str| post(at, "/v1/start", body).refused(400, "invalid");
    assert_mentions(&start(r#"{"subjects": "x"}"#), &["subjects"]);
    start(r#"{"seconds": "10"}"#);
    start(r#"{"at": 14}"#);
    // A start that waits is accepted, not done.
    let pending = post(at, "/v1/start", r#"{"at": "14:05:00"}"#);
    assert_eq!(pending.status, 202);
    assert_eq!(get(at, "/v1/status").json()["pending_start"], pending.json());
    post(at, "/v1/start", r#"{"at": "15:05:00"}"#).refused(409, "conflict");
    assert_eq!(post(at, "/v1/cancel", "{}").json(), pending.json());
    post(at, "/v1/cancel", "{}").refused(409, "conflict");
}
