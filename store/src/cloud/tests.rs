//! Stores in memory that behave, and stores that do not.

use std::{
    io::{Cursor, Read, Write},
    net::TcpListener,
    sync::atomic::{AtomicUsize, Ordering},
};

use futures_util::stream::BoxStream;
use object_store::{
    CopyOptions, ListResult, ObjectMeta, PutMultipartOptions, PutOptions, PutResult,
    memory::InMemory,
};

use super::{connect::runtime, *};
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

/// How a store in memory misbehaves.
#[derive(Debug, Default)]
struct Fault {
    /// It ignores the condition of a creation.
    replaces: bool,
    /// It ignores the condition of a copy.
    copies_over: bool,
    /// This many times, a copy is shown empty.
    pending: AtomicUsize,
    /// Objects that were removed while a copy was shown empty.
    removed_early: AtomicUsize,
}

/// A store in memory with a fault.
#[derive(Debug, Default)]
struct Faulty {
    store: InMemory,
    fault: Fault,
}

impl std::fmt::Display for Faulty {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.store.fmt(f)
    }
}

#[async_trait::async_trait]
impl ObjectStore for Faulty {
    async fn put_opts(
        &self,
        path: &Path,
        content: PutPayload,
        mut options: PutOptions,
    ) -> object_store::Result<PutResult> {
        if self.fault.replaces {
            options.mode = PutMode::Overwrite;
        }
        self.store.put_opts(path, content, options).await
    }

    async fn put_multipart_opts(
        &self,
        path: &Path,
        options: PutMultipartOptions,
    ) -> object_store::Result<Box<dyn MultipartUpload>> {
        self.store.put_multipart_opts(path, options).await
    }

    async fn get_opts(&self, path: &Path, options: GetOptions) -> object_store::Result<GetResult> {
        let is_head = options.head;
        let mut found = self.store.get_opts(path, options).await?;
        let is_pending = is_head && found.meta.size > PART_BYTES as u64 && {
            let left = self.fault.pending.load(Ordering::SeqCst);
            self.fault.pending.store(left.saturating_sub(1), Ordering::SeqCst);
            left > 0
        };
        if is_pending {
            found.meta.size = 0;
        }
        Ok(found)
    }

