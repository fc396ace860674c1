//! Markers that appear after the start.

use mocapd_drivers::device::{MarkerInfo, MarkerSample};
use mocapd_take::motion::is_gap;

use crate::support::{
    chunks, config, dense, fast, feed_samples, jump, lossless, rows, samples, start,
};

#[test]
fn a_marker_that_appears_becomes_a_channel() {
    let motion = jump(1, 100.0, 2.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    for seq in 0..200 {
        let mut markers = samples(motion.frame(seq));
        if seq >= 77 {
            markers.push(MarkerSample {
                id: 900,
                position_mm: [1.0, 2.0, 3.0],
                ..Default::default()
            });
        }
        if seq == 120 {
            let label = "wand".to_owned();
            intake.announce(&[MarkerInfo { id: 901, label, labelled: true }]);
        }
        if seq >= 130 {
            markers.push(MarkerSample {
                id: 901,
                position_mm: [4.0, 5.0, 6.0],
                ..Default::default()
            });
        }
        feed_samples(&mut intake, 100.0, seq, &markers);
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let ledger = written.ledger;
    assert!(ledger.closes(), "{ledger:?}");
    assert_eq!(ledger.samples_announced, 15 * 200 + 123 + 80);
    assert_eq!(ledger.markers_dropped, 0);
    assert_eq!(chunks(&take).labels[15..], ["u016", "wand"]);
    for (seq, row) in rows(&take).0.iter().enumerate() {
        assert_eq!(is_gap(row[15]), seq < 77, "{seq}");
        assert_eq!(is_gap(row[16]), seq < 130, "{seq}");
    }
}

/// A second group of channels starts in mid-take, without a key stretch.
#[test]
fn markers_that_appear_may_need_another_group() {
    for codec in [dense(0.5), fast(0.5), lossless()] {
        let motion = jump(6, 100.0, 12.0);
        let (mut intake, pipeline) = start(&config(&motion, codec), Vec::new());
        let seen = |seq: usize, id: u16| {
            seq > 310 + usize::from(id) && !(seq / 50 + usize::from(id)).is_multiple_of(3)
        };
        for seq in 0..1200 {
            let mut markers = samples(motion.frame(seq));
            let position_mm = [seq as f32, 2.0, 3.0];
            for id in (100..175).filter(|&id| seen(seq, id)) {
                markers.push(MarkerSample { id, position_mm, ..Default::default() });
            }
            while intake.is_full() {
                std::thread::yield_now();
            }
            feed_samples(&mut intake, 100.0, seq, &markers);
        }
        intake.finish();
        let (written, take) = pipeline.finish().unwrap();
        assert!(written.ledger.closes());
        let (rows, problems) = rows(&take);
        assert!(problems.is_empty(), "{problems:?}");
        let mut ids: Vec<u16> = (100..175).collect();
        let first = |id: &u16| (0..1200).find(|&seq| seen(seq, *id)).unwrap_or(1200);
        ids.sort_by_key(|id| (first(id), *id));
        let n_pool = 64;
        for (seq, row) in rows.iter().enumerate() {
            assert_eq!(row.len(), 15 + n_pool);
            for (position, &id) in row[15..].iter().zip(&ids) {
                assert_eq!(is_gap(*position), !seen(seq, id), "{} {id} in {seq}", codec.kind);
                assert!(is_gap(*position) || (position[0] - seq as f32).abs() <= 0.5);
            }
        }
    }
}

#[test]
fn samples_beyond_the_pool_are_dropped_and_counted() {
    let motion = jump(2, 100.0, 0.5);
    let config =
        mocapd_acquire::pipeline::PipelineConfig { reserve: 1, ..config(&motion, dense(0.5)) };
    let (mut intake, pipeline) = start(&config, Vec::new());
    for seq in 0..50 {
        let mut markers = samples(motion.frame(seq));
        for id in [500, 501, 502] {
            markers.push(MarkerSample { id, position_mm: [1.0; 3], ..Default::default() });
        }
        feed_samples(&mut intake, 100.0, seq, &markers);
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert!(written.ledger.closes());
    assert_eq!(written.ledger.markers_dropped, 100);
    assert_eq!(chunks(&take).labels.len(), 16);
}

#[test]
fn a_device_that_announces_nothing_is_still_recorded() {
    let motion = jump(3, 100.0, 1.0);
    let mut config = config(&motion, dense(0.5));
    config.channels.clear();
    let (mut intake, pipeline) = start(&config, Vec::new());
    for seq in 0..100 {
        // The first frames have no markers.
        let markers = if seq < 10 { Vec::new() } else { samples(motion.frame(seq)) };
        feed_samples(&mut intake, 100.0, seq, &markers);
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert!(written.ledger.closes(), "{:?}", written.ledger);
    assert_eq!(written.ledger.recorded, 100);
    let (rows, problems) = rows(&take);
    assert!(problems.is_empty(), "{problems:?}");
    assert_eq!((rows.len(), rows[50].len()), (100, 15));
    assert_eq!(is_gap(rows[50][0]), is_gap(motion.frame(50)[0]));
}

#[test]
fn an_id_reused_for_another_marker_is_not_stored_under_the_old_name() {
    let motion = jump(4, 100.0, 1.0);
    let config =
        mocapd_acquire::pipeline::PipelineConfig { reserve: 0, ..config(&motion, dense(0.5)) };
    let (mut intake, pipeline) = start(&config, Vec::new());
    for seq in 0..100 {
        if seq == 40 {
            let label = "other".to_owned();
            intake.announce(&[MarkerInfo { id: 3, label, labelled: true }]);
        }
        feed_samples(&mut intake, 100.0, seq, &samples(motion.frame(seq)));
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert_eq!(written.ledger.markers_dropped, 60);
    assert!(rows(&take).0[40..].iter().all(|row| is_gap(row[3])));
}

#[test]
fn a_table_that_is_announced_again_opens_no_channel() {
    let motion = jump(5, 100.0, 1.0);
    let (mut intake, pipeline) = start(&config(&motion, dense(0.5)), Vec::new());
    for seq in 0..100 {
        for (id, marker) in motion.info.markers.iter().enumerate() {
            let label = if id == 4 { String::new() } else { marker.label.clone() };
            intake.announce(&[MarkerInfo { id: id as u16, label, labelled: id != 4 }]);
        }
        feed_samples(&mut intake, 100.0, seq, &samples(motion.frame(seq)));
    }
    intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    assert!(written.ledger.closes());
    assert_eq!(chunks(&take).labels.len(), 15);
}

/// After a replug, a device may number its markers differently, in a table of several messages.
#[test]
fn markers_that_change_their_ids_keep_their_channels() {
    let motion = jump(7, 100.0, 4.0);
    let n = motion.info.markers.len();
    let label = |column: usize| motion.info.markers[column].label.clone();
    for (turn, per_message) in [(1, n), (n - 1, n), (3, 2), (n / 2, 1)] {
        let (mut intake, pipeline) = start(&config(&motion, lossless()), Vec::new());
        for seq in 0..400 {
            // From frame 200 on, the marker of a column has another id.
            let id = |column: usize| if seq < 200 { column } else { (column + turn) % n };
            if seq == 200 {
                let infos: Vec<MarkerInfo> = (0..n)
                    .map(|column| MarkerInfo {
                        id: id(column) as u16,
                        label: label(column),
                        labelled: true,
                    })
                    .collect();
                infos.chunks(per_message).for_each(|message| intake.announce(message));
            }
            let markers: Vec<MarkerSample> = samples(motion.frame(seq))
                .into_iter()
                .map(|marker| MarkerSample { id: id(usize::from(marker.id)) as u16, ..marker })
                .collect();
            while intake.is_full() {
                std::thread::yield_now();
            }
            feed_samples(&mut intake, 100.0, seq, &markers);
        }
        intake.finish();
        let (written, take) = pipeline.finish().unwrap();
        assert_eq!((written.ledger.markers_dropped, written.ledger.recorded), (0, 400));
        assert_eq!(chunks(&take).labels.len(), n, "{turn}: {:?}", chunks(&take).labels);
        for (seq, row) in rows(&take).0.iter().enumerate() {
            for (column, (a, b)) in row.iter().zip(motion.frame(seq)).enumerate() {
                assert!(
                    is_gap(*a) == is_gap(*b) && (is_gap(*a) || a == b),
                    "{turn}: {seq} {column}: {a:?} {b:?}"
                );
            }
        }
    }
}
