//! Takes written by each version of the format, kept so that every later build that reads the version decodes them bit
//! for bit.
//!
//! They are in folders named by [`CODEC_VERSION`], or [`LONG_KEYS_VERSION`] where keys are far apart, with their content in `expected.txt`. Their motion is seeded and
//! generated here, never recorded. They belong to this crate because a take holds blocks and times with everything that
//! a decoder needs for both, so one file serves the codec, the take format and the reference decoder.
//!
//! This command writes the folders of the versions that this build writes:
//!
//! ```text
//! MOCAPD_WRITE_GOLDEN=1 cargo test -p mocapd-take --test golden
//! ```

#![expect(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test stops there")]

mod decoded;
mod folders;
mod motion;
mod poses;
mod recording;
mod sampled;
mod takes;
mod text;
mod times;

use std::{collections::HashSet, io::Cursor};

use mocapd_take::{
    TakeError, TakeFrames, chunk,
    record::{CODEC_VERSION, Header, LONG_KEYS_VERSION, Record},
    timeline::Timeline,
};

use self::{
    decoded::Decoded,
    folders::{WRITE, expected, folder, goldens, stored, versions},
    takes::{GOLDENS, all},
};

/// Other versions that this build reads. Removing one is a breaking change.
const ALSO_READ: [u16; 1] = [LONG_KEYS_VERSION];

#[test]
fn takes_of_every_version_that_is_read_decode_as_when_they_were_written() {
    let goldens = goldens();
    let versions = versions(&goldens);
    for wanted in ALSO_READ.iter().chain([&CODEC_VERSION]) {
        assert!(
            versions.iter().any(|(version, takes)| version == wanted && !takes.is_empty()),
            "there are no golden takes of version {wanted}: for a new version write them with {WRITE}=1"
        );
    }
    for (version, takes) in versions {
        let is_read = version == CODEC_VERSION || ALSO_READ.contains(&version);
        let expected = expected(&folder(&goldens, version));
        assert!(
            takes.keys().eq(expected.keys()),
            "version {version}: takes and expected.txt differ"
        );
        for (name, take) in takes {
            match Decoded::read(&take) {
                Ok(decoded) => {
                    assert!(is_read, "v{version}/{name} is read, and ALSO_READ does not say so");
                    assert_same(&decoded.to_text(), &expected[&name], version, &name);
                }
                Err(TakeError::Unsupported { .. }) if !is_read => {}
                Err(error) => panic!("v{version}/{name}: {error}"),
            }
        }
    }
}

/// Reports the first line that differs.
fn assert_same(found: &str, expected: &str, version: u16, name: &str) {
    for (found, expected) in found.lines().zip(expected.lines()) {
        assert_eq!(found, expected, "v{version}/{name} decodes to something else");
    }
    assert_eq!(found, expected, "v{version}/{name} decodes to something else");
}

#[test]
fn another_version_is_refused_with_its_number() {
    for golden in all() {
        let take = stored(&golden);
        let behind_magic = chunk::MAGIC.len();
        let chunk::ChunkParse::Whole { kind: Header::KIND, payload, len } =
            chunk::parse(&take[behind_magic..])
        else {
            panic!("{}: no header in front", golden.name)
        };
        let header = Header::from_payload(payload, 0).unwrap();
        let mut advice = HashSet::new();
        for codec_version in [LONG_KEYS_VERSION + 1, CODEC_VERSION - 1] {
            let read = codec_version.clamp(CODEC_VERSION, LONG_KEYS_VERSION);
            let changed = Header { codec_version, ..header.clone() }.to_payload().unwrap();
            let mut other = chunk::MAGIC.to_vec();
            chunk::put(&mut other, Header::KIND, &changed).unwrap();
            other.extend_from_slice(&take[behind_magic + len..]);
            let errors = [
                Decoded::read(&other).unwrap_err(),
                TakeFrames::open(Cursor::new(&other)).unwrap_err(),
            ];
            for error in errors {
                let message = error.to_string();
                advice.insert(message.rsplit(": ").next().unwrap().to_owned());
                assert!(
                    matches!(error, TakeError::Unsupported { what: "block format", found, supported }
                        if found == codec_version && supported == read),
                    "{error}"
                );
            }
        }
        assert_eq!(advice.len(), 2, "a newer and an older version share advice: {advice:?}");
    }
}

#[test]
fn the_same_motion_gives_the_same_bytes() {
    for golden in all() {
        let (stored, written) = (stored(&golden), golden.write().bytes);
        let differs = stored.iter().zip(&written).position(|(a, b)| a != b);
        assert!(
            stored == written,
            "{} differs from the golden take of version {CODEC_VERSION}: {} bytes, not {}, from byte {} on. \
             An encoder may make other choices without a new version, as long as every decoder of this \
             version still reads them and the golden takes still decode; the commit must give the reason. \
             A change of the decoded content needs a new version. Then: \
             {WRITE}=1 cargo test -p mocapd-take --test golden",
            golden.file(),
            written.len(),
            stored.len(),
            differs.unwrap_or(stored.len().min(written.len())),
        );
    }
}

/// Takes of this version as they were written before SUMMARY had statistics.
#[test]
fn takes_without_statistics_decode_alike() {
    let goldens = goldens();
    let expected = expected(&folder(&goldens, CODEC_VERSION));
    for entry in std::fs::read_dir(goldens.join("earlier")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let decoded = Decoded::read(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(decoded.statistics, None, "{name}");
        assert_same(&decoded.to_text(), &expected[&name], CODEC_VERSION, &name);
    }
    for golden in GOLDENS {
        assert!(Decoded::read(&stored(&golden)).unwrap().statistics.is_some(), "{}", golden.name);
    }
}

/// Keeps a wrong take from becoming a golden one.
#[test]
fn the_takes_hold_their_motion() {
    for golden in all() {
        let written = golden.write();
        let decoded = Decoded::read(&written.bytes).unwrap();
        let mut n_samples = 0;
        for (channel, column) in &written.columns {
            let track = &decoded.tracks[*channel];
            for (row, (&at, &present)) in column.positions.iter().zip(&column.present).enumerate() {
                let found = track[row];
                assert_eq!(found.is_some(), present, "{}: {channel} {row}", golden.name);
                let Some((found, _)) = found else { continue };
                n_samples += 1;
                let apart = |axis: usize| f64::from(found[axis]) - f64::from(at[axis]);
                let squares = (0..3).map(|axis| apart(axis) * apart(axis)).sum::<f64>();
                assert!(
                    squares.sqrt() <= golden.tolerance_mm,
                    "{}: {channel} {row}: {found:?} for {at:?}",
                    golden.name
                );
                if golden.settings().kind.is_lossless() {
                    assert_eq!(found.map(f32::to_bits), at.map(f32::to_bits));
                }
            }
        }
        assert_eq!(decoded.tracks.iter().flatten().flatten().count(), n_samples);
        let times: Vec<_> = written.timelines.iter().flat_map(Timeline::recorded).collect();
        assert_eq!(decoded.times.len(), times.len());
        for (found, wanted) in decoded.times.iter().zip(&times) {
            assert_eq!((found.0, found.1.device_ticks), (wanted.0, wanted.1.device_ticks));
            assert_eq!(found.1.timecode, wanted.1.timecode);
            // Half of the quantisation step of arrivals at 120 Hz, 320 us.
            assert!(found.1.arrival_10us.abs_diff(wanted.1.arrival_10us) <= 16, "{found:?}");
        }
    }
}
