//! `bench codec`: size and speed of the sampled channels of a file.

use std::{fmt::Write, io::Cursor};

use anyhow::ensure;
use mocapd_take::{
    TakeMap, TakeWriter,
    foreign::ForeignPart,
    motion::Foreign,
    record::{Header, Ledger},
    sampled::{GroupSamples, SampledPart, SpanEncoder},
};
use serde::Serialize;

use super::median_time;
use crate::cli::{
    output::plain,
    values::{count, thousands},
};

/// The results for one foreign part with samples.
#[derive(Debug, Serialize)]
pub(super) struct MeasuredSamples {
    kind: String,
    channels: u64,
    /// Samples of each channel.
    samples: u64,
    raw_bytes: u64,
    /// Size of all its chunks in a take.
    bytes: u64,
    encode_mb_s: f64,
    decode_mb_s: f64,
}

/// Encodes and decodes the parts that have samples, and measures both speeds `repeats` times, on one thread.
pub(super) fn measure(
    header: &Header,
    parts: &[Foreign],
    repeats: u8,
) -> anyhow::Result<Vec<MeasuredSamples>> {
    let mut take = TakeWriter::new(Vec::new(), header)?;
    let mut encode_s = Vec::new();
    // Content that was not read, such as that of a take, is not measured.
    for part in parts.iter().filter(|part| !part.data.is_empty()) {
        let Some(plan) = take.plan_samples(part)? else {
            take.foreign(part)?;
            continue;
        };
        let mut encoder = SpanEncoder::default();
        let took = median_time(repeats, || {
            plan.spans().try_for_each(|span| encoder.encode(&span?).map(|_| ()))?;
            Ok(())
        })?;
        encode_s.push(took.as_secs_f64());
        plan.spans().try_for_each(|span| take.span(&encoder.encode(&span?)?))?;
    }
    let (take, _) = take.finish(&Ledger { finished: true, ..Ledger::default() })?;
    let map = TakeMap::scan(&mut Cursor::new(&take))?;
    let sampled = map.foreign.iter().filter_map(ForeignPart::sampled);
    let mut measured = Vec::new();
    for (part, encode_s) in sampled.zip(encode_s) {
        let decode = median_time(repeats, || {
            let undecodable = part.check(&mut Cursor::new(&take))?;
            ensure!(undecodable.is_empty(), "{undecodable:?} cannot be decoded: report this bug");
            Ok(())
        })?;
        measured.push(MeasuredSamples::new(part, encode_s, decode.as_secs_f64()));
    }
    Ok(measured)
}

impl MeasuredSamples {
    fn new(part: &SampledPart, encode_s: f64, decode_s: f64) -> Self {
        let groups = || part.groups().iter();
        let channels = groups().map(|found| found.group.channels.len() as u64).sum();
        let samples = groups().next().map_or(0, GroupSamples::n_samples);
        let raw_bytes = 4 * channels * samples;
        let speed = |seconds: f64| raw_bytes as f64 / 1e6 / seconds.max(1e-9);
        Self {
            kind: groups().next().map(|found| found.group.kind.clone()).unwrap_or_default(),
            channels,
            samples,
            raw_bytes,
            bytes: groups().map(|found| found.stored_bytes).sum(),
            encode_mb_s: speed(encode_s),
            decode_mb_s: speed(decode_s),
        }
    }
}

/// One line per part.
pub(super) fn table(measured: &[MeasuredSamples]) -> String {
    let mut out = String::new();
    for part in measured {
        let MeasuredSamples { channels, samples, raw_bytes, bytes, .. } = part;
        writeln!(
            out,
            "{}: {}, {} of each, {} bytes of float32, {} in a take ({:.2}:1), encode {:.1} MB/s, decode {:.1} MB/s",
            plain(&part.kind),
            count(*channels, "channel"),
            count(*samples, "sample"),
            thousands(*raw_bytes),
            thousands(*bytes),
            *raw_bytes as f64 / (*bytes).max(1) as f64,
            part.encode_mb_s,
            part.decode_mb_s,
        )
        .ok();
    }
    out
}
