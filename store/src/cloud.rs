//! The clients of S3, Google Cloud Storage, Azure and web servers. They are asynchronous, and run on one thread.

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

use futures_util::TryStreamExt;
use object_store::{
    ClientConfigKey, ClientOptions, Error, GetOptions, GetRange, MultipartUpload, ObjectStore,
    ObjectStoreExt, PutMode, RetryConfig,
    aws::{AmazonS3Builder, AmazonS3ConfigKey, S3CopyIfNotExists},
    azure::{AzureConfigKey, MicrosoftAzureBuilder},
    gcp::{GoogleCloudStorageBuilder, GoogleConfigKey},
    http::HttpBuilder,
    path::Path,
};
use tokio::runtime::Handle;

use crate::{
    ObjectUrl, StoreError,
    backend::{Backend, ByteRange, ListedObject, ObjectPiece, incomplete_name},
    location::Scheme,
};

/// Longest time of one request: the longest range or part, 8 MiB, in it needs a line of 1.1 Mbit/s.
const REQUEST_MAX: Duration = Duration::from_secs(60);

/// After this time a failed request is not repeated: whoever waits for it has to know.
const REPEATED_MAX: Duration = Duration::from_secs(30);

/// Longest time of one call: a request, its repetitions, and as much for credentials.
const CALL_MAX: Duration = Duration::from_secs(2 * (60 + 30));

/// Longest text of a store in a message.
const DETAIL_CHARS_MAX: usize = 200;

/// A store of the crate `object_store`.
#[derive(Debug)]
pub(crate) struct Cloud {
    client: Arc<dyn ObjectStore>,
}

impl Cloud {
    /// The client of the bucket of `url`, configured by the environment.
    pub(crate) fn connect(url: &ObjectUrl) -> Result<Self, StoreError> {
        // A client is made for the runtime's TLS.
        runtime().map_err(|detail| unavailable(url, detail))?;
        let (_, bucket) = url.root().split_once("://").unwrap_or_default();
        let client = match url.scheme() {
            Scheme::S3 => s3(bucket),
            Scheme::Gcs => gcs(bucket),
            Scheme::Azure => azure(bucket),
            Scheme::File | Scheme::Http => {
                let options = ClientOptions::new().with_allow_http(true).with_timeout(REQUEST_MAX);
                let builder = HttpBuilder::new().with_url(url.root()).with_retry(retry());
                builder.with_client_options(options).build().map(|store| Arc::new(store) as _)
            }
        };
        Ok(Self { client: client.map_err(|error| explain(url, &error))? })
    }

    #[cfg(test)]
    pub(crate) fn of(client: Arc<dyn ObjectStore>) -> Self {
        Self { client }
    }
}

fn retry() -> RetryConfig {
    RetryConfig { max_retries: 3, retry_timeout: REPEATED_MAX, ..RetryConfig::default() }
}

fn timeout_text() -> String {
    format!("{} seconds", REQUEST_MAX.as_secs())
}

/// Whether the environment names an endpoint without TLS, as test stores and those of a laboratory's own network have.
fn is_plain_http(names: &[&str]) -> bool {
    let endpoint = |name: &&str| env::var(name).is_ok_and(|url| url.starts_with("http://"));
    names.iter().any(endpoint)
}

fn s3(bucket: &str) -> object_store::Result<Arc<dyn ObjectStore>> {
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_copy_if_not_exists(S3CopyIfNotExists::Multipart)
        .with_retry(retry());
    let set = |key| AmazonS3ConfigKey::Client(key);
    if env::var_os("AWS_TIMEOUT").is_none() {
        builder = builder.with_config(set(ClientConfigKey::Timeout), timeout_text());
    }
    if is_plain_http(&["AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT"]) {
        builder = builder.with_allow_http(true);
    }
    Ok(Arc::new(builder.build()?))
}

