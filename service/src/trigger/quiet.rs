//! Words about datagrams, of which anybody can send a thousand a second: a few, and then how many more.

use std::time::Duration;

/// Words at once.
const BURST: u32 = 5;

/// One more after so long.
const EACH: Duration = Duration::from_secs(10);

/// Lets a few words through, and counts the others.
#[derive(Debug)]
pub struct Quiet {
    left: u32,
    since: Duration,
    held_back: u64,
}

impl Default for Quiet {
    fn default() -> Self {
        Self { left: BURST, since: Duration::ZERO, held_back: 0 }
    }
}

impl Quiet {
    /// The words, when it is time for them, with how many were held back since the last ones.
    pub fn say(&mut self, words: &str, now: Duration) -> Option<String> {
        let earned = now.saturating_sub(self.since).as_secs() / EACH.as_secs();
        if earned > 0 {
            let earned = u32::try_from(earned).unwrap_or(u32::MAX);
            self.left = self.left.saturating_add(earned).min(BURST);
            self.since = now;
        }
        if self.left == 0 {
            self.held_back += 1;
            return None;
        }
        self.left -= 1;
        let held_back = std::mem::take(&mut self.held_back);
        Some(match held_back {
            0 => words.to_owned(),
            n => format!("{words}; {n} more were not told"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_becomes_a_few_words() {
        let mut quiet = Quiet::default();
        let said: Vec<String> =
            (0..60_000_u64).filter_map(|ms| quiet.say("no", Duration::from_millis(ms))).collect();
        assert_eq!(said.len(), 5 + 5, "{said:?}");
        assert_eq!(said[4], "no");
        assert_eq!(said[5], "no; 9995 more were not told");
        // What was silent for long may say a few again, and no more.
        let later = (0..100).filter(|_| quiet.say("no", Duration::from_secs(86_400)).is_some());
        assert_eq!(later.count(), 5);
    }
}
