//! The kinds of faults.

use super::super::*;

#[test]
fn kinds_are_indices_into_the_table() {
    for (index, keys) in KINDS.iter().enumerate() {
        assert_eq!(keys.kind as usize, index, "{}", keys.name);
        assert_eq!(keys.kind.name(), keys.name);
    }
    let mut kinds = Kinds::of(Kind::Unplug);
    kinds.add(Kinds::of(Kind::BitFlips));
    assert_eq!(kinds.names(), "bit-flips+unplug");
}
