//! Access control: tokens, host names and origins.

use mocapd_service::http::{HttpOptions, HttpServer};

use super::{
    client::{ask, exchange, get, post, request},
    local, serve, serve_with,
};
use crate::{service::fake::Fake, support::assert_mentions};

const TOKEN: &str = "correct-horse-battery-staple";

fn guarded() -> super::Served {
    serve_with(HttpOptions { token: Some(TOKEN.to_owned()), ..local() })
}

#[test]
fn another_name_for_the_service_is_refused() {
    let options = HttpOptions { allowed_hosts: vec!["rig.lab".to_owned()], ..local() };
    let served = serve_with(options);
    let as_host = |host: &str| ask(served.at, "GET", "/v1/status", &[("host", host)], "");
    for host in ["localhost", "127.0.0.1:7060", "[::1]:1", "RIG.lab:8080"] {
        assert_eq!(as_host(host).status, 200, "{host}");
    }
    for host in ["evil.example", "rig.lab.evil.example", "127.0.0.1.evil.example", "2130706433"] {
        assert_mentions(&as_host(host).refused(421, "forbidden"), &[host, "allowed_hosts"]);
    }
    as_host("a b").refused(400, "invalid");
    as_host("").refused(400, "invalid");
    let two =
        "GET /v1/status HTTP/1.1\r\nhost: localhost\r\nhost: evil\r\nconnection: close\r\n\r\n";
    super::client::Answer::parse(&exchange(served.at, two.as_bytes())).refused(400, "invalid");
    let proxy = request("GET", "http://evil.example/v1/status", &[], "");
    super::client::Answer::parse(&exchange(served.at, &proxy)).refused(400, "invalid");
    let old = "GET /v1/status HTTP/1.0\r\n\r\n";
    super::client::Answer::parse(&exchange(served.at, old.as_bytes())).refused(400, "invalid");
    // The dashboard, too.
    ask(served.at, "GET", "/", &[("host", "evil.example")], "").refused(421, "forbidden");
}

#[test]
fn a_page_of_another_site_changes_nothing() {
    let served = serve();
    let from = |headers: &[(&str, &str)]| ask(served.at, "POST", "/v1/arm", headers, "{}");
    for origin in ["https://evil.example", "null", "http://localhost:1", "http://127.0.0.1"] {
        from(&[("origin", origin)]).refused(403, "forbidden");
    }
    from(&[("sec-fetch-site", "cross-site")]).refused(403, "forbidden");
    from(&[("sec-fetch-site", "same-site")]).refused(403, "forbidden");
    assert_eq!(served.fake.executed.load(std::sync::atomic::Ordering::Relaxed), 0);
    let ours = [("origin", "http://localhost"), ("sec-fetch-site", "same-origin")];
    assert_eq!(from(&ours).status, 200);
    let status = ask(served.at, "GET", "/v1/status", &[("origin", "https://evil.example")], "");
    assert_eq!(status.status, 200, "reading changes nothing");
    assert_eq!(status.header("access-control-allow-origin"), None, "other sites cannot read it");
}

#[test]
fn without_the_token_there_is_only_the_login() {
    let served = guarded();
    let at = served.at;
    let routes = ["/v1/status", "/v1/quality", "/v1/devices", "/openapi.json", "/", "/nothing"];
    for path in routes {
        let refused = get(at, path);
        refused.refused(401, "unauthorized");
        assert_eq!(refused.header("www-authenticate"), Some("Bearer"), "{path}");
    }
    for path in ["arm", "disarm", "start", "stop", "mark", "save-last"] {
        post(at, &format!("/v1/{path}"), "{}").refused(401, "unauthorized");
    }
    post(at, "/logout", "").refused(401, "unauthorized");
    for path in ["/login", "/style.css", "/icon.svg", "/healthz"] {
        assert_eq!(get(at, path).status, 200, "{path}");
    }
    served.fake.fail("/secret/folder is full");
    assert!(!get(at, "/healthz").refused(503, "internal").contains("secret"));
    for wrong in ["Bearer wrong", "Basic abc", "Bearer ", "Bearer correct-horse-battery-stapl"] {
        ask(at, "GET", "/v1/status", &[("authorization", wrong)], "").refused(401, "unauthorized");
    }
    let known = format!("Bearer {TOKEN}");
    let known = [("authorization", known.as_str())];
    assert_eq!(ask(at, "GET", "/v1/status", &known, "").status, 200);
    assert_eq!(ask(at, "POST", "/v1/arm", &known, "{}").status, 200);
    // A browser is redirected to the form.
    let sent = ask(at, "GET", "/", &[("accept", "text/html,*/*")], "");
    assert_eq!((sent.status, sent.header("location")), (303, Some("/login")));
}

