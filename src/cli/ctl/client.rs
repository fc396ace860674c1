//! A blocking HTTP client for the service's API: hyper on a current-thread tokio runtime.

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

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Longer than the service's own limit on the time of a request.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(75);

/// Largest document, bytes: a list of a thousand takes has some 300 kB.
const DOCUMENT_BYTES_MAX: usize = 16 << 20;

/// Attempts to send a command if the connection breaks before the reply. All carry the same `request_id`, so the
/// service executes the command once.
const POST_ATTEMPTS: u32 = 3;

/// Delay between these attempts.
const RETRY_DELAY: Duration = Duration::from_millis(500);

/// Largest token file, bytes.
const TOKEN_BYTES_MAX: usize = 4096;

/// A client of one service.
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

    /// Requests a JSON document.
    pub(super) fn get(&self, path: &str) -> anyhow::Result<Value> {
        let answer = self.open(&Method::GET, path, &[], Bytes::new())?;
        self.document(answer.response)
    }

    /// Sends a command and waits for its result; retries if the connection breaks.
    pub(super) fn post(&self, path: &str, mut body: Value) -> anyhow::Result<Value> {
        body["request_id"] = Value::from(request_id()?);
        let body = Bytes::from(serde_json::to_vec(&body)?);
        let mut attempts = 1;
        loop {
            let answer = self
                .open(&Method::POST, path, &[], body.clone())
                .and_then(|answer| self.document(answer.response));
            match answer {
                Err(error) if error.is::<ConnectionLost>() && attempts < POST_ATTEMPTS => {
                    attempts += 1;
                    std::thread::sleep(RETRY_DELAY);
                }
                answer => return answer,
            }
        }
    }

    /// Sends a request as [`open`](Self::open) does; `None` if the service does not have what is requested.
    pub(super) fn open_if_there(
        &self,
        method: &Method,
        path: &str,
        body: Bytes,
    ) -> anyhow::Result<Option<ResponseStream<'_>>> {
        match self.open(method, path, &[], body) {
            Err(error) if error.is::<NotFoundError>() => Ok(None),
            opened => opened.map(Some),
        }
    }

    /// Sends a request; the body of the response is read as it arrives.
    pub(super) fn open(
        &self,
        method: &Method,
        path: &str,
        headers: &[(&str, &str)],
        body: Bytes,
    ) -> anyhow::Result<ResponseStream<'_>> {
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
        let request = request.body(Full::new(body)).context("cannot build the request")?;
        let response = self.runtime.block_on(self.send(request))?;
        let response = self.check_status(response)?;
        Ok(ResponseStream { client: self, response })
    }

    async fn send(&self, request: Request<Full<Bytes>>) -> anyhow::Result<Response<Incoming>> {
        let failed = || {
            format!(
                "cannot connect to {} (is the service running there? --connect gives another address)",
                self.target
            )
        };
        match &self.target {
            Target::Unix(path) => {
                let stream = timeout(CONNECT_TIMEOUT, UnixStream::connect(path)).await;
                let stream = stream.with_context(failed)?;
                if stream.as_ref().is_err_and(|e| e.kind() == ErrorKind::PermissionDenied) {
                    let path = path.display();
                    bail!(
                        "no permission to open {path}: join the group of the socket (`ls -l {path}` shows it, `sudo usermod -aG GROUP $USER` adds you) and log in again"
                    );
                }
                exchange(stream.with_context(failed)?, request).await
            }
            Target::Tcp(host) => {
                let stream = timeout(CONNECT_TIMEOUT, TcpStream::connect(host.as_str())).await;
                exchange(stream.with_context(failed)?.with_context(failed)?, request).await
            }
        }
    }

    /// Turns an error response into an error: usage errors and lost data keep their exit codes.
    fn check_status(&self, response: Response<Incoming>) -> anyhow::Result<Response<Incoming>> {
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let body = self.bytes(response)?;
        let Ok(problem) = serde_json::from_slice::<Problem>(&body) else {
            bail!("{} answered {status}: it may not be a mocapd service", self.target);
        };
        if problem.kind == ProblemKind::Unauthorized {
            bail!("{} requires a token: give it with --token-file", self.target);
        }
        if problem.kind == ProblemKind::Invalid {
            return Err(UsageError(problem.message).into());
        }
        if problem.kind == ProblemKind::NotFound {
            return Err(NotFoundError(problem.message).into());
        }
        if matches!(problem.kind, ProblemKind::Vanished | ProblemKind::DataLost) {
            return Err(DataLostError(problem.message).into());
        }
        Err(anyhow!(problem.message))
    }

    fn document(&self, response: Response<Incoming>) -> anyhow::Result<Value> {
        let body = self.bytes(response)?;
        serde_json::from_slice(&body)
            .with_context(|| format!("the reply from {} is not JSON", self.target))
    }

    fn bytes(&self, response: Response<Incoming>) -> anyhow::Result<Bytes> {
        let body = Limited::new(response.into_body(), DOCUMENT_BYTES_MAX);
        let collected = async { timeout(RESPONSE_TIMEOUT, body.collect()).await };
        match self.runtime.block_on(collected) {
            Ok(Ok(collected)) => Ok(collected.to_bytes()),
            Ok(Err(error)) => Err(ConnectionLost(error.to_string()).into()),
            Err(_) => bail!("no complete reply within {} s", RESPONSE_TIMEOUT.as_secs()),
        }
    }
}

