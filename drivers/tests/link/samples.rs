//! Groups of sampled channels, force plates, and batches of samples.

use mocapd_drivers::{
    device::{
        DeviceEvent, ForcePlateInfo, PlateOutput, Protocol, SampleBatch, SampleForm,
        SampledChannelInfo, SampledGroupInfo,
    },
    link::{
        DeviceLink, EncodeError, GROUPS_MAX, HostLink, SAMPLE_VALUES_MAX, WIRE_BYTES_MAX,
        batch_bytes_max,
    },
};
use proptest::{collection::vec, prelude::*};

use crate::{host_events, with_envelope};

fn any_form() -> impl Strategy<Value = SampleForm> {
    prop_oneof![Just(SampleForm::Int16), Just(SampleForm::Int32), Just(SampleForm::Float32)]
}

/// A sample of the form, from any bits.
fn of_form(form: SampleForm, bits: u32) -> f32 {
    match form {
        SampleForm::Int16 => f32::from(bits as u16 as i16),
        SampleForm::Int32 => (bits as i32 >> 7) as f32,
        SampleForm::Float32 => f32::from_bits(bits),
    }
}

fn group_of(n_channels: usize, name: &str) -> SampledGroupInfo {
    let channel = |i: usize| SampledChannelInfo {
        name: format!("{name}{i}"),
        unit: "N·m".to_owned(),
        scale: -0.1 * (i as f64 + 1.0),
        offset: i as f64,
    };
    let channels = (0..n_channels).map(channel).collect();
    SampledGroupInfo { id: 3, form: SampleForm::Int32, rate_millihertz: 1_999_999, channels }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn every_batch_round_trips_bit_for_bit(
        form in any_form(),
        group in 0u8..16,
        n_channels in 1u8..=64,
        (number, first, device_ticks) in any::<(u32, u64, u64)>(),
        bits in vec(any::<u32>(), 0..1000),
    ) {
        let n = bits.len() / usize::from(n_channels) * usize::from(n_channels);
        let samples: Vec<f32> = bits[..n].iter().map(|&bits| of_form(form, bits)).collect();
        let batch = SampleBatch { group, number, first, device_ticks, form, n_channels, samples: &samples };
        let mut wire = Vec::new();
        DeviceLink::new().samples(&batch, &mut wire).unwrap();
        prop_assert!(wire.len() <= batch_bytes_max(form, n_channels.into(), batch.n_samples()));
        let mut n_events = 0;
        HostLink::new().push(&wire, &mut |event| {
            let DeviceEvent::Samples(got) = event else { panic!("{event:?}") };
            assert_eq!((got.group, got.number, got.first, got.device_ticks), (group, number, first, device_ticks));
            assert_eq!((got.form, got.n_channels, got.samples.len()), (form, n_channels, samples.len()));
            assert!(got.samples.iter().zip(&samples).all(|(a, b)| a.to_bits() == b.to_bits()));
            n_events += 1;
        });
        prop_assert_eq!(n_events, 1);
    }

    #[test]
    fn every_group_round_trips(n_channels in 1usize..=64, name in "[a-zA-Z µ]{0,20}") {
        let group = group_of(n_channels, &name);
        let mut wire = Vec::new();
        DeviceLink::new().sampled_group(&group, &mut wire).unwrap();
        let expected = format!("{:?}", DeviceEvent::SampledGroup(&group));
        prop_assert_eq!(host_events(&mut HostLink::new(), &wire), [expected]);
    }

    /// Any payload of the two types is decoded or damage, and what is decoded is within the limits.
    #[test]
    fn hostile_payloads_stay_within_the_limits(
        kind in prop_oneof![Just(0x03u8), Just(0x05u8), Just(0x13u8)],
        mut payload in vec(any::<u8>(), 0..300),
        (form, n_channels, n) in (0u8..4, 0u8..70, 0u8..8),
    ) {
        // Plausible heads get past the first checks.
        if let Some(head) = payload.get_mut(..5) {
            head.copy_from_slice(&[3, form, n_channels, n, 0]);
        }
        if kind == 0x13 {
            payload.resize(25 + usize::from(n_channels) * usize::from(n) * 4, 1);
        }
        let mut host = HostLink::new();
        host.push(&with_envelope(1, kind, &payload), &mut |event| match event {
            DeviceEvent::Samples(batch) => {
                assert!(usize::from(batch.group) < GROUPS_MAX);
                assert!((1..=64).contains(&batch.n_channels));
                assert_eq!(batch.n_samples() * usize::from(batch.n_channels), batch.samples.len());
            }
            DeviceEvent::SampledGroup(group) => assert!((1..=64).contains(&group.channels.len())),
            DeviceEvent::ForcePlate(plate) => assert!((6..=8).contains(&plate.channels.len())),
            _ => panic!("{event:?}"),
        });
        let counters = host.counters();
        prop_assert_eq!(counters.messages + counters.messages_damaged, 1);
    }
}

#[test]
fn the_largest_batch_fits_and_one_more_sample_is_refused() {
    let samples = vec![-16_777_216.0; SAMPLE_VALUES_MAX + 64];
    let batch = |n: usize| SampleBatch {
        group: 15,
        number: 1,
        first: u64::MAX,
        device_ticks: 5,
        form: SampleForm::Int32,
        n_channels: 64,
        samples: &samples[..n],
    };
    let (mut device, mut wire) = (DeviceLink::new(), Vec::new());
    device.samples(&batch(SAMPLE_VALUES_MAX), &mut wire).unwrap();
    assert!(wire.len() < WIRE_BYTES_MAX);
    let mut host = HostLink::new();
    assert_eq!(host_events(&mut host, &wire).len(), 1);
    wire.clear();
    for n in [SAMPLE_VALUES_MAX + 64, 63] {
        assert!(matches!(device.samples(&batch(n), &mut wire), Err(EncodeError::Samples(_))));
    }
    assert!(wire.is_empty());
}