fn gcs(bucket: &str) -> object_store::Result<Arc<dyn ObjectStore>> {
    let mut builder =
        GoogleCloudStorageBuilder::from_env().with_bucket_name(bucket).with_retry(retry());
    if env::var_os("GOOGLE_TIMEOUT").is_none() {
        let key = GoogleConfigKey::Client(ClientConfigKey::Timeout);
        builder = builder.with_config(key, timeout_text());
    }
    Ok(Arc::new(builder.build()?))
}

fn azure(container: &str) -> object_store::Result<Arc<dyn ObjectStore>> {
    let mut builder =
        MicrosoftAzureBuilder::from_env().with_container_name(container).with_retry(retry());
    if env::var_os("AZURE_TIMEOUT").is_none() {
        let key = AzureConfigKey::Client(ClientConfigKey::Timeout);
        builder = builder.with_config(key, timeout_text());
    }
    if is_plain_http(&["AZURE_ENDPOINT", "AZURE_STORAGE_ENDPOINT"]) {
        builder = builder.with_allow_http(true);
    }
    Ok(Arc::new(builder.build()?))
}

/// The runtime of all clients, on a thread of its own that starts with the first use.
fn runtime() -> Result<Handle, String> {
    static RUNTIME: Mutex<Option<Handle>> = Mutex::new(None);
    let mut known = RUNTIME.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(handle) = &*known {
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
    Ok(known.insert(handle).clone())
}

/// Runs a call on the runtime's thread, and waits for it.
fn wait<T: Send + 'static>(
    url: &ObjectUrl,
    call: impl Future<Output = object_store::Result<T>> + Send + 'static,
) -> Result<T, StoreError> {
    let (answer, answered) = sync_channel(1);
    let runtime = runtime().map_err(|detail| unavailable(url, detail))?;
    // Ends with the call, even where nobody waits for it any more.
    runtime.spawn(async move { answer.send(tokio::time::timeout(CALL_MAX, call).await).ok() });
    match answered.recv_timeout(CALL_MAX + REPEATED_MAX) {
        Ok(Ok(answer)) => answer.map_err(|error| explain(url, &error)),
        Ok(Err(_)) | Err(RecvTimeoutError::Timeout) => Err(StoreError::TimedOut(url.to_string())),
        Err(RecvTimeoutError::Disconnected) => {
            Err(unavailable(url, "its client failed: please report this bug".to_owned()))
        }
    }
}

fn unavailable(url: &ObjectUrl, detail: String) -> StoreError {
    StoreError::Unavailable { url: url.to_string(), detail }
}

/// The path of an object. The name of an S3 object is literal, that of a web server's file is encoded.
fn path_of(url: &ObjectUrl) -> Result<Path, StoreError> {
    let key = url.key().trim_end_matches('/');
    let path = match url.scheme() {
        Scheme::Http => Path::from_url_path(key),
        _ => Path::parse(key),
    };
    path.map_err(|error| StoreError::InvalidUrl { url: url.to_string(), reason: error.to_string() })
}

impl Backend for Cloud {
    fn read(
        &self,
        url: &ObjectUrl,
        range: &ByteRange,
        e_tag: Option<&str>,
    ) -> Result<ObjectPiece, StoreError> {
        let (client, path) = (Arc::clone(&self.client), path_of(url)?);
        let range = Some(match range {
            ByteRange::Of(range) => GetRange::Bounded(range.clone()),
            ByteRange::Last(n) => GetRange::Suffix(*n),
        });
        // Weak tags never match.
        let if_match = e_tag.filter(|tag| !tag.starts_with("W/")).map(str::to_owned);
        wait(url, async move {
            let options = GetOptions { range, if_match, ..GetOptions::default() };
            let found = client.get_opts(&path, options).await?;
            let (at, len, e_tag) = (found.range.start, found.meta.size, found.meta.e_tag.clone());
            let bytes = Vec::from(found.bytes().await?);
            Ok(ObjectPiece { at, bytes, len, e_tag })
        })
    }

    fn len(&self, url: &ObjectUrl) -> Result<u64, StoreError> {
        let (client, path) = (Arc::clone(&self.client), path_of(url)?);
        wait(url, async move { Ok(client.head(&path).await?.size) })
    }

