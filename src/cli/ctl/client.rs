//! A client that waits: hyper, which is in the program anyway, on a runtime of this thread.

use std::{
    env, fmt,
    io::ErrorKind,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::{Context, anyhow, bail};
use http_body_util::{BodyExt, Full, Limited};
use hyper::{
    Method, Request, Response,
    body::{Bytes, Incoming},
    client::conn::http1::handshake,
    header,
};
use hyper_util::rt::TokioIo;
use mocapd::outcome::{DataLostError, UsageError};
use mocapd_acquire::files;
use mocapd_service::http::{Problem, ProblemKind};
use serde_json::Value;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpStream, UnixStream},
    runtime::{Builder, Runtime},
    time::timeout,
};

const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// Longer than the service lets a request take.
const ANSWER_WITHIN: Duration = Duration::from_secs(75);

/// Bytes of a document at most: a thousand takes have some 300 kB.
const DOCUMENT_BYTES_MAX: usize = 16 << 20;

/// Times that an order is given while its answer is lost on the way. Its id is the same, so it is carried out once.
const ORDER_TRIES: u32 = 3;

/// Between them.
const ORDER_AGAIN: Duration = Duration::from_millis(500);

/// A token's file at most.
const TOKEN_BYTES_MAX: usize = 4096;

/// Speaks to one service.
#[derive(Debug)]
pub(super) struct Client {
    runtime: Runtime,
    target: Target,
    token: Option<String>,
}

impl Client {
    pub(super) fn new(target: Target, token_file: Option<&Path>) -> anyhow::Result<Self> {
        let runtime = Builder::new_current_thread().enable_io().enable_time().build();
        let runtime = runtime.context("cannot start a runtime")?;
        Ok(Self { runtime, target, token: token_file.map(token).transpose()? })
    }

    /// A document.
    pub(super) fn get(&self, path: &str) -> anyhow::Result<Value> {
        let answer = self.open(&Method::GET, path, &[], Bytes::new())?;
        self.document(answer.response)
    }

    /// Gives an order and waits until it is carried out.
    pub(super) fn order(&self, path: &str, mut body: Value) -> anyhow::Result<Value> {
        body["request_id"] = Value::from(request_id()?);
        let body = Bytes::from(serde_json::to_vec(&body)?);
        let mut tries = 1;
        loop {
            let answer = self
                .open(&Method::POST, path, &[], body.clone())
                .and_then(|answer| self.document(answer.response));
            match answer {
                Err(error) if error.is::<Lost>() && tries < ORDER_TRIES => {
                    tries += 1;
                    std::thread::sleep(ORDER_AGAIN);
                }
                answer => return answer,
            }
        }
    }

    /// An answer that is read as it comes.
    pub(super) fn open(
        &self,
        method: &Method,
        path: &str,
        headers: &[(&str, &str)],
        body: Bytes,
    ) -> anyhow::Result<Answer<'_>> {
        let host = match &self.target {
            Target::Unix(_) => "localhost",
            Target::Tcp(host) => host,
        };
        let mut request = Request::builder().method(method).uri(path).header(header::HOST, host);
        if *method == Method::POST {
            request = request.header(header::CONTENT_TYPE, "application/json");
        }
        if let Some(token) = &self.token {
            request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
        }
        for &(name, value) in headers {
            request = request.header(name, value);
        }
        let request = request.body(Full::new(body)).context("that cannot be asked")?;
        let response = self.runtime.block_on(self.send(request))?;
        let response = self.refused(response)?;
        Ok(Answer { client: self, response })
    }

    async fn send(&self, request: Request<Full<Bytes>>) -> anyhow::Result<Response<Incoming>> {
        let nobody = || format!("nobody answers at {}: is the service running?", self.target);
        match &self.target {
            Target::Unix(path) => {
                let stream = timeout(CONNECT_WITHIN, UnixStream::connect(path)).await;
                let stream = stream.with_context(nobody)?;
                if stream.as_ref().is_err_and(|e| e.kind() == ErrorKind::PermissionDenied) {
                    let path = path.display();
                    bail!(
                        "you may not open {path}: it is for the service's user and group. Become a member of the group (`ls -l {path}` names it, `sudo usermod -aG GROUP $USER` adds you) and log in again"
                    );
                }
                exchange(stream.with_context(nobody)?, request).await
            }
            Target::Tcp(host) => {
                let stream = timeout(CONNECT_WITHIN, TcpStream::connect(host.as_str())).await;
                exchange(stream.with_context(nobody)?.with_context(nobody)?, request).await
            }
        }
    }

    /// Turns a problem into an error.
    fn refused(&self, response: Response<Incoming>) -> anyhow::Result<Response<Incoming>> {
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let body = self.bytes(response)?;
        let Ok(problem) = serde_json::from_slice::<Problem>(&body) else {
            bail!("{} answered {status}: it may be no mocapd", self.target);
        };
        if problem.kind == ProblemKind::Unauthorized {
            bail!("{}: give the token with --token-file", self.target);
        }
        if problem.kind == ProblemKind::Invalid {
            return Err(UsageError(problem.message).into());
        }
        if matches!(problem.kind, ProblemKind::Vanished | ProblemKind::DataLost) {
            return Err(DataLostError(problem.message).into());
        }
        Err(anyhow!(problem.message))
    }

    fn document(&self, response: Response<Incoming>) -> anyhow::Result<Value> {
        let body = self.bytes(response)?;
        serde_json::from_slice(&body).with_context(|| format!("{} answered no JSON", self.target))
    }

    fn bytes(&self, response: Response<Incoming>) -> anyhow::Result<Bytes> {
        let body = Limited::new(response.into_body(), DOCUMENT_BYTES_MAX);
        let collected = async { timeout(ANSWER_WITHIN, body.collect()).await };
        match self.runtime.block_on(collected) {
            Ok(Ok(collected)) => Ok(collected.to_bytes()),
            Ok(Err(error)) => Err(Lost(error.to_string()).into()),
            Err(_) => bail!("the answer did not come within {} s", ANSWER_WITHIN.as_secs()),
        }
    }
}

