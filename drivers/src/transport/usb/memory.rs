//! The kernel's limit on what all USB transfers of all programs may hold in memory.

use std::fs;

use super::bulk::{TRANSFER_BYTES, TRANSFERS};

const PARAMETER: &str = "/sys/module/usbcore/parameters/usbfs_memory_mb";

/// The limit in MiB; `None` where there is none (0), or it cannot be read.
pub(super) fn limit_mib() -> Option<u64> {
    parse(&fs::read_to_string(PARAMETER).ok()?)
}

fn parse(text: &str) -> Option<u64> {
    text.trim().parse().ok().filter(|mib| *mib > 0)
}

/// Why there is no memory for transfers, and what to type.
pub(super) fn words(device: &str, limit_mib: Option<u64>) -> String {
    let limit = limit_mib.map_or_else(String::new, |mib| format!(", {mib} MiB for all programs,"));
    let raised = limit_mib.unwrap_or(16).saturating_mul(4).max(64);
    format!(
        "no memory for USB transfers with {device}: the kernel's limit{limit} is used up, and {TRANSFERS} \
         transfers of {} KiB are needed; close other programs that use USB, or type \
         `echo {raised} | sudo tee {PARAMETER}`",
        TRANSFER_BYTES >> 10
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_kernels_parameter() {
        assert_eq!(parse("16\n"), Some(16));
        assert_eq!(parse("0\n"), None, "no limit");
        assert_eq!(parse("many"), None);
    }

    #[test]
    fn says_what_to_type() {
        let words = words("usb:1209:0001:A", Some(16));
        assert!(words.contains("usb:1209:0001:A") && words.contains("16 MiB"), "{words}");
        assert!(words.contains(&format!("`echo 64 | sudo tee {PARAMETER}`")), "{words}");
        assert!(super::words("x", Some(u64::MAX)).contains("echo 1844"));
    }
}
