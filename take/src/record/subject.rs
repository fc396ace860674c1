//! SUBJECT: the captured person, and documents about them.
//!
//! A take stores documents as opaque bytes; skeletons and faces are interpreted elsewhere.

use std::io::{Read, Write};

use bincode::{Decode, Encode, de::Decoder, enc::Encoder, error::DecodeError, error::EncodeError};
use flate2::{Compression, bufread::DeflateDecoder, write::DeflateEncoder};

use super::Record;
use crate::chunk::types;

/// Longest document; a face mesh with a hundred times the vertices of ours is shorter.
pub const DOCUMENT_BYTES_MAX: usize = 1 << 20;

/// Most documents: one of each existing kind, and as many again for future ones.
pub const DOCUMENTS_MAX: usize = 8;

/// A document about the subject.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Document {
    /// Its kind: [`Subject::SKELETON`], [`Subject::FACE`] or [`Subject::FACE_MARKERS`].
    pub kind: String,
    /// Its bytes, unchanged.
    pub data: Vec<u8>,
}

/// The captured person. The record follows the header.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Subject {
    /// Their name; may be empty.
    pub name: String,
    /// Documents, at most one of each kind.
    pub documents: Vec<Document>,
}

impl Subject {
    /// The kind of `skeleton.json`.
    pub const SKELETON: &str = "skeleton";
    /// The kind of `face.json`.
    pub const FACE: &str = "face";
    /// The kind of the file that assigns face markers to vertices of the face mesh.
    pub const FACE_MARKERS: &str = "face-markers";

    /// Whether there is neither a name nor a document.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.name.is_empty() && self.documents.is_empty()
    }

    /// The document of this kind.
    #[must_use]
    pub fn document(&self, kind: &str) -> Option<&[u8]> {
        let found = self.documents.iter().find(|document| document.kind == kind);
        found.map(|document| document.data.as_slice())
    }

    /// Adds a document, or replaces the one of its kind.
    pub fn set(&mut self, kind: &str, data: Vec<u8>) {
        self.documents.retain(|document| document.kind != kind);
        self.documents.push(Document { kind: kind.to_owned(), data });
    }
}

impl Record for Subject {
    const NAME: &'static str = "subject";
    const KIND: u8 = types::SUBJECT;
    const VERSION: u16 = 1;
}

impl Encode for Subject {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        if self.documents.len() > DOCUMENTS_MAX {
            return Err(EncodeError::Other("more documents than a subject may have"));
        }
        self.name.encode(encoder)?;
        (self.documents.len() as u64).encode(encoder)?;
        for (i, Document { kind, data }) in self.documents.iter().enumerate() {
            if data.len() > DOCUMENT_BYTES_MAX {
                return Err(EncodeError::Other("a document of more than 1 MiB"));
            }
            if self.documents[..i].iter().any(|before| before.kind == *kind) {
                return Err(EncodeError::Other("two documents of one kind"));
            }
            kind.encode(encoder)?;
            (data.len() as u64).encode(encoder)?;
            let mut deflate = DeflateEncoder::new(Vec::new(), Compression::best());
            let deflated = deflate.write_all(data).and_then(|()| deflate.finish());
            let failed = |_| EncodeError::Other("a document could not be compressed");
            deflated.map_err(failed)?.encode(encoder)?;
        }
        Ok(())
    }
}

impl Decode<()> for Subject {
    fn decode<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let name = String::decode(decoder)?;
        let n = u64::decode(decoder)?;
        if n > DOCUMENTS_MAX as u64 {
            return Err(DecodeError::Other("more documents than a subject may have"));
        }
        let mut subject = Self { name, documents: Vec::new() };
        for _ in 0..n {
            let kind = String::decode(decoder)?;
            let stated = u64::decode(decoder)?;
            let deflated = Vec::<u8>::decode(decoder)?;
            let data = inflate(&deflated, stated).map_err(DecodeError::Other)?;
            if subject.document(&kind).is_some() {
                return Err(DecodeError::Other("two documents of one kind"));
            }
            subject.documents.push(Document { kind, data });
        }
        Ok(subject)
    }
}

