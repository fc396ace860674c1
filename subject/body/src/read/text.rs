//! Lines, tokens and numbers of text formats.

/// Most bytes of foreign text that a message quotes.
const QUOTE_MAX: usize = 24;

/// Strips a UTF-8 byte order mark.
pub(super) fn without_bom(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(&[0xef, 0xbb, 0xbf]).unwrap_or(bytes)
}

/// Lines with their numbers from 1. Line ends are LF, CR LF, or CR alone if there is no LF.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    bytes
        .split(move |&b| b == end)
        .enumerate()
        .map(|(i, line)| (i + 1, line.strip_suffix(b"\r").unwrap_or(line)))
}

/// Tokens separated by white space.
pub(super) fn tokens(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|token| !token.is_empty())
}

/// The line up to a `#` that begins a token.
pub(super) fn before_comment(line: &[u8]) -> &[u8] {
    let begins = |at: &usize| {
        line.get(*at) == Some(&b'#')
            && at.checked_sub(1).and_then(|at| line.get(at)).is_none_or(u8::is_ascii_whitespace)
    };
    (0..line.len()).find(begins).and_then(|at| line.get(..at)).unwrap_or(line)
}

/// Parses a number, including the ways in which programs write "not a number".
pub(super) fn number(token: &[u8]) -> Option<f64> {
    let token = std::str::from_utf8(token).ok()?;
    if let Ok(number) = token.parse() {
        return Some(number);
    }
    // Microsoft's run-time library: `-1.#IND`, `1.#QNAN`, `1.#INF`.
    let odd = token.trim_start_matches(['-', '+']);
    odd.starts_with("1.#").then_some(f64::NAN)
}

/// Parses an integer.
pub(super) fn integer(token: &[u8]) -> Option<i64> {
    std::str::from_utf8(token).ok()?.parse().ok()
}

/// The next three tokens as a position.
pub(super) fn position(tokens: &mut dyn Iterator<Item = &[u8]>) -> Option<[f64; 3]> {
    let mut next = || number(tokens.next()?);
    Some([next()?, next()?, next()?])
}

/// Quotes a piece of a file: short, and without control characters.
pub(super) fn quote(bytes: &[u8]) -> String {
    let short = bytes.get(..QUOTE_MAX).unwrap_or(bytes);
    let dots = if short.len() < bytes.len() { "..." } else { "" };
    format!("`{}{dots}`", short.escape_ascii())
}