    fn create(&self, url: &ObjectUrl, bytes: Vec<u8>) -> Result<(), StoreError> {
        let (client, path) = (Arc::clone(&self.client), path_of(url)?);
        wait(url, async move {
            client.put_opts(&path, bytes.into(), PutMode::Create.into()).await.map(drop)
        })
    }

    /// Parts cannot be completed under a condition in every store, but a copy can be made under one: the parts get a
    /// temporary name, and the object is its copy.
    fn create_from_parts(
        &self,
        url: &ObjectUrl,
        next_part: &mut dyn FnMut() -> Result<Option<Vec<u8>>, StoreError>,
    ) -> Result<(), StoreError> {
        match self.len(url) {
            Ok(_) => return Err(StoreError::Exists(url.to_string())),
            Err(StoreError::NotFound(_)) => {}
            Err(error) => return Err(error),
        }
        let path = path_of(url)?;
        let temporary_key = match url.key().rsplit_once('/') {
            Some((folder, _)) => format!("{folder}/{}", incomplete_name()),
            None => incomplete_name(),
        };
        let temporary_path = path_of(&url.with_key(temporary_key))?;
        let (client, to) = (Arc::clone(&self.client), temporary_path.clone());
        let mut upload = wait(url, async move { client.put_multipart(&to).await })?;
        if let Err(error) = send_parts(url, &mut *upload, next_part) {
            wait(url, async move { upload.abort().await }).ok();
            return Err(error);
        }
        let (client, from) = (Arc::clone(&self.client), temporary_path);
        wait(url, async move {
            if let Err(error) = upload.complete().await {
                upload.abort().await.ok();
                return Err(error);
            }
            let copied = client.copy_if_not_exists(&from, &path).await;
            // One that is left is hidden, and harms nobody.
            client.delete(&from).await.ok();
            copied
        })
    }

    fn list(&self, folder: &ObjectUrl, recursive: bool) -> Result<Vec<ListedObject>, StoreError> {
        let (client, path) = (Arc::clone(&self.client), path_of(folder)?);
        let prefix = (!folder.key().is_empty()).then_some(path);
        let found = wait(folder, async move {
            match recursive {
                true => client.list(prefix.as_ref()).try_collect::<Vec<_>>().await,
                false => Ok(client.list_with_delimiter(prefix.as_ref()).await?.objects),
            }
        })?;
        let is_hidden =
            |key: &str| key.rsplit('/').next().is_some_and(|name| name.starts_with('.'));
        let objects = found.into_iter().map(|meta| ListedObject {
            url: folder.with_key(meta.location.to_string()),
            len: meta.size,
        });
        let mut objects: Vec<_> = objects.filter(|object| !is_hidden(object.url.key())).collect();
        objects.sort_by(|a, b| a.url.key().cmp(b.url.key()));
        Ok(objects)
    }

    fn remove(&self, url: &ObjectUrl) -> Result<(), StoreError> {
        let (client, path) = (Arc::clone(&self.client), path_of(url)?);
        wait(url, async move { client.delete(&path).await })
    }
}

