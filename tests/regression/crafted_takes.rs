//! Crafted takes: valid checksums and malicious contents.

use mocapd_take::{
    TakeWriter,
    damage::{LedgerTotals, Problem},
    record::{CODEC_VERSION, Channel, Header, Ledger},
    statistics::StretchTally,
    stretch::{CHANNELS_MAX, Span},
};

use super::sparse_files::{assert_small, run};
use crate::{cli::Folder, support::assert_mentions};

fn header() -> Header {
    Header {
        software: String::new(),
        take_id: [0; 16],
        created_unix_ms: 0,
        resampler: "lossless".to_owned(),
        codec_version: CODEC_VERSION,
        tolerance_mm: 0.0,
        rate_hz: 100.0,
        up_axis: mocapd_take::motion::UpAxis::Unknown,
        device: None,
        source: None,
        channels: Vec::new(),
        stretch_rows: 50,
        settings: Vec::new(),
    }
}

fn take(fill: impl FnOnce(&mut TakeWriter<Vec<u8>>)) -> Vec<u8> {
    let mut take = TakeWriter::new(Vec::new(), &header()).unwrap();
    fill(&mut take);
    take.finish(&Ledger { finished: true, ..Ledger::default() }).unwrap().0
}

/// Asserts that every command that reads the take ends, reports a problem, and uses little memory.
fn assert_survived(bytes: &[u8]) {
    let folder = Folder::new();
    folder.write("a.take", bytes);
    for args in
        [&["info", "a.take"][..], &["verify", "a.take"], &["recover", "a.take", "-o", "b.take"]]
    {
        let (ran, resident) = run(&folder, args);
        assert_small(args[0], resident);
        ran.with_code(3);
    }
}

#[test]
fn a_stretch_of_millions_of_runs_without_rows_costs_no_memory() {
    const RUNS: u32 = 6_000_000;
    // A key stretch with a time line, runs and rows listed: from row 0, no rows.
    let mut payload = vec![1 | 4, 1 | 2 | 4, 0, 0];
    let n_runs = [RUNS & 127 | 128, RUNS >> 7 & 127 | 128, RUNS >> 14 & 127 | 128, RUNS >> 21];
    payload.extend(n_runs.map(|byte| byte as u8));
    payload.resize(payload.len() + RUNS as usize, 0);
    let span = Span { first_row: 0, n_rows: 0, key: true, number: 0 };
    let tally = StretchTally::default();
    assert_survived(&take(|take| take.stretch(span, &payload, &tally).unwrap()));
}

#[test]
fn more_channels_than_there_are_marker_ids_cost_no_memory() {
    let channel = |i: usize| Channel { marker_id: i as u16, label: String::new(), labelled: true };
    let more: Vec<_> = (0..30_000).map(channel).collect();
    assert_survived(&take(|take| (0..40).for_each(|_| take.channels(&more).unwrap())));
}

#[test]
fn more_markers_than_a_take_has_are_refused_by_an_import() {
    let folder = Folder::new();
    let csv = |n: usize| {
        let labels: Vec<_> = (0..n).map(|i| format!("{i}.x,{i}.y,{i}.z")).collect();
        let row = vec!["100,200,300"; n].join(",");
        format!("frame,time_s,{}\n1,0,{row}\n2,0.01,{row}\n", labels.join(","))
    };
    folder.write("most.csv", csv(CHANNELS_MAX));
    folder.run(&["import", "most.csv", "-o", "most.take"]).with_code(0);
    let verify = folder.run(&["verify", "most.take", "--json"]).with_code(0).json();
    assert_eq!(verify["samples"], 2 * CHANNELS_MAX as u64);
    folder.write("more.csv", csv(CHANNELS_MAX + 1));
    let ran = folder.run(&["import", "more.csv", "-o", "more.take"]).with_code(1);
    assert_mentions(&ran.stderr, &[&CHANNELS_MAX.to_string()]);
    assert!(!folder.path("more.take").exists());
}

#[test]
fn a_label_as_long_as_a_book_is_shown() {
    let folder = Folder::new();
    let label = "L".repeat(70_000);
    folder.write(
        "a.csv",
        format!(
            "frame,time_s,{label}.x,{label}.y,{label}.z\n1,0,100,200,300\n2,0.01,100,200,300\n"
        ),
    );
    folder.run(&["import", "a.csv", "-o", "a.take"]).with_code(0);
    let ran = folder.run(&["info", "a.take", "--markers"]).with_code(0);
    assert!(ran.stdout.contains(&label));
}

#[test]
fn a_ledger_with_more_frames_than_the_take_is_counted_again() {
    let folder = Folder::new();
    let mut writer = TakeWriter::new(Vec::new(), &header()).unwrap();
    let span = Span { first_row: 0, n_rows: 0, key: true, number: 0 };
    writer.stretch(span, &[1 | 4, 1 | 2 | 4, 0, 0, 0], &StretchTally::default()).unwrap();
    let n = 388;
    let ledger = Ledger { finished: true, frames_sent: n, recorded: n, ..Ledger::default() };
    folder.write("a.take", writer.finish(&ledger).unwrap().0);
    folder.run(&["verify", "a.take"]).with_code(1);
    let ran = folder.run(&["recover", "a.take", "-o", "b.take"]).with_code(3);
    let recounted = Problem::LedgerCounts {
        stated: LedgerTotals { frames: n, samples: 0 },
        found: LedgerTotals { frames: 0, samples: 0 },
    };
    assert_mentions(&ran.stderr, &["a.take", &recounted.to_string()]);
    // The rest is consistent.
    let verify = folder.run(&["verify", "b.take", "--json"]).with_code(3).json();
    assert_eq!(verify["contradictions"], serde_json::json!([]), "{verify}");
}
