//! The clients, configured by the environment, and the thread on which they run.

use std::{
    env,
    future::Future,
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{RecvTimeoutError, sync_channel},
    },
    time::Duration,
};

use object_store::{
    ClientConfigKey, ClientOptions, ObjectStore, RetryConfig,
    aws::{AmazonS3Builder, AmazonS3ConfigKey, S3CopyIfNotExists},
    azure::{AzureConfigKey, MicrosoftAzureBuilder},
    gcp::{GoogleCloudStorageBuilder, GoogleConfigKey},
    http::HttpBuilder,
};
use tokio::runtime::Handle;

use super::explain::explain;
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
}
