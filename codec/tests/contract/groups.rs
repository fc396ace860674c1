//! Groups: their number of channels, which channels and samples a block has, what presence costs, and channels that
//! appear later.

use mocapd_codec::{BlockReport, CodecError, GROUP_CHANNELS, stated_channels};

use super::{
    Channel, KINDS, Stretch, cut, decode_and_check, encode,
    motions::{MOTIONS, PRESENCES, Random},
    settings,
};

fn mixed(n_channels: usize, n_rows: usize) -> Vec<Channel> {
    (0..n_channels)
        .map(|i| {
            let (motion, gaps) = (MOTIONS[i % MOTIONS.len()], PRESENCES[i % PRESENCES.len()]);
            Channel::new(motion, gaps, i as u64, n_rows)
        })
        .collect()
}

#[test]
fn groups_of_every_size() {
    for kind in KINDS.into_iter().filter(|kind| !kind.ends_with("exhaustive")) {
        for n_channels in [1, 2, 63, GROUP_CHANNELS] {
            let stretches = cut(&mixed(n_channels, 150), &[50, 1, 40, 9, 50], 0b1_0000);
            let blocks = encode(settings(kind, 0.5), &stretches);
            assert_eq!(blocks, encode(settings(kind, 0.5), &stretches));
            decode_and_check(settings(kind, 0.5), &stretches, &blocks);
        }
    }
}

#[test]
fn invalid_arguments_are_refused_and_change_nothing() {
    let settings = settings("fast", 0.5);
    let channels = mixed(GROUP_CHANNELS + 1, 20);
    let rows: Vec<_> = channels.iter().map(Channel::rows).collect();
    let short = Channel::new("walk", "all", 1, 19);
    let odd = [rows[0], short.rows()];
    let mut reports = vec![BlockReport::default(); rows.len()];
    let mut encoder = settings.encoder();
    let mut out = Vec::new();
    encoder.encode(&rows[..5], &[], true, &mut out, &mut reports[..5]).unwrap();
    let before = out.clone();
    // Too many channels, none, too few reports, unequal rows, and fewer channels than before.
    for (rows, n_reports) in
        [(&rows[..], 65), (&[][..], 0), (&rows[..5], 4), (&odd[..], 2), (&rows[..4], 4)]
    {
        let outcome = encoder.encode(rows, &[], false, &mut out, &mut reports[..n_reports]);
        assert!(matches!(outcome, Err(CodecError::InvalidArgument(_))), "{outcome:?}");
        assert_eq!(out, before);
    }
    encoder.encode(&rows[..5], &[], false, &mut out, &mut reports[..5]).unwrap();
    let group = |key| Stretch { channels: channels[..5].to_vec(), key };
    let expected = encode(settings, &[group(true), group(false)]);
    assert_eq!(out, [&expected[0].bytes[..], &expected[1].bytes].concat());
}

#[test]
fn a_block_ends_with_the_last_channel_seen_since_the_key() {
    for kind in ["dense", "fast", "lossless", "lossless:predictive"] {
        let (seen, absent) =
            (Channel::new("smooth", "all", 3, 30), Channel::new("smooth", "none", 3, 30));
        let group = |seen_ones: &[usize], n: usize, key| Stretch {
            channels: (0..n)
                .map(|i| if seen_ones.contains(&i) { seen.clone() } else { absent.clone() })
                .collect(),
            key,
        };
        let stretches = [
            group(&[2], 40, true),
            group(&[0, 2], 40, false),
            // Channels appear, also new ones.
            group(&[2, 39], 40, false),
            group(&[63], 64, false),
            group(&[], 64, false),
            group(&[1], 64, false),
            // An empty key block resets all state.
            group(&[], 64, true),
            group(&[10], 64, false),
            group(&[4], 64, true),
        ];
        let blocks = encode(settings(kind, 0.5), &stretches);
        decode_and_check(settings(kind, 0.5), &stretches, &blocks);
        let stated: Vec<_> = blocks.iter().map(|block| stated_channels(&block.bytes)).collect();
        let expected = [Some(3), None, Some(40), Some(64), None, None, None, Some(11), Some(5)];
        assert_eq!(stated, expected, "{kind}");
        // A decoder and an encoder may start after an empty key block.
        let again = encode(settings(kind, 0.5), &stretches[7..]);
        assert_eq!(again, blocks[7..]);
        decode_and_check(settings(kind, 0.5), &stretches[7..], &blocks[7..]);
    }
}

