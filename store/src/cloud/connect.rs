//! The clients, configured by the environment, the thread on which they run, what their errors mean, and what to do
//! about these.

use std::{
    env,
    error::Error as _,
    future::Future,
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{RecvTimeoutError, sync_channel},
    },
    time::Duration,
};

use object_store::{
    ClientConfigKey, ClientOptions, Error, ObjectStore, RetryConfig,
    aws::{AmazonS3Builder, AmazonS3ConfigKey, S3CopyIfNotExists},
    azure::{AzureConfigKey, MicrosoftAzureBuilder},
    gcp::{GoogleCloudStorageBuilder, GoogleConfigKey},
    http::HttpBuilder,
};
use tokio::runtime::Handle;

use crate::{ObjectUrl, StoreError, location::Scheme};

/// Longest time of one request: the longest range or part, 8 MiB, in it needs a line of 1.1 Mbit/s.
pub(super) const REQUEST_MAX: Duration = Duration::from_secs(60);

/// Longest time of a request for which a server copies an object: 5 GiB in it are 6 MB/s.
pub(super) const COPY_MAX: Duration = Duration::from_secs(15 * 60);

/// After this time a failed request is not repeated, so that its caller learns of the failure.
const REPEATED_MAX: Duration = Duration::from_secs(30);

/// Longest time of one call: a request, its repetitions, and as much for credentials.
const CALL_MAX: Duration = Duration::from_secs(2 * (60 + 30));

/// Longest time of a list. A request lists at most a thousand objects, and each has [`REQUEST_MAX`]: for a million objects,
/// which need 1000 requests one after another, 3.6 s remain for each.
pub(super) const LIST_MAX: Duration = Duration::from_secs(3600);

/// The client of the bucket of `url`, whose requests may take `request_max`, unless the environment has another limit.
pub(super) fn client(
    url: &ObjectUrl,
    request_max: Duration,
) -> Result<Arc<dyn ObjectStore>, StoreError> {
    // A client is made for the runtime's TLS.
    runtime().map_err(|detail| unavailable(url, detail))?;
    let (_, bucket) = url.root().split_once("://").unwrap_or_default();
    let client = match url.scheme() {
        Scheme::S3 => s3(bucket, request_max),
        Scheme::Gcs => gcs(bucket, request_max),
        Scheme::Azure => azure(bucket, request_max),
        Scheme::File | Scheme::Http => {
            let builder = HttpBuilder::new().with_url(url.root()).with_retry(retry());
            let options = web_options(url).with_timeout(request_max);
            builder.with_client_options(options).build().map(|store| Arc::new(store) as _)
        }
    };
    client.map_err(|error| explain(url, &error))
}

/// A web server that was asked with TLS does not lead to one without it.
fn web_options(url: &ObjectUrl) -> ClientOptions {
    ClientOptions::new().with_allow_http(url.root().starts_with("http://"))
}

fn retry() -> RetryConfig {
    RetryConfig { max_retries: 3, retry_timeout: REPEATED_MAX, ..RetryConfig::default() }
}

fn seconds(time: Duration) -> String {
    format!("{} seconds", time.as_secs())
}

/// Whether the environment names an endpoint without TLS, as test stores and those of a laboratory's own network have.
fn is_plain_http(names: &[&str]) -> bool {
    let endpoint = |name: &&str| env::var(name).is_ok_and(|url| url.starts_with("http://"));
    names.iter().any(endpoint)
}

fn s3(bucket: &str, request_max: Duration) -> object_store::Result<Arc<dyn ObjectStore>> {
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_copy_if_not_exists(S3CopyIfNotExists::Multipart)
        .with_retry(retry());
    let set = |key| AmazonS3ConfigKey::Client(key);
    if env::var_os("AWS_TIMEOUT").is_none() {
        builder = builder.with_config(set(ClientConfigKey::Timeout), seconds(request_max));
    }
    if is_plain_http(&["AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT"]) {
        builder = builder.with_allow_http(true);
    }
    Ok(Arc::new(builder.build()?))
}

fn gcs(bucket: &str, request_max: Duration) -> object_store::Result<Arc<dyn ObjectStore>> {
    let mut builder =
        GoogleCloudStorageBuilder::from_env().with_bucket_name(bucket).with_retry(retry());
    if env::var_os("GOOGLE_TIMEOUT").is_none() {
        let key = GoogleConfigKey::Client(ClientConfigKey::Timeout);
        builder = builder.with_config(key, seconds(request_max));
    }
    Ok(Arc::new(builder.build()?))
}

fn azure(container: &str, request_max: Duration) -> object_store::Result<Arc<dyn ObjectStore>> {
    let mut builder =
        MicrosoftAzureBuilder::from_env().with_container_name(container).with_retry(retry());
    if env::var_os("AZURE_TIMEOUT").is_none() {
        let key = AzureConfigKey::Client(ClientConfigKey::Timeout);
        builder = builder.with_config(key, seconds(request_max));
    }
    if is_plain_http(&["AZURE_ENDPOINT", "AZURE_STORAGE_ENDPOINT"]) {
        builder = builder.with_allow_http(true);
    }
    Ok(Arc::new(builder.build()?))
}

