//! The statistics that a recording states, and `info`, which takes them in place of decoding.

use mocapd_acquire::{inspect::Summary, ledger::TakeHealth};
use mocapd_take::{
    chunk::{self, ChunkParse, MAGIC, types},
    index::Footer,
    motion::{Motion, UpAxis},
    record::{EndingKind, Header, Record, SummaryRecord},
    statistics::TakeStatistics,
};

use crate::{
    cli::Folder,
    support::{config, crowd, dense, fast, jump, lossless, places, record},
};

/// A recording without the frames around the 50th of every 80.
fn lossy(motion: &Motion, codec: mocapd_codec::Settings) -> Vec<u8> {
    let wanted = (0..motion.n_frames()).filter(|seq| !(48..53).contains(&(seq % 80)));
    record(motion, &config(motion, codec), wanted).1
}

/// Both ways to read the take agree in everything that `info` shows.
fn assert_alike(take: &[u8], what: &str) {
    let (decoded, stated) = (Summary::read(take).unwrap(), Summary::read_stated(take).unwrap());
    assert_eq!(stated.per_channel, decoded.per_channel, "{what}");
    assert_eq!(stated.statistics, decoded.statistics, "{what}");
    assert_eq!(stated.take, decoded.take, "{what}");
    assert_eq!(stated.contradictions(), decoded.contradictions(), "{what}");
    assert_eq!((stated.stretches, stated.outages), (decoded.stretches, decoded.outages), "{what}");
    assert_eq!((stated.bytes, stated.clock), (decoded.bytes, decoded.clock), "{what}");
    assert_eq!(stated.health(), decoded.health(), "{what}");
    assert_eq!(stated.max_error_mm(), decoded.max_error_mm(), "{what}");
}

/// The take with another summary.
fn with_summary(take: &[u8], change: impl FnOnce(&mut SummaryRecord)) -> Vec<u8> {
    let mut change = Some(change);
    let mut out = MAGIC.to_vec();
    let mut index_offset = 0;
    for (kind, place) in places(take) {
        let ChunkParse::Whole { payload, .. } = chunk::parse(&take[place]) else { panic!() };
        let payload = match kind {
            types::SUMMARY => {
                let mut summary = SummaryRecord::from_payload(payload, 0).unwrap();
                change.take().unwrap()(&mut summary);
                summary.to_payload().unwrap()
            }
            types::FOOTER => {
                let footer = Footer::from_payload(payload, 0).unwrap();
                Footer { index_offset, ..footer }.to_payload()
            }
            _ => payload.to_vec(),
        };
        if kind == types::INDEX {
            index_offset = out.len() as u64;
        }
        chunk::put(&mut out, kind, &payload).unwrap();
    }
    out
}

fn with_statistics(take: &[u8], change: impl FnOnce(&mut TakeStatistics)) -> Vec<u8> {
    with_summary(take, |summary| change(summary.statistics.as_mut().unwrap()))
}

#[test]
fn stated_figures_are_those_of_the_samples() {
    for codec in [dense(0.5), fast(2.0), lossless()] {
        for motion in [jump(3, 60.0, 4.0), crowd(4, 120.0, 3.0)] {
            assert_alike(&lossy(&motion, codec), &codec.kind.to_string());
        }
    }
}

#[test]
fn any_damage_is_found_and_reported_as_by_decoding() {
    let motion = jump(5, 60.0, 4.0);
    let take = lossy(&motion, dense(0.5));
    for (kind, place) in places(&take) {
        if kind == types::HEADER {
            continue;
        }
        for at in [place.start, place.start + place.len() / 2, place.end - 1] {
            let mut hurt = take.clone();
            hurt[at] ^= 0x21;
            let what = format!("byte {at} of a chunk of type {kind:02x}");
            let stated = Summary::read_stated(&hurt[..]).unwrap();
            assert_ne!(stated.take.problems, [], "{what}");
            assert_alike(&hurt, &what);
        }
        // A missing chunk.
        let mut gone = take.clone();
        gone.drain(place.clone());
        assert_alike(&gone, &format!("without a chunk of type {kind:02x}"));
    }
    for cut in (take.len() / 3..take.len()).step_by(97) {
        assert_alike(&take[..cut], &format!("cut at {cut}"));
    }
}

#[test]
fn a_take_without_statistics_is_decoded() {
    let motion = jump(6, 60.0, 2.0);
    let take = lossy(&motion, dense(0.5));
    let earlier = with_summary(&take, |summary| {
        (summary.header, summary.statistics) = (None, None);
    });
    assert!(Summary::read(&earlier[..]).unwrap().take.statistics.is_none());
    assert_alike(&earlier, "of an earlier version");
    let [old, new] = [&earlier, &take].map(|take| Summary::read_stated(&take[..]).unwrap());
    assert_eq!((old.per_channel, old.statistics), (new.per_channel, new.statistics));
}

