//! Seeds of `read_lsl`.

use mocapd_drivers::lsl::{StreamMessage, put_message};

/// Messages of a line, samples, descriptions and URIs.
pub(super) fn messages() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for how in 0..4_u8 {
        seeds.push([&[how], &feeds()[..]].concat());
        seeds.push([&[how], &sample(2.5)[..]].concat());
        for xml in crate::lsl::descriptions() {
            seeds.push([&[how], xml.as_bytes()].concat());
        }
        seeds.push([&[how], &b"Rig,EMG%2C 1?hostname=lab&rate=100&unit=mm"[..]].concat());
    }
    seeds
}

/// A sample of four floats with a time stamp, and one without.
fn sample(time_s: f64) -> Vec<u8> {
    let mut bytes = vec![2];
    bytes.extend(time_s.to_le_bytes());
    (1..5).for_each(|value| bytes.extend((value as f32).to_le_bytes()));
    bytes.push(1);
    (1..5).for_each(|_| bytes.extend(f32::NAN.to_le_bytes()));
    bytes
}

fn feeds() -> Vec<u8> {
    let mut wire = Vec::new();
    for number in 0..4 {
        let read_ns = 1_000_000 * number;
        put_message(
            StreamMessage::Data { stream: 0, read_ns, bytes: &sample(number as f64) },
            &mut wire,
        );
        let text = [&[2][..], &1.5_f64.to_le_bytes(), &[1, 2, b'g', b'o']].concat();
        put_message(StreamMessage::Data { stream: 1, read_ns, bytes: &text }, &mut wire);
        put_message(StreamMessage::Time { host_ns: 5, sender_s: 0.25, read_ns }, &mut wire);
    }
    put_message(StreamMessage::Ended, &mut wire);
    wire
}
