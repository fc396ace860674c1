//! Invariants of blocks and of decoded rows.

use mocapd_codec::{BlockEncoder, BlockReport, DecodedRows, Settings};

use crate::motion::{Block, Channel, Stretch};

/// Encodes one stretch into a buffer of exactly the promised maximum size.
pub(crate) fn encode(
    settings: Settings,
    encoder: &mut dyn BlockEncoder,
    stretch: &Stretch,
) -> Block {
    let rows = stretch.rows();
    let shared = settings.plan(&rows).expect("finite samples of few rows");
    let mut reports = vec![BlockReport::default(); rows.len()];
    let room = settings.max_block_bytes(rows.len(), stretch.n_rows());
    let mut bytes = Vec::with_capacity(room);
    let capacity = bytes.capacity();
    encoder.encode(&rows, &shared, stretch.key, &mut bytes, &mut reports).expect("finite samples");
    assert!(bytes.len() <= room && bytes.capacity() == capacity, "the room was too small");
    Block { bytes, shared, reports }
}

/// Checks rows decoded from arbitrary bytes: well formed, finite, with a possible stated error.
pub(crate) fn well_formed(settings: Settings, n_rows: usize, decoded: &[DecodedRows]) {
    let most = if settings.kind.is_lossless() { 0.0 } else { settings.tolerance.mm() };
    for rows in decoded {
        assert!(rows.positions.len() == n_rows);
        assert!(rows.present.len() == n_rows && rows.kept.len() == n_rows);
        assert!((0.0..=most).contains(&rows.max_error_mm));
        for (position, (&present, &kept)) in
            rows.positions.iter().zip(rows.present.iter().zip(&rows.kept))
        {
            assert!(position.iter().all(|coordinate| coordinate.is_finite()));
            assert!(present || (!kept && *position == [0.0; 3]), "an absent row has a sample");
        }
    }
}

/// Checks rows decoded from a valid block: they match the samples within the bound, and the encoder's report.
pub(crate) fn faithful(
    settings: Settings,
    stretch: &Stretch,
    block: &Block,
    decoded: &[DecodedRows],
) {
    well_formed(settings, stretch.n_rows(), decoded);
    assert_eq!(block.bytes.is_empty(), decoded.is_empty());
    assert!(decoded.len() <= stretch.channels.len());
    for (i, (channel, report)) in stretch.channels.iter().zip(&block.reports).enumerate() {
        let samples = channel.present.iter().filter(|&&present| present).count();
        assert_eq!(report.samples as usize, samples);
        match decoded.get(i) {
            Some(rows) => faithful_channel(settings, channel, report, rows),
            None => assert_eq!((samples, *report), (0, BlockReport::default())),
        }
    }
}

fn faithful_channel(
    settings: Settings,
    channel: &Channel,
    report: &BlockReport,
    rows: &DecodedRows,
) {
    assert_eq!(rows.present, channel.present);
    let mut worst = 0.0_f64;
    for row in (0..channel.present.len()).filter(|&row| channel.present[row]) {
        let (sample, rebuilt) = (channel.positions[row], rows.positions[row]);
        if settings.kind.is_lossless() {
            assert_eq!(sample.map(f32::to_bits), rebuilt.map(f32::to_bits));
        }
        let [x, y, z]: [f64; 3] =
            std::array::from_fn(|axis| f64::from(sample[axis]) - f64::from(rebuilt[axis]));
        worst = worst.max((x * x + y * y + z * z).sqrt());
    }
    assert!(worst <= settings.tolerance.mm(), "{worst} mm");
    assert_eq!(report.max_error_mm, worst);
    assert!(rows.max_error_mm >= worst);
    assert_eq!(report.kept as usize, rows.kept.iter().filter(|&&kept| kept).count());
}
