//! Authentication over TCP: a token from a file that only the service may read, and sessions of browsers, which send the token
//! once, and a cookie from then on. Also the HTML pages for the login form and for errors.

use std::{
    collections::VecDeque,
    fmt,
    fs::File,
    io::{self, Read},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, header},
    response::{Html, IntoResponse, Redirect, Response},
};
use rustix::{
    fs::{Mode, OFlags, open},
    process::geteuid,
    rand::{GetRandomFlags, getrandom},
};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::{
    Shared,
    body::{self, Problem, ProblemKind},
};

/// Maximum number of browsers logged in at once; beyond that, the oldest session ends.
const SESSIONS_MAX: usize = 64;

/// Length of a browser session: a day in the studio.
const SESSION_MAX: Duration = Duration::from_secs(12 * 3600);

/// Name of the session cookie.
pub(super) const COOKIE: &str = "mocapd_session";

/// Hashes are compared in constant time, so that neither content nor length of a secret shows in the timing.
type Hash = [u8; 32];

/// A new secret: 256 random bits in hexadecimal digits.
///
/// # Errors
/// The system has no random bytes.
pub(crate) fn new_secret() -> rustix::io::Result<String> {
    let mut random = [0; 32];
    // Up to 256 bytes are never returned in part.
    getrandom(&mut random, GetRandomFlags::empty())?;
    Ok(random.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn hash(secret: &[u8]) -> Hash {
    Sha256::digest(secret).into()
}

/// The token, and the sessions opened with it.
#[derive(Debug)]
pub(super) struct Auth {
    token: Option<Hash>,
    sessions: Mutex<VecDeque<LoginSession>>,
}

#[derive(Debug)]
struct LoginSession {
    id: Hash,
    until: Instant,
}

impl Auth {
    pub(super) fn new(token: Option<&str>) -> Self {
        Self {
            token: token.map(|token| hash(token.as_bytes())),
            sessions: Mutex::new(VecDeque::with_capacity(SESSIONS_MAX)),
        }
    }

    /// Whether a token is required.
    fn is_on(&self) -> bool {
        self.token.is_some()
    }

    /// Whether this is the token; always true if none is required.
    fn is_token(&self, sent: &[u8]) -> bool {
        self.token.as_ref().is_none_or(|token| bool::from(hash(sent).ct_eq(token)))
    }

    /// Whether a request has the token or the cookie of a session.
    pub(super) fn is_authorized(&self, headers: &HeaderMap) -> bool {
        if self.token.is_none() {
            return true;
        }
        if let Some(sent) = headers.get(header::AUTHORIZATION) {
            let sent = sent.as_bytes();
            let is_bearer = sent.get(..7).is_some_and(|s| s.eq_ignore_ascii_case(b"bearer "));
            return is_bearer && self.is_token(sent[7..].trim_ascii());
        }
        session_id(headers).is_some_and(|id| self.is_session(id))
    }

    fn is_session(&self, id: &str) -> bool {
        let id = hash(id.as_bytes());
        let now = Instant::now();
        let mut sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
        sessions.retain(|session| session.until > now);
        sessions.iter().any(|session| bool::from(session.id.ct_eq(&id)))
    }

    /// Opens a session and returns its id for the cookie.
    ///
    /// # Errors
    /// The system has no random bytes.
    fn open_session(&self) -> rustix::io::Result<String> {
        let id = new_secret()?;
        let mut sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
        if sessions.len() == SESSIONS_MAX {
            sessions.pop_front();
        }
        let until = Instant::now() + SESSION_MAX;
        sessions.push_back(LoginSession { id: hash(id.as_bytes()), until });
        Ok(id)
    }

    /// Closes the session of a request.
    fn close_session(&self, headers: &HeaderMap) {
        if let Some(id) = session_id(headers) {
            let id = hash(id.as_bytes());
            let mut sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
            sessions.retain(|session| session.id != id);
        }
    }
}

fn session_id(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|line| line.to_str().ok());
    cookies.flat_map(|line| line.split(';')).find_map(|cookie| {
        let (name, value) = cookie.trim().split_once('=')?;
        (name == COOKIE).then_some(value)
    })
}

/// Largest token file in bytes: a token and a line end.
const FILE_BYTES_MAX: u64 = 1024;

/// Shortest token: sixteen base64 characters are 96 bits, which cannot be guessed over a network.
pub(super) const TOKEN_BYTES_MIN: usize = 16;

/// The secret that clients over TCP must send. It is never printed.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// Why a token file is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TokenError {
    /// The file does not exist or cannot be read.
    #[error("cannot read the token file {}: {error}; make one with `(umask 077; openssl rand -hex 32 > {})`", .file.display(), .file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The cause. It is part of the message, and therefore not a `source`.
        error: io::Error,
    },
    /// It is a folder, a pipe or a device.
    #[error("the token file {} is not a regular file", .0.display())]
    NotAFile(PathBuf),
    /// Others may read or change it.
    #[error("the token file {} has mode {mode:04o}, so others can access it: chmod 600 {}", .file.display(), .file.display())]
    Permissions {
        /// The file.
        file: PathBuf,
        /// Its mode.
        mode: u32,
    },
    /// Another user owns it, and may change it.
    #[error("the token file {} belongs to user {owner}, but the service runs as user {user}: chown it", .file.display())]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Its owner.
        owner: u32,
        /// The user of the service.
        user: u32,
    },
    /// Its content is not a token.
    #[error("the token file {} {why}: write one line of at least 16 visible ASCII characters without spaces", .file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        why: &'static str,
    },
}