#[test]
fn samples_that_are_no_numbers_of_their_form_are_refused() {
    let mut device = DeviceLink::new();
    let mut wire = Vec::new();
    for (form, sample) in [
        (SampleForm::Int16, 0.5),
        (SampleForm::Int16, 32_768.0),
        (SampleForm::Int16, -0.0),
        (SampleForm::Int32, 16_777_218.0),
        (SampleForm::Int32, f32::NAN),
    ] {
        let batch = SampleBatch {
            group: 0,
            number: 0,
            first: 0,
            device_ticks: 0,
            form,
            n_channels: 1,
            samples: &[sample],
        };
        let refused = device.samples(&batch, &mut wire);
        assert!(matches!(refused, Err(EncodeError::Samples(_))), "{form:?} {sample}");
    }
    assert!(wire.is_empty());
    // A count beyond the range of form 1 is damage for a host.
    let mut payload = vec![0, 1, 1, 1, 0];
    payload.extend_from_slice(&[0; 20]);
    payload.extend_from_slice(&16_777_217_i32.to_le_bytes());
    let mut host = HostLink::new();
    assert!(host_events(&mut host, &with_envelope(1, 0x13, &payload)).is_empty());
    assert_eq!(host.counters().messages_damaged, 1);
}

#[test]
fn groups_beyond_the_limits_are_refused_by_both_ends() {
    let good = group_of(2, "Fx");
    let mut bad = vec![good.clone(); 7];
    bad[0].id = 16;
    bad[1].rate_millihertz = 0;
    bad[2].channels.clear();
    bad[3].channels = vec![good.channels[0].clone(); 65];
    bad[4].rate_millihertz = 2_000_001_000;
    bad[5].channels[1].scale = 0.0;
    bad[6].channels[1].offset = f64::INFINITY;
    let (mut device, mut wire) = (DeviceLink::new(), Vec::new());
    for group in &bad {
        let refused = device.sampled_group(group, &mut wire);
        assert!(matches!(refused, Err(EncodeError::SampledGroup(_))), "{group:?}");
    }
    for (name, unit) in [("x".repeat(65), "N".to_owned()), ("Fz".to_owned(), "N\n".to_owned())] {
        let mut group = good.clone();
        (group.channels[0].name, group.channels[0].unit) = (name, unit);
        assert!(matches!(device.sampled_group(&group, &mut wire), Err(EncodeError::Text { .. })));
    }
    assert!(wire.is_empty());
}

fn plate(output: PlateOutput) -> ForcePlateInfo {
    ForcePlateInfo {
        number: 32,
        output,
        group: 15,
        channels: (56..64).take(output.n_channels()).collect(),
        corners_mm: [[600.0, 0.0, 1.5], [0.0, 0.0, 1.5], [0.0, -400.0, 1.5], [600.0, -400.0, 1.5]],
        origin_mm: [-0.5, 1e-3, -50.0],
    }
}

#[test]
fn every_kind_of_force_plate_round_trips() {
    // The sensors are below or above the surface, in axes that point up or down.
    for (output, z) in
        PlateOutput::ALL.into_iter().flat_map(|output| [(output, -50.0), (output, 50.0)])
    {
        let (mut plate, mut wire) = (plate(output), Vec::new());
        plate.origin_mm[2] = z;
        DeviceLink::new().force_plate(&plate, &mut wire).unwrap();
        let expected = format!("{:?}", DeviceEvent::ForcePlate(&plate));
        assert_eq!(host_events(&mut HostLink::new(), &wire), [expected]);
    }
}

#[test]
fn force_plates_beyond_the_limits_are_refused_by_both_ends() {
    let good = plate(PlateOutput::ForceAndMoment);
    let mut bad = vec![good.clone(); 6];
    bad[0].number = 0;
    bad[1].number = 33;
    bad[2].group = 16;
    bad[3].channels.push(1);
    bad[4].channels[0] = 64;
    bad[5].corners_mm[3][2] = f32::NAN;
    let (mut device, mut wire) = (DeviceLink::new(), Vec::new());
    for plate in &bad {
        let refused = device.force_plate(plate, &mut wire);
        assert!(matches!(refused, Err(EncodeError::ForcePlate(_))), "{plate:?}");
    }
    assert!(wire.is_empty());
    device.force_plate(&good, &mut wire).unwrap();
    let mut message = vec![0; wire.len()];
    let n = cobs::decode(&wire[..wire.len() - 1], &mut message).unwrap().frame_size();
    let payload = &message[2..n - 4];
    // Number, type and group; the index of a channel; a corner that is not finite.
    for (at, byte) in [(0, 0), (0, 33), (1, 0), (1, 4), (2, 16), (3, 64), (12, 0x7f)] {
        let mut payload = payload.to_vec();
        payload[at] = byte;
        if at == 12 {
            payload[11] = 0x80;
        }
        let mut host = HostLink::new();
        assert!(
            host_events(&mut host, &with_envelope(1, 0x05, &payload)).is_empty(),
            "{at}: {byte}"
        );
        assert_eq!(host.counters().messages_damaged, 1);
    }
}