    fn delete_stream(
        &self,
        paths: BoxStream<'static, object_store::Result<Path>>,
    ) -> BoxStream<'static, object_store::Result<Path>> {
        if self.fault.pending.load(Ordering::SeqCst) > 0 {
            self.fault.removed_early.fetch_add(1, Ordering::SeqCst);
        }
        self.store.delete_stream(paths)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, object_store::Result<ObjectMeta>> {
        self.store.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> object_store::Result<ListResult> {
        self.store.list_with_delimiter(prefix).await
    }

    async fn copy_opts(
        &self,
        from: &Path,
        to: &Path,
        options: CopyOptions,
    ) -> object_store::Result<()> {
        let over = if self.fault.copies_over { CopyOptions::default() } else { options };
        self.store.copy_opts(from, to, over).await
    }
}

/// A store with a fault, what it holds, and an object in it.
fn faulty(fault: Fault) -> (Store, Arc<Faulty>, ObjectUrl) {
    runtime().unwrap();
    let held = Arc::new(Faulty { fault, ..Faulty::default() });
    let store = Store::with_backend(Arc::new(Cloud::of(Arc::clone(&held) as _)));
    (store, held, ObjectUrl::parse("s3://lab/takes/x.take").unwrap())
}

/// The names of all objects, also hidden ones.
fn names(held: &Arc<Faulty>, url: &ObjectUrl) -> Vec<String> {
    let held = Arc::clone(held);
    let objects = wait(url, async move { held.store.list(None).try_collect::<Vec<_>>().await });
    objects.unwrap().iter().map(|object| object.location.to_string()).collect()
}

#[test]
fn a_store_that_ignores_conditions_gets_no_object() {
    let large = vec![7; 2 * PART_BYTES];
    let upload = |store: &Store, url: &ObjectUrl, content: &[u8]| {
        store.upload(url, &mut Cursor::new(content), &mut |_| Ok(()))
    };
    let (store, held, url) = faulty(Fault { replaces: true, ..Fault::default() });
    let refused = Err(StoreError::Replaces(url.to_string()));
    assert_eq!(upload(&store, &url, b"take"), refused);
    assert_eq!(upload(&store, &url, &large), refused);
    assert_eq!(names(&held, &url), [""; 0]);
    // Even there, no object that is there already is replaced.
    let (store, held, url) = faulty(Fault { replaces: true, ..Fault::default() });
    let (there, to) = (Arc::clone(&held), path_of(&url).unwrap());
    wait(&url, async move { there.store.put(&to, PutPayload::from_static(b"other")).await })
        .unwrap();
    assert_eq!(store.create(&url, b"take".to_vec()), Err(StoreError::Exists(url.to_string())));
    assert_eq!(store.read(&url, &ByteRange::Last(9), None).unwrap().bytes, b"other");
    // One that ignores the condition of a copy can get objects of one part.
    let (store, held, url) = faulty(Fault { copies_over: true, ..Fault::default() });
    assert_eq!(upload(&store, &url, b"take"), Ok(true));
    let other = url.with_key("takes/y.take".to_owned());
    assert_eq!(upload(&store, &other, &large), Err(StoreError::Replaces(other.to_string())));
    assert_eq!(names(&held, &url), ["takes/x.take"]);
}

#[test]
fn a_copy_that_takes_time_is_waited_for() {
    let content = vec![7; 2 * PART_BYTES];
    let (store, held, url) = faulty(Fault { pending: 4.into(), ..Fault::default() });
    let upload = store.upload(&url, &mut Cursor::new(&content), &mut |_| Ok(()));
    assert_eq!(upload, Ok(true));
    assert_eq!(held.fault.pending.load(Ordering::SeqCst), 0);
    assert_eq!(held.fault.removed_early.load(Ordering::SeqCst), 2, "those of the check alone");
    assert_eq!(names(&held, &url), ["takes/x.take"]);
}

#[test]
fn the_source_of_a_copy_that_never_ends_stays() {
    let content = vec![7; 2 * PART_BYTES];
    let (store, held, url) = faulty(Fault { pending: usize::MAX.into(), ..Fault::default() });
    let upload = store.upload(&url, &mut Cursor::new(&content), &mut |_| Ok(()));
    assert!(matches!(upload, Err(StoreError::Unavailable { .. })), "{upload:?}");
    let names = names(&held, &url);
    let is_hidden = |name: &String| name.starts_with("takes/.mocapd-upload-");
    assert!(names.len() == 2 && names.iter().any(is_hidden), "{names:?}");
    assert_eq!(held.fault.removed_early.load(Ordering::SeqCst), 2, "those of the check alone");
}

/// A web server that answers every request for a range of `x`, of a million bytes, with `n` bytes and says they are
/// from byte `at` on.
fn web_server(at: u64, n: usize) -> ObjectUrl {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/x", listener.local_addr().unwrap());
    let serve = move || {
        for connection in listener.incoming() {
            let Ok(mut connection) = connection else { return };
            let mut request = Vec::new();
            let mut byte = [0];
            while !request.ends_with(b"\r\n\r\n") && connection.read(&mut byte).unwrap_or(0) == 1 {
                request.push(byte[0]);
            }
            let last = at + 99;
            let head = format!(
                "HTTP/1.1 206 Partial Content\r\nContent-Range: bytes {at}-{last}/1000000\r\n\
                 Last-Modified: Sat, 28 Nov 2026 12:00:00 GMT\r\nETag: \"a\"\r\n\
                 Content-Length: {n}\r\nConnection: close\r\n\r\n"
            );
            connection.write_all(head.as_bytes()).ok();
            let piece = [7; 1 << 16];
            let mut left = n;
            while left > 0 && connection.write_all(&piece[..left.min(1 << 16)]).is_ok() {
                left -= left.min(1 << 16);
            }
        }
    };
    std::thread::Builder::new().name("web-server".to_owned()).spawn(serve).unwrap();
    ObjectUrl::parse(&url).unwrap()
}

#[test]
fn an_answer_has_the_bytes_that_were_asked_for() {
    let read = |url: &ObjectUrl| {
        let store = Store::with_backend(Arc::new(Cloud::connect(url).unwrap()));
        store.read(url, &ByteRange::Of(1000..1100), None)
    };
    assert_eq!(read(&web_server(1000, 100)).unwrap().bytes, [7; 100]);
    // Longer than memory, shorter, and from elsewhere.
    for (at, n, said) in
        [(1000, 1 << 40, "it sent more"), (1000, 99, "it sent 99"), (0, 100, "0..100")]
    {
        let error = read(&web_server(at, n)).unwrap_err();
        let StoreError::Unavailable { detail, .. } = &error else { panic!("{at} {n}: {error:?}") };
        assert!(detail.contains(said), "{detail}");
    }
}
