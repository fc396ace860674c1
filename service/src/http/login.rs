//! A browser shows the token once, and holds a cookie from then on. The pages that the service itself writes: the form
//! for it, and refusals for people who look at them in a browser.

use std::time::Duration;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{Html, IntoResponse, Redirect, Response},
};

use super::{
    Shared,
    auth::{COOKIE, SESSION_MAX},
    body,
    problem::{Problem, ProblemKind},
};

/// Before a wrong token is answered: guessing over one connection is slow, and connections are counted.
const WRONG_TOKEN_WAIT: Duration = Duration::from_millis(500);

/// A page that asks for the token
#[utoipa::path(get, path = "/login", tag = "login",
    responses((status = 200, body = String, content_type = "text/html")), security(()))]
pub(super) async fn page() -> Html<String> {
    Html(LOGIN.replace(PLACE, ""))
}

/// What the page sends.
#[derive(Debug, utoipa::ToSchema)]
#[expect(dead_code, reason = "it stands in the description only: the one field is read by hand")]
pub(super) struct Login {
    /// The token.
    token: String,
}

/// Log a browser in
///
/// Answers with a cookie that scripts cannot read and other sites' pages cannot use. A client that accepts HTML gets a
/// refusal as the form again, with the reason.
#[utoipa::path(post, path = "/login", tag = "login", security(()),
    request_body(content = inline(Login), content_type = "application/x-www-form-urlencoded"),
    responses((status = 303, description = "Logged in: to the dashboard"),
        (status = 401, description = "Not the token", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn login(
    State(app): State<Shared>,
    request: Request,
) -> Result<Response, Problem> {
    let (parts, body) = request.into_parts();
    if !body::is_type(&parts.headers, "application/x-www-form-urlencoded") {
        return Err(Problem::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            ProblemKind::UnsupportedMediaType,
            "send the form of /login",
        ));
    }
    let form = body::read(body, &parts.headers, &app).await?;
    let token = token_of(&form).ok_or_else(|| Problem::invalid("the form has no field `token`"))?;
    if !app.auth.is_token(token.as_bytes()) {
        tokio::time::sleep(WRONG_TOKEN_WAIT).await;
        let message = "wrong token: it stands in the file that the configuration names";
        return Err(Problem::new(StatusCode::UNAUTHORIZED, ProblemKind::Unauthorized, message));
    }
    let mut response = Redirect::to("/").into_response();
    if app.auth.is_on() {
        let id = app.auth.open_session();
        let id = id.map_err(|error| Problem::internal(format!("no random bytes: {error}")))?;
        set_cookie(&mut response, &id, SESSION_MAX)?;
    }
    Ok(response)
}

/// Log a browser out
#[utoipa::path(post, path = "/logout", tag = "login",
    responses((status = 303, description = "Logged out: to the login page")))]
pub(super) async fn logout(
    State(app): State<Shared>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    app.auth.close_session(&headers);
    let mut response = Redirect::to("/login").into_response();
    set_cookie(&mut response, "", Duration::ZERO)?;
    Ok(response)
}

fn set_cookie(response: &mut Response, value: &str, life: Duration) -> Result<(), Problem> {
    let cookie =
        format!("{COOKIE}={value}; Path=/; HttpOnly; SameSite=Strict; Max-Age={}", life.as_secs());
    let cookie =
        HeaderValue::try_from(cookie).map_err(|error| Problem::internal(error.to_string()))?;
    response.headers_mut().insert(header::SET_COOKIE, cookie);
    Ok(())
}

/// The field `token` of a form. It may have been pasted with a line end.
fn token_of(form: &[u8]) -> Option<String> {
    let (_, token) = form_urlencoded::parse(form).find(|(name, _)| name == "token")?;
    Some(token.trim_ascii().to_owned())
}

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
    fn the_form_is_read() {
        let token = |form: &str| token_of(form.as_bytes());
        assert_eq!(token("token=abc").as_deref(), Some("abc"));
        assert_eq!(token("a=b&token=a%2Bb%20&c=d").as_deref(), Some("a+b"));
        assert_eq!(token("token=%zz%4").as_deref(), Some("%zz%4"));
        assert_eq!(token("tokens=abc"), None);
    }

    #[test]
    fn what_a_request_said_is_no_markup() {
        let problem = Problem::invalid("'<b>&\"'");
        let Html(page) = refusal("/", &problem);
        assert!(page.contains("'&lt;b&gt;&amp;&quot;'") && !page.contains("<b>"), "{page}");
    }
}
