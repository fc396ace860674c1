//! Compares docs/api.md with the API: the routes are the same, and the examples work.

use std::collections::BTreeSet;

use serde_json::Value;

use super::{
    client::{ask, get, post},
    serve,
};

const PAGE: &str = include_str!("../../../docs/api.md");

/// Method, path and the remaining cells of every table row with a route.
fn rows() -> Vec<(String, String, Vec<String>)> {
    let rows = PAGE.lines().filter_map(|line| {
        let mut cells = line.split('|').map(str::trim).skip(1);
        let route = cells.next()?.strip_prefix('`')?.strip_suffix('`')?;
        let (method, path) = route.split_once(' ')?;
        let rest = cells.map(str::to_owned).collect();
        ["GET", "POST"].contains(&method).then(|| (method.to_owned(), path.to_owned(), rest))
    });
    rows.collect()
}

fn quoted_words(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

#[test]
fn the_page_has_every_route_and_its_examples_work() {
    let document: Value = serde_json::from_str(&mocapd_service::http::openapi().unwrap()).unwrap();
    let described = document["paths"].as_object().unwrap().iter().flat_map(|(path, item)| {
        let methods = item.as_object().unwrap().keys();
        methods.map(move |method| format!("{} {path}", method.to_uppercase()))
    });
    let mut described: BTreeSet<_> = described.collect();
    described.insert("GET /".to_owned());
    let rows = rows();
    let shown: BTreeSet<_> = rows
        .iter()
        .map(|(method, path, _)| {
            let path = path.replace("/trash/jump-001/", "/trash/{id}/");
            format!("{method} {}", path.replace("jump-001", "{name}").replace("jump-002", "{name}"))
        })
        .collect();
    assert_eq!(shown, described);

    let served = serve();
    for (method, path, cells) in &rows {
        // Of the last one, which needs another take, see `a_take_is_compared_with_its_original`.
        let others =
            ["/login", "/logout", "/v1/events", "/v1/live", "/", "/v1/takes/jump-001/difference"];
        if others.contains(&path.as_str()) {
            continue;
        }
        let body = cells[0].trim_matches('`');
        let body = if body.starts_with('{') { body } else { "{}" };
        let answer =
            if method == "POST" { post(served.at, path, body) } else { get(served.at, path) };
        let text = String::from_utf8_lossy(&answer.body).into_owned();
        let expected = if body.contains("\"at\"") { 202 } else { 200 };
        assert_eq!(answer.status, expected, "{method} {path}: {text}");
        let Ok(answer) = serde_json::from_slice::<Value>(&answer.body) else { continue };
        // The response has the fields that the page names.
        let one = if answer.is_array() { answer[0].clone() } else { answer };
        let cells = cells.iter().filter(|cell| !cell.starts_with("`{"));
        for word in cells.flat_map(|cell| quoted_words(cell)) {
            let is_field = word.chars().all(|c| c.is_ascii_lowercase() || c == '_');
            if is_field && word != "stop" && one.is_object() {
                assert!(one.get(word).is_some(), "{method} {path} has no {word}: {text}");
            }
        }
    }
}

#[test]
fn the_problem_on_the_page_is_the_one_sent() {
    let served = serve();
    let example = PAGE.split("```json\n").nth(1).unwrap().lines().next().unwrap();
    assert_eq!(String::from_utf8(post(served.at, "/v1/stop", "{}").body).unwrap(), example);
    for kind in document_kinds() {
        assert!(PAGE.contains(&format!("| `{kind}` |")), "{kind} is not on the page");
    }
    let page = ask(served.at, "GET", "/metrics", &[], "");
    let metrics = String::from_utf8(page.body).unwrap();
    for word in quoted_words(PAGE).filter(|word| word.starts_with("mocapd_")) {
        let name = word.split('{').next().unwrap();
        assert!(metrics.contains(&format!("\n{name}")), "{name}");
    }
}

fn document_kinds() -> Vec<String> {
    let document: Value = serde_json::from_str(&mocapd_service::http::openapi().unwrap()).unwrap();
    let kinds = &document["components"]["schemas"]["ProblemKind"];
    let one_of = kinds["oneOf"].as_array().map(|kinds| {
        kinds.iter().flat_map(|kind| kind["enum"].as_array().unwrap().clone()).collect()
    });
    let kinds: Vec<Value> = one_of.unwrap_or_else(|| kinds["enum"].as_array().unwrap().clone());
    kinds.iter().map(|kind| kind.as_str().unwrap().to_owned()).collect()
}
