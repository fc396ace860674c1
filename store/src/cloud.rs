//! The clients of S3, Google Cloud Storage, Azure and web servers. They are asynchronous, and run on one thread.

mod connect;

#[cfg(test)]
mod tests;

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use futures_util::TryStreamExt;
use object_store::{
    Error, GetOptions, GetRange, GetResult, MultipartUpload, ObjectStore, ObjectStoreExt, PutMode,
    PutPayload, path::Path,
};

use self::connect::{COPY_MAX, LIST_MAX, REQUEST_MAX, client, unavailable, wait, wait_up_to};
use crate::{
    ObjectUrl, StoreError,
    backend::{Backend, ByteRange, ListedObject, ObjectPiece, incomplete_name},
    location::Scheme,
};

/// First wait between two looks at a copy that the server still makes; each further one doubles it.
const COPY_POLL_MIN: Duration = Duration::from_millis(100);

/// Longest of these waits.
const COPY_POLL_MAX: Duration = Duration::from_secs(5);

/// A store of the crate `object_store`.
#[derive(Debug)]
pub(crate) struct Cloud {
    client: Arc<dyn ObjectStore>,
    /// The same store, for requests whose answer waits until the server has copied an object.
    slow: Arc<dyn ObjectStore>,
    /// How long a server may copy.
    copy_max: Duration,
    seen: Mutex<SeenConditions>,
}

/// Which conditions the store was seen to respect.
#[derive(Debug, Default)]
struct SeenConditions {
    of_creation: bool,
    of_copy: bool,
}

impl Cloud {
    /// The client of the bucket of `url`, configured by the environment.
    pub(crate) fn connect(url: &ObjectUrl) -> Result<Self, StoreError> {
        let (client, slow) = (client(url, REQUEST_MAX)?, client(url, COPY_MAX)?);
        Ok(Self { client, slow, copy_max: COPY_MAX, seen: Mutex::default() })
    }

    #[cfg(test)]
    pub(crate) fn of(client: Arc<dyn ObjectStore>) -> Self {
        let slow = Arc::clone(&client);
        Self { client, slow, copy_max: Duration::from_secs(3), seen: Mutex::default() }
    }

