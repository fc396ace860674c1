//! A set of trials as a study has it: several subjects, who each jump many times.

use super::{GenerateError, Jump, JumpSpec, Rng, TRIALS_MAX};

/// The most subjects of a set.
pub const SUBJECTS_MAX: u32 = 1000;

/// Jumps dealt to subjects as evenly as they go: 326 to 10 are 33 for the first six and 32 for the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JumpSet {
    /// How each jump is seen; its seed is the set's, and says who the subjects are.
    pub spec: JumpSpec,
    n_subjects: u32,
    n_jumps: u32,
}

impl JumpSet {
    /// Subjects differ in stature (1.60 to 1.92 m) and style, jumps of one subject by a few per cent.
    ///
    /// # Errors
    /// When a number is out of its range; the message names it and the range.
    pub fn new(spec: JumpSpec, n_subjects: u32, n_jumps: u32) -> Result<Self, GenerateError> {
        for (what, value, high) in
            [("subjects", n_subjects, SUBJECTS_MAX), ("jumps", n_jumps, TRIALS_MAX)]
        {
            let (value, high) = (f64::from(value), f64::from(high));
            if !(1.0..=high).contains(&value) {
                return Err(GenerateError::OutOfRange { what, value, low: 1.0, high });
            }
        }
        Ok(Self { spec, n_subjects, n_jumps })
    }

    /// Each jump in turn, by its subject and trial, both from 1: a whole trial each.
    pub fn jumps(&self) -> impl Iterator<Item = (u32, u32, Result<Jump, GenerateError>)> {
        let Self { spec, n_subjects, n_jumps } = *self;
        (0..n_subjects).flat_map(move |subject| {
            let n_trials = n_jumps / n_subjects + u32::from(subject < n_jumps % n_subjects);
            let seed = Rng::stream(spec.seed, 0x4_0000 + u64::from(subject)).next_u64();
            (0..n_trials).map(move |first_trial| {
                let spec = JumpSpec { seed, first_trial, ..spec };
                (subject + 1, first_trial + 1, spec.generate())
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(n_subjects: u32, n_jumps: u32) -> Vec<(u32, u32, Jump)> {
        let set = JumpSet::new(JumpSpec::new(1, 30.0), n_subjects, n_jumps).unwrap();
        set.jumps().map(|(subject, trial, jump)| (subject, trial, jump.unwrap())).collect()
    }

    #[test]
    fn jumps_are_dealt_evenly_and_none_is_another() {
        let jumps = set(3, 8);
        let who: Vec<(u32, u32)> =
            jumps.iter().map(|(subject, trial, _)| (*subject, *trial)).collect();
        assert_eq!(who, [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3), (3, 1), (3, 2)]);
        for (i, (_, _, a)) in jumps.iter().enumerate() {
            assert_eq!(a.phases.len(), 7, "each is one whole trial");
            assert!(
                jumps[..i].iter().all(|(_, _, b)| b.motion.positions_mm != a.motion.positions_mm)
            );
        }
    }

    #[test]
    fn a_subject_keeps_its_bones_and_subjects_differ() {
        let jumps = set(2, 4);
        let thigh_mm = |jump: &Jump| {
            let [hip, knee] = [9, 10].map(|site| jump.motion.frame(0)[site].map(f64::from));
            (0..3).map(|axis| (hip[axis] - knee[axis]).powi(2)).sum::<f64>().sqrt()
        };
        let lengths: Vec<f64> = jumps.iter().map(|(_, _, jump)| thigh_mm(jump)).collect();
        assert!((lengths[0] - lengths[1]).abs() < 1.0 && (lengths[2] - lengths[3]).abs() < 1.0);
        assert!((lengths[0] - lengths[2]).abs() > 1.0, "{lengths:?}");
    }

    #[test]
    fn the_first_trial_is_the_one_that_was_always_there() {
        let spec = JumpSpec::new(7, 60.0);
        assert_eq!(spec.first_trial, 0);
        let again = JumpSpec { first_trial: 3, ..spec };
        assert_ne!(spec.generate().unwrap().phases, again.generate().unwrap().phases);
        assert!(JumpSpec { first_trial: TRIALS_MAX + 1, ..spec }.generate().is_err());
        assert!(JumpSet::new(spec, 0, 1).is_err() && JumpSet::new(spec, 1, 0).is_err());
    }
}