async fn exchange(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    request: Request<Full<Bytes>>,
) -> anyhow::Result<Response<Incoming>> {
    let (mut sender, connection) =
        handshake(TokioIo::new(stream)).await.map_err(|error| lost(&error))?;
    // It ends with the answer; what breaks it is told by who reads that.
    tokio::spawn(async move { connection.await.ok() });
    match timeout(ANSWER_WITHIN, sender.send_request(request)).await {
        Ok(answer) => Ok(answer.map_err(|error| lost(&error))?),
        Err(_) => bail!("no answer within {} s", ANSWER_WITHIN.as_secs()),
    }
}

fn lost(error: &hyper::Error) -> Lost {
    Lost(error.to_string())
}

/// The connection broke: nobody knows what became of the request.
#[derive(Debug, thiserror::Error)]
#[error("the service broke the connection off: {0}")]
pub(super) struct Lost(String);

/// An answer that goes on.
#[derive(Debug)]
pub(super) struct Answer<'a> {
    client: &'a Client,
    response: Response<Incoming>,
}

impl Answer<'_> {
    /// Bytes that will come, where that is known.
    pub(super) fn len(&self) -> Option<u64> {
        let len = self.response.headers().get(header::CONTENT_LENGTH)?;
        len.to_str().ok()?.parse().ok()
    }

    /// The next piece, waited for at most so long. `None`: that was all.
    ///
    /// # Errors
    /// [`Lost`], and when nothing comes.
    pub(super) fn next(&mut self, within: Duration) -> anyhow::Result<Option<Bytes>> {
        loop {
            let body = self.response.body_mut();
            let frame = self.client.runtime.block_on(async { timeout(within, body.frame()).await });
            match frame {
                Err(_) => bail!("nothing came for {} s", within.as_secs_f64()),
                Ok(None) => return Ok(None),
                Ok(Some(Err(error))) => return Err(lost(&error).into()),
                Ok(Some(Ok(frame))) => {
                    // What is no data are trailers, which nobody sends.
                    if let Ok(data) = frame.into_data() {
                        return Ok(Some(data));
                    }
                }
            }
        }
    }
}

fn request_id() -> anyhow::Result<String> {
    let mut random = [0; 16];
    rustix::rand::getrandom(&mut random, rustix::rand::GetRandomFlags::empty())
        .context("cannot get random bytes")?;
    Ok(random.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn token(path: &Path) -> anyhow::Result<String> {
    let text = String::from_utf8(files::read_bounded(path, TOKEN_BYTES_MAX)?).unwrap_or_default();
    let token = text.trim();
    if token.is_empty() || !token.bytes().all(|byte| byte.is_ascii_graphic()) {
        bail!("{} holds no token: one line of visible characters", path.display());
    }
    Ok(token.to_owned())
}

/// Where services put their sockets.
const SOCKETS: &str = "/run/mocapd";

/// Where one listens that has no socket.
const LOOPBACK: &str = "127.0.0.1:7060";

/// An address to connect to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Target {
    /// A Unix socket.
    Unix(PathBuf),
    /// A host and a port.
    Tcp(String),
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Tcp(host) => write!(f, "http://{host}"),
        }
    }
}

