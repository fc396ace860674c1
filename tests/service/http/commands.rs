//! The commands and their responses.

use std::sync::atomic::Ordering;

use serde_json::json;

use super::{
    client::{ask, get, post},
    serve,
};
use crate::support::assert_mentions;

#[test]
fn from_idle_to_a_take_and_back() {
    let served = serve();
    let at = served.at;
    let status = get(at, "/v1/status");
    assert_eq!((status.status, status.json()["state"].as_str()), (200, Some("idle")));
    assert_eq!(status.header("content-type"), Some("application/json"));
    assert_eq!(status.header("cache-control"), Some("no-store"));

    assert_eq!(post(at, "/v1/arm", "{}").json()["state"], "armed");
    post(at, "/v1/stop", "").refused(409, "conflict");
    let started = post(at, "/v1/start", r#"{"name": "jump", "pre_roll_s": 2}"#).json();
    assert_eq!(started["name"], "jump");
    assert_eq!(get(at, "/v1/status").json()["take"]["name"], "jump");
    post(at, "/v1/start", "{}").refused(409, "conflict");
    post(at, "/v1/disarm", "{}").refused(409, "conflict");
    assert_eq!(post(at, "/v1/mark", r#"{"text": "take off"}"#).json(), json!({"row": 60}));
    let stopped = post(at, "/v1/stop", "{}").json();
    assert_eq!(
        (&stopped["ending"], &stopped["ledger"]["closes"]),
        (&json!("stopped"), &json!(true))
    );
    post(at, "/v1/start", r#"{"name": "jump"}"#).refused(409, "exists");
    assert_eq!(post(at, "/v1/save-last", r#"{"seconds": 3}"#).json()["ending"], "length");
    assert_eq!(post(at, "/v1/disarm", "{}").json()["state"], "idle");
    assert_eq!(get(at, "/v1/quality").json()[1]["label"], "l_knee");
    assert!(get(at, "/v1/devices").json().is_array());
    served.stop();
}

#[test]
fn a_repeated_request_is_not_executed_again() {
    let served = serve();
    let first = post(served.at, "/v1/start", r#"{"request_id": "a-1"}"#);
    let again = ask(served.at, "POST", "/v1/start", &[("idempotency-key", "a-1")], "{}");
    let quoted = ask(served.at, "POST", "/v1/start", &[("idempotency-key", "\"a-1\"")], "");
    assert_eq!((first.status, &first.body), (200, &again.body));
    assert_eq!(first.body, quoted.body);
    assert_eq!(served.fake.executed.load(Ordering::Relaxed), 1);
    let both =
        ask(served.at, "POST", "/v1/stop", &[("idempotency-key", "b")], r#"{"request_id": "c"}"#);
    assert_mentions(&both.refused(400, "invalid"), &["Idempotency-Key", "request_id"]);
    ask(served.at, "POST", "/v1/stop", &[("idempotency-key", "\"\"")], "").refused(400, "invalid");
}

#[test]
fn invalid_requests_are_refused_with_a_reason() {
    let served = serve();
    let bad = |path: &str, body: &str| post(served.at, path, body).refused(400, "invalid");
    for body in [
        "[]",
        "[null]",
        "null",
        "\"x\"",
        "1",
        "{",
        "{}{}",
        " ",
        "\n",
        "{\"request_id\": 1}",
        "\u{1}",
    ] {
        bad("/v1/arm", body);
    }
    assert_mentions(&bad("/v1/start", r#"{"nmae": "x"}"#), &["nmae"]);
    assert_mentions(&bad("/v1/start", r#"{"name": "a", "name": "b"}"#), &["name"]);
    bad("/v1/start", r#"{"pre_roll_s": 1e999}"#);
    bad("/v1/start", r#"{"pre_roll_s": -1}"#);
    bad("/v1/start", r#"{"name": "../x"}"#);
    bad("/v1/save-last", r#"{"seconds": 0}"#);
    bad("/v1/start", r#"{"at": "noon"}"#);
    bad("/v1/mark", &format!(r#"{{"text": "{}"}}"#, "x".repeat(1025)));
    bad("/v1/arm", &"[".repeat(5000));
    for id in [String::new(), "x".repeat(65), "é".to_owned(), "a\tb".to_owned()] {
        bad("/v1/arm", &serde_json::json!({"request_id": id}).to_string());
    }
    assert_eq!(served.fake.executed.load(Ordering::Relaxed), 4, "the fake's own refusals");
}

#[test]
fn wrong_paths_and_methods_have_their_own_statuses() {
    let served = serve();
    let at = served.at;
    get(at, "/v2/status").refused(404, "not_found");
    get(at, "/V1/status").refused(404, "not_found");
    let wrong = get(at, "/v1/start");
    wrong.refused(405, "method_not_allowed");
    assert_eq!(wrong.header("allow"), Some("POST"));
    let wrong = post(at, "/v1/status", "{}");
    wrong.refused(405, "method_not_allowed");
    assert_eq!(wrong.header("allow"), Some("GET,HEAD"));
    for method in ["PUT", "DELETE", "OPTIONS", "TRACE", "BREW"] {
        ask(at, method, "/v1/start", &[], "").refused(405, "method_not_allowed");
    }
    for kind in ["text/plain", "application/x-www-form-urlencoded", "application/jsonx", ""] {
        let typed = ask(at, "POST", "/v1/arm", &[("content-type", kind)], "{}");
        typed.refused(415, "unsupported_media_type");
    }
    let kind = [("content-type", "Application/JSON; charset=utf-8")];
    assert_eq!(ask(at, "POST", "/v1/arm", &kind, "{}").status, 200);
    let head = ask(at, "HEAD", "/v1/status", &[], "");
    assert_eq!((head.status, head.body.len()), (200, 0));
    assert!(head.header("content-length").is_some_and(|len| len != "0"));
    let huge = post(at, "/v1/arm", &" ".repeat((64 << 10) + 1));
    huge.refused(413, "too_large");
    let full = format!("{{}}{}", " ".repeat((64 << 10) - 2));
    assert_eq!(post(at, "/v1/arm", &full).status, 200);
    let chunked = format!("{:x}\r\n{}\r\n0\r\n\r\n", 65 << 10, " ".repeat(65 << 10));
    ask(at, "POST", "/v1/arm", &[("transfer-encoding", "chunked")], &chunked)
        .refused(413, "too_large");
    let long = ask(at, "GET", &format!("/v1/status?{}", "x".repeat(5000)), &[], "");
    long.refused(414, "too_large");
    let header = "x".repeat(20 << 10);
    assert_eq!(ask(at, "GET", "/v1/status", &[("x-a", &header)], "").status, 431);
    let many: Vec<_> = (0..80).map(|_| ("x-a", "b")).collect();
    assert_eq!(ask(at, "GET", "/v1/status", &many, "").status, 431);
}

#[test]
fn health_is_bad_when_the_service_has_failed() {
    let served = serve();
    let health = get(served.at, "/healthz");
    assert_eq!((health.status, health.json()), (200, json!({"state": "idle"})));
    served.fake.fail("the disk failed: replace it");
    let message = get(served.at, "/healthz").refused(503, "internal");
    assert_eq!(message, "the disk failed: replace it");
}

#[test]
fn requests_that_do_not_fit_into_the_queue_are_refused() {
    let served = serve();
    served.fake.command_ms.store(700, Ordering::Relaxed);
    let at = served.at;
    let answers: Vec<_> = std::thread::scope(|scope| {
        let clients: Vec<_> =
            (0..30).map(|_| scope.spawn(move || post(at, "/v1/arm", "{}"))).collect();
        std::thread::sleep(std::time::Duration::from_millis(300));
        let asked = std::time::Instant::now();
        assert_eq!(get(at, "/v1/status").status, 200, "status never waits");
        assert!(asked.elapsed().as_millis() < 200, "{:?}", asked.elapsed());
        clients.into_iter().map(|client| client.join().unwrap()).collect()
    });
    let done = answers.iter().filter(|answer| answer.status == 200).count();
    assert_eq!(done, 20, "four executing and sixteen queued");
    for answer in answers.iter().filter(|answer| answer.status != 200) {
        answer.refused(503, "unavailable");
        assert_eq!(answer.header("retry-after"), Some("1"));
    }
}
