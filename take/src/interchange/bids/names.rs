//! Whose recording it is and what of: the parts of every file's name.

use crate::interchange::InterchangeError;

/// Subject and task, as file names have them: letters and digits alone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Names {
    subject: String,
    task: String,
}

impl Names {
    /// Checks both.
    ///
    /// # Errors
    /// `Unsupported` when one is empty or has anything but letters and digits of ASCII.
    pub fn new(subject: &str, task: &str) -> Result<Self, InterchangeError> {
        for (what, name) in [("subject", subject), ("task", task)] {
            if name.is_empty() || !name.bytes().all(|b| b.is_ascii_alphanumeric()) {
                return Err(InterchangeError::Unsupported(format!(
                    "the {what} `{name}` does not fit into a file name of bids: use letters a to z and digits"
                )));
            }
        }
        Ok(Self { subject: subject.to_owned(), task: task.to_owned() })
    }

    /// The task that a take's name gives: its letters and digits, or `recording` where it has none.
    #[must_use]
    pub fn task_of(name: &str) -> String {
        let task: String = name.chars().filter(char::is_ascii_alphanumeric).take(64).collect();
        if task.is_empty() { "recording".to_owned() } else { task }
    }

    /// The subject's label.
    #[must_use]
    pub fn subject(&self) -> &str {
        &self.subject
    }

    /// The task's label.
    #[must_use]
    pub fn task(&self) -> &str {
        &self.task
    }

    /// The path of a file of the recording.
    pub(super) fn path(&self, suffix: &str) -> String {
        let Self { subject, task } = self;
        format!("sub-{subject}/motion/sub-{subject}_task-{task}_tracksys-optical_{suffix}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_letters_and_digits() {
        let names = Names::new("01", "walk2").unwrap();
        assert_eq!(
            names.path("motion.tsv"),
            "sub-01/motion/sub-01_task-walk2_tracksys-optical_motion.tsv"
        );
        for (subject, task) in
            [("", "a"), ("a", ""), ("a b", "c"), ("../a", "c"), ("a", "gehen_\u{e4}")]
        {
            assert!(Names::new(subject, task).is_err(), "{subject} {task}");
        }
        assert_eq!(Names::task_of("squat_jump-47m 120hz"), "squatjump47m120hz");
        assert_eq!(Names::task_of("\u{e4}"), "recording");
    }
}
