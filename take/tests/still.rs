//! Takes in which nothing moves take few bytes, in stretches that an import makes longer for them.

#![expect(clippy::unwrap_used, reason = "a test stops there")]

use std::{io::Cursor, time::Duration};

use mocapd_codec::{Effort, ResamplerKind, Settings, Tolerance};
use mocapd_take::{
    TakeEvent,
    frames::read_motion,
    motion::{GAP, Marker, Motion, MotionFrames, MotionInfo, is_gap},
    motion_encoder::{EncodePlan, MotionWriter, channels, stretch_rows},
    reader::read_events,
    record::{CODEC_VERSION, Header, ImportSource},
    stretch::Span,
};
use mocapd_testkit::random::Random;

const RATE_HZ: f64 = 100.0;
const N_MARKERS: usize = 7;

/// Markers at random places, each with an offset in millimetres from its place, or none.
fn motion(
    n_markers: usize,
    n_frames: usize,
    offset: impl FnMut(usize, usize) -> Option<[f32; 3]>,
) -> Motion {
    let mut random = Random::new(25);
    let mut offset = offset;
    let places: Vec<[f32; 3]> = (0..n_markers)
        .map(|_| std::array::from_fn(|_| random.between(-900.0, 900.0) as f32))
        .collect();
    let markers =
        (0..n_markers).map(|marker| Marker { label: format!("M{marker}"), labelled: true });
    let info = MotionInfo {
        rate_hz: RATE_HZ,
        n_frames: n_frames as u64,
        markers: markers.collect(),
        ..MotionInfo::default()
    };
    let mut positions_mm = Vec::with_capacity(n_frames * n_markers);
    for frame in 0..n_frames {
        positions_mm.extend(places.iter().enumerate().map(|(marker, place)| {
            let moved = |by: [f32; 3]| std::array::from_fn(|axis| place[axis] + by[axis]);
            offset(frame, marker).map_or(GAP, moved)
        }));
    }
    Motion { info, positions_mm }
}

/// Slow sway of 4 mm with the noise of a good rig; each marker but the first is hidden for a second now and then.
fn near_still() -> Motion {
    let mut random = Random::new(4);
    let mut hidden = [0_usize; N_MARKERS];
    motion(N_MARKERS, 24_000, |frame, marker| {
        if marker > 0 && hidden[marker] == 0 && random.one_in(1500) {
            hidden[marker] = 1 + random.below(200);
        }
        hidden[marker] = hidden[marker].saturating_sub(1);
        let phase = frame as f32 / 250.0 + marker as f32;
        let mut noise = || random.between(-0.05, 0.05) as f32;
        let at = [2.0 * phase.sin() + noise(), 2.0 * (0.7 * phase).cos() + noise(), noise()];
        (hidden[marker] == 0).then_some(at)
    })
}

/// The take of an import with `dense`.
fn imported(motion: &Motion, tolerance_mm: f64, effort: u8, keys: Option<Duration>) -> Vec<u8> {
    let tolerance = Tolerance::from_mm(tolerance_mm).unwrap();
    let codec = Settings { kind: ResamplerKind::Dense, tolerance };
    let mut header = Header {
        software: "mocapd".to_owned(),
        codec_version: CODEC_VERSION,
        rate_hz: RATE_HZ,
        source: Some(ImportSource::default()),
        channels: channels(&motion.info.markers),
        ..Header::default()
    };
    header.set_codec(&codec);
    header.set_effort(Effort::new(effort).unwrap());
    header.stretch_rows =
        stretch_rows(&codec, RATE_HZ, motion.n_frames(), header.channels.len()) as u32;
    keys.into_iter().for_each(|distance| header.set_key_distance(distance));
    let mut frames = MotionFrames::new(motion);
    let (plan, parts) = EncodePlan::new(&mut frames, &header).unwrap();
    let mut writer = MotionWriter::new(&plan, &motion.info, &header, Vec::new()).unwrap();
    let mut encoder = plan.encoder();
    for part in parts {
        let part = part.unwrap();
        writer.push(&part, &encoder.encode(&part).unwrap()).unwrap();
    }
    writer.finish().unwrap().1
}

