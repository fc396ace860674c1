//! URLs of objects and folders in stores.

use std::{
    borrow::Cow,
    fmt,
    path::{Path, PathBuf},
};

use crate::StoreError;

/// The URLs that are understood, for messages.
pub(crate) const EXPECTED: &str = "s3://BUCKET/NAME, gs://BUCKET/NAME, az://CONTAINER/NAME, file:///FOLDER/NAME or, to read, https://HOST/NAME";

/// The kind of store that a URL names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Scheme {
    /// Amazon S3, and stores with its interface.
    S3,
    /// Google Cloud Storage.
    Gcs,
    /// Azure Blob Storage.
    Azure,
    /// Files.
    File,
    /// A web server; read only.
    Http,
}

/// The schemes, by name.
const SCHEMES: [(&str, Scheme); 6] = [
    ("s3", Scheme::S3),
    ("gs", Scheme::Gcs),
    ("az", Scheme::Azure),
    ("file", Scheme::File),
    ("https", Scheme::Http),
    ("http", Scheme::Http),
];

/// The URL of an object, or of a folder: a common beginning of names that ends in `/`.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ObjectUrl {
    scheme: Scheme,
    /// Scheme and bucket, without a slash at the end: `s3://bucket`, or `file://`.
    root: String,
    /// The name within the bucket, without a slash at its start.
    key: String,
}

/// Whether a path given by a user is a URL: a scheme of at least two letters, and `://`.
#[must_use]
pub fn is_url(path: &Path) -> bool {
    let scheme = path.to_str().and_then(|text| text.split_once("://"));
    scheme.is_some_and(|(scheme, _)| {
        scheme.len() > 1 && scheme.bytes().all(|byte| byte.is_ascii_alphanumeric())
    })
}

/// A URL as messages quote it: without the user, the password and the query, which may be secret.
#[must_use]
pub fn without_secrets(text: &str) -> Cow<'_, str> {
    let Some((scheme, rest)) = text.split_once("://") else { return Cow::Borrowed(text) };
    let is_object = ["s3", "gs", "az"].iter().any(|name| scheme.eq_ignore_ascii_case(name));
    // A password may contain a slash, but only a name in a bucket may contain an `@`.
    let authority = match rest.split_once('/') {
        Some((bucket, _)) if is_object => bucket,
        _ => rest.split(['?', '#']).next().unwrap_or(rest),
    };
    let user = authority.rfind('@').map_or(0, |at| at + 1);
    let queried = rest[user..].find('?').map(|at| user + at).filter(|_| !is_object);
    if user == 0 && queried.is_none() {
        return Cow::Borrowed(text);
    }
    let mut shown = format!("{scheme}://");
    if user > 0 {
        shown.push_str("***@");
    }
    shown.push_str(&rest[user..queried.unwrap_or(rest.len())]);
    if queried.is_some() {
        shown.push_str("?***");
    }
    Cow::Owned(shown)
}

/// Whether it is the name of a bucket, or a host with or without a port: nothing in it may be a user, a password or a
/// query, which would be sent to a log with every message.
fn is_bucket(text: &str, scheme: Scheme) -> bool {
    let is_refused = |c: char| c.is_control() || c.is_whitespace() || r"@?#\".contains(c);
    // The address of a host may be in brackets.
    let port = text.rsplit(']').next().and_then(|text| text.split_once(':'));
    let is_port = |(_, port): (&str, &str)| scheme == Scheme::Http && port.parse::<u16>().is_ok();
    !text.contains(is_refused) && port.is_none_or(is_port)
}

impl ObjectUrl {
    /// Parses a URL.
    ///
    /// # Errors
    /// `InvalidUrl`.
    pub fn parse(url: &str) -> Result<Self, StoreError> {
        let invalid = |reason: &str| StoreError::InvalidUrl {
            url: without_secrets(url).into_owned(),
            reason: reason.to_owned(),
        };
        let (name, rest) = url.split_once("://").ok_or_else(|| invalid("not a URL"))?;
        let found = SCHEMES.iter().find(|(scheme, _)| name.eq_ignore_ascii_case(scheme));
        let &(name, scheme) = found.ok_or_else(|| invalid("unknown scheme"))?;
        let (bucket, key) = rest.split_once('/').unwrap_or((rest, ""));
        if scheme == Scheme::File && !bucket.is_empty() {
            return Err(invalid("a file URL has three slashes and an absolute path"));
        }
        if scheme != Scheme::File && bucket.is_empty() {
            return Err(invalid("the name of the bucket is missing"));
        }
        if !is_bucket(bucket, scheme) {
            return Err(invalid(
                r"a bucket or host has no user, password or query (@ ? # \ or :): credentials are read from the environment",
            ));
        }
        if scheme == Scheme::Http && key.contains(['?', '#']) {
            return Err(invalid("signed URLs and other queries are not supported"));
        }
        let is_bad = |part: &str| matches!(part, "" | "." | "..");
        if key.trim_end_matches('/').split('/').any(is_bad) && !key.is_empty() {
            return Err(invalid("a part of its name is empty, or is . or .."));
        }
        Ok(Self { scheme, root: format!("{name}://{bucket}"), key: key.to_owned() })
    }