async fn exchange(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    request: Request<Full<Bytes>>,
) -> anyhow::Result<Response<Incoming>> {
    let (mut sender, connection) =
        handshake(TokioIo::new(stream)).await.map_err(|error| connection_lost(&error))?;
    // The task ends with the response; errors of the connection reach the reader of the body.
    tokio::spawn(async move { connection.await.ok() });
    match timeout(RESPONSE_TIMEOUT, sender.send_request(request)).await {
        Ok(answer) => Ok(answer.map_err(|error| connection_lost(&error))?),
        Err(_) => bail!("no reply within {} s: see the service's log", RESPONSE_TIMEOUT.as_secs()),
    }
}

fn connection_lost(error: &hyper::Error) -> ConnectionLost {
    ConnectionLost(error.to_string())
}

/// The service does not have what was requested.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct NotFoundError(String);

/// The connection broke; the service may have handled the request or not.
#[derive(Debug, thiserror::Error)]
#[error("lost the connection to the service: {0}")]
pub(super) struct ConnectionLost(String);

/// A response whose body is still being received.
#[derive(Debug)]
pub(super) struct ResponseStream<'a> {
    client: &'a Client,
    response: Response<Incoming>,
}

impl ResponseStream<'_> {
    /// The announced length of the body, bytes, if the service states it.
    pub(super) fn len(&self) -> Option<u64> {
        let len = self.response.headers().get(header::CONTENT_LENGTH)?;
        len.to_str().ok()?.parse().ok()
    }

    /// The next part of the body; `None` at its end.
    ///
    /// # Errors
    /// [`ConnectionLost`], and if nothing arrives `within` that time.
    pub(super) fn next(&mut self, within: Duration) -> anyhow::Result<Option<Bytes>> {
        loop {
            let body = self.response.body_mut();
            let frame = self.client.runtime.block_on(async { timeout(within, body.frame()).await });
            match frame {
                Err(_) => bail!(
                    "received nothing for {} s: check that the service is still running",
                    within.as_secs_f64()
                ),
                Ok(None) => return Ok(None),
                Ok(Some(Err(error))) => return Err(connection_lost(&error).into()),
                Ok(Some(Ok(frame))) => {
                    // Other frames are trailers, which the service does not send.
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
        bail!("{} holds no token: expected one line of printable ASCII", path.display());
    }
    Ok(token.to_owned())
}

/// The folder of the services' sockets.
const SOCKETS: &str = "/run/mocapd";

/// The default TCP address of a service.
const LOOPBACK: &str = "127.0.0.1:7060";

/// The address of a service.
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
    /// The address `argument`; else `$MOCAPD_SOCKET`; else the default of [`default_in`](Self::default_in).
    pub(super) fn find(argument: Option<&str>) -> anyhow::Result<Self> {
        if let Some(address) = argument {
            return Ok(Self::parse(address).map_err(UsageError)?);
        }
        if let Some(path) = env::var_os("MOCAPD_SOCKET").filter(|path| !path.is_empty()) {
            return Ok(Self::Unix(path.into()));
        }
        Ok(Self::default_in(Path::new(SOCKETS)).map_err(UsageError)?)
    }

    /// # Errors
    /// What is wrong, and what to type instead.
    fn parse(text: &str) -> Result<Self, String> {
        if let Some(path) = text.strip_prefix("unix:") {
            let path = path.strip_prefix("//").unwrap_or(path);
            return if path.is_empty() {
                Err(format!("'{text}' names no socket: give unix:PATH"))
            } else {
                Ok(Self::Unix(path.into()))
            };
        }
        let wrong = || format!("invalid address '{text}': give unix:PATH or http://HOST:PORT");
        let host = text.strip_prefix("http://").ok_or_else(wrong)?.trim_end_matches('/');
        let authority: axum::http::uri::Authority = host.parse().map_err(|_| wrong())?;
        if authority.host().is_empty() || host.contains('@') {
            return Err(wrong());
        }
        let has_port = authority.port_u16().is_some();
        Ok(Self::Tcp(if has_port { host.to_owned() } else { format!("{host}:80") }))
    }

    /// The only socket in the folder, or the loopback address if there is none.
    ///
    /// # Errors
    /// A list of the sockets if there are several.
    fn default_in(folder: &Path) -> Result<Self, String> {
        let is_socket = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "sock");
        let within = |folder: &Path| -> Vec<PathBuf> {
            let entries = folder.read_dir().into_iter().flatten().flatten();
            entries.map(|entry| entry.path()).collect()
        };
        let mut sockets = within(folder);
        // An instance of the systemd unit has its own folder: /run/mocapd/NAME/mocapd.sock.
        sockets.extend(sockets.clone().iter().flat_map(|folder| within(folder)));
        sockets.retain(is_socket);
        sockets.sort();
        match &sockets[..] {
            [] => Ok(Self::Tcp(LOOPBACK.to_owned())),
            [only] => Ok(Self::Unix(only.clone())),
            several => {
                let option = |path: &PathBuf| format!("--connect unix:{}", path.display());
                let names: Vec<_> = several.iter().map(option).collect();
                Err(format!("several services are running: choose one with {}", names.join(" or ")))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses() {
        let parse = |text| Target::parse(text).map(|target| target.to_string());
        assert_eq!(parse("unix:/run/a.sock").unwrap(), "unix:/run/a.sock");
        assert_eq!(parse("unix:///run/a.sock").unwrap(), "unix:/run/a.sock");
        assert_eq!(parse("http://rig:7060/").unwrap(), "http://rig:7060");
        assert_eq!(parse("http://[::1]:7060").unwrap(), "http://[::1]:7060");
        assert_eq!(parse("http://rig").unwrap(), "http://rig:80");
        for text in [
            "",
            "rig:7060",
            "unix:",
            "https://rig",
            "http://",
            "http://a b",
            "http://u@rig",
            "http://rig/x",
        ] {
            assert!(Target::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_only_socket_is_the_default() {
        let folder = tempfile::tempdir().unwrap();
        let default = || Target::default_in(folder.path());
        assert_eq!(default().unwrap(), Target::Tcp(LOOPBACK.to_owned()));
        std::fs::write(folder.path().join("note.txt"), "").unwrap();
        let units = folder.path().join("hall/mocapd.sock");
        std::fs::create_dir(folder.path().join("hall")).unwrap();
        std::fs::write(&units, "").unwrap();
        assert_eq!(default().unwrap(), Target::Unix(units), "a unit's");
        std::fs::write(folder.path().join("b.sock"), "").unwrap();
        let several = default().unwrap_err();
        assert!(several.contains("hall/mocapd.sock") && several.contains("b.sock"), "{several}");
        std::fs::remove_dir_all(folder.path().join("hall")).unwrap();
        assert_eq!(default().unwrap(), Target::Unix(folder.path().join("b.sock")));
        assert_eq!(
            Target::default_in(Path::new("/nowhere")).unwrap(),
            Target::Tcp(LOOPBACK.to_owned())
        );
    }
}
