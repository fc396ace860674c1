//! What each kind of fault had a part in.

use super::keys::KINDS;
use super::kinds::Kind;

/// For each kind the frames that it changed or hit, or how often it happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Parts([u64; KINDS.len()]);

impl Kind {
    /// Whether it is counted by how often it happened, and not by frames.
    pub(super) fn is_of_a_moment(self) -> bool {
        matches!(
            self,
            Self::Stall
                | Self::ClockJump
                | Self::Unplug
                | Self::PowerLoss
                | Self::CounterJump
                | Self::Garbage
        )
    }
}

impl Parts {
    pub(super) fn add(&mut self, kind: Kind, n: u64) {
        if let Some(part) = self.0.get_mut(kind as usize) {
            *part += n;
        }
    }

    /// These and those.
    pub(super) fn join(mut self, others: Self) -> Self {
        self.0.iter_mut().zip(others.0).for_each(|(part, other)| *part += other);
        self
    }

    /// Of one kind: frames, or times.
    #[must_use]
    pub fn of(&self, kind: Kind) -> u64 {
        self.0.get(kind as usize).copied().unwrap_or(0)
    }

    /// Behind the fates; empty when nothing happened.
    pub(super) fn words(self) -> String {
        let told = KINDS.iter().zip(self.0).filter(|(_, n)| *n > 0).map(|(keys, n)| {
            let name = keys.name;
            match (keys.kind.is_of_a_moment(), n) {
                (true, 1) => format!("{name} once"),
                (true, _) => format!("{name} {n} times"),
                (false, 1) => format!("{name} in 1 frame"),
                (false, _) => format!("{name} in {n} frames"),
            }
        });
        let told: Vec<String> = told.collect();
        if told.is_empty() {
            String::new()
        } else {
            format!("; what happened: {}", told.join(", "))
        }
    }
}
