//! Strays keep their ids on lines too slow for every frame, and never share one.

use std::collections::BTreeMap;

use mocapd_drivers::device::Command;
use mocapd_simulator::generator::JumpSpec;
use mocapd_simulator::ndi::NdiSettings;
use mocapd_take::motion::Motion;

use super::bench::{Bench, jump, settings};

/// How stray markers were numbered over a line.
#[derive(Debug, Default)]
struct Numbered {
    /// Frames skipped.
    skipped: usize,
    /// Different ids used.
    numbers: usize,
    /// How often a stray had another id than when it was last visible.
    renumbered: usize,
    /// How often an id moved to another stray between two fetched frames.
    confused: usize,
}

fn numbered(motion: &Motion, baud: u32) -> Numbered {
    let mut bench = Bench::new(motion.clone(), NdiSettings::default(), baud);
    bench.identify();
    bench.send(Command::Start { line_bytes_per_s: 0 });
    bench.run_until(|bench| bench.end.is_some() || bench.refused.is_some());
    let bits = |position: [f32; 3]| position.map(f32::to_bits);
    let mut out = Numbered::default();
    let (mut number_of, mut column_of) = (BTreeMap::new(), BTreeMap::new());
    let mut last = None;
    for received in &bench.frames {
        let row = motion.frame(received.seq as usize);
        out.skipped += last.map_or(0, |last| (received.seq - last - 1) as usize);
        last = Some(received.seq);
        let mut now = BTreeMap::new();
        for sample in &received.markers {
            let column = row.iter().position(|p| bits(*p) == bits(sample.position_mm)).unwrap();
            let before = number_of.insert(column, sample.id);
            out.renumbered += usize::from(before.is_some_and(|before| before != sample.id));
            let was: Option<&usize> = column_of.get(&sample.id);
            out.confused += usize::from(was.is_some_and(|was| *was != column));
            now.insert(sample.id, column);
        }
        column_of = now;
    }
    let mut ids: Vec<_> =
        bench.frames.iter().flat_map(|f| f.markers.iter().map(|m| m.id)).collect();
    ids.sort_unstable();
    ids.dedup();
    out.numbers = ids.len();
    out
}

#[test]
fn on_a_slow_line_strays_keep_their_numbers() {
    // A whole jump; a third to half of its frames arrive, and nothing is hidden.
    let spec = JumpSpec { seconds: Some(10.0), n_markers: 20, ..JumpSpec::new(11, 60.0) };
    let motion = spec.generate().unwrap().motion;
    for (baud, skipped_min) in [(115_200, 0), (57_600, 200)] {
        let numbered = numbered(&motion, baud);
        assert!(numbered.skipped >= skipped_min, "{numbered:?}");
        assert_eq!(
            (numbered.numbers, numbered.renumbered, numbered.confused),
            (20, 0, 0),
            "{baud}"
        );
    }
}

#[test]
fn hidden_and_skipped_strays_are_not_confused_with_others() {
    // A tenth is hidden at any time: an id changes only when its stray was hidden.
    let numbered = numbered(&jump(20, 60.0, 10.0), 57_600);
    assert!(numbered.skipped > 200, "{numbered:?}");
    assert!(numbered.numbers <= 30 && numbered.renumbered <= 70, "{numbered:?}");
    assert_eq!(numbered.confused, 0, "{numbered:?}");
}

#[test]
fn a_line_too_slow_for_the_strays_is_reported_once_with_a_remedy() {
    let motion = jump(20, 60.0, 3.0);
    for (bx2, baud, remedy) in
        [(true, 57_600, Some("@921600")), (true, 921_600, None), (false, 57_600, Some("@230400"))]
    {
        let tools: &[&str] = if bx2 { &[] } else { &["head"] };
        let mut bench = Bench::new(motion.clone(), settings(tools, bx2), baud);
        bench.identify();
        bench.start();
        bench.run_until(|bench| bench.end.is_some());
        let of_the_speed = |note: &&String| note.contains(&baud.to_string());
        let slow: Vec<_> = bench.notes.iter().filter(of_the_speed).collect();
        assert_eq!(slow.len(), usize::from(remedy.is_some()), "{:?}", bench.notes);
        if let Some(remedy) = remedy {
            assert!(slow[0].contains(remedy), "{slow:?}");
            assert!(slow[0].contains("60 Hz"), "{slow:?}");
        }
        let clock = bench.notes.iter().filter(|note| note.contains("BX2"));
        assert_eq!(clock.count(), usize::from(!bx2), "{:?}", bench.notes);
    }
}
