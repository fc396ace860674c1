//! Seeds of the fuzz targets: valid inputs, and valid ones that were modified.

mod faces;
mod meshes;
mod natnet;
mod network;
mod streams;

use mocapd_codec::{BlockReport, Rows, Settings, Tolerance};
use mocapd_drivers::{
    device::{Frame, Hello, MarkerInfo, MarkerSample, Status},
    link::{DeviceLink, FrameForm},
};
use mocapd_take::{
    TakeWriter,
    chunk::{self, ChunkParse},
    interchange::Format,
    motion::{Foreign, GAP, Marker, Motion, MotionFrames, MotionInfo, Source, UpAxis},
    record::{Channel, Device, EndingKind, Event, EventKind, Header, Ledger},
    statistics::{BlockTally, StretchTally},
    stretch::{Span, StretchHeaderWriter, put_block},
    timeline::{LossCauses, RowTime, Timeline, TimelineEncoder},
};

/// Modes of a channel in `motion.rs`, with a scale: rest, random walk, smooth, given steps, jumps, any bits.
const MODES: [u8; 8] = [0x00, 0x72, 0x52, 0x63, 0x54, 0x66, 0x6a, 0x07];

/// A fuzz target and its seeds.
#[derive(Debug)]
pub struct Target {
    /// Its name, which is that of its folder of seeds.
    pub name: &'static str,
    /// Runs it on an input.
    pub run: fn(&[u8]),
    /// The seeds.
    pub seeds: Vec<Vec<u8>>,
}

/// All targets.
#[must_use]
pub fn targets() -> Vec<Target> {
    let target = |name, run, seeds| Target { name, run, seeds };
    vec![
        target("round_trip", crate::round_trip, round_trips()),
        target("decode_block", crate::decode_block, blocks()),
        target("decode_samples", crate::decode_samples, samples()),
        target("range_coder", crate::range_coder, programs()),
        target("read_take", crate::read_take, takes()),
        target("recover_take", crate::recover_take, damaged_takes()),
        target("read_file", crate::read_file, files()),
        target("hear", crate::hear, wires()),
        target("read_qtm", crate::read_qtm, network::packets()),
        target("read_lsl", crate::read_lsl, streams::messages()),
        target("read_natnet", crate::read_natnet, natnet::messages()),
        target("config", crate::config, configs()),
        target("read_mesh", crate::read_mesh, meshes::files()),
        target("read_skeleton", crate::read_skeleton, meshes::skeletons()),
        target("read_photo", crate::read_photo, faces::photos()),
        target("read_face", crate::read_face, faces::faces()),
        target("read_mapping", crate::read_mapping, faces::mappings()),
        target("read_face_model", crate::read_face_model, faces::models()),
    ]
}

/// Pseudo-random bytes, always the same.
fn noise(seed: usize, len: usize) -> Vec<u8> {
    let mut state = seed as u32;
    let byte = |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    (0..len).map(byte).collect()
}

/// A stretch of `n_channels` channels, for `Group::stretch`.
fn stretch(i: usize, n_channels: usize, n_rows: u8) -> Vec<u8> {
    let mut seed = vec![n_rows];
    for channel in 0..n_channels {
        let mode = MODES[(i + channel) % MODES.len()];
        seed.extend([mode, [0, 0, 0x55, 0x11, 0, 0xfe][(i + 2 * channel) % 6]]);
        match mode & 7 {
            4 | 5 => seed.extend(noise(i, 3 * usize::from(n_rows))),
            7 => seed.extend(noise(i + 1, 12 * usize::from(n_rows))),
            _ => {}
        }
    }
    seed
}

fn round_trips() -> Vec<Vec<u8>> {
    let seed = |i: usize| {
        let n_channels = i % 4 + 1;
        let mut seed = vec![(i % 7) as u8, (i * 37 % 256) as u8, n_channels as u8 - 1];
        for block in 0..5 {
            seed.push(if block == 3 { 0 } else { 1 });
            seed.extend(stretch(i, n_channels, [30, 7, 1, 19, 40][block]));
        }
        seed
    };
    (0..70).map(seed).collect()
}

fn blocks() -> Vec<Vec<u8>> {
    let seed = |i: usize| {
        let n_channels = i % 4 + 1;
        let mut seed = vec![(i % 7) as u8, (i * 37 % 256) as u8, n_channels as u8 - 1];
        seed.extend([3, 1, 4, 2]);
        for operation in [0b101, 0b001, 0b0_1010, 0b001, 0b101, 0b011, 0b001] {
            seed.push(operation);
            if operation & 3 != 3 {
                seed.extend(stretch(i, n_channels, 20));
            }
            if operation & 3 == 2 {
                seed.extend([i as u8, 0, 1 << (i % 8)]);
            }
        }
        // A real block as arbitrary bytes, and some noise.
        let real = block((i % 7) as u8, (i * 37 % 256) as u8, i);
        for (key, n_rows, bytes) in [(4, 12, real), (0, 12, noise(i, 40)), (4, 200, noise(i, 9))] {
            seed.extend([key, n_rows, 0, bytes.len() as u8, (bytes.len() >> 8) as u8]);
            seed.extend(bytes);
        }
        seed
    };
    (0..70).map(seed).collect()
}

