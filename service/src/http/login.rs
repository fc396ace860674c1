//! Login of browsers: the token is sent once, and a cookie from then on. Also the HTML pages for the login form and for
//! errors.

use std::time::Duration;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, header},
    response::{Html, IntoResponse, Redirect, Response},
};

use super::{
    Shared,
    auth::{COOKIE, SESSION_MAX},
    body::{self, Problem, ProblemKind},
};

/// Delay before a wrong token is refused: guessing over one connection is slow, and connections are limited.
const WRONG_TOKEN_WAIT: Duration = Duration::from_millis(500);

/// The login page
#[utoipa::path(get, path = "/login", tag = "login",
    responses((status = 200, body = String, content_type = "text/html")), security(()))]
pub(super) async fn page() -> Html<String> {
    Html(LOGIN.replace(PLACE, ""))
}

/// The fields of the login form.
#[derive(Debug, utoipa::ToSchema)]
#[expect(dead_code, reason = "for the API description only: the one field is parsed by hand")]
pub(super) struct Login {
    /// The token.
    token: String,
}

/// Log in a browser
///
/// Replies with a cookie that scripts cannot read and pages of other sites cannot use. Clients that accept HTML get the
/// form again if they are refused, with the reason.
#[utoipa::path(post, path = "/login", tag = "login", security(()),
    request_body(content = inline(Login), content_type = "application/x-www-form-urlencoded"),
    responses((status = 303, description = "Logged in: redirects to the dashboard"),
        (status = 401, description = "Wrong token", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn login(app: State<Shared>, request: Request) -> Result<Response, Problem> {
    let (parts, body) = request.into_parts();
    if !body::is_type(&parts.headers, "application/x-www-form-urlencoded") {
        return Err(Problem::of(ProblemKind::UnsupportedMediaType, "send the form of /login"));
    }
    let form = body::read(body, &parts.headers, &app).await?;
    let token = token_of(&form).ok_or_else(|| Problem::invalid("the form has no field `token`"))?;
    if !app.auth.is_token(token.as_bytes()) {
        tokio::time::sleep(WRONG_TOKEN_WAIT).await;
        let message = "wrong token: the service's configuration names the file that contains it";
        return Err(Problem::of(ProblemKind::Unauthorized, message));
    }
    let mut response = Redirect::to("/").into_response();
    if app.auth.is_on() {
        let id = app.auth.open_session();
        let id =
            id.map_err(|error| Problem::internal(format!("cannot get random bytes: {error}")))?;
        set_cookie(&mut response, &id, SESSION_MAX)?;
    }
    Ok(response)
}

/// Log out a browser
#[utoipa::path(post, path = "/logout", tag = "login",
    responses((status = 303, description = "Logged out: redirects to the login page")))]
pub(super) async fn logout(app: State<Shared>, headers: HeaderMap) -> Result<Response, Problem> {
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

/// The field `token` of a form, without a line end that was pasted with it.
fn token_of(form: &[u8]) -> Option<String> {
    let (_, token) = form_urlencoded::parse(form).find(|(name, _)| name == "token")?;
    Some(token.trim_ascii().to_owned())
}

pub(super) const LOGIN_PATH: &str = "/login";

const LOGIN: &str = include_str!("login.html");

const REFUSAL: &str = include_str!("problem.html");

/// Where a page shows the error.
const PLACE: &str = "<!-- problem -->";

/// Whether the client is a browser that shows the response: `fetch` and programs accept anything, not HTML in
/// particular.
pub(super) fn wants_html(headers: &HeaderMap) -> bool {
    let accepts = headers.get(header::ACCEPT).and_then(|accepts| accepts.to_str().ok());
    accepts.is_some_and(|accepts| accepts.contains("text/html"))
}

/// An error as a page; at the login, the form again.
pub(super) fn refusal(path: &str, problem: &Problem) -> Html<String> {
    let (page, message) = match problem.kind {
        ProblemKind::Unauthorized if path == LOGIN_PATH => (LOGIN, "Wrong token.".to_owned()),
        _ if path == LOGIN_PATH => (LOGIN, escaped(&problem.message)),
        _ => (REFUSAL, escaped(&problem.message)),
    };
    Html(page.replace(PLACE, &format!("<p role=\"alert\">{message}</p>")))
}

/// Escapes text for HTML: a message may contain parts of a request.
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
    fn text_of_a_request_is_escaped() {
        let problem = Problem::invalid("'<b>&\"'");
        let Html(page) = refusal("/", &problem);
        assert!(page.contains("'&lt;b&gt;&amp;&quot;'") && !page.contains("<b>"), "{page}");
    }
}
