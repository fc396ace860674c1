//! Numbers as people read them.

/// `12 345 678`: digits in threes.
pub(crate) fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(digit);
    }
    out
}

/// `1 marker`, `12 345 markers`.
pub(crate) fn count(n: u64, what: &str) -> String {
    format!("{} {what}{}", thousands(n), if n == 1 { "" } else { "s" })
}

/// `12 345 frames`, or `300 of 12 345 frames` where some of the rows are empty.
pub(crate) fn frames_of(recorded: u64, rows: u64) -> String {
    if recorded < rows {
        format!("{} of {}", thousands(recorded), count(rows, "frame"))
    } else {
        count(rows, "frame")
    }
}

/// `1.3 MB`.
pub(crate) fn bytes(n: u64) -> String {
    match n {
        0..10_000 => format!("{} B", thousands(n)),
        10_000..1_000_000 => format!("{:.1} kB", n as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", n as f64 / 1e6),
        _ => format!("{:.2} GB", n as f64 / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_for_people() {
        assert_eq!(thousands(0), "0");
        assert_eq!(thousands(1_234_567), "1 234 567");
        assert_eq!(count(1, "marker"), "1 marker");
        assert_eq!(count(1200, "frame"), "1 200 frames");
        assert_eq!(frames_of(1200, 1200), "1 200 frames");
        assert_eq!(frames_of(300, 1200), "300 of 1 200 frames");
        assert_eq!(bytes(999), "999 B");
        assert_eq!(bytes(1_250_000), "1.2 MB");
    }
}
