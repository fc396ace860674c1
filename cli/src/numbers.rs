//! Numbers as people read them.

/// A number with its digits in groups of three: `12 345 678`.
#[must_use]
pub fn thousands(n: u64) -> String {
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

/// A count with its noun, plural with s: `1 marker`, `12 345 markers`.
#[must_use]
pub fn count(n: u64, what: &str) -> String {
    count_of(n, [what, &format!("{what}s")])
}

/// A count with a noun of irregular plural: `1 vertex`, `2 vertices`.
#[must_use]
pub fn count_of(n: u64, [one, several]: [&str; 2]) -> String {
    format!("{} {}", thousands(n), if n == 1 { one } else { several })
}

/// A number of bytes with its unit: `1.3 MB`.
#[must_use]
pub fn bytes(n: u64) -> String {
    match n {
        0..10_000 => format!("{} B", thousands(n)),
        // What would round to 1000.0 has the next unit.
        10_000..999_950 => format!("{:.1} kB", n as f64 / 1e3),
        999_950..999_950_000 => format!("{:.1} MB", n as f64 / 1e6),
        _ => format!("{:.2} GB", n as f64 / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_grouped_and_nouns_agree() {
        assert_eq!(thousands(0), "0");
        assert_eq!(thousands(1_234_567), "1 234 567");
        assert_eq!(count(1, "marker"), "1 marker");
        assert_eq!(count(1200, "frame"), "1 200 frames");
        assert_eq!(count_of(2, ["vertex", "vertices"]), "2 vertices");
    }

    #[test]
    fn bytes_have_a_unit() {
        assert_eq!(bytes(999), "999 B");
        assert_eq!(bytes(1_250_000), "1.2 MB");
    }
}
