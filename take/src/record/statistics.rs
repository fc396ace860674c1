//! The statistics of a take, as SUMMARY stores them: docs/take-format.md, "SUMMARY".

use mocapd_codec::{
    Tolerance,
    range::{BinaryCoder, RangeDecoder, RangeEncoder},
};

use super::section_content;
use crate::{
    TakeError,
    statistics::{ChannelStatistics, TakeStatistics},
    stretch::CHANNELS_MAX,
    timeline::ResidualModel,
    varint,
};

const NAME: &str = "statistics";

/// The only version of the section.
const VERSION: u16 = 1;

/// Largest number of rows: 55 years at 10 kHz. Even with all channels, 12 bytes for each sample are a number of bytes
/// that fits into 64 bits.
const FIGURE_MAX: u64 = 1 << 44;

/// The initial probability, in 1/256, that a figure differs from that of the channel before: in a take without gaps
/// most channels have the same number of samples.
const ODDS: u8 = 32;

/// The content of the section.
///
/// # Errors
/// `InvalidArgument` if the counts do not fit together.
pub(super) fn to_section(statistics: &TakeStatistics) -> Result<Vec<u8>, TakeError> {
    let mut out = VERSION.to_le_bytes().to_vec();
    varint::put(&mut out, statistics.channels.len() as u64);
    varint::put(&mut out, statistics.rows_with_samples);
    let mut coder = RangeEncoder::new(&mut out, usize::MAX);
    let is_possible = code(&mut coder, &mut statistics.clone()).is_some();
    if coder.finish() && is_possible && statistics.channels.len() <= CHANNELS_MAX {
        return Ok(out);
    }
    Err(TakeError::InvalidArgument(
        "impossible statistics: their counts do not fit together".to_owned(),
    ))
}

/// Decodes the content of the section in the chunk at file offset `offset`.
///
/// # Errors
/// `Unsupported` for another version, `Corrupt`.
pub(super) fn of_section(section: &[u8], offset: u64) -> Result<TakeStatistics, TakeError> {
    let content = section_content(section, NAME, VERSION, offset)?;
    decode(content)
        .ok_or_else(|| TakeError::corrupt(NAME, offset, "its counts do not fit together"))
}

fn decode(content: &[u8]) -> Option<TakeStatistics> {
    let mut cursor = varint::Cursor::new(content);
    let n_channels = cursor.varint().filter(|&n| n <= CHANNELS_MAX as u64)?;
    let rows_with_samples = cursor.varint()?;
    // At most 2 MiB, within the limit of other records.
    let channels = vec![ChannelStatistics::default(); n_channels as usize];
    let mut statistics =
        TakeStatistics { channels, rows_with_samples, ..TakeStatistics::default() };
    let mut coder = RangeDecoder::new(cursor.rest());
    code(&mut coder, &mut statistics)?;
    coder.finish().is_ok().then_some(statistics)
}

/// Encodes all figures but the first; with a decoder, replaces them by the decoded ones. `None` for figures that no
/// take can have.
fn code(coder: &mut impl BinaryCoder, statistics: &mut TakeStatistics) -> Option<()> {
    let rows = Some(statistics.rows_with_samples).filter(|&rows| rows <= FIGURE_MAX)?;
    let mut models = std::array::from_fn::<_, 4, _>(|_| ResidualModel::new(ODDS));
    let mut before = [rows, 0, 0, Tolerance::STEPS.into()];
    for channel in &mut statistics.channels {
        let ChannelStatistics { samples, gaps, knots, error_step } = *channel;
        let figures = [samples, gaps, knots, error_step.into()];
        for ((model, before), figure) in models.iter_mut().zip(&mut before).zip(figures) {
            *before = code_figure(model, coder, *before, figure);
        }
        let [samples, gaps, knots, step] = before;
        let error_step = u8::try_from(step).ok().filter(|&step| step <= Tolerance::STEPS)?;
        // Gaps are separated by samples, which lie in rows with samples.
        if samples > rows || knots > samples || gaps > samples + 1 {
            return None;
        }
        *channel = ChannelStatistics { samples, gaps, knots, error_step };
    }
    let mut model = ResidualModel::new(ODDS);
    let (samples, key_rows) = (statistics.samples(), statistics.key_rows);
    statistics.key_rows = code_figure(&mut model, coder, rows, key_rows);
    let in_key_rows = statistics.samples_in_key_rows;
    statistics.samples_in_key_rows = code_figure(&mut model, coder, samples, in_key_rows);
    let is_possible = statistics.key_rows <= rows
        && (statistics.key_rows..=samples).contains(&statistics.samples_in_key_rows);
    is_possible.then_some(())
}

/// Codes a figure as its difference from `expected`.
fn code_figure(
    model: &mut ResidualModel,
    coder: &mut impl BinaryCoder,
    expected: u64,
    figure: u64,
) -> u64 {
    let difference = figure.wrapping_sub(expected).cast_signed();
    expected.wrapping_add_signed(model.code(coder, difference))
}
