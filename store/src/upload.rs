//! Uploads of files: whole or not at all, created once, at a pace that the caller sets, and read back.

use std::io::{self, Read, Seek, SeekFrom};

use sha2::{Digest, Sha256};

use crate::{ObjectUrl, Store, StoreError, backend::ByteRange};

/// Size of a part, which is held in memory. S3 needs at least 5 MiB, and accepts 10 000 parts: 78 GiB.
pub const PART_BYTES: usize = 8 << 20;

/// Longest object: a copy on the server, which gives an object of several parts its name once, takes at most 5 GiB.
const OBJECT_BYTES_MAX: u64 = 5 << 30;

/// Called with the number of bytes that were sent or received, after each part: it may wait, so that the line is not
/// filled, or end the upload with [`StoreError::Stopped`].
pub type Pace<'a> = &'a mut dyn FnMut(usize) -> Result<(), StoreError>;

impl Store {
    /// Creates an object with the content of `source`: in one request if it fits into a part, else in parts, under a
    /// temporary name until it is complete.
    ///
    /// An object of this name and content is left there, and is no error, so that an upload can be repeated after a
    /// failure that left it unknown whether it had succeeded. Returns whether the object is new.
    ///
    /// # Errors
    /// `Exists` if an object of this name has other content; `Source`; those of any request and of `pace`.
    pub fn upload(
        &self,
        url: &ObjectUrl,
        source: &mut (impl Read + Seek),
        pace: Pace<'_>,
    ) -> Result<bool, StoreError> {
        let read_error = |error: io::Error| StoreError::Source(error.to_string());
        let len = source.seek(SeekFrom::End(0)).map_err(read_error)?;
        if len > OBJECT_BYTES_MAX {
            let reason = "larger than 5 GiB, the limit of an object: divide it with `mocapd cut`";
            return Err(StoreError::Unsupported {
                url: url.to_string(),
                reason: reason.to_owned(),
            });
        }
        source.rewind().map_err(read_error)?;
        let mut next_part = || -> Result<Option<Vec<u8>>, StoreError> {
            let mut part = Vec::new();
            source.take(PART_BYTES as u64).read_to_end(&mut part).map_err(read_error)?;
            if part.is_empty() {
                return Ok(None);
            }
            pace(part.len())?;
            Ok(Some(part))
        };
        let created = if len <= PART_BYTES as u64 {
            next_part().and_then(|part| self.create(url, part.unwrap_or_default()))
        } else {
            self.create_from_parts(url, &mut next_part)
        };
        match created {
            Ok(()) => Ok(true),
            Err(StoreError::Exists(name)) => match self.has_content(url, source, pace)? {
                true => Ok(false),
                false => Err(StoreError::Exists(name)),
            },
            Err(error) => Err(error),
        }
    }

    /// Reads an object back and compares it with `source`, by length and SHA-256.
    ///
    /// # Errors
    /// `NotFound`; `Source`; those of any request and of `pace`.
    pub fn has_content(
        &self,
        url: &ObjectUrl,
        source: &mut (impl Read + Seek),
        pace: Pace<'_>,
    ) -> Result<bool, StoreError> {
        let read_error = |error: io::Error| StoreError::Source(error.to_string());
        let len = source.seek(SeekFrom::End(0)).map_err(read_error)?;
        if self.len_bytes(url)? != len {
            return Ok(false);
        }
        source.rewind().map_err(read_error)?;
        let mut expected = Sha256::new();
        let mut piece = vec![0; 1 << 16];
        loop {
            let n = source.read(&mut piece).map_err(read_error)?;
            if n == 0 {
                break;
            }
            expected.update(&piece[..n]);
        }
        Ok(self.sha256(url, pace)? == <[u8; 32]>::from(expected.finalize()))
    }

    /// The SHA-256 of an object.
    ///
    /// # Errors
    /// `NotFound`; those of any request and of `pace`.
    pub fn sha256(&self, url: &ObjectUrl, pace: Pace<'_>) -> Result<[u8; 32], StoreError> {
        let mut sha256 = Sha256::new();
        let len = self.len_bytes(url)?;
        let (mut at, mut e_tag) = (0, None);
        while at < len {
            let range = ByteRange::Of(at..len.min(at + PART_BYTES as u64));
            let piece = self.read(url, &range, e_tag.as_deref())?;
            if piece.bytes.is_empty() || piece.len != len {
                return Err(StoreError::Changed(url.to_string()));
            }
            pace(piece.bytes.len())?;
            sha256.update(&piece.bytes);
            at += piece.bytes.len() as u64;
            e_tag = piece.e_tag;
        }
        Ok(sha256.finalize().into())
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, io::Cursor};

    use super::*;

    fn folder() -> (tempfile::TempDir, ObjectUrl, Store) {
        let folder = tempfile::tempdir().unwrap();
        let url = ObjectUrl::parse(&format!("file://{}/", folder.path().display())).unwrap();
        let store = Store::of(&url).unwrap().counted_anew();
        (folder, url, store)
    }

    #[test]
    fn an_object_is_created_once_and_the_same_content_is_no_error() {
        let (folder, url, store) = folder();
        for len in [0, 5, PART_BYTES, PART_BYTES + 1, 3 * PART_BYTES] {
            let object = url.join(&format!("sub/{len}"));
            let mut content = vec![7; len];
            let upload =
                |content: &[u8]| store.upload(&object, &mut Cursor::new(content), &mut |_| Ok(()));
            assert_eq!(upload(&content), Ok(true), "{len}");
            assert_eq!(upload(&content), Ok(false), "{len}");
            content.push(8);
            assert_eq!(upload(&content), Err(StoreError::Exists(object.to_string())), "{len}");
            content.pop();
            if let Some(last) = content.last_mut() {
                *last = 8;
                assert_eq!(upload(&content), Err(StoreError::Exists(object.to_string())), "{len}");
            }
            let read = fs::read(folder.path().join(format!("sub/{len}"))).unwrap();
            assert!(read == vec![7; len]);
        }
        let names = store.list(&url, true).unwrap();
        assert_eq!(names.len(), 5, "nothing incomplete is left: {names:?}");
        assert_eq!(store.list(&url, false).unwrap(), []);
        for listed in names {
            store.remove(&listed.url).unwrap();
            store.remove(&listed.url).unwrap();
        }
        assert_eq!(store.list(&url, true).unwrap(), []);
    }

    #[test]
    fn a_stopped_upload_leaves_nothing() {
        let (folder, url, store) = folder();
        let object = url.join("x");
        let mut parts = 0;
        let stopped = store.upload(&object, &mut Cursor::new(vec![1; 3 * PART_BYTES]), &mut |_| {
            parts += 1;
            if parts < 3 { Ok(()) } else { Err(StoreError::Stopped(object.to_string())) }
        });
        assert_eq!(stopped, Err(StoreError::Stopped(object.to_string())));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