/// Positions of a channel that swings.
fn swing(channel: usize, n_rows: usize) -> Vec<[f32; 3]> {
    let at = |row: usize| {
        let t = row as f32 / 60.0 + channel as f32;
        [300.0 * t.sin(), 900.0 + 50.0 * (3.0 * t).cos(), 10.0 * t]
    };
    (0..n_rows).map(at).collect()
}

/// A key block of two channels over twelve rows.
fn block(kind: u8, tolerance: u8, i: usize) -> Vec<u8> {
    let settings = crate::Input::new(&[kind, tolerance]).settings();
    let paths = [swing(i, 12), swing(i + 1, 12)];
    let present: Vec<bool> = (0..12).map(|row| i.is_multiple_of(2) || row % 5 != 3).collect();
    let rows = [0, 1].map(|channel| Rows::new(&paths[channel], &present).expect("12 rows"));
    let shared = settings.plan(&rows).expect("finite samples");
    let (mut out, mut reports) = (Vec::new(), [BlockReport::default(); 2]);
    settings
        .encoder()
        .encode(&rows, &shared, true, &mut out, &mut reports)
        .expect("finite samples");
    out
}

/// Blocks of sampled channels of every kind of signal, an encoder's, modified and arbitrary ones.
fn samples() -> Vec<Vec<u8>> {
    let seed = |i: usize| {
        let mut seed = vec![(i % 5) as u8];
        for (number, operation) in [1, 1, 2, 0, 1, 3, 1, 2].into_iter().enumerate() {
            let key = if number % 4 == 1 { 0 } else { 4 };
            seed.push(operation | key | (i as u8) << 3);
            match operation {
                0 => {
                    seed.extend([20, 0, 30, 0]);
                    seed.extend(noise(i, 30));
                }
                1 | 2 => {
                    seed.push(40);
                    seed.extend(noise(i + number, 40 * (i % 5 + 1) * 2));
                }
                _ => {}
            }
        }
        seed
    };
    (0..40).map(seed).collect()
}

fn programs() -> Vec<Vec<u8>> {
    (0..20)
        .map(|i| {
            let mut seed = vec![if i % 4 == 0 { 5 } else { 0xff }, 0xff * u8::from(i % 4 != 0)];
            // Runs of expected bits, and of unexpected ones, which cause carries.
            let value =
                |at: usize, byte: u8| if (at / 64 + i).is_multiple_of(3) { byte } else { 0xff };
            seed.extend(noise(i, 400 + 20 * i).into_iter().enumerate().map(|(at, b)| value(at, b)));
            seed
        })
        .collect()
}

/// Small files of each format, whole and cut, with gaps and labels of every kind.
fn files() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for i in 0..6 {
        let names = ["head", "l knee", "", "a,b", "é"];
        let marker = |k: usize| Marker { label: names[k % names.len()].to_owned(), labelled: true };
        let n_frames = 3 + 2 * i;
        let info = MotionInfo {
            rate_hz: 100.0,
            n_frames: n_frames as u64,
            markers: (0..=i).map(marker).collect(),
            source: Source { factor: 1.0, first_frame: 1, ..Source::default() },
            ..MotionInfo::default()
        };
        let mut motion = Motion { info, positions_mm: Vec::new() };
        let paths: Vec<_> = (0..=i).map(|k| swing(k, n_frames)).collect();
        for row in 0..n_frames {
            let gap = |k: usize| (row + k).is_multiple_of(4);
            let positions = paths.iter().map(|path| path[row]).enumerate();
            motion.positions_mm.extend(positions.map(|(k, at)| if gap(k) { GAP } else { at }));
        }
        for (byte, format) in [(0, Format::C3d), (1, Format::Trc), (3, Format::Csv)] {
            let mut seed = vec![byte];
            // Writing stops at a label that the format cannot hold; the partial file is also a seed.
            format.write(&mut MotionFrames::new(&motion), &mut seed).ok();
            let cut = seed.len() * 2 / 3;
            seeds.push(seed[..cut].to_vec());
            seeds.push(seed);
        }
    }
    let tsv = "NO_OF_FRAMES\t2\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t2\nFREQUENCY\t100\nNO_OF_ANALOG\t0\n\
               ANALOG_FREQUENCY\t0\nDESCRIPTION\t--\nTIME_STAMP\t--\nDATA_INCLUDED\t3D\nMARKER_NAMES\ta\tb\n\
               1.0\t2.0\t3.0\t4.0\t5.0\t6.0\n1.5\t2.5\t3.5\t0.000\t0.000\t0.000\n";
    seeds.push([&[2], tsv.as_bytes()].concat());
    seeds
}