impl Target {
    /// What was said, or where a service is to be expected.
    pub(super) fn find(said: Option<&str>) -> anyhow::Result<Self> {
        if let Some(said) = said {
            return Ok(Self::parse(said).map_err(UsageError)?);
        }
        if let Some(path) = env::var_os("MOCAPD_SOCKET").filter(|path| !path.is_empty()) {
            return Ok(Self::Unix(path.into()));
        }
        Ok(Self::expected(Path::new(SOCKETS)).map_err(UsageError)?)
    }

    /// # Errors
    /// What is wrong and what to type.
    fn parse(said: &str) -> Result<Self, String> {
        if let Some(path) = said.strip_prefix("unix:") {
            let path = path.strip_prefix("//").unwrap_or(path);
            return if path.is_empty() {
                Err(format!("'{said}' names no socket: give unix:PATH"))
            } else {
                Ok(Self::Unix(path.into()))
            };
        }
        let wrong = || format!("'{said}' is no address: give unix:PATH or http://HOST:PORT");
        let host = said.strip_prefix("http://").ok_or_else(wrong)?.trim_end_matches('/');
        let authority: axum::http::uri::Authority = host.parse().map_err(|_| wrong())?;
        if authority.host().is_empty() || host.contains('@') {
            return Err(wrong());
        }
        Ok(Self::Tcp(if authority.port_u16().is_some() {
            host.to_owned()
        } else {
            format!("{host}:80")
        }))
    }

    /// The only socket in the folder; loopback where there is none.
    ///
    /// # Errors
    /// Which there are, when there are several.
    fn expected(folder: &Path) -> Result<Self, String> {
        let is_socket =
            |path: &PathBuf| path.extension().is_some_and(|extension| extension == "sock");
        let within = |folder: &Path| -> Vec<PathBuf> {
            let entries = folder.read_dir().into_iter().flatten().flatten();
            entries.map(|entry| entry.path()).collect()
        };
        let mut sockets = within(folder);
        // A unit has a folder of its own: /run/mocapd/NAME/mocapd.sock.
        sockets.extend(sockets.clone().iter().flat_map(|folder| within(folder)));
        sockets.retain(is_socket);
        sockets.sort();
        match &sockets[..] {
            [] => Ok(Self::Tcp(LOOPBACK.to_owned())),
            [only] => Ok(Self::Unix(only.clone())),
            several => {
                let names: Vec<_> = several
                    .iter()
                    .map(|path| format!("--connect unix:{}", path.display()))
                    .collect();
                Err(format!("several services listen here: say which, {}", names.join(" or ")))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses() {
        let parse = |said| Target::parse(said).map(|target| target.to_string());
        assert_eq!(parse("unix:/run/a.sock").unwrap(), "unix:/run/a.sock");
        assert_eq!(parse("unix:///run/a.sock").unwrap(), "unix:/run/a.sock");
        assert_eq!(parse("http://rig:7060/").unwrap(), "http://rig:7060");
        assert_eq!(parse("http://[::1]:7060").unwrap(), "http://[::1]:7060");
        assert_eq!(parse("http://rig").unwrap(), "http://rig:80");
        for said in [
            "",
            "rig:7060",
            "unix:",
            "https://rig",
            "http://",
            "http://a b",
            "http://u@rig",
            "http://rig/x",
        ] {
            assert!(Target::parse(said).is_err(), "{said}");
        }
    }

    #[test]
    fn the_only_socket_is_the_one_that_is_meant() {
        let folder = tempfile::tempdir().unwrap();
        let expected = || Target::expected(folder.path());
        assert_eq!(expected().unwrap(), Target::Tcp(LOOPBACK.to_owned()));
        std::fs::write(folder.path().join("note.txt"), "").unwrap();
        let units = folder.path().join("hall/mocapd.sock");
        std::fs::create_dir(folder.path().join("hall")).unwrap();
        std::fs::write(&units, "").unwrap();
        assert_eq!(expected().unwrap(), Target::Unix(units), "a unit's");
        std::fs::write(folder.path().join("b.sock"), "").unwrap();
        let several = expected().unwrap_err();
        assert!(several.contains("hall/mocapd.sock") && several.contains("b.sock"), "{several}");
        std::fs::remove_dir_all(folder.path().join("hall")).unwrap();
        assert_eq!(expected().unwrap(), Target::Unix(folder.path().join("b.sock")));
        assert_eq!(
            Target::expected(Path::new("/nowhere")).unwrap(),
            Target::Tcp(LOOPBACK.to_owned())
        );
    }
}
