//! The guarantees for programs that embed the crate, most of them checked by the compiler.

use mocapd_codec::{
    BLOCK_VERSION, BlockDecoder, BlockEncoder, BlockReport, CodecError, DecodedRows, Effort,
    ResamplerKind, Rows, Settings, Tolerance,
    range::{Bit, RangeDecoder, RangeEncoder},
};

use super::{Channel, KINDS, cut, decode_and_check, encode, settings};

const fn send<T: Send + ?Sized>() {}
const fn shared<T: Send + Sync + 'static>() {}
const fn error<T: std::error::Error + Send + Sync + 'static>() {}

/// The test is that this compiles.
const _: () = {
    send::<Box<dyn BlockEncoder>>();
    send::<Box<dyn BlockDecoder>>();
    shared::<Settings>();
    shared::<Tolerance>();
    shared::<Effort>();
    shared::<ResamplerKind>();
    shared::<Rows<'static>>();
    shared::<BlockReport>();
    shared::<DecodedRows>();
    shared::<Bit>();
    shared::<RangeEncoder<'static>>();
    shared::<RangeDecoder<'static>>();
    error::<CodecError>();
};

#[test]
fn an_encoder_that_moves_between_threads_writes_the_same_bytes() {
    for kind in ["dense", "fast", "lossless", "lossless:predictive"] {
        let settings = settings(kind, 0.5);
        let channels: Vec<_> = (0..3).map(|i| Channel::new("smooth", "gaps", i, 240)).collect();
        let stretches = cut(&channels, &[60; 4], 0);
        let expected = encode(settings, &stretches);
        let mut encoder = settings.encoder();
        let mut blocks = Vec::new();
        for stretch in &stretches {
            let (coded, moved) = std::thread::scope(|scope| {
                let one_block = move || {
                    let (mut bytes, mut reports) = (Vec::new(), [BlockReport::default(); 3]);
                    let rows = stretch.rows();
                    encoder.encode(&rows, &[], stretch.key, &mut bytes, &mut reports).unwrap();
                    (bytes, encoder)
                };
                scope.spawn(one_block).join().unwrap()
            });
            encoder = moved;
            blocks.push(coded);
        }
        let expected_bytes: Vec<_> = expected.iter().map(|block| block.bytes.clone()).collect();
        assert_eq!(blocks, expected_bytes, "{kind}");
        decode_and_check(settings, &stretches, &expected);
    }
}

#[test]
fn settings_round_trip_through_their_stored_form() {
    for kind in KINDS {
        let stored = settings(kind, 0.5);
        let name = stored.kind.to_string();
        assert_eq!(name, kind);
        assert_eq!(settings(&name, stored.tolerance.mm()), stored);
    }
    // The README and the header of takes state the same number.
    assert_eq!(BLOCK_VERSION, 6);
}

#[test]
fn invalid_arguments_are_errors_and_change_nothing() {
    let row = [[1.0; 3]; 10];
    let rows = |n: usize| Rows::new(&row[..n], &[true; 10][..n]).unwrap();
    for kind in KINDS {
        let mut encoder = settings(kind, 0.5).encoder();
        encoder.prepare(0, 0);
        let mut out = vec![9];
        let mut reports = [BlockReport::default(); 65];
        let not_finite = [[f32::NAN; 3]; 10];
        for (channels, n_reports) in [
            (vec![], 0),
            (vec![rows(10); 65], 65),
            (vec![rows(10); 2], 1),
            (vec![rows(10), rows(9)], 2),
            (vec![Rows::new(&not_finite, &[true; 10]).unwrap()], 1),
        ] {
            let refused = encoder.encode(&channels, &[], true, &mut out, &mut reports[..n_reports]);
            assert!(matches!(refused, Err(CodecError::InvalidArgument(_))), "{kind}: {refused:?}");
            assert_eq!(out, [9], "{kind}");
        }
    }
    assert!(Rows::new(&row, &[true; 9]).is_err());
}
