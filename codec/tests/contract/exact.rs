//! Blocks of samples that were decoded before: they decode to the same floats, and state the same error.

use mocapd_codec::{BlockReport, CodecError, DecodedRows, ResamplerKind, Rows, Settings};

use super::{Channel, KINDS, cut, encode, settings};

/// The channels of a decoded block from row `from` on; channels that it lacks have no samples.
fn channels(decoded: &[DecodedRows], n: usize, from: usize) -> Vec<Channel> {
    let part = |rows: &DecodedRows| Channel {
        positions: rows.positions[from..].to_vec(),
        present: rows.present[from..].to_vec(),
    };
    let n_rows = decoded[0].present.len() - from;
    let absent = Channel { positions: vec![[0.0; 3]; n_rows], present: vec![false; n_rows] };
    (0..n).map(|i| decoded.get(i).map_or_else(|| absent.clone(), part)).collect()
}

fn encode_exact(settings: Settings, channels: &[Channel], stated_mm: f64) -> Vec<u8> {
    let rows: Vec<Rows<'_>> = channels.iter().map(Channel::rows).collect();
    let mut reports = vec![BlockReport::default(); rows.len()];
    let mut encoder = settings.encoder();
    let mut bytes = Vec::new();
    encoder.encode_exact(&rows, stated_mm, &mut bytes, &mut reports).unwrap();
    for (channel, report) in channels.iter().zip(&reports) {
        let samples = channel.present.iter().filter(|&&present| present).count() as u32;
        assert_eq!((report.samples, report.max_error_mm), (samples, 0.0));
        // `dense` keeps fewer, where the samples lie on its lattices.
        assert!(report.kept == samples || settings.kind == ResamplerKind::Dense, "{report:?}");
    }
    assert!(bytes.len() <= settings.max_block_bytes(rows.len(), rows[0].len()));
    bytes
}

#[test]
fn decoded_samples_round_trip_bit_for_bit_and_keep_their_stated_error() {
    for kind in KINDS {
        for (motion, gaps) in [("smooth", "all"), ("smooth", "gaps"), ("walk", "gaps")] {
            let settings = settings(kind, 0.5);
            let group: Vec<_> = (20..25).map(|seed| Channel::new(motion, gaps, seed, 90)).collect();
            let stretches = cut(&group, &[60, 30], 2);
            let blocks = encode(settings, &stretches);
            let mut decoder = settings.decoder();
            let mut decoded = Vec::new();
            let first = &blocks[0];
            decoder.decode(&first.bytes, &first.shared, 60, true, &mut decoded).unwrap();
            for from in [0, 1, 37, 59] {
                let part = channels(&decoded, group.len(), from);
                let stated_mm = decoded[0].max_error_mm;
                let block = encode_exact(settings, &part, stated_mm);
                let mut decoder = settings.decoder();
                let mut again = Vec::new();
                decoder.decode(&block, &[], 60 - from, true, &mut again).unwrap();
                for (i, expected) in part.iter().enumerate() {
                    let Some(found) = again.get(i) else {
                        assert!(!expected.present.contains(&true), "{kind} {gaps}: channel {i}");
                        continue;
                    };
                    assert_eq!(found.present, expected.present, "{kind} {gaps} from {from}");
                    let bits = |rows: &[[f32; 3]]| -> Vec<_> {
                        rows.iter().map(|p| p.map(f32::to_bits)).collect()
                    };
                    assert_eq!(bits(&found.positions), bits(&expected.positions), "{kind} {from}");
                    assert_eq!(found.max_error_mm, stated_mm, "{kind} {gaps} from {from}");
                }
                // A key block after it does not depend on it.
                let next = &blocks[1];
                decoder.decode(&next.bytes, &next.shared, 30, true, &mut again).unwrap();
            }
        }
    }
}

/// Whole spans from a key block on come back at about the size that they had, and so do rows in which nothing moves.
#[test]
fn spans_behind_a_key_and_still_rows_of_dense_take_few_bytes() {
    let settings = settings("dense", 0.5);
    let group: Vec<_> = (40..46).map(|seed| Channel::new("smooth", "gaps", seed, 320)).collect();
    let blocks = encode(settings, &cut(&group, &[320], 1));
    let mut decoded = Vec::new();
    let first = &blocks[0].bytes;
    settings.decoder().decode(first, &[], 320, true, &mut decoded).unwrap();
    let stated_mm = decoded[0].max_error_mm;
    let whole = encode_exact(settings, &channels(&decoded, group.len(), 0), stated_mm);
    assert_eq!(whole, *first, "the same points in the same spans");
    decoded.iter_mut().for_each(|rows| {
        rows.positions.truncate(256);
        rows.present.truncate(256);
    });
    let part = encode_exact(settings, &channels(&decoded, group.len(), 0), stated_mm);
    assert!(part.len() < first.len(), "{} of {} bytes", part.len(), first.len());
    // Still markers that a key block decodes to, from any row on.
    let still = |seed: u64| Channel {
        positions: vec![group[seed as usize].positions[0]; 3000],
        present: vec![true; 3000],
    };
    let group: Vec<_> = (0..6).map(still).collect();
    let blocks = encode(settings, &cut(&group, &[3000], 1));
    settings.decoder().decode(&blocks[0].bytes, &[], 3000, true, &mut decoded).unwrap();
    let later = encode_exact(settings, &channels(&decoded, 6, 1234), decoded[0].max_error_mm);
    assert!(later.len() < 100, "{} bytes", later.len());
}

#[test]
fn every_stated_error_is_kept() {
    let channel = Channel::new("smooth", "all", 3, 20);
    for tolerance_mm in [1e-4, 0.1, 0.3, 0.5, 7.7] {
        let settings = settings("dense", tolerance_mm);
        for step in 0..=63_u8 {
            // The head byte has the step, as a decoder reads it.
            let stated_mm = match step {
                63 => tolerance_mm,
                _ => tolerance_mm * f64::from(step) / 63.0,
            };
            let block = encode_exact(settings, std::slice::from_ref(&channel), stated_mm);
            assert_eq!(block[0] & 63, step, "{tolerance_mm} mm");
        }
    }
}

#[test]
fn no_block_is_written_without_samples_or_above_the_tolerance() {
    let absent = Channel { positions: vec![[0.0; 3]; 9], present: vec![false; 9] };
    for kind in KINDS {
        let settings = settings(kind, 0.5);
        assert_eq!(
            encode_exact(settings, &[absent.clone(), absent.clone()], 0.0),
            [0; 0],
            "{kind}"
        );
        let channel = Channel::new("smooth", "all", 1, 9);
        let mut bytes = vec![7];
        let mut reports = [BlockReport::default()];
        let above = if settings.kind.is_lossless() { 1e-9 } else { 0.6 };
        let refused =
            settings.encoder().encode_exact(&[channel.rows()], above, &mut bytes, &mut reports);
        assert!(matches!(refused, Err(CodecError::InvalidArgument(_))), "{kind}: {refused:?}");
        assert_eq!(bytes, [7], "{kind}");
    }
}
