//! Truncated and damaged takes: readable parts are read, the loss is reported, and the exit code is 3.

use mocapd_take::{NotATake, damage::Problem};
use serde_json::Value;

use super::{Folder, Ran};
use crate::support::{assert_mentions, jump};

/// Length of a header, the first chunk: type 01, varint length, payload, CRC-32.
fn header_end(take: &[u8]) -> usize {
    let (mut len, mut at) = (0, 9);
    for shift in 0.. {
        len |= usize::from(take[at] & 0x7f) << (7 * shift);
        at += 1;
        if take[at - 1] & 0x80 == 0 {
            break;
        }
    }
    at + len + 4
}

/// Three stretches of ten seconds.
fn three_stretches() -> (Folder, Vec<u8>) {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(1, 30.0, 30.0));
    let import = ["import", "jump.csv", "-o", "jump.take", "--lossless"];
    folder.run(&import).with_code(0);
    let take = folder.read("jump.take");
    (folder, take)
}

fn problems(report: &Value) -> Vec<&str> {
    report["problems"].as_array().unwrap().iter().map(|p| p.as_str().unwrap()).collect()
}

/// Runs `info`, `verify` and `export` on the same damage: each exits with 3 and reports it on stderr.
fn inspected(folder: &Folder) -> (Value, Vec<String>) {
    let info = folder.run(&["info", "bad.take", "--json"]).with_code(3).json();
    assert!(!problems(&info).is_empty());
    let printed = folder.run(&["info", "bad.take"]).with_code(3);
    let verify = folder.run(&["verify", "bad.take", "--json"]).with_code(3).json();
    assert_eq!(verify["intact"], false);
    for problem in problems(&info) {
        assert!(printed.stderr.contains(problem), "{problem}: {}", printed.stderr);
        assert!(problems(&verify).contains(&problem), "{problem}: {verify}");
    }
    std::fs::remove_file(folder.path("bad.csv")).ok();
    let export: Ran = folder.run(&["export", "bad.take", "-o", "bad.csv"]).with_code(3);
    assert_mentions(&export.stderr, &["bad.take", problems(&info)[0]]);
    let rows: Vec<String> = folder.text("bad.csv").lines().skip(1).map(str::to_owned).collect();
    assert_eq!(rows.len() as u64, info["frames"].as_u64().unwrap());
    (info, rows)
}

#[test]
fn a_truncated_take_is_read_to_its_end() {
    let (folder, take) = three_stretches();
    let original: Vec<String> =
        folder.text("jump.csv").lines().skip(1).map(str::to_owned).collect();
    let header = header_end(&take);
    let mut most = 0;
    for cut in [take.len() / 2, take.len() - 200, take.len() - 1] {
        folder.write("bad.take", &take[..cut]);
        let (info, rows) = inspected(&folder);
        assert_eq!(info["finished"], false);
        assert!(problems(&info).contains(&&*Problem::CutOff.to_string()), "{info}");
        assert_eq!(rows, original[..rows.len()], "cut at {cut}");
        assert!(rows.len() >= most, "cut at {cut}: {} rows", rows.len());
        most = rows.len();
    }
    assert_eq!(most, original.len(), "only the end was cut off");
    for cut in [9, header - 1] {
        folder.write("bad.take", &take[..cut]);
        let line = folder.refuses(&["info", "bad.take"], 1);
        assert_mentions(&line, &["bad.take", &NotATake::HeaderCut.to_string()]);
    }
    for cut in [header, header + 1] {
        folder.write("bad.take", &take[..cut]);
        assert_eq!(folder.run(&["info", "bad.take", "--json"]).with_code(3).json()["frames"], 0);
        folder.run(&["verify", "bad.take"]).with_code(3);
        assert_mentions(
            &folder.refuses(&["export", "bad.take", "-o", "new.csv"], 1),
            &["bad.take"],
        );
    }
}

#[test]
fn damage_in_the_middle_costs_its_stretch_and_no_more() {
    let (folder, take) = three_stretches();
    let original = folder.text("jump.csv");
    let original: Vec<&str> = original.lines().skip(1).collect();
    let mut bad = take.clone();
    bad[take.len() / 2] ^= 0x10;
    folder.write("bad.take", &bad);
    let (info, rows) = inspected(&folder);
    assert_eq!(info["finished"], true);
    let (_, found) = crate::support::rows(&bad);
    let damaged = take.len() as u64 / 2;
    assert!(
        matches!(found[..], [Problem::Damaged { offset, len, .. }] if (offset..offset + len).contains(&damaged)),
        "{found:?}"
    );
    assert_eq!(problems(&info), [found[0].to_string()]);
    assert_eq!(rows.len(), original.len());
    for (index, (row, original)) in rows.iter().zip(&original).enumerate() {
        if (300..600).contains(&index) {
            assert!(row.ends_with(&",".repeat(45)), "row {index} is not gaps: {row}");
        } else {
            assert_eq!(row, original, "row {index}");
        }
    }
    let verify = folder.run(&["verify", "bad.take"]).with_code(3);
    // The frames on the ledger, and those that are left.
    let counts = [&info["ledger"]["samples_present"], &info["samples"]].map(Value::to_string);
    assert_mentions(&verify.stderr, &["bad.take", &counts[0], &counts[1]]);
}

#[test]
fn every_byte_that_is_damaged_is_noticed() {
    let folder = Folder::new();
    folder.write_motion("jump.csv", &jump(2, 30.0, 1.0));
    folder.run(&["import", "jump.csv", "-o", "jump.take"]).with_code(0);
    let take = folder.read("jump.take");
    for at in (0..take.len()).step_by(take.len() / 40) {
        let mut bad = take.clone();
        bad[at] ^= 0x41;
        folder.write("bad.take", &bad);
        let code = folder.run(&["verify", "bad.take"]).code;
        // The checksum allows to restore type and length of a chunk, even those of the header.
        let header = at < header_end(&take) && !(8..11).contains(&at);
        assert_eq!(code, Some(if header { 1 } else { 3 }), "byte {at} of {}", take.len());
    }
}