/// The runtime of all clients, on its own thread, which starts at the first use. A process that was forked off has no
/// thread of its parent's, and starts another.
pub(super) fn runtime() -> Result<Handle, String> {
    static RUNTIME: Mutex<Option<(u32, Handle)>> = Mutex::new(None);
    let process = std::process::id();
    let mut known = RUNTIME.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((started_by, handle)) = &*known
        && *started_by == process
    {
        return Ok(handle.clone());
    }
    // An error means that the process has chosen one already.
    rustls::crypto::ring::default_provider().install_default().ok();
    let built = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = built.map_err(|error| format!("its runtime cannot start: {error}"))?;
    let handle = runtime.handle().clone();
    std::thread::Builder::new()
        .name("mocapd-store".to_owned())
        .spawn(move || runtime.block_on(std::future::pending::<()>()))
        .map_err(|error| format!("its thread cannot start: {error}"))?;
    Ok(known.insert((process, handle)).1.clone())
}

/// Runs a call on the runtime's thread, and waits for it.
pub(super) fn wait<T: Send + 'static>(
    url: &ObjectUrl,
    call: impl Future<Output = object_store::Result<T>> + Send + 'static,
) -> Result<T, StoreError> {
    wait_up_to(url, CALL_MAX, call)
}

/// The same, for a call that may take `call_max`.
pub(super) fn wait_up_to<T: Send + 'static>(
    url: &ObjectUrl,
    call_max: Duration,
    call: impl Future<Output = object_store::Result<T>> + Send + 'static,
) -> Result<T, StoreError> {
    let (answer, answered) = sync_channel(1);
    let runtime = runtime().map_err(|detail| unavailable(url, detail))?;
    // Ends with the call, even if its caller has stopped waiting.
    runtime.spawn(async move { answer.send(tokio::time::timeout(call_max, call).await).ok() });
    match answered.recv_timeout(call_max + REPEATED_MAX) {
        Ok(Ok(answer)) => answer.map_err(|error| explain(url, &error)),
        Ok(Err(_)) | Err(RecvTimeoutError::Timeout) => Err(StoreError::TimedOut(url.to_string())),
        Err(RecvTimeoutError::Disconnected) => {
            Err(unavailable(url, "its client failed: please report this bug".to_owned()))
        }
    }
}

pub(super) fn unavailable(url: &ObjectUrl, detail: String) -> StoreError {
    StoreError::Unavailable { url: url.to_string(), detail }
}

/// Longest text of a store in a message.
const DETAIL_CHARS_MAX: usize = 200;

/// How the crate begins the text of an answer with an error, before its status.
const NOT_SUCCESSFUL: &str = "Server returned non-2xx status code: ";

/// Where each kind of store looks for credentials.
fn remedy(url: &ObjectUrl) -> &'static str {
    match url.scheme() {
        Scheme::S3 => {
            "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (from a profile: `eval \"$(aws configure export-credentials --format env)\"`), or run on a machine with a role"
        }
        Scheme::Gcs => {
            "set GOOGLE_APPLICATION_CREDENTIALS to a key file, run `gcloud auth application-default login`, or run on a machine with a service account"
        }
        Scheme::Azure => {
            "set AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY (or AZURE_STORAGE_SAS_TOKEN), or run on a machine with a managed identity"
        }
        Scheme::File | Scheme::Http => "this server needs none that mocapd could send",
    }
}

/// The error of a client, by what to do about it.
fn explain(url: &ObjectUrl, error: &Error) -> StoreError {
    let name = url.to_string();
    let texts = texts(error);
    // The outer texts repeat the URL, which may contain any word.
    let mentions = |words: &[&str]| {
        let is_said = |w: &&str| !name.contains(*w) && texts.iter().any(|text| text.contains(*w));
        words.iter().any(is_said)
    };
    let answer = texts.last().map_or("", String::as_str);
    let code = element(answer, "Code").unwrap_or_default();
    let is_status = |status: &str| {
        answer.strip_prefix(NOT_SUCCESSFUL).is_some_and(|answer| answer.starts_with(status))
    };
    // Nothing answers there but in a cloud, whose machines have credentials.
    let metadata =
        ["169.254.169.254", "metadata.google.internal", "169.254.170.2", "/latest/api/token"];
    let missing = ["must be specified", "Missing access key", "Missing secret", "Account must"];
    match error {
        _ if matches!(code, "NoSuchBucket" | "ContainerNotFound") => StoreError::NoBucket(name),
        Error::NotFound { .. } => StoreError::NotFound(name),
        Error::AlreadyExists { .. } => StoreError::Exists(name),
        Error::Precondition { .. } | Error::NotModified { .. } => StoreError::Changed(name),
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            StoreError::Forbidden { url: name, detail: detail(&texts) }
        }
        Error::InvalidPath { .. } => StoreError::InvalidUrl { url: name, reason: detail(&texts) },
        Error::NotSupported { .. } | Error::NotImplemented { .. } => {
            StoreError::Unsupported { url: name, reason: detail(&texts) }
        }
        _ if is_status("416") || code == "InvalidRange" => {
            StoreError::Unsupported { url: name, reason: "it has no such range".to_owned() }
        }
        _ if mentions(&metadata) || mentions(&missing) => {
            StoreError::NoCredentials { url: name, remedy: remedy(url) }
        }
        _ if mentions(&["timed out", "TimedOut", "deadline has elapsed"]) => {
            StoreError::TimedOut(name)
        }
        _ => StoreError::Unavailable { url: name, detail: detail(&texts) },
    }
}

