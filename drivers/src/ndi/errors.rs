//! What a device says with `ERRORxx`, and what helps.

/// In words: what the code says, and what to do. The codes are those of the vendor's guide; a code
/// that is not in it is given by its number.
pub(super) fn words(code: u8) -> &'static str {
    match code {
        0x01 => "it does not know the command: its firmware is too old for this driver, update it",
        0x02 | 0x03 | 0x07 => "the command does not fit its firmware: update it",
        0x04 => "the command arrived damaged: check the cable, or use a lower baud rate",
        0x05 => "it timed out inside: switch it off and on again",
        0x06 => "it cannot run its line at that speed: give a lower baud rate",
        0x08 => "the port handle is not valid: plug the tool in again",
        0x09 => "it cannot track this tool: its definition is for another kind of system",
        0x0C => "it is in another mode than expected: is another program using it?",
        0x0D => "no tool is assigned to the port: plug the tool in again",
        0x0E => "the port is not initialized: plug the tool in again",
        0x0F => "the port is not enabled: plug the tool in again",
        0x10 => "it is not initialized: switch it off and on again",
        0x11 => "it cannot stop tracking: switch it off and on again",
        0x12 => "it cannot start tracking: look at its error light, and switch it off and on again",
        0x13 => "it cannot initialize the tool: unplug the tool, or repair its definition",
        0x14 | 0x22 | 0x24 => {
            "its calibration does not fit the tool or the volume: choose another volume"
        }
        0x15 => "it cannot initialize itself: switch it off and on again",
        0x18 | 0xF1 => "too much infrared light around it: remove the lamp or the sunlight",
        0x19 | 0x25 | 0x29 => "its firmware cannot be read: have it serviced",
        0x1A => "an internal error: switch it off and on again",
        0x1D..=0x20 => "it cannot read the tool's memory: clean the tool's plug",
        0x21 => "the tool draws a wrong current: have the tool repaired",
        0x23 => "a value is out of its range: its firmware is too old for this driver",
        0x28 => "its hardware changed while it ran: switch it off and on again",
        0x2A => "it has no memory left: unplug tools, and switch it off and on again",
        0x2B | 0x2C => "the tool is gone: plug it in again",
        0x2D => "all its ports are taken: switch it off and on again to free them",
        0xF4..=0xF6 => "its flash memory fails: have it serviced",
        _ => "see its user's guide for the code",
    }
}

/// The code in `ERRORxx`.
pub(super) fn code(text: &str) -> Option<u8> {
    let digits = text.strip_prefix("ERROR")?;
    (digits.len() == 2).then(|| u8::from_str_radix(digits, 16).ok()).flatten()
}
