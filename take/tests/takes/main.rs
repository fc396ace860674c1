//! Takes as they are written and read: claims beyond the limits, orders of markers, still stretches, statistics, subjects, and
//! reading from the middle.

#![expect(clippy::unwrap_used, clippy::panic, reason = "a test stops there")]

mod bounds;
mod middle;
mod order;
mod statistics;
mod still;
mod subject;
#[path = "../sweeps/take.rs"]
mod take;

use mocapd_take::{
    motion::{Motion, MotionFrames},
    motion_encoder::{EncodePlan, MotionWriter},
    record::Header,
};

/// The take of a motion, as an import writes it.
fn encoded(motion: &Motion, header: &Header) -> Vec<u8> {
    let mut frames = MotionFrames::new(motion);
    let (plan, parts) = EncodePlan::new(&mut frames, header).unwrap();
    let mut writer = MotionWriter::new(&plan, &motion.info, header, Vec::new()).unwrap();
    let mut encoder = plan.encoder();
    for part in parts {
        let part = part.unwrap();
        writer.push(&part, &encoder.encode(&part).unwrap()).unwrap();
    }
    writer.finish().unwrap().1
}
