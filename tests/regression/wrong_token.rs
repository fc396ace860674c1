//! After a wrong token a browser gets the form again, and programs get the problem as JSON.

use mocapd_service::http::{HttpOptions, HttpServer};

use crate::service::{
    fake::Fake,
    http::client::{Answer, ask},
};

const TOKEN: &str = "correct-horse-battery-staple";
const FORM: (&str, &str) = ("content-type", "application/x-www-form-urlencoded");
/// The `accept` header of a browser that submits a form.
const BROWSER: (&str, &str) =
    ("accept", "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8");

fn is_form_with_alert(answer: &Answer, status: u16) {
    let page = String::from_utf8_lossy(&answer.body);
    assert_eq!(answer.status, status, "{page}");
    let kind = answer.header("content-type").unwrap();
    assert!(kind.starts_with("text/html"), "{kind}: {page}");
    assert!(page.contains("name=\"token\"") && page.contains("role=\"alert\""), "{page}");
    assert!(answer.header("content-security-policy").is_some());
}

#[test]
fn a_wrong_token_brings_the_form_again_in_a_browser() {
    let folder = tempfile::tempdir().unwrap();
    let options = HttpOptions {
        tcp: Some("127.0.0.1:0".parse().unwrap()),
        token: Some(TOKEN.to_owned()),
        ..HttpOptions::default()
    };
    let server = HttpServer::start(options, Fake::new(folder.path(), Vec::new())).unwrap();
    let at = server.tcp_address().unwrap();

    let wrong = ask(at, "POST", "/login", &[FORM, BROWSER], "token=wrong");
    is_form_with_alert(&wrong, 401);
    let empty = ask(at, "POST", "/login", &[FORM, BROWSER], "tokens=x");
    is_form_with_alert(&empty, 400);
    let cross = [FORM, BROWSER, ("origin", "https://evil.example")];
    is_form_with_alert(&ask(at, "POST", "/login", &cross, "token=x"), 403);
    // Other pages say what is refused; the login form has no alert, and the right token is still accepted.
    let elsewhere = ask(at, "GET", "/", &[BROWSER, ("host", "rig.example")], "");
    assert_eq!(elsewhere.status, 421);
    assert!(elsewhere.header("content-type").unwrap().starts_with("text/html"));
    assert!(
        !String::from_utf8_lossy(&ask(at, "GET", "/login", &[BROWSER], "").body).contains("alert")
    );
    let right = ask(at, "POST", "/login", &[FORM, BROWSER], &format!("token={TOKEN}"));
    assert_eq!((right.status, right.header("location")), (303, Some("/")));

    // A program, and the page's own script, get the problem.
    ask(at, "POST", "/login", &[FORM], "token=wrong").refused(401, "unauthorized");
    let script = [FORM, ("accept", "*/*")];
    ask(at, "POST", "/login", &script, "token=wrong").refused(401, "unauthorized");
    ask(at, "GET", "/v1/takes/x/download", &[BROWSER, ("host", "rig.example")], "")
        .refused(421, "forbidden");
}