#[test]
fn verify_finds_forged_figures() {
    let motion = jump(7, 60.0, 2.0);
    let whole = record(&motion, &config(&motion, dense(0.5)), 0..motion.n_frames()).1;
    assert_eq!(Summary::read_stated(&whole[..]).unwrap().health(), TakeHealth::Complete);
    let folder = Folder::new();
    // Figures that nothing else contradicts: `info` shows them, which proves that it does not decode.
    let knots = |figures: &mut TakeStatistics| figures.channels[2].knots -= 1;
    let gaps = |figures: &mut TakeStatistics| figures.channels[1].gaps += 1;
    let error = |figures: &mut TakeStatistics| figures.channels[0].error_step -= 1;
    let keys = |figures: &mut TakeStatistics| figures.key_rows -= 1;
    let believed: [&dyn Fn(&mut TakeStatistics); 4] = [&knots, &gaps, &error, &keys];
    for (round, change) in believed.into_iter().enumerate() {
        let forged = with_statistics(&whole, change);
        let stated = Summary::read_stated(&forged[..]).unwrap();
        assert_eq!(stated.take.statistics.as_ref(), Some(&stated.statistics), "{round}");
        let decoded = Summary::read(&forged[..]).unwrap();
        assert_eq!(decoded.contradictions().len(), 1, "{round}");
        assert_eq!(decoded.health(), TakeHealth::Damaged, "{round}");
        folder.write("a.take", &forged);
        folder.run(&["info", "a.take"]).with_code(0);
        folder.run(&["verify", "a.take"]).with_code(1);
    }
    // Those that contradict the ledger, the channel table or the frames.
    let fewer = |figures: &mut TakeStatistics| {
        figures.channels[0].samples -= 1;
        figures.channels[0].gaps += 1;
    };
    let more_rows = |figures: &mut TakeStatistics| figures.rows_with_samples += 1;
    let more_markers = |figures: &mut TakeStatistics| figures.channels.push(Default::default());
    let found: [&dyn Fn(&mut TakeStatistics); 3] = [&fewer, &more_rows, &more_markers];
    for (round, change) in found.into_iter().enumerate() {
        let forged = with_statistics(&whole, change);
        assert_alike(&forged, &format!("{round}"));
        folder.write("a.take", &forged);
        folder.run(&["info", "a.take"]).with_code(3);
        folder.run(&["verify", "a.take"]).with_code(1);
    }
    // Another header.
    for change in [
        |summary: &mut SummaryRecord| summary.header.as_mut().unwrap().rate_hz = 61.0,
        |summary: &mut SummaryRecord| summary.header.as_mut().unwrap().channels.clear(),
    ] {
        let forged = with_summary(&whole, change);
        assert_alike(&forged, "header");
        assert_eq!(Summary::read_stated(&forged[..]).unwrap().contradictions().len(), 1);
    }
}

/// The take with these payloads in place of each chunk's.
fn forged(take: &[u8], change: impl Fn(u8, &[u8]) -> Vec<Vec<u8>>) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    let (mut index_offset, mut ledger_offset) = (0, 0);
    for (kind, place) in places(take) {
        let ChunkParse::Whole { payload, .. } = chunk::parse(&take[place]) else { panic!() };
        let payloads = match kind {
            types::FOOTER => {
                let footer = Footer::from_payload(payload, 0).unwrap();
                vec![Footer { index_offset, ledger_offset, ..footer }.to_payload()]
            }
            _ => change(kind, payload),
        };
        match kind {
            types::INDEX => index_offset = out.len() as u64,
            types::LEDGER => ledger_offset = out.len() as u64,
            _ => {}
        }
        for payload in payloads {
            chunk::put(&mut out, kind, &payload).unwrap();
        }
    }
    out
}

#[test]
fn verify_finds_records_that_no_writer_writes() {
    let folder = Folder::new();
    folder.write_motion("a.csv", &jump(8, 60.0, 2.0));
    folder.run(&["import", "a.csv", "-o", "import.take"]).with_code(0);
    let import = folder.read("import.take");
    let assert_found = |take: Vec<u8>, sentence: &str| {
        folder.write("a.take", &take);
        let ran = folder.run(&["verify", "a.take", "--json"]);
        let report = ran.json();
        let found = [&report["contradictions"], &report["problems"]];
        assert!(found.iter().any(|all| all.to_string().contains(sentence)), "{report}");
        assert_ne!(ran.code, Some(0), "{sentence}");
    };
    let same = |payload: &[u8]| vec![payload.to_vec()];
    assert_eq!(forged(&import, |_, payload| same(payload)), import);
    let twice = forged(&import, |kind, payload| {
        if kind == types::SUMMARY { [same(payload), same(payload)].concat() } else { same(payload) }
    });
    assert_found(twice, "a second summary");
    let ending = forged(&import, |kind, payload| {
        if kind != types::SUMMARY {
            return same(payload);
        }
        let mut summary = SummaryRecord::from_payload(payload, 0).unwrap();
        summary.ending = Some(EndingKind::DeviceGone.into());
        vec![summary.to_payload().unwrap()]
    });
    assert_found(ending, "but the take was imported");
    let with_header = |change: &dyn Fn(Header) -> Vec<u8>| {
        forged(&import, |kind, payload| {
            if kind != types::HEADER {
                return same(payload);
            }
            vec![change(Header::from_payload(payload, 0).unwrap())]
        })
    };
    let up = with_header(&|header| {
        let [unknown, up] = [UpAxis::Unknown, UpAxis::Z]
            .map(|up_axis| Header { up_axis, ..header.clone() }.to_payload().unwrap());
        let at = unknown.iter().zip(&up).position(|(a, b)| a != b).unwrap();
        [&up[..at], &[9], &up[at + 1..]].concat()
    });
    assert_found(up, "up axis 9");
    let rows =
        with_header(&|header| Header { stretch_rows: 1 << 31, ..header }.to_payload().unwrap());
    assert_found(rows, "stretches of 2147483648 frames");
}
