//! The id of an imported take: a function of its file and its settings, so that the same import gives
//! the same bytes wherever and whenever it is made.

use sha2::{Digest, Sha256};

use super::{Header, Record, Subject};
use crate::TakeError;

impl Header {
    /// Makes `take_id` of everything else in this header, the bytes of the file that was imported, and the subject
    /// where there is one, as a UUID of version 8 (RFC 9562, 5.8). Call it when nothing else will change.
    ///
    /// The header names program, resampler, versions, tolerance, file and settings: two imports have
    /// the same id when they are the same import. docs/take-format.md gives the steps.
    ///
    /// # Errors
    /// `InvalidArgument` when the header is larger than a take can hold.
    pub fn set_import_id(
        &mut self,
        source: &[u8],
        subject: Option<&Subject>,
    ) -> Result<(), TakeError> {
        self.take_id = [0; 16];
        let hash = Sha256::new().chain_update(self.to_payload()?).chain_update(source);
        let subject = subject.map_or(Ok(Vec::new()), Subject::to_payload)?;
        let hash = hash.chain_update(subject).finalize();
        self.take_id.iter_mut().zip(hash).for_each(|(byte, of_hash)| *byte = of_hash);
        self.take_id[6] = self.take_id[6] & 0x0f | 0x80;
        self.take_id[8] = self.take_id[8] & 0x3f | 0x80;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{CODEC_VERSION, Channel, ImportSource};

    fn header() -> Header {
        Header {
            software: "mocapd 0.1.0".to_owned(),
            take_id: [7; 16],
            created_unix_ms: 0,
            resampler: "dense".to_owned(),
            codec_version: CODEC_VERSION,
            tolerance_mm: 0.5,
            rate_hz: 120.0,
            up_axis: 3,
            device: None,
            source: Some(ImportSource {
                format: "csv".to_owned(),
                file: "jump.csv".to_owned(),
                factor: 1.0,
                ..ImportSource::default()
            }),
            channels: vec![Channel { marker_id: 0, label: "head".to_owned(), labelled: true }],
            stretch_rows: 1200,
            settings: Vec::new(),
        }
    }

    fn id(header: &Header, source: &[u8]) -> [u8; 16] {
        let mut header = header.clone();
        header.set_import_id(source, None).unwrap();
        header.take_id
    }

    #[test]
    fn it_is_what_the_format_says() {
        // From Python's hashlib, over a payload put together field by field after docs/take-format.md.
        let id = id(&Header { codec_version: 4, ..header() }, b"frame,time_s\n");
        assert_eq!(u128::from_be_bytes(id), 0x6025_74d8_73e9_80b4_9ab3_7376_bd1c_3941);
    }

    #[test]
    fn it_depends_on_the_file_and_every_setting_and_not_on_the_id_before() {
        let first = id(&header(), b"a");
        assert_eq!(first, id(&Header { take_id: [0; 16], ..header() }, b"a"));
        assert_eq!((first[6] >> 4, first[8] >> 6), (8, 2), "version and variant of the UUID");
        let others = [
            id(&header(), b"b"),
            id(&header(), b""),
            id(&Header { software: "mocapd 0.2.0".to_owned(), ..header() }, b"a"),
            id(&Header { resampler: "fast".to_owned(), ..header() }, b"a"),
            id(&Header { codec_version: CODEC_VERSION + 1, ..header() }, b"a"),
            id(&Header { tolerance_mm: 1.0, ..header() }, b"a"),
            id(&Header { source: None, ..header() }, b"a"),
            id(&Header { settings: vec![(String::new(), String::new())], ..header() }, b"a"),
        ];
        for (i, other) in others.iter().enumerate() {
            assert!(*other != first && !others[..i].contains(other), "{i}: {other:02x?}");
        }
        let mut of_anna = header();
        let anna = Subject { name: "Anna".to_owned(), documents: Vec::new() };
        of_anna.set_import_id(b"a", Some(&anna)).unwrap();
        assert_ne!(of_anna.take_id, first);
    }
}
