//! Pages that the service itself writes: the login form, and refusals for people who look at them in a browser.

use axum::{
    http::{HeaderMap, header},
    response::Html,
};

use super::problem::{Problem, ProblemKind};

pub(super) const LOGIN_PATH: &str = "/login";

const LOGIN: &str = include_str!("login.html");

const REFUSAL: &str = include_str!("problem.html");

/// Where a page says what was refused.
const PLACE: &str = "<!-- problem -->";

/// Whether the client is a browser that shows what comes: `fetch` and programs accept anything, not HTML first of all.
pub(super) fn is_wanted(headers: &HeaderMap) -> bool {
    let accepts = headers.get(header::ACCEPT).and_then(|accepts| accepts.to_str().ok());
    accepts.is_some_and(|accepts| accepts.contains("text/html"))
}

/// The form that asks for the token.
pub(super) fn login() -> Html<String> {
    Html(LOGIN.replace(PLACE, ""))
}

/// A refusal as a page: at the login the form again.
pub(super) fn refusal(path: &str, problem: &Problem) -> Html<String> {
    let (page, message) = match problem.kind {
        ProblemKind::Unauthorized if path == LOGIN_PATH => (LOGIN, "Wrong token.".to_owned()),
        _ if path == LOGIN_PATH => (LOGIN, escaped(&problem.message)),
        _ => (REFUSAL, escaped(&problem.message)),
    };
    Html(page.replace(PLACE, &format!("<p role=\"alert\">{message}</p>")))
}

/// Text as HTML: a message may hold what a request said.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_request_said_is_no_markup() {
        let problem = Problem::invalid("'<b>&\"' is no host");
        let Html(page) = refusal("/", &problem);
        assert!(
            page.contains("'&lt;b&gt;&amp;&quot;' is no host") && !page.contains("<b>"),
            "{page}"
        );
    }
}
