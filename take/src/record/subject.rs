//! SUBJECT: who was captured: documents about them, as plain data.
//!
//! A take stores what it is given and parses none of it: a skeleton and a face are somebody else's to understand.

use std::io::{Read, Write};

use bincode::{
    Decode, Encode,
    de::Decoder,
    enc::Encoder,
    error::{DecodeError, EncodeError},
};
use flate2::{Compression, bufread::DeflateDecoder, write::DeflateEncoder};

use super::Record;
use crate::chunk::types;

/// Longest document: a face of a hundred times as many vertices as ours stays below it.
pub const DOCUMENT_BYTES_MAX: usize = 1 << 20;

/// Most documents: each kind that there is, and as many again for what may come.
pub const DOCUMENTS_MAX: usize = 8;

/// Something that is known of the subject.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Document {
    /// What it is: [`Subject::SKELETON`], [`Subject::FACE`], [`Subject::FACE_MARKERS`].
    pub kind: String,
    /// Its bytes, as they were given.
    pub data: Vec<u8>,
}

/// Who was captured. Stands behind the header.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Subject {
    /// What they are called; empty where nobody said.
    pub name: String,
    /// What is known of them, one document a kind.
    pub documents: Vec<Document>,
}

impl Subject {
    /// The kind of `skeleton.json`.
    pub const SKELETON: &str = "skeleton";
    /// The kind of `face.json`.
    pub const FACE: &str = "face";
    /// The kind of the file that says which marker sits at which vertex of the face.
    pub const FACE_MARKERS: &str = "face-markers";

    /// Whether it says nothing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.name.is_empty() && self.documents.is_empty()
    }

    /// The document of a kind.
    #[must_use]
    pub fn document(&self, kind: &str) -> Option<&[u8]> {
        let found = self.documents.iter().find(|document| document.kind == kind);
        found.map(|document| document.data.as_slice())
    }

    /// Puts a document in, in the place of the one of its kind.
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
            let deflated =
                deflated.map_err(|_| EncodeError::Other("a document was not compressed"))?;
            deflated.encode(encoder)?;
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

/// So many bytes; memory grows with what is really inflated.
fn inflate(deflated: &[u8], stated: u64) -> Result<Vec<u8>, &'static str> {
    if stated > DOCUMENT_BYTES_MAX as u64 {
        return Err("a document of more than 1 MiB");
    }
    let mut data = Vec::new();
    // From memory: no buffer of its own, which would be larger than most documents.
    DeflateDecoder::new(deflated)
        .take(stated + 1)
        .read_to_end(&mut data)
        .map_err(|_| "a document is not DEFLATE")?;
    if data.len() as u64 != stated {
        return Err("a document has another length than stated");
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
                // Whatever it is read as is within the bounds.
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
        // A bomb: a stated length that is not so, and one that is too much.
        let bomb = |stated: u64| {
            let mut deflate = DeflateEncoder::new(Vec::new(), Compression::best());
            deflate.write_all(&vec![0; 64 << 20]).unwrap();
            inflate(&deflate.finish().unwrap(), stated)
        };
        assert_eq!(bomb(10), Err("a document has another length than stated"));
        assert_eq!(bomb(64 << 20), Err("a document of more than 1 MiB"));
    }
}