/// The texts of an error and its sources.
fn texts(error: &Error) -> Vec<String> {
    let mut texts = vec![error.to_string()];
    let mut source = error.source();
    while let Some(error) = source {
        texts.push(error.to_string());
        source = error.source();
    }
    texts
}

/// The text of an element of a store's answer.
fn element<'a>(answer: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = answer.split_once(&format!("<{name}>"))?;
    Some(rest.split_once(&format!("</{name}>"))?.0)
}

/// What the store said, in one line: the message in its answer, or else the innermost error.
fn detail(texts: &[String]) -> String {
    let of_xml = texts.iter().find_map(|text| element(text, "Message"));
    let text = of_xml.or_else(|| texts.last().map(String::as_str)).unwrap_or_default();
    // A status that came without a text is followed by a colon and nothing.
    let text = text.trim_start_matches(NOT_SUCCESSFUL).trim_end_matches([':', ' ', '\n']);
    let words: Vec<&str> = text.split_whitespace().collect();
    words.join(" ").chars().take(DETAIL_CHARS_MAX).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tls_is_not_given_up() {
        for (url, expected) in [("https://h/x", "false"), ("http://h/x", "true")] {
            let options = web_options(&ObjectUrl::parse(url).unwrap());
            let found = options.get_config_value(&ClientConfigKey::AllowHttp);
            assert_eq!(found.as_deref(), Some(expected), "{url}");
        }
    }

    /// The texts are those of the crate, which states most causes in words only.
    #[test]
    fn errors_say_what_to_do() {
        let url = ObjectUrl::parse("s3://lab/x.take").unwrap();
        let name = || url.to_string();
        let generic = |text: &str| Error::Generic { store: "S3", source: text.into() };
        let not_found = |text: &str| Error::NotFound { path: "x".to_owned(), source: text.into() };
        let denied = "status 403: <Error><Code>AccessDenied</Code><Message>Access\n Denied</Message></Error>";
        let denied = Error::PermissionDenied { path: "x".to_owned(), source: denied.into() };
        for (error, expected) in [
            (not_found("status 404"), StoreError::NotFound(name())),
            (not_found("<Code>NoSuchBucket</Code>"), StoreError::NoBucket(name())),
            (denied, StoreError::Forbidden { url: name(), detail: "Access Denied".to_owned() }),
            (
                generic("Error performing PUT http://169.254.169.254/latest/api/token"),
                StoreError::NoCredentials { url: name(), remedy: remedy(&url) },
            ),
            (generic("operation timed out"), StoreError::TimedOut(name())),
            (
                generic("status 503, after 3 retries, retry_timeout: 30s"),
                StoreError::Unavailable {
                    url: name(),
                    detail: "status 503, after 3 retries, retry_timeout: 30s".to_owned(),
                },
            ),
            (
                generic("Server returned non-2xx status code: 503 Service Unavailable: "),
                StoreError::Unavailable {
                    url: name(),
                    detail: "503 Service Unavailable".to_owned(),
                },
            ),
            (
                generic("connection refused"),
                StoreError::Unavailable { url: name(), detail: "connection refused".to_owned() },
            ),
        ] {
            assert_eq!(explain(&url, &error), expected);
        }
    }

    #[test]
    fn words_of_the_url_are_no_cause() {
        let url = "s3://lab/416/timed out/NoSuchBucket/169.254.169.254/InvalidRange.take";
        let url = ObjectUrl::parse(url).unwrap();
        for (status, expected) in [
            ("500 Internal Server Error: ", None),
            ("416 Range Not Satisfiable: ", Some("it has no such range")),
            ("400 Bad Request: <Code>InvalidRange</Code>", Some("it has no such range")),
            ("500 Oops: <Code>InternalError</Code><Key>416/NoSuchBucket</Key>", None),
        ] {
            let text = format!("{NOT_SUCCESSFUL}{status}");
            let outer = format!("Error performing GET http://h/{} in 1s - {text}", url.key());
            let error = Error::Generic { store: "S3", source: Box::new(Outer(outer, text.into())) };
            match (explain(&url, &error), expected) {
                (StoreError::Unsupported { reason, .. }, Some(expected)) => {
                    assert_eq!(reason, expected);
                }
                (StoreError::Unavailable { .. }, None) => {}
                (other, _) => panic!("{status}: {other:?}"),
            }
        }
    }

    /// An error with a source, as the crate's.
    #[derive(Debug)]
    struct Outer(String, Box<dyn std::error::Error + Send + Sync>);

    impl std::fmt::Display for Outer {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str(&self.0)
        }
    }

    impl std::error::Error for Outer {
        fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
            Some(&*self.1)
        }
    }
}
