//! `demo`: recording, verification and export without hardware.

use super::Folder;
use crate::support::assert_mentions;

#[test]
fn the_demo_records_verifies_and_exports() {
    let folder = Folder::new();
    let demo = ["demo", "--seconds", "1s", "--rate", "240Hz", "--tolerance", "1mm", "--out", "d"];
    let ran = folder.run(&demo).with_code(0);
    assert_eq!(ran.stderr, "");
    let facts = ["240 Hz", "1 s", "1 mm", "ledger closes", "mocapd info d/jump-001.take"];
    assert_mentions(&ran.stdout, &facts);
    let info = folder.run(&["info", "d/jump-001.take", "--json"]).with_code(0).json();
    assert_eq!(info["ledger"]["closes"], true, "{info}");
    let names = || {
        let entries = std::fs::read_dir(folder.path("d")).unwrap();
        let mut names: Vec<_> =
            entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    let first = ["jump-001.c3d", "jump-001.csv", "jump-001.take", "jump-001.trc"];
    assert_eq!(names(), first);
    // The exports are bit-identical to the take.
    for export in ["d/jump-001.c3d", "d/jump-001.trc", "d/jump-001.csv"] {
        let verify = ["verify", "d/jump-001.take", "--against", export, "--json"];
        let report = folder.run(&verify).with_code(0).json();
        assert_eq!(report["against"]["bits_differing"], 0, "{export}");
        assert_eq!(report["against"]["frames"], 240, "{export}");
    }
    // A second run takes the next number, even if only an export of the first is left.
    std::fs::remove_file(folder.path("d/jump-001.take")).unwrap();
    let kept = folder.content();
    folder.run(&demo).with_code(0);
    assert!(names().contains(&"jump-002.take".to_owned()), "{:?}", names());
    for (path, bytes) in kept.iter().filter(|(path, _)| path.is_file()) {
        assert!(std::fs::read(path).is_ok_and(|now| now == *bytes), "{} changed", path.display());
    }
}
