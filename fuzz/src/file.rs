//! Bytes of anybody as a file of another program.

use mocapd_take::{interchange::Format, motion::MotionFrames};

use crate::Input;

/// Bytes of positions that a byte of input may become.
const EARNED: usize = 48;

/// The first byte says which format. An error, or a motion that the bytes earn; and what was read can be written, or is
/// refused.
pub fn read_file(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let format = match input.byte() & 3 {
        0 => Format::C3d,
        1 => Format::Trc,
        2 => Format::Tsv,
        _ => Format::Csv,
    };
    let file = input.take(usize::MAX);
    let Ok(motion) = format.read(file) else { return };
    let positions = size_of_val(&motion.positions_mm[..]);
    assert!(positions <= file.len() * EARNED, "{positions} bytes of positions from {}", file.len());
    let foreign: u64 = motion.info.foreign.iter().map(|part| part.data.len()).sum();
    assert!(foreign <= 2 * file.len() as u64 + 1024, "{foreign} bytes kept from {}", file.len());
    assert!(motion.info.markers.is_empty() || motion.n_frames() as u64 == motion.info.n_frames);
    let mut written = Vec::new();
    // The rate of a CSV is that of its times: one frame has none.
    let has_rate = motion.n_frames() >= 2 && !motion.info.markers.is_empty();
    if format.write(&mut MotionFrames::new(&motion), &mut written).is_ok() && has_rate {
        let again = format.read(&written).expect("our own file");
        assert_eq!(again.info.markers.len(), motion.info.markers.len());
        assert_eq!(again.n_frames(), motion.n_frames());
    }
}
