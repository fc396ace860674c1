//! Who may come in over TCP: who knows the token, and whose browser has shown it.

use std::{
    collections::VecDeque,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use axum::http::{HeaderMap, header};
use rustix::rand::{GetRandomFlags, getrandom};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// Browsers that are logged in at once; the one that came first has to log in again.
const SESSIONS_MAX: usize = 64;

/// How long a browser stays logged in: a day in the studio.
pub(super) const SESSION_MAX: Duration = Duration::from_secs(12 * 3600);

/// Of the cookie.
pub(super) const COOKIE: &str = "mocapd_session";

/// Hashes are compared, so that neither content nor length of a secret shows in the time that it takes.
type Hash = [u8; 32];

fn hash(secret: &[u8]) -> Hash {
    Sha256::digest(secret).into()
}

/// The token, and the sessions that it opened.
#[derive(Debug)]
pub(super) struct Auth {
    token: Option<Hash>,
    sessions: Mutex<VecDeque<Session>>,
}

#[derive(Debug)]
struct Session {
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

    /// Whether a token is needed at all.
    pub(super) fn is_on(&self) -> bool {
        self.token.is_some()
    }

    /// Whether this is the token; anything is where there is none.
    pub(super) fn is_token(&self, said: &[u8]) -> bool {
        self.token.as_ref().is_none_or(|token| bool::from(hash(said).ct_eq(token)))
    }

    /// Whether a request shows the token, or the cookie of a session.
    pub(super) fn lets_in(&self, headers: &HeaderMap) -> bool {
        if self.token.is_none() {
            return true;
        }
        if let Some(said) = headers.get(header::AUTHORIZATION) {
            let said = said.as_bytes();
            let scheme =
                said.get(..7).is_some_and(|scheme| scheme.eq_ignore_ascii_case(b"bearer "));
            return scheme && self.is_token(said[7..].trim_ascii());
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

    /// Begins a session: the id for the cookie.
    ///
    /// # Errors
    /// Of the system, which has no random bytes.
    pub(super) fn open_session(&self) -> rustix::io::Result<String> {
        let mut random = [0; 32];
        // Up to 256 bytes come whole.
        getrandom(&mut random, GetRandomFlags::empty())?;
        let id: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
        let mut sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
        if sessions.len() == SESSIONS_MAX {
            sessions.pop_front();
        }
        sessions
            .push_back(Session { id: hash(id.as_bytes()), until: Instant::now() + SESSION_MAX });
        Ok(id)
    }

    /// Ends the session of a request.
    pub(super) fn close_session(&self, headers: &HeaderMap) {
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

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn with(name: header::HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_str(value).unwrap())])
    }

    #[test]
    fn the_token_and_nothing_like_it() {
        let auth = Auth::new(Some("0123456789abcdef"));
        let lets_in = |value: &str| auth.lets_in(&with(header::AUTHORIZATION, value));
        assert!(lets_in("Bearer 0123456789abcdef") && lets_in("bearer  0123456789abcdef"));
        for value in [
            "",
            "Bearer",
            "Bearer ",
            "0123456789abcdef",
            "Bearer 0123456789abcde",
            "Basic 0123456789abcdef",
        ] {
            assert!(!lets_in(value), "{value}");
        }
        assert!(!auth.lets_in(&HeaderMap::new()));
        assert!(Auth::new(None).lets_in(&HeaderMap::new()));
    }

    #[test]
    fn sessions_are_bounded_and_end() {
        let auth = Auth::new(Some("0123456789abcdef"));
        let cookie = |id: &str| with(header::COOKIE, &format!("a=b; {COOKIE}={id}; c=d"));
        let first = auth.open_session().unwrap();
        assert!(auth.lets_in(&cookie(&first)));
        assert!(!auth.lets_in(&cookie("")) && !auth.lets_in(&cookie(&first[1..])));
        let more: Vec<_> = (0..SESSIONS_MAX).map(|_| auth.open_session().unwrap()).collect();
        assert!(!auth.lets_in(&cookie(&first)), "the first made room");
        assert!(more.iter().all(|id| auth.lets_in(&cookie(id))));
        auth.close_session(&cookie(&more[0]));
        assert!(!auth.lets_in(&cookie(&more[0])) && auth.lets_in(&cookie(&more[1])));
        // A wrong token is not mended by a good cookie.
        let mut both = cookie(&more[1]);
        both.insert(header::AUTHORIZATION, HeaderValue::from_static("Bearer no"));
        assert!(!auth.lets_in(&both));
    }
}
