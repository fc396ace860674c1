//! The content of a take as text: `expected.txt`.

use std::fmt::Write;

use mocapd_codec::Position;
use mocapd_take::{
    record::{Channel, ClockFit, Event, Ledger, SampledChannel, SampledGroup},
    timeline::RowTime,
};
use sha2::{Digest, Sha256};

use super::decoded::Decoded;

impl Decoded {
    /// One line per item; [`PREFACE`] describes the digests.
    pub(crate) fn to_text(&self) -> String {
        let mut text = String::new();
        let mut line = |item: String| writeln!(text, "{item}").expect("memory");
        line(format!("rows {}, stated {:?} mm", self.n_rows, self.stated_mm));
        for (first_row, n_rows, key) in &self.stretches {
            let key = if *key { ", key" } else { "" };
            line(format!("stretch at row {first_row}, {n_rows} rows{key}"));
        }
        line(format!("{} markers, {}", self.channels.len(), of_markers(&self.channels)));
        for (i, track) in self.tracks.iter().enumerate() {
            let (samples, digest) = (track.iter().flatten(), of_track(track));
            let (n, kept) = (samples.clone().count(), samples.filter(|sample| sample.1).count());
            if n > 0 {
                line(format!("channel {i}: {n} samples, {kept} kept, {digest}"));
            }
        }
        line(format!("times of {} rows, {}", self.times.len(), of_times(&self.times)));
        for (row, n_rows, causes) in &self.lost {
            line(format!("lost from row {row}: {n_rows}, causes {}", causes.0));
        }
        self.groups.iter().for_each(|group| line(of_group(group)));
        self.recorded.iter().for_each(|item| line(item.clone()));
        for part in &self.parts {
            let bytes = part.data.to_vec(u64::MAX).unwrap().unwrap();
            line(format!(
                "part {}: {} bytes, {}",
                part.kind,
                bytes.len(),
                digest(bytes.into_iter())
            ));
        }
        for Event { kind, row, device_ticks, host_ns, input, text } in &self.events {
            line(format!("event {kind:?} {row} {device_ticks} {host_ns} {input} {text}"));
        }
        self.ledgers.iter().for_each(|ledger| line(of_ledger(ledger)));
        text
    }
}

/// The first lines of `expected.txt`.
pub(crate) const PREFACE: &str = "\
# What the takes beside this file decode to, bit for bit. Written by take/tests/golden, not by hand.
# A digest is the first 16 digits of the SHA-256 of, little endian,
# - the markers: for each a line of its id, its label and 1 if it is labelled, with spaces between;
# - a channel: for every row of the take a byte (1: a sample, 2: kept) and three float32, zeros without one;
# - the times: for every recorded row its number, device ticks and arrival in 10 us (u64), and five bytes:
#   1 and the timecode, or zeros;
# - the channels of a group: for each a line of its name, unit, index, scale and offset, with spaces between;
# - a part: its block of columns (docs/foreign.md);
# - the samples of a group: by channel the bits of each sample, 7fc00000 for a lost one;
# - the poses of a group: for each sample and body the number of its state in outputs (docs/poses.md) and eight float32, with
#   7fc00000 for every NaN; the rows of poses: the same for each row of the take and all bodies.
# Events and ledgers have the fields of docs/take-format.md, in order.
";

fn of_ledger(ledger: &Ledger) -> String {
    let counters = [
        ledger.frames_sent,
        ledger.recorded,
        ledger.lost_on_link,
        ledger.dropped_by_device,
        ledger.lost_ring_full,
        ledger.lost_other,
        ledger.duplicates,
        ledger.unknown_after_disconnect,
        ledger.samples_announced,
        ledger.samples_present,
        ledger.samples_occluded,
        ledger.samples_not_finite,
        ledger.markers_dropped,
        ledger.link_bytes,
        ledger.link_bytes_skipped,
        ledger.link_messages,
        ledger.link_messages_damaged,
        ledger.link_messages_unknown,
    ];
    let counters = counters.map(|counter| counter.to_string()).join(" ");
    let clock = ledger.clock.map_or_else(String::new, |clock| {
        let ClockFit { offset_ns, drift_ppm, residual_us, n_fitted } = clock;
        format!(", clock {offset_ns} {drift_ppm:?} {residual_us:?} {n_fitted}")
    });
    format!("ledger {}: {counters} {:?}{clock}", ledger.finished, ledger.contradictions)
}

fn of_group(group: &SampledGroup) -> String {
    let channels = group.channels.iter().flat_map(|channel| {
        let SampledChannel { name, unit, index, scale, offset } = channel;
        format!("{name} {unit} {index} {scale:?} {offset:?}\n").into_bytes()
    });
    let bounds = match &group.bounds.0[..] {
        [] => String::new(),
        bounds => format!(", bounds {bounds:?}"),
    };
    let SampledGroup { number, kind, first_channel, part_channels, .. } = group;
    format!(
        "group {number} of {kind}: form {}, from channel {first_channel} of {part_channels}, {} a frame, {:?} Hz, from frame {}, {} samples, {}{bounds}",
        group.form as u8,
        group.samples_per_frame,
        group.rate_hz,
        group.first_frame,
        group.n_samples.map_or_else(|| "None".to_owned(), |n| n.to_string()),
        digest(channels),
    )
}

fn of_markers(channels: &[Channel]) -> String {
    digest(channels.iter().flat_map(|Channel { marker_id, label, labelled }| {
        format!("{marker_id} {label} {}\n", u8::from(*labelled)).into_bytes()
    }))
}

fn of_track(track: &[Option<(Position, bool)>]) -> String {
    digest(track.iter().flat_map(|sample| {
        let (position, kept) = sample.unwrap_or_default();
        let mut bytes = vec![u8::from(sample.is_some()) | u8::from(kept) << 1];
        bytes.extend(position.iter().flat_map(|value| value.to_le_bytes()));
        bytes
    }))
}

fn of_times(times: &[(u64, RowTime)]) -> String {
    digest(times.iter().flat_map(|(row, time)| {
        let fields = [*row, time.device_ticks, time.arrival_10us];
        let mut bytes = fields.map(u64::to_le_bytes).concat();
        bytes.push(time.timecode.is_some().into());
        bytes.extend(time.timecode.unwrap_or_default());
        bytes
    }))
}

pub(super) fn digest(bytes: impl Iterator<Item = u8>) -> String {
    let hash = Sha256::digest(bytes.collect::<Vec<_>>());
    hash.iter().take(8).fold(String::new(), |digits, byte| digits + &format!("{byte:02x}"))
}
