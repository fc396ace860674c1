//! `lossless`: bit-exact float32, as packed differences of bit patterns.

use crate::{
    BlockReport, DecodedRows, Result, Rows,
    coding::{
        bytes::Bytes,
        columns::{Histories, Raw},
    },
    frame::{Payload, PayloadDecoder, PayloadEncoder},
};

/// Encoder and decoder of one group. Its state is the last bit patterns of each channel.
#[derive(Debug, Default)]
pub(crate) struct Lossless {
    histories: Vec<Histories>,
    raw: Raw,
}

impl Lossless {
    fn grow(&mut self, n_channels: usize) {
        if self.histories.len() < n_channels {
            self.histories.resize(n_channels, Histories::default());
        }
    }
}

/// Empty blocks keep the histories: a marker usually reappears close to where it was lost.
impl Payload for Lossless {
    const EXACT: bool = true;

    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        self.grow(n_channels);
        self.raw.reserve(n_rows);
    }

    fn reset(&mut self) {
        self.histories.fill(Histories::default());
    }
}

impl PayloadEncoder for Lossless {
    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        n_channels * Raw::max_bytes(n_rows)
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        _exact: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
        kept_rows: &mut [bool],
    ) -> Result<()> {
        self.grow(channels.len());
        let channels = channels.iter().zip(&mut self.histories).zip(reports);
        for ((rows, history), report) in channels.filter(|(_, report)| report.samples > 0) {
            self.raw.write(*rows, history, out);
            report.keep_all(*rows, kept_rows);
        }
        Ok(())
    }
}

impl PayloadDecoder for Lossless {
    fn decode(&mut self, payload: &[u8], channels: &mut [DecodedRows]) -> Result<()> {
        self.grow(channels.len());
        let mut input = Bytes::new(payload);
        for (rows, history) in channels.iter_mut().zip(&mut self.histories) {
            if rows.has_samples() {
                self.raw.read(&mut input, history, rows)?;
            }
        }
        input.finish()
    }
}
