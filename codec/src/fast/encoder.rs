//! The encoder of a group: the choices that the format leaves open.

use super::{
    FastDecoder, Mode,
    coding::{Coding, Emitting, Outcome, Work},
    isa::Isa,
    step,
    tans::Tables,
    walk::Channel,
    writer::Writer,
};
use crate::{BlockReport, CodecError, Rows, Tolerance, frame::PayloadEncoder, raw::Raw};

/// The encoder of a group of channels.
#[derive(Debug)]
pub(crate) struct FastEncoder {
    tolerance_mm: f64,
    tables: &'static Tables,
    isa: Isa,
    channels: Vec<Channel>,
    modes: Vec<Mode>,
    work: Work,
    raw: Raw,
}

impl FastEncoder {
    /// Nothing is allocated yet.
    pub(crate) fn new(tolerance: Tolerance) -> Self {
        Self::with_isa(tolerance, Isa::detect())
    }

    pub(super) fn with_isa(tolerance: Tolerance, isa: Isa) -> Self {
        Self {
            tolerance_mm: tolerance.mm(),
            tables: Tables::get(),
            isa,
            channels: Vec::new(),
            modes: Vec::new(),
            work: Work::default(),
            raw: Raw::default(),
        }
    }

    /// Codes one channel; `false` leaves everything as it was.
    fn channel(
        &mut self,
        i: usize,
        rows: Rows<'_>,
        report: &mut BlockReport,
        writer: &mut Writer,
        out: &mut Vec<u8>,
    ) -> bool {
        for mode in Mode::STEPS {
            let mut channel = self.channels[i].clone();
            let outcome = self.isa.run(Coding {
                channel: &mut channel,
                rows,
                work: &mut self.work,
                tolerance_mm: self.tolerance_mm,
                step: step(self.tolerance_mm, mode),
            });
            let Some(Outcome { max_error_mm, kept }) = outcome else { return false };
            if max_error_mm <= self.tolerance_mm {
                let mut next = *writer;
                let Work { ops, bytes, .. } = &mut self.work;
                let tables = self.tables;
                let length = self.isa.run(Emitting { writer: &mut next, tables, ops, bytes });
                if length > Raw::max_bytes(report.samples as usize) {
                    return false;
                }
                out.extend_from_slice(&self.work.bytes[..length]);
                *writer = next;
                self.channels[i] = channel;
                self.modes[i] = mode;
                report.kept = kept;
                report.max_error_mm = max_error_mm;
                return true;
            }
        }
        false
    }
}

impl PayloadEncoder for FastEncoder {
    type Decoder = FastDecoder;

    fn max_payload_bytes(n_channels: usize, n_rows: usize) -> usize {
        super::max_payload_bytes(n_channels, n_rows)
    }

    fn prepare(&mut self, n_channels: usize, n_rows: usize) {
        if self.channels.len() < n_channels {
            self.channels.resize(n_channels, Channel::NEW);
            self.modes.resize(n_channels, Mode::default());
        }
        self.work.prepare(n_rows);
        self.raw.reserve(n_rows);
    }

    fn reset(&mut self) {
        self.channels.fill(Channel::NEW);
    }

    fn break_off(&mut self) {
        self.channels.iter_mut().for_each(|channel| channel.known = 0);
    }

    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        _shared: &[u8],
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> Result<(), CodecError> {
        self.prepare(channels.len(), channels.first().map_or(0, Rows::len));
        let start = out.len();
        let mut writer = Writer::NEW;
        let mut coded = false;
        // The decoder reads from the end: the first channel comes last.
        for (i, (rows, report)) in channels.iter().zip(reports.iter_mut()).enumerate().rev() {
            self.modes[i] = Mode::default();
            if report.samples == 0 {
                self.channels[i].known = 0;
                continue;
            }
            if !self.channel(i, *rows, report, &mut writer, out) {
                self.modes[i] = Mode::RAW;
                self.channels[i].known = 0;
                report.kept = report.samples;
                report.max_error_mm = 0.0;
            }
            coded |= self.modes[i] != Mode::RAW;
        }
        let plain = self.modes[..channels.len()].iter().all(|mode| *mode == Mode::default());
        writer.finish(coded, !plain, out);
        if !plain {
            let behind = out.len();
            let sampled = || {
                channels.iter().zip(&self.modes).zip(reports.iter()).filter(|(_, r)| r.samples > 0)
            };
            out.extend(sampled().map(|((_, mode), _)| mode.0));
            for ((rows, _), _) in sampled().filter(|((_, mode), _)| **mode == Mode::RAW) {
                self.raw.write(*rows, out);
            }
            // Written last, read first.
            out[start..].rotate_left(behind - start);
        }
        Ok(())
    }
}
