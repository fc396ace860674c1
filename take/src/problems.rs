//! What is wrong with a take, one sentence each: as many as anyone reads.

/// Sentences that are kept. A take that a disk has ruined has one a stretch; a file that was made to have more would
/// have one every few bytes, each longer than these.
pub const PROBLEMS_MAX: usize = 10_000;

/// A list of problems that does not grow with the damage.
pub trait Problems {
    /// Adds one, if there are not too many already; the last one then says that there are more.
    fn note(&mut self, problem: String);
}

impl Problems for Vec<String> {
    fn note(&mut self, problem: String) {
        if self.len() < PROBLEMS_MAX {
            self.push(problem);
        } else if self.len() == PROBLEMS_MAX {
            self.push(format!("there are more problems than these {PROBLEMS_MAX}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_ends_and_says_so() {
        let mut problems = Vec::new();
        (0..2 * PROBLEMS_MAX).for_each(|i| problems.note(i.to_string()));
        assert_eq!(problems.len(), PROBLEMS_MAX + 1);
        assert_eq!(problems[PROBLEMS_MAX - 1], (PROBLEMS_MAX - 1).to_string());
        assert!(problems[PROBLEMS_MAX].contains("more problems"));
    }
}
