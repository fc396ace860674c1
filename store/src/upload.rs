//! Uploads of files: whole or not at all, created once, at a pace that the caller sets, and read back.

use std::io::{self, Read, Seek, SeekFrom};

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

    /// Reads an object back and compares it with `source`, byte by byte: a part of one, then the same part of the other,
    /// so that the pace is that of both.
    ///
    /// # Errors
    /// `NotFound`; `Changed` if the object was replaced meanwhile; `Source`; those of any request and of `pace`.
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
        let (mut at, mut e_tag) = (0, None);
        let mut expected = Vec::new();
        while at < len {
            let range = at..len.min(at + PART_BYTES as u64);
            let part_len = range.end - range.start;
            let piece = self.read(url, &ByteRange::Of(range), e_tag.as_deref())?;
            if piece.at != at || piece.bytes.len() as u64 != part_len || piece.len != len {
                return Err(StoreError::Changed(url.to_string()));
            }
            expected.clear();
            source.take(part_len).read_to_end(&mut expected).map_err(read_error)?;
            pace(piece.bytes.len())?;
            if piece.bytes != expected {
                return Ok(false);
            }
            at += part_len;
            e_tag = piece.e_tag;
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::Cell, fs, io::Cursor};

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

    /// Counts what is read of a file.
    struct Counted<'a>(Cursor<Vec<u8>>, &'a Cell<usize>);

    impl Read for Counted<'_> {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let n = self.0.read(bytes)?;
            self.1.set(self.1.get() + n);
            Ok(n)
        }
    }

    impl Seek for Counted<'_> {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.0.seek(to)
        }
    }

    #[test]
    fn a_comparison_reads_the_file_at_the_pace_and_ends_at_the_first_difference() {
        let (_folder, url, store) = folder();
        let object = url.join("x");
        let content: Vec<u8> = (0..3 * PART_BYTES).map(|i| (i % 251) as u8).collect();
        let create = store.upload(&object, &mut Cursor::new(&content), &mut |_| Ok(()));
        assert_eq!(create, Ok(true));
        let read = Cell::new(0);
        let mut paced = 0;
        let mut file = Counted(Cursor::new(content.clone()), &read);
        let same = store.has_content(&object, &mut file, &mut |n| {
            paced += n;
            assert_eq!(read.get(), paced, "no byte of the file is read ahead of the pace");
            Ok(())
        });
        assert_eq!((same, paced), (Ok(true), content.len()));
        read.set(0);
        let stopped = store
            .has_content(&object, &mut file, &mut |_| Err(StoreError::Stopped(object.to_string())));
        assert_eq!(stopped, Err(StoreError::Stopped(object.to_string())));
        assert_eq!(read.get(), PART_BYTES, "nothing is read once it is stopped");
        read.set(0);
        let mut other = content;
        other[7] ^= 1;
        let mut file = Counted(Cursor::new(other), &read);
        assert_eq!(store.has_content(&object, &mut file, &mut |_| Ok(())), Ok(false));
        assert_eq!(read.get(), PART_BYTES);
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