#[test]
fn a_raw_channel_does_not_affect_the_others() {
    for kind in ["dense", "fast"] {
        let mut channels: Vec<Channel> =
            (0..8).map(|i| Channel::new("smooth", "all", i, 240)).collect();
        let lengths = [60; 4];
        let plain = encode(settings(kind, 0.1), &cut(&channels, &lengths, 0));
        // Coordinates too large to be coded, in the second stretch only.
        channels[5].positions[70..110].fill([f32::MAX; 3]);
        let stretches = cut(&channels, &lengths, 0);
        let blocks = encode(settings(kind, 0.1), &stretches);
        decode_and_check(settings(kind, 0.1), &stretches, &blocks);
        let raw = blocks[1].reports[5];
        assert_eq!((raw.kept, raw.max_error_mm), (60, 0.0));
        assert!(blocks[2].reports[5].kept < 60, "{kind}: it is coded again");
        let more = blocks[1].bytes.len() - plain[1].bytes.len();
        assert!(more < 60 * 13, "{kind}: {more} bytes more");
    }
}

/// Bytes of all blocks of `lossless`, 60 rows each, after checking that they decode.
fn bytes(channels: &[Channel], n_rows: usize) -> usize {
    let stretches = cut(channels, &vec![60; n_rows / 60], 0);
    let blocks = encode(settings("lossless", 1.0), &stretches);
    decode_and_check(settings("lossless", 1.0), &stretches, &blocks);
    blocks.iter().map(|block| block.bytes.len()).sum()
}

fn at_rest(n: usize, present: impl Fn(usize, usize) -> bool) -> Vec<Channel> {
    (0..n)
        .map(|i| Channel {
            positions: vec![[1.0; 3]; 600],
            present: (0..600).map(|row| present(i, row)).collect(),
        })
        .collect()
}

#[test]
fn channels_that_never_change_cost_next_to_nothing() {
    // Every sampled channel of `lossless` takes bytes of its own, so only one of 64 has samples.
    let alone = bytes(&at_rest(1, |_, _| true), 600);
    let last = bytes(&at_rest(64, |i, _| i == 63), 600);
    assert!(last < alone + 40 + 20, "{alone} and {last} bytes");
}

#[test]
fn gaps_that_channels_share_cost_less() {
    let together = at_rest(32, |_, row| row / 20 % 2 == 0);
    let apart = at_rest(32, |i, row| (row + 37 * i) / 20 % 2 == 0);
    let (together, apart) = (bytes(&together, 600), bytes(&apart, 600));
    assert!(together < apart, "{together} and {apart} bytes");
}

#[test]
fn random_presence_costs_hardly_more_than_a_bit_per_row() {
    let mut random = Random(5);
    let noise: Vec<Vec<bool>> =
        (0..16).map(|_| (0..600).map(|_| random.below(2) == 0).collect()).collect();
    let blocks = |present: &dyn Fn(usize, usize) -> bool| bytes(&at_rest(16, present), 600);
    let more = blocks(&|i, row| noise[i][row]) - blocks(&|_, row| row % 2 == 0);
    assert!(more < 16 * 600 / 8 * 12 / 10, "{more} bytes");
}

#[test]
fn single_rows_and_single_channels() {
    for pattern in 1..1 << 9_u32 {
        let present = |i: usize, row: usize| pattern >> (3 * i + row) & 1 == 1;
        let channels: Vec<Channel> = (0..3)
            .map(|i| Channel {
                positions: vec![[2.0, 3.0, 4.0]; 3],
                present: (0..3).map(|row| present(i, row)).collect(),
            })
            .collect();
        let stretch = Stretch { channels, key: true };
        let again = Stretch { key: false, ..stretch.clone() };
        let stretches = [stretch, again.clone(), again];
        let blocks = encode(settings("fast", 1.0), &stretches);
        decode_and_check(settings("fast", 1.0), &stretches, &blocks);
    }
}
