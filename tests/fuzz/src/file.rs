//! Arbitrary bytes as an interchange file.

use mocapd_take::{interchange::Format, motion::MotionFrames};

use crate::Input;

/// Maximum number of bytes of positions per byte of input.
const EARNED: usize = 48;

/// Reads a file; the first byte selects the format. Gives an error, or a motion whose size is bounded by the input's,
/// which can be written and read again unless the format cannot hold it.
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
    // The rate of a CSV file follows from its times, so one frame has none.
    let has_rate = motion.n_frames() >= 2 && !motion.info.markers.is_empty();
    if format.write(&mut MotionFrames::new(&motion), &mut written).is_ok() && has_rate {
        let again = format.read(&written).expect("our own file");
        assert_eq!(again.info.markers.len(), motion.info.markers.len());
        assert_eq!(again.n_frames(), motion.n_frames());
    }
}