impl Token {
    /// Reads and checks a token file.
    ///
    /// # Errors
    /// The file is refused; the message says what to do.
    pub fn read(file: &Path) -> Result<Self, TokenError> {
        Self::read_as(file, geteuid().as_raw())
    }

    /// Reads a token file for a service that runs as `user`.
    fn read_as(file: &Path, user: u32) -> Result<Self, TokenError> {
        let unreadable = |error| TokenError::Unreadable { file: file.to_owned(), error };
        // Opening a pipe without a writer must not block.
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let mut opened =
            File::from(open(file, flags, Mode::empty()).map_err(|e| unreadable(e.into()))?);
        // Checks the opened file, which cannot be replaced any more.
        let meta = opened.metadata().map_err(unreadable)?;
        if !meta.is_file() {
            return Err(TokenError::NotAFile(file.to_owned()));
        }
        let mode = meta.mode() & 0o7777;
        if mode & !0o600 != 0 {
            return Err(TokenError::Permissions { file: file.to_owned(), mode });
        }
        if meta.uid() != user {
            return Err(TokenError::Foreign { file: file.to_owned(), owner: meta.uid(), user });
        }
        let mut text = String::new();
        let limited = opened.by_ref().take(FILE_BYTES_MAX + 1).read_to_string(&mut text);
        let no_token = |why| TokenError::Malformed { file: file.to_owned(), why };
        limited.map_err(|error| match error.kind() {
            io::ErrorKind::InvalidData => no_token("is not text"),
            _ => unreadable(error),
        })?;
        let token = text.strip_suffix('\n').unwrap_or(&text);
        let token = token.strip_suffix('\r').unwrap_or(token);
        if text.len() as u64 > FILE_BYTES_MAX {
            return Err(no_token("is longer than 1024 bytes"));
        }
        if token.len() < TOKEN_BYTES_MIN {
            return Err(no_token("is too short"));
        }
        if !token.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(no_token("contains spaces, several lines or other characters"));
        }
        Ok(Self(token.to_owned()))
    }

    /// The token itself, to compare with what clients send.
    #[must_use]
    pub fn into_text(self) -> String {
        self.0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

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
struct Login {
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
    use std::{collections::HashSet, fs, os::unix::fs::PermissionsExt};

    use axum::http::HeaderValue;

    use super::*;

    fn with(name: header::HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_str(value).unwrap())])
    }

    #[test]
    fn only_the_exact_token_is_accepted() {
        let auth = Auth::new(Some("0123456789abcdef"));
        let accepts = |value: &str| auth.is_authorized(&with(header::AUTHORIZATION, value));
        assert!(accepts("Bearer 0123456789abcdef") && accepts("bearer  0123456789abcdef"));
        for value in [
            "",
            "Bearer",
            "Bearer ",
            "0123456789abcdef",
            "Bearer 0123456789abcde",
            "Basic 0123456789abcdef",
        ] {
            assert!(!accepts(value), "{value}");
        }
        assert!(!auth.is_authorized(&HeaderMap::new()));
        assert!(Auth::new(None).is_authorized(&HeaderMap::new()));
    }

    #[test]
    fn sessions_are_bounded_and_end() {
        let auth = Auth::new(Some("0123456789abcdef"));
        let cookie = |id: &str| with(header::COOKIE, &format!("a=b; {COOKIE}={id}; c=d"));
        let first = auth.open_session().unwrap();
        assert!(auth.is_authorized(&cookie(&first)));
        assert!(!auth.is_authorized(&cookie("")) && !auth.is_authorized(&cookie(&first[1..])));
        let more: Vec<_> = (0..SESSIONS_MAX).map(|_| auth.open_session().unwrap()).collect();
        assert!(!auth.is_authorized(&cookie(&first)), "the first made room");
        assert!(more.iter().all(|id| auth.is_authorized(&cookie(id))));
        auth.close_session(&cookie(&more[0]));
        assert!(!auth.is_authorized(&cookie(&more[0])) && auth.is_authorized(&cookie(&more[1])));
        // A valid cookie does not make up for a wrong token.
        let mut both = cookie(&more[1]);
        both.insert(header::AUTHORIZATION, HeaderValue::from_static("Bearer no"));
        assert!(!auth.is_authorized(&both));
    }

    const SECRET: &str = "0123456789abcdef";

    fn file(mode: u32, content: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("token");
        fs::write(&path, content).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        (dir, path)
    }

    fn refused(mode: u32, content: &[u8]) -> TokenError {
        let (_dir, path) = file(mode, content);
        let error = Token::read(&path).unwrap_err();
        assert!(error.to_string().contains(path.to_str().unwrap()), "{error}");
        error
    }

    fn no_token(content: &[u8]) -> &'static str {
        match refused(0o600, content) {
            TokenError::Malformed { why, .. } => why,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_secret_file_is_read_and_never_shown() {
        for (mode, content) in [(0o600, "0123456789abcdef\n"), (0o400, SECRET)] {
            let (_dir, path) = file(mode, content.as_bytes());
            let token = Token::read(&path).unwrap();
            assert_eq!(format!("{token:?}"), "Token(..)");
            assert_eq!(token.into_text(), SECRET);
        }
    }

    #[test]
    fn files_that_others_may_read_or_change_are_refused() {
        for mode in [0o640, 0o604, 0o620, 0o602, 0o644, 0o700, 0o1600] {
            let open = refused(mode, SECRET.as_bytes());
            assert!(matches!(open, TokenError::Permissions { mode: found, .. } if found == mode));
            assert!(open.to_string().contains("chmod 600"), "{open}");
        }
        let (_dir, path) = file(0o600, SECRET.as_bytes());
        let owner = fs::metadata(&path).unwrap().uid();
        let foreign = Token::read_as(&path, owner + 1).unwrap_err();
        assert!(
            matches!(foreign, TokenError::Foreign { owner: found, user, .. } if (found, user) == (owner, owner + 1)),
            "{foreign:?}"
        );
    }

    #[test]
    fn invalid_tokens_are_refused() {
        let short = no_token(b"");
        assert_eq!(no_token(b"0123456789abcde\n"), short);
        let space = no_token(b"0123456789 abcdef");
        assert_eq!(no_token(b"0123456789abcdef\n0123456789abcdef\n"), space);
        let (binary, long) = (no_token(&[0xff; 32]), no_token(&[b'x'; 1025]));
        assert!(long.contains("1024"), "{long}");
        let reasons = HashSet::from([short, space, binary, long]);
        assert_eq!(reasons.len(), 4, "{reasons:?}");
    }

    #[test]
    fn anything_but_a_file_is_refused_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let missing = Token::read(&dir.path().join("none")).unwrap_err();
        assert!(
            matches!(&missing, TokenError::Unreadable { error, .. } if error.kind() == io::ErrorKind::NotFound),
            "{missing:?}"
        );
        assert!(missing.to_string().contains("openssl rand -hex 32"), "{missing}");
        assert!(matches!(Token::read(dir.path()), Err(TokenError::NotAFile(_))));
        let pipe = dir.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg("-m600").arg(&pipe).status();
        assert!(made.unwrap().success());
        assert!(matches!(Token::read(&pipe), Err(TokenError::NotAFile(_))));
    }

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