    /// Checks that there is no such object. A condition of the request that creates it follows, but not every store
    /// respects conditions.
    fn check_absent(&self, url: &ObjectUrl) -> Result<(), StoreError> {
        match self.len(url) {
            Ok(_) => Err(StoreError::Exists(url.to_string())),
            Err(StoreError::NotFound(_)) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Checks once that the store respects the conditions under which objects are created: it has to refuse to create
    /// a hidden object again, and to copy over one.
    fn check_conditions(&self, url: &ObjectUrl, with_copy: bool) -> Result<(), StoreError> {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.of_creation && (seen.of_copy || !with_copy) {
            return Ok(());
        }
        let (first, second) = (path_of(&hidden_beside(url))?, path_of(&hidden_beside(url))?);
        let client = Arc::clone(&self.client);
        let is_refused = wait(url, async move {
            let is_refused = is_refused(&*client, &first, &second, with_copy).await;
            client.delete(&first).await.ok();
            if with_copy {
                client.delete(&second).await.ok();
            }
            is_refused
        })?;
        if !is_refused {
            return Err(StoreError::Replaces(url.to_string()));
        }
        seen.of_creation = true;
        seen.of_copy |= with_copy;
        Ok(())
    }
}

/// Whether the store refuses to create an object that exists, and with `with_copy` also to copy to its name.
async fn is_refused(
    client: &dyn ObjectStore,
    first: &Path,
    second: &Path,
    with_copy: bool,
) -> object_store::Result<bool> {
    let create =
        |path| client.put_opts(path, PutPayload::from_static(b"?"), PutMode::Create.into());
    let exists = |answer| match answer {
        Ok(()) => Ok(false),
        Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => Ok(true),
        Err(error) => Err(error),
    };
    // A repeated request may find the object of the first.
    exists(create(first).await.map(drop))?;
    if !exists(create(first).await.map(drop))? {
        return Ok(false);
    }
    if !with_copy {
        return Ok(true);
    }
    exists(create(second).await.map(drop))?;
    exists(client.copy_if_not_exists(first, second).await)
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

/// A hidden name in the folder of an object.
fn hidden_beside(url: &ObjectUrl) -> ObjectUrl {
    url.with_key(match url.key().rsplit_once('/') {
        Some((folder, _)) => format!("{folder}/{}", incomplete_name()),
        None => incomplete_name(),
    })
}

/// The bytes of an answer, which are as many as were asked for, whatever the server sends.
async fn bytes_of(found: GetResult, asked: &GetRange) -> object_store::Result<Vec<u8>> {
    let len = found.meta.size;
    let expected = match asked {
        GetRange::Bounded(asked) => asked.start.min(len)..asked.end.min(len),
        GetRange::Offset(start) => (*start).min(len)..len,
        GetRange::Suffix(n) => len.saturating_sub(*n)..len,
    };
    let n = expected.end - expected.start;
    let wrong = |what: String| Error::Generic {
        store: "mocapd",
        source: format!("asked for {n} bytes from byte {}, it sent {what}", expected.start).into(),
    };
    if found.range != expected {
        return Err(wrong(format!("those from {} to {}", found.range.start, found.range.end)));
    }
    let mut bytes = Vec::new();
    let mut stream = found.into_stream();
    while let Some(piece) = stream.try_next().await? {
        if (bytes.len() + piece.len()) as u64 > n {
            return Err(wrong("more".to_owned()));
        }
        bytes.extend_from_slice(&piece);
    }
    if (bytes.len() as u64) < n {
        return Err(wrong(format!("{} bytes", bytes.len())));
    }
    Ok(bytes)
}

/// Waits until an object has `len` bytes: some stores answer a request for a copy before they have made it. Returns
/// whether it has.
async fn is_whole_within(
    client: &dyn ObjectStore,
    path: &Path,
    len: u64,
    time: Duration,
) -> object_store::Result<bool> {
    let has_len = async {
        let mut wait = COPY_POLL_MIN;
        loop {
            match client.head(path).await {
                Ok(object) if object.size == len => return Ok(()),
                Ok(_) | Err(Error::NotFound { .. }) => {}
                Err(error) => return Err(error),
            }
            tokio::time::sleep(wait).await;
            wait = (2 * wait).min(COPY_POLL_MAX);
        }
    };
    tokio::time::timeout(time, has_len).await.map_or(Ok(false), |found| found.map(|()| true))
}

impl Backend for Cloud {
    fn read(
        &self,
        url: &ObjectUrl,
        range: &ByteRange,
        e_tag: Option<&str>,
    ) -> Result<ObjectPiece, StoreError> {
        let (client, path) = (Arc::clone(&self.client), path_of(url)?);
        let asked = match range {
            ByteRange::Of(range) => GetRange::Bounded(range.clone()),
            ByteRange::Last(n) => GetRange::Suffix(*n),
        };
        // Weak tags never match.
        let if_match = e_tag.filter(|tag| !tag.starts_with("W/")).map(str::to_owned);
        wait(url, async move {
            let range = Some(asked.clone());
            let options = GetOptions { range, if_match, ..GetOptions::default() };
            let found = client.get_opts(&path, options).await?;
            let (at, len, e_tag) = (found.range.start, found.meta.size, found.meta.e_tag.clone());
            Ok(ObjectPiece { at, bytes: bytes_of(found, &asked).await?, len, e_tag })
        })
    }

    fn len(&self, url: &ObjectUrl) -> Result<u64, StoreError> {
        let (client, path) = (Arc::clone(&self.client), path_of(url)?);
        wait(url, async move { Ok(client.head(&path).await?.size) })
    }

    fn create(&self, url: &ObjectUrl, bytes: Vec<u8>) -> Result<(), StoreError> {
        self.check_absent(url)?;
        self.check_conditions(url, false)?;
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
        self.check_absent(url)?;
        self.check_conditions(url, true)?;
        let (path, temporary) = (path_of(url)?, hidden_beside(url));
        let from = path_of(&temporary)?;
        let (slow, to) = (Arc::clone(&self.slow), from.clone());
        let mut upload = wait(url, async move { slow.put_multipart(&to).await })?;
        let len = match send_parts(url, &mut *upload, next_part) {
            Ok(len) => len,
            Err(error) => {
                wait(url, async move { upload.abort().await }).ok();
                return Err(error);
            }
        };
        let (client, slow, copy_max) =
            (Arc::clone(&self.client), Arc::clone(&self.slow), self.copy_max);
        // Azure copies after it has answered.
        let is_copied_later = url.scheme() == Scheme::Azure;
        // The parts are put together, and copied, and the copy is waited for.
        let is_whole = wait_up_to(url, 4 * copy_max, async move {
            if let Err(error) = upload.complete().await {
                upload.abort().await.ok();
                return Err(error);
            }
            let copied = slow.copy_if_not_exists(&from, &path).await;
            let is_whole = match &copied {
                Ok(()) => is_whole_within(&*client, &path, len, copy_max).await?,
                // A repeated request may find what the first one began to copy; another object of this name needs no source.
                Err(Error::AlreadyExists { .. }) if !is_copied_later => true,
                Err(Error::AlreadyExists { .. }) => {
                    client.head(&path).await.is_ok_and(|found| found.size == len)
                }
                // If the copy has begun, its source is still needed.
                Err(_) => matches!(client.head(&path).await, Err(Error::NotFound { .. })),
            };
            if is_whole {
                // If this fails, a hidden object remains until a lifecycle rule removes it.
                client.delete(&from).await.ok();
            }
            copied.map(|()| is_whole)
        })?;
        if is_whole {
            return Ok(());
        }
        let detail = format!(
            "it has not made the object out of {temporary} within {} s; that stays until a lifecycle rule removes it",
            copy_max.as_secs()
        );
        Err(unavailable(url, detail))
    }

    fn list(&self, folder: &ObjectUrl, recursive: bool) -> Result<Vec<ListedObject>, StoreError> {
        let (client, path) = (Arc::clone(&self.client), path_of(folder)?);
        let prefix = (!folder.key().is_empty()).then_some(path);
        let found = wait_up_to(folder, LIST_MAX, async move {
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
            modified: Some(meta.last_modified.into()),
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

/// Sends one part after another, so that the pace of the caller is that of the line. Returns the number of bytes.
fn send_parts(
    url: &ObjectUrl,
    upload: &mut dyn MultipartUpload,
    next_part: &mut dyn FnMut() -> Result<Option<Vec<u8>>, StoreError>,
) -> Result<u64, StoreError> {
    let mut len = 0;
    while let Some(part) = next_part()? {
        len += part.len() as u64;
        wait(url, upload.put_part(part.into()))?;
    }
    Ok(len)
}