/// A device's messages: unchanged, damaged, and as messages whose checksums the target computes.
fn wires() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for i in 0..12_usize {
        let (mut link, mut wire) = (DeviceLink::new(), Vec::new());
        let hello = Hello {
            model: "rig".into(),
            serial: "1".into(),
            rate_millihertz: 100_000,
            rate_min_millihertz: 60_000,
            rate_max_millihertz: 1_000_000,
            tick_hz: 1 << i,
            markers_max: 64,
            ..Hello::default()
        };
        link.hello(&hello, &mut wire).expect("short names");
        let label = |id: u16| MarkerInfo { id, label: format!("m{id}"), labelled: id > 0 };
        link.markers(&(0..i as u16).map(label).collect::<Vec<_>>(), &mut wire)
            .expect("few markers");
        let form = if i.is_multiple_of(2) { FrameForm::Float } else { FrameForm::Micrometres };
        for seq in 0..4 {
            let markers: Vec<_> = (0..i as u16)
                .map(|id| MarkerSample {
                    id,
                    occluded: (id + seq as u16).is_multiple_of(3),
                    position_mm: swing(id.into(), 4)[seq as usize],
                    ..MarkerSample::default()
                })
                .collect();
            let frame =
                Frame { seq, device_ticks: u64::from(seq) * 10, timecode: None, markers: &markers };
            link.frame(form, &frame, &mut wire).expect("few markers");
        }
        link.end_of_stream(Status { frames_produced: 4, ..Status::default() }, &mut wire);
        let as_is = [0, 2, 4, 6][i % 4];
        seeds.push([&[as_is], &wire[..]].concat());
        let at = wire.len() * i / 12;
        wire[at] ^= 0x20;
        seeds.push([&[as_is], &wire[..]].concat());
        // Any payload in a message of each type.
        let kinds = [0x01, 0x02, 0x03, 0x10, 0x11, 0x12, 0x20, 0x21, 0x22, 0x23, 0x30, 0x40];
        let payload = noise(i, 3 * i);
        let mut seed = vec![1 | as_is, kinds[i], payload.len() as u8, 0];
        seed.extend(payload);
        seeds.push(seed);
    }
    seeds
}

/// The example configuration, every key with its default or an example, and common mistakes.
fn configs() -> Vec<Vec<u8>> {
    let example = mocapd_service::config::example();
    let mut given = String::new();
    for key in mocapd_service::config::keys::KEYS {
        // Dotted keys, because a section may occur only once.
        given.push_str(&format!("{} = {}\n", key.path, key.example()));
    }
    let mut seeds = vec![example.into_bytes(), given.clone().into_bytes()];
    for (from, to) in [
        ("auto", "usb:1209:0001:A?driver=dvmc"),
        ("\"0.5mm\"", "'1e-1 mm'"),
        ("lossless = false", "lossless = true"),
        ("[]", "['192.168.10.0/24', '::1']"),
        ("127.0.0.1", "0.0.0.0"),
        ("= 240", "= \"59.94Hz\""),
        ("\"10s\"", "10"),
        ("pre_roll", "pre_rol"),
        ("{date}", "../{dat}"),
        (" = ", " = = "),
    ] {
        seeds.push(given.replace(from, to).into_bytes());
    }
    seeds
}

/// Takes: unchanged, and as chunks whose checksums the target computes.
fn takes() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for kind in ["dense", "fast", "lossless", "lossless:predictive", "spline", "sync"] {
        for timed in [false, true] {
            let take = take(kind, timed);
            let mut chunks = vec![1];
            let mut rest = &take[chunk::MAGIC.len()..];
            while let ChunkParse::Whole { kind, payload, len } = chunk::parse(rest) {
                chunks.extend([kind, payload.len() as u8, (payload.len() >> 8) as u8]);
                chunks.extend(payload);
                rest = &rest[len..];
            }
            seeds.push([&[0], &take[..]].concat());
            seeds.push([&[4], &take[..take.len() / 2]].concat());
            seeds.push(chunks);
        }
    }
    seeds
}

/// Takes with none, one, three and twenty of their bytes changed.
fn damaged_takes() -> Vec<Vec<u8>> {
    let damage = [0, 1, 3, 20];
    let damaged =
        |seed: Vec<u8>| damage.map(|n: u8| [&[seed[0] & 7 | n << 3], &seed[1..]].concat());
    takes().into_iter().flat_map(damaged).collect()
}