/// Inflates a document of `stated` bytes; memory grows with the actual output.
fn inflate(deflated: &[u8], stated: u64) -> Result<Vec<u8>, &'static str> {
    if stated > DOCUMENT_BYTES_MAX as u64 {
        return Err("a document of more than 1 MiB");
    }
    let mut data = Vec::new();
    // `bufread` needs no buffer of its own here, which would be larger than most documents.
    DeflateDecoder::new(deflated)
        .take(stated + 1)
        .read_to_end(&mut data)
        .map_err(|_| "a document is not valid DEFLATE data")?;
    if data.len() as u64 != stated {
        return Err("the length of a document is not the stated one");
    }
    Ok(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TakeError;

    fn subject() -> Subject {
        let mut subject = Subject { name: "Änne 7".to_owned(), documents: Vec::new() };
        subject.set(Subject::SKELETON, b"{\"format\":\"mocapd-skeleton\",\"version\":1}".to_vec());
        subject.set(Subject::FACE, vec![0xff; 40_000]);
        subject.set("hands of a later version", Vec::new());
        subject
    }

    #[test]
    fn it_comes_back_byte_for_byte_and_is_never_parsed() {
        for subject in [subject(), Subject::default()] {
            let payload = subject.to_payload().unwrap();
            assert_eq!(Subject::from_payload(&payload, 8).unwrap(), subject);
            assert_eq!(payload, subject.to_payload().unwrap());
        }
        assert!(subject().to_payload().unwrap().len() < 300, "documents are compressed");
        let mut one = subject();
        one.set(Subject::FACE, b"other".to_vec());
        assert_eq!((one.documents.len(), one.document(Subject::FACE)), (3, Some(&b"other"[..])));
        assert_eq!(one.document("shoes"), None);
    }

    #[test]
    fn its_bytes_are_what_the_format_says() {
        // Put together by hand after docs/take-format.md; a stored block of DEFLATE holds "ab".
        let bytes = b"\x01\x00\x01B\x01\x04face\x02\x07\x01\x02\x00\xfd\xff\x61\x62";
        let read = Subject::from_payload(bytes, 8).unwrap();
        assert_eq!((read.name.as_str(), read.document(Subject::FACE)), ("B", Some(&b"ab"[..])));
    }

    #[test]
    fn damage_is_an_error_and_a_newer_version_says_so() {
        let payload = subject().to_payload().unwrap();
        for cut in 0..payload.len() {
            let read = Subject::from_payload(&payload[..cut], 8);
            assert!(matches!(read, Err(TakeError::Corrupt { .. })), "{cut}");
        }
        for at in 2..payload.len() {
            for flip in [1, 0x40, 0xff] {
                let mut changed = payload.clone();
                changed[at] ^= flip;
                // Any value that is decoded is within the limits.
                let read = Subject::from_payload(&changed, 8).unwrap_or_default();
                assert!(read.documents.len() <= DOCUMENTS_MAX);
            }
        }
        let newer = [&[2, 0], &payload[2..]].concat();
        assert!(matches!(Subject::from_payload(&newer, 8), Err(TakeError::Unsupported { .. })));
    }

    #[test]
    fn what_is_beyond_the_bounds_is_refused_by_both_sides() {
        let document = |kind: &str, n| Document { kind: kind.to_owned(), data: vec![0; n] };
        let of = |documents| Subject { name: String::new(), documents }.to_payload();
        assert!(of(vec![document("a", DOCUMENT_BYTES_MAX)]).is_ok());
        assert!(of(vec![document("a", DOCUMENT_BYTES_MAX + 1)]).is_err());
        assert!(of(vec![document("a", 1), document("a", 1)]).is_err());
        assert!(of((0..9).map(|i| document(&i.to_string(), 1)).collect()).is_err());
        // A decompression bomb: with a wrong stated length, and with one beyond the limit.
        let bomb = |stated: u64| {
            let mut deflate = DeflateEncoder::new(Vec::new(), Compression::best());
            deflate.write_all(&vec![0; 64 << 20]).unwrap();
            inflate(&deflate.finish().unwrap(), stated)
        };
        assert_eq!(bomb(10), Err("the length of a document is not the stated one"));
        assert_eq!(bomb(64 << 20), Err("a document of more than 1 MiB"));
    }
}