/// Sends one part after another, so that the pace of the caller is that of the line.
fn send_parts(
    url: &ObjectUrl,
    upload: &mut dyn MultipartUpload,
    next_part: &mut dyn FnMut() -> Result<Option<Vec<u8>>, StoreError>,
) -> Result<(), StoreError> {
    while let Some(part) = next_part()? {
        wait(url, upload.put_part(part.into()))?;
    }
    Ok(())
}

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
    let mentions = |words: &[&str]| texts.iter().any(|text| words.iter().any(|w| text.contains(w)));
    let no_bucket = ["NoSuchBucket", "ContainerNotFound", "bucket does not exist"];
    // Nothing answers there but in a cloud, whose machines have credentials.
    let metadata =
        ["169.254.169.254", "metadata.google.internal", "169.254.170.2", "/latest/api/token"];
    let missing = ["must be specified", "Missing access key", "Missing secret", "Account must"];
    match error {
        _ if mentions(&no_bucket) => StoreError::NoBucket(name),
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
        _ if mentions(&["416", "InvalidRange"]) => {
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

/// What the store said, in one line: the message in its answer, or else the innermost error.
fn detail(texts: &[String]) -> String {
    let of_xml = texts.iter().find_map(|text| {
        let (_, rest) = text.split_once("<Message>")?;
        Some(rest.split_once("</Message>")?.0)
    });
    let text = of_xml.or_else(|| texts.last().map(String::as_str)).unwrap_or_default();
    let words: Vec<&str> = text.split_whitespace().collect();
    words.join(" ").chars().take(DETAIL_CHARS_MAX).collect()
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Read};

    use object_store::memory::InMemory;

    use super::*;
    use crate::{PART_BYTES, Store};

    fn store() -> (Store, ObjectUrl) {
        runtime().unwrap();
        let store = Store::with_backend(Arc::new(Cloud::of(Arc::new(InMemory::new()))));
        (store, ObjectUrl::parse("s3://lab/takes/").unwrap())
    }

    #[test]
    fn objects_are_created_once_and_read_by_ranges() {
        let (store, folder) = store();
        for len in [0, 9, PART_BYTES, PART_BYTES + 1, 3 * PART_BYTES] {
            let url = folder.join(&format!("{len}.take"));
            let mut content: Vec<u8> = (0..len).map(|i| (i % 251) as u8).collect();
            let upload =
                |content: &[u8]| store.upload(&url, &mut Cursor::new(content), &mut |_| Ok(()));
            assert_eq!(upload(&content), Ok(true), "{len}");
            assert_eq!(upload(&content), Ok(false), "{len}");
            assert_eq!(store.len_bytes(&url), Ok(len as u64));
            let mut read = Vec::new();
            store.open(&url).unwrap().read_to_end(&mut read).unwrap();
            assert!(read == content, "{len}");
            content.push(1);
            assert_eq!(upload(&content), Err(StoreError::Exists(url.to_string())), "{len}");
        }
        let names: Vec<String> = store
            .list(&folder, false)
            .unwrap()
            .iter()
            .map(|object| object.url.key().to_owned())
            .collect();
        assert_eq!(names.len(), 5, "no temporary object is left: {names:?}");
        assert!(store.list(&folder.join("other"), true).unwrap().is_empty());
        assert_eq!(store.list(&ObjectUrl::parse("s3://lab").unwrap(), true).unwrap().len(), 5);
    }

    #[test]
    fn a_stopped_upload_leaves_nothing() {
        let (store, folder) = store();
        let url = folder.join("x.take");
        let mut left = 2;
        let mut content = Cursor::new(vec![1; 3 * PART_BYTES]);
        let stopped = store.upload(&url, &mut content, &mut |_| {
            left -= 1;
            if left > 0 { Ok(()) } else { Err(StoreError::Stopped(url.to_string())) }
        });
        assert_eq!(stopped, Err(StoreError::Stopped(url.to_string())));
        assert!(store.list(&folder, true).unwrap().is_empty());
        assert_eq!(store.open(&url).unwrap_err(), StoreError::NotFound(url.to_string()));
    }

    #[test]
    fn an_object_that_was_replaced_is_not_mixed() {
        let (store, folder) = store();
        let url = folder.join("x.take");
        store.create(&url, vec![1; 1_000_000]).unwrap();
        let mut reader = store.open(&url).unwrap();
        store.remove(&url).unwrap();
        store.create(&url, vec![2; 1_000_000]).unwrap();
        let error = reader.read(&mut [0; 9]).unwrap_err();
        assert_eq!(StoreError::of(&error), Some(StoreError::Changed(url.to_string())));
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
                generic("connection refused"),
                StoreError::Unavailable { url: name(), detail: "connection refused".to_owned() },
            ),
        ] {
            assert_eq!(explain(&url, &error), expected);
        }
    }
}