#[test]
fn a_browser_logs_in_and_out() {
    let served = guarded();
    let at = served.at;
    let page = get(at, "/login");
    assert!(page.status == 200 && String::from_utf8_lossy(&page.body).contains("name=\"token\""));
    let form = ("content-type", "application/x-www-form-urlencoded");
    ask(at, "POST", "/login", &[form], "token=wrong").refused(401, "unauthorized");
    ask(at, "POST", "/login", &[form], "tokens=x").refused(400, "invalid");
    ask(at, "POST", "/login", &[], "{}").refused(415, "unsupported_media_type");
    let other = [form, ("origin", "https://evil.example")];
    ask(at, "POST", "/login", &other, &format!("token={TOKEN}")).refused(403, "forbidden");

    let inside = ask(at, "POST", "/login", &[form], &format!("token={TOKEN}"));
    assert_eq!((inside.status, inside.header("location")), (303, Some("/")));
    let cookie = inside.header("set-cookie").unwrap();
    for word in ["; HttpOnly", "; SameSite=Strict", "; Path=/", "; Max-Age="] {
        assert!(cookie.contains(word), "{cookie}");
    }
    assert!(!cookie.contains(TOKEN), "the cookie does not contain the token");
    let cookie = cookie.split(';').next().unwrap().to_owned();
    let held = [("cookie", cookie.as_str())];
    assert_eq!(ask(at, "GET", "/v1/status", &held, "").status, 200);
    assert_eq!(ask(at, "POST", "/v1/arm", &held, "{}").status, 200);
    let cross = [held[0], ("origin", "https://evil.example")];
    ask(at, "POST", "/v1/arm", &cross, "{}").refused(403, "forbidden");
    let out = ask(at, "POST", "/logout", &held, "");
    assert_eq!((out.status, out.header("location")), (303, Some("/login")));
    ask(at, "GET", "/v1/status", &held, "").refused(401, "unauthorized");
}

#[test]
fn the_service_does_not_listen_on_the_network_without_a_token() {
    let folder = tempfile::tempdir().unwrap();
    let start = |token: Option<&str>| {
        let options = HttpOptions {
            tcp: Some("0.0.0.0:0".parse().unwrap()),
            token: token.map(str::to_owned),
            ..HttpOptions::default()
        };
        HttpServer::start(options, Fake::new(folder.path(), Vec::new()))
    };
    let refused = start(None).unwrap_err().to_string();
    assert_mentions(&refused, &["0.0.0.0:0", "token", "127.0.0.1"]);
    assert!(start(Some(TOKEN)).is_ok());
}

#[test]
fn responses_have_security_headers() {
    let served = serve();
    for path in ["/", "/v1/status", "/nothing", "/login"] {
        let answer = get(served.at, path);
        let policy = answer.header("content-security-policy").unwrap();
        assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
        assert_eq!(answer.header("x-content-type-options"), Some("nosniff"), "{path}");
        assert_eq!(answer.header("cross-origin-resource-policy"), Some("same-origin"), "{path}");
        // With `no-referrer` a browser's form of /login would come with `Origin: null`, and be refused.
        assert_eq!(answer.header("referrer-policy"), Some("same-origin"), "{path}");
    }
    let page = get(served.at, "/");
    assert!(page.header("content-type").unwrap().starts_with("text/html"));
    let tag = page.header("etag").unwrap();
    let known = ask(served.at, "GET", "/", &[("if-none-match", tag)], "");
    assert_eq!((known.status, known.body.len()), (304, 0));
    assert_eq!(ask(served.at, "GET", "/", &[("if-none-match", "\"x\"")], "").status, 200);
}