/// The stretches of a take whose every sample is within the tolerance.
fn spans(take: &[u8], motion: &Motion, tolerance_mm: f64) -> Vec<Span> {
    let (decoded, problems) = read_motion(Cursor::new(take)).unwrap();
    assert_eq!(problems, []);
    assert_eq!(decoded.positions_mm.len(), motion.positions_mm.len());
    for (decoded, original) in decoded.positions_mm.iter().zip(&motion.positions_mm) {
        assert_eq!(is_gap(*decoded), is_gap(*original));
        let off = decoded.iter().zip(original).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        assert!(is_gap(*decoded) || off.sqrt() <= tolerance_mm * 1.000_001, "{off}");
    }
    let mut spans = Vec::new();
    read_events(take, |event| {
        if let TakeEvent::Stretch(stretch) = event {
            spans.push(stretch.span);
        }
        Ok(())
    })
    .unwrap();
    spans
}

/// Numbers of rows of the stretches.
fn lengths(spans: &[Span]) -> Vec<u32> {
    assert!(spans.iter().all(|span| span.key));
    spans.iter().map(|span| span.n_rows).collect()
}

#[test]
fn an_hour_in_which_nothing_moves_takes_less_than_2_kb() {
    let still = motion(N_MARKERS, 360_000, |_, _| Some([0.0; 3]));
    let take = imported(&still, 0.1, 3, None);
    assert_eq!(lengths(&spans(&take, &still, 0.1)), [30_000; 12]);
    assert!(take.len() < 1300, "{} bytes", take.len());
}

#[test]
fn five_still_minutes_cost_little_more_than_ten_seconds() {
    let still = |n_rows| motion(N_MARKERS, n_rows, |_, _| Some([0.0; 3]));
    let (short, long) = (still(1000), still(30_000));
    for tolerance_mm in [0.1, 5.0] {
        let bytes = |motion| imported(motion, tolerance_mm, 3, None).len();
        let more = bytes(&long) - bytes(&short);
        assert!(more <= 16, "{more} bytes at {tolerance_mm} mm");
        // What a recorder writes is not changed by what follows: the least effort keeps stretches of ten seconds.
        let least = imported(&long, tolerance_mm, 1, None);
        assert_eq!(lengths(&spans(&least, &long, tolerance_mm)), [1000; 30]);
    }
}

#[test]
fn near_still_takes_are_joined_where_the_tolerance_holds_their_motion() {
    let near = near_still();
    let ten_s = Some(Duration::from_secs(10));
    for tolerance_mm in [0.1, 2.0, 5.0, 20.0] {
        let keyed = imported(&near, tolerance_mm, 3, ten_s);
        let take = imported(&near, tolerance_mm, 3, None);
        let spans = spans(&take, &near, tolerance_mm);
        if tolerance_mm < 5.0 {
            assert_eq!(lengths(&spans), [1000; 24]);
            // The setting that states the distance.
            assert!((1..20).contains(&(keyed.len() - take.len())));
        } else {
            assert_eq!(lengths(&spans), [24_000]);
            assert!(take.len() * 2 < keyed.len(), "{} of {} bytes", take.len(), keyed.len());
        }
    }
}

#[test]
fn stretches_end_where_motion_begins_in_every_group_of_markers() {
    // Only the last marker, of the second group, moves; nothing is seen in the last seconds.
    let moving = motion(70, 7_300, |frame, marker| {
        let is_moving = marker == 69 && (3_500..3_600).contains(&frame);
        let at = if is_moving { (frame - 3_500) as f32 } else { 0.0 };
        (frame < 7_000).then_some([at, 0.0, 0.0])
    });
    let take = imported(&moving, 0.5, 2, None);
    assert_eq!(lengths(&spans(&take, &moving, 0.5)), [3_000, 1_000, 3_300]);
}

#[test]
fn a_stated_distance_of_keys_is_kept() {
    let still = motion(3, 1_030, |_, _| Some([0.0; 3]));
    let take = imported(&still, 0.5, 3, Some(Duration::from_millis(2_500)));
    assert_eq!(lengths(&spans(&take, &still, 0.5)), [250, 250, 250, 250, 30]);
    let take = imported(&still, 0.5, 3, Some(Duration::from_secs(10)));
    assert_eq!(lengths(&spans(&take, &still, 0.5)), [1_000, 30]);
    let take = imported(&still, 0.5, 3, None);
    assert_eq!(lengths(&spans(&take, &still, 0.5)), [1_030]);
}