/// Three analog channels of 16-bit integers, four samples in each of thirty frames; with error
/// bounds, one of them that of an exact channel, or without.
fn analog_part(is_bounded: bool) -> Foreign {
    const SAMPLES: usize = 120;
    let mut data = vec![1, 2];
    data.extend([3_u32, 4].iter().flat_map(|number| number.to_le_bytes()));
    data.extend([1_u64, SAMPLES as u64 / 4].iter().flat_map(|number| number.to_le_bytes()));
    for column in 0..3 {
        // High bytes of small differences, then their low bytes.
        data.extend([0; SAMPLES]);
        data.extend(noise(column, SAMPLES).iter().map(|byte| byte >> 4));
    }
    let bounds = if is_bounded { vec![1.0, 0.0, 3.0] } else { Vec::new() };
    Foreign { bounds, ..Foreign::exact("c3d/analog", data) }
}

fn take(kind: &str, timed: bool) -> Vec<u8> {
    const ROWS: usize = 30;
    let settings = Settings {
        kind: kind.parse().expect("a resampler's name"),
        tolerance: Tolerance::from_mm(0.5).expect("a tolerance"),
    };
    let channels: Vec<Channel> =
        (0..3).map(|i| Channel { marker_id: i, label: format!("m{i}"), labelled: i < 2 }).collect();
    let mut header = Header {
        software: "seeds".to_owned(),
        take_id: [7; 16],
        created_unix_ms: 0,
        resampler: String::new(),
        codec_version: 0,
        tolerance_mm: 0.0,
        rate_hz: 60.0,
        up_axis: UpAxis::default(),
        device: None,
        source: None,
        channels: channels[..2].to_vec(),
        stretch_rows: ROWS as u32,
        settings: vec![("key".to_owned(), "value".to_owned())],
    };
    header.set_codec(&settings);
    if timed {
        header.device = Some(Device { tick_hz: 1_000_000, ..Device::default() });
    }
    let mut writer = TakeWriter::new(Vec::new(), &header).expect("a header");
    writer.channels(&channels[2..]).expect("a channel");
    if kind == "lossless" {
        writer.foreign(&analog_part(timed)).expect("a short part");
    }
    let event = Event {
        kind: EventKind::Mark,
        row: 3,
        device_ticks: 50_000,
        host_ns: 1,
        input: 0,
        text: "start".to_owned(),
    };
    writer.event(&event).expect("an event");
    let paths: Vec<_> = (0..3).map(|channel| swing(channel, 5 * ROWS)).collect();
    let mut front = if timed {
        StretchHeaderWriter::with_times(ROWS as u32, TimelineEncoder::new(1_000_000, 60.0))
    } else {
        StretchHeaderWriter::new(ROWS as u32)
    };
    let mut encoder = settings.encoder();
    let mut first_row = 0;
    for number in 0..4_u8 {
        let n_rows = if number == 1 { 7 } else { ROWS };
        let key = number % 3 == 0 || !settings.kind.is_live();
        let mut timeline = Timeline::default();
        timeline.restart(first_row);
        if timed && number == 2 {
            timeline.push_lost(4, LossCauses::NOT_RECEIVED);
        }
        let from = first_row + timeline.n_rows();
        for row in from..from + n_rows as u64 {
            timeline.push(RowTime {
                device_ticks: row * 16_667,
                arrival_10us: row * 1667 + row % 3,
                timecode: None,
            });
        }
        let at = from as usize..from as usize + n_rows;
        let present: Vec<bool> = at.clone().map(|row| row % 11 != 4).collect();
        let rows: Vec<_> = paths
            .iter()
            .map(|path| Rows::new(&path[at.clone()], &present).expect("of one length"))
            .collect();
        let shared = settings.plan(&rows).expect("finite samples");
        let (mut block, mut reports) = (Vec::new(), [BlockReport::default(); 3]);
        encoder.encode(&rows, &shared, key, &mut block, &mut reports).expect("finite samples");
        let span = Span { first_row: from, n_rows: n_rows as u32, key, number };
        let mut payload = Vec::new();
        front.put(span, &timeline, &shared, number % 2 == 0, &mut payload);
        put_block(&block, number % 2 == 0, &mut payload);
        let tally = BlockTally::of_encoded(&block, &rows, &reports, encoder.kept_rows());
        writer.stretch(span, &payload, &StretchTally::of(&tally)).expect("a stretch");
        first_row = span.end_row();
    }
    // Takes without a device are imports, which have no ending.
    let ending = timed.then(|| EndingKind::DiskFull.into());
    writer.close(&Ledger::default(), ending).expect("a ledger");
    writer.abandon()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A target that fails on its own seeds is useless.
    #[test]
    fn every_target_passes_on_its_seeds() {
        for Target { name, run, seeds } in targets() {
            assert!(!seeds.is_empty(), "{name}");
            seeds.iter().for_each(|seed| run(seed));
        }
    }
}