    /// Parses a path that [is a URL](is_url).
    ///
    /// # Errors
    /// `InvalidUrl`, also for a path that is not UTF-8.
    pub fn of_path(path: &Path) -> Result<Self, StoreError> {
        match path.to_str() {
            Some(url) => Self::parse(url),
            None => Err(StoreError::InvalidUrl {
                url: without_secrets(&path.to_string_lossy()).into_owned(),
                reason: "not UTF-8".to_owned(),
            }),
        }
    }

    /// The name within its bucket.
    #[must_use]
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Scheme and bucket.
    #[must_use]
    pub fn root(&self) -> &str {
        &self.root
    }

    /// The file or folder that a `file://` URL names.
    #[must_use]
    pub fn local_path(&self) -> Option<PathBuf> {
        (self.scheme == Scheme::File).then(|| Path::new("/").join(&self.key))
    }

    pub(crate) fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Whether it names a folder: it ends in a slash, or has no name at all.
    #[must_use]
    pub fn is_folder(&self) -> bool {
        self.key.is_empty() || self.key.ends_with('/')
    }

    /// Checks that this build has the client of its store.
    ///
    /// # Errors
    /// `NotBuilt`.
    pub fn check_built(&self) -> Result<(), StoreError> {
        if cfg!(feature = "full") || self.scheme == Scheme::File {
            return Ok(());
        }
        Err(StoreError::NotBuilt(self.to_string()))
    }

    /// Whether objects can be created there.
    #[must_use]
    pub fn is_writable(&self) -> bool {
        self.scheme != Scheme::Http
    }

    /// The URL of `name` in this folder.
    #[must_use]
    pub fn join(&self, name: &str) -> Self {
        let folder = self.key.trim_end_matches('/');
        let key = if folder.is_empty() { name.to_owned() } else { format!("{folder}/{name}") };
        self.with_key(key)
    }

    /// The URL of another object in the bucket.
    #[must_use]
    pub fn with_key(&self, key: String) -> Self {
        Self { scheme: self.scheme, root: self.root.clone(), key }
    }
}

impl fmt::Display for ObjectUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.root, self.key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_are_taken_apart_and_put_together() {
        for text in [
            "s3://b/a b/ü.take",
            "gs://b/x.take",
            "az://c/d/",
            "file:///tmp/x.take",
            "https://h:80/x",
        ] {
            let url = ObjectUrl::parse(text).unwrap();
            assert_eq!(url.to_string(), text);
            assert_eq!(url.is_folder(), text.ends_with('/'));
            assert_eq!(url.is_writable(), !text.starts_with("http"));
        }
        let bucket = ObjectUrl::parse("S3://b").unwrap();
        assert_eq!((bucket.to_string(), bucket.is_folder()), ("s3://b/".to_owned(), true));
        assert_eq!(bucket.join("x").join("y.take").to_string(), "s3://b/x/y.take");
        for wrong in [
            "x.take",
            "ftp://h/x",
            "s3:///x",
            "file://host/x",
            "s3://b/a//b",
            "s3://b/../x",
            "https://h/x?sig=1",
        ] {
            let error = ObjectUrl::parse(wrong).unwrap_err();
            assert!(matches!(error, StoreError::InvalidUrl { .. }), "{wrong}: {error}");
        }
    }

    #[test]
    fn secrets_in_a_url_are_refused_and_not_quoted() {
        for (text, quoted) in [
            ("s3://key:secret@b/x", "s3://***@b/x"),
            ("https://user:sec/ret@h/x", "https://***@h/x"),
            ("https://user:secret@h/x?secret", "https://***@h/x?***"),
            ("https://h/x?sig=secret", "https://h/x?***"),
            ("https://user:secret/x", "https://user:secret/x"),
            ("https://h?sig=secret", "https://h?***"),
            (r"https://h\secret@evil/x", "https://***@evil/x"),
            ("ftp://user:secret@h/x", "ftp://***@h/x"),
            ("file://user:secret@h/x", "file://***@h/x"),
            ("az://c#secret@d/", "az://***@d/"),
        ] {
            let Err(StoreError::InvalidUrl { url, .. }) = ObjectUrl::parse(text) else {
                panic!("{text} is accepted")
            };
            assert_eq!(url, quoted);
        }
        for text in ["s3://b/a@b?c#d.take", "https://h:80/a@b", "http://[::1]:80/x", "s3://b-1.x/"]
        {
            assert_eq!(ObjectUrl::parse(text).unwrap().to_string(), text);
        }
    }

    #[test]
    fn only_urls_are_urls() {
        for (path, expected) in [
            ("s3://b/x", true),
            ("ftp://h/x", true),
            ("./s3://b/x", false),
            ("a.take", false),
            ("c://x", false),
            ("/a/b", false),
        ] {
            assert_eq!(is_url(Path::new(path)), expected, "{path}");
        }
    }
}
