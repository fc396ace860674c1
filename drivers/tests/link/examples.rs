//! One message of every type: the examples of docs/link-protocol.md, and the stream for the sweeps.

use mocapd_drivers::{
    device::{
        BodyInfo, Command, DeviceEvent, EndOfPoses, ForcePlateInfo, Frame, Hello, MarkerInfo,
        MarkerSample, PlateOutput, Pong, Pose, PoseFrame, PoseStatus, Protocol, SampleBatch,
        SampleForm, SampledChannelInfo, SampledGroupInfo, Status, Trigger,
    },
    link::{DeviceLink, FrameForm, HostLink, frame_bytes_in_volume, link_budget},
};

/// A message under its name in the document.
#[derive(Debug)]
pub(crate) struct Example {
    pub(crate) name: &'static str,
    pub(crate) wire: Vec<u8>,
    /// Debug text of what the other end decodes.
    pub(crate) decoded: String,
    pub(crate) is_command: bool,
}

fn seen(id: u16, residual_10um: u8, position_mm: [f32; 3]) -> MarkerSample {
    MarkerSample { id, occluded: false, residual_10um, position_mm }
}

fn occluded(id: u16) -> MarkerSample {
    MarkerSample { id, occluded: true, ..MarkerSample::default() }
}

fn from_device(
    name: &'static str,
    event: DeviceEvent<'_>,
    encode: impl FnOnce(&mut DeviceLink, &mut Vec<u8>),
) -> Example {
    let mut wire = Vec::new();
    encode(&mut DeviceLink::new(), &mut wire);
    Example { name, wire, decoded: format!("{event:?}"), is_command: false }
}

fn from_host(name: &'static str, command: Command) -> Example {
    let mut wire = Vec::new();
    HostLink::new().command(command, &mut wire);
    Example { name, wire, decoded: format!("{command:?}"), is_command: true }
}

fn frame(
    name: &'static str,
    form: FrameForm,
    timecode: Option<[u8; 4]>,
    markers: &[MarkerSample],
) -> Example {
    let frame = Frame { seq: 7, device_ticks: 70_000, timecode, markers };
    from_device(name, DeviceEvent::Frame(frame), |link, out| link.frame(form, &frame, out).unwrap())
}

pub(crate) fn all() -> Vec<Example> {
    let hello = Hello {
        model: "DVMC-8820".to_owned(),
        serial: "SIM0001".to_owned(),
        firmware: "1.0".to_owned(),
        rate_millihertz: 120_000,
        rate_min_millihertz: 60_000,
        rate_max_millihertz: 1_000_000,
        tick_hz: 1_000_000,
        up_axis: 3,
        markers_max: 64,
        n_frames: 0,
    };
    let table = [
        MarkerInfo { id: 0, label: "HEAD".to_owned(), labelled: true },
        MarkerInfo { id: 1000, label: String::new(), labelled: false },
    ];
    let channel = |name: &str, unit: &str, scale, offset| {
        let (name, unit) = (name.to_owned(), unit.to_owned());
        SampledChannelInfo { name, unit, scale, offset }
    };
    let group = SampledGroupInfo {
        id: 2,
        form: SampleForm::Int16,
        rate_millihertz: 2_000_000,
        channels: vec![channel("Fz1", "N", 0.25, -8.0), channel("EMG", "", 1.0, 0.0)],
    };
    let plate = ForcePlateInfo {
        number: 1,
        output: PlateOutput::ForceAndMoment,
        group: 0,
        channels: (0..6).collect(),
        corners_mm: [
            [450.0, 300.0, 0.0],
            [-450.0, 300.0, 0.0],
            [-450.0, -300.0, 0.0],
            [450.0, -300.0, 0.0],
        ],
        origin_mm: [0.0, 0.0, 41.5],
    };
    let batch = SampleBatch {
        group: 2,
        number: 7,
        first: 60,
        device_ticks: 100_000,
        form: SampleForm::Int16,
        n_channels: 2,
        samples: &[2792.0, -1.0, 2800.0, 0.0, 2801.0, 32_767.0],
    };
    let of_floats = SampleBatch {
        group: 0,
        number: u32::MAX,
        first: 0,
        device_ticks: 70_000,
        form: SampleForm::Float32,
        n_channels: 1,
        samples: &[-0.5],
    };
    let bodies = [
        BodyInfo { id: 1, name: "pelvis".to_owned() },
        BodyInfo { id: 4, name: String::new() },
        BodyInfo { id: 5, name: "prop".to_owned() },
    ];
    let of_bodies = [
        Pose {
            body: 1,
            status: PoseStatus::Tracked,
            position_mm: [812.5, -40.25, 1604.0],
            quaternion: [0.5, -0.5, 0.5, -0.5],
            residual_mm: 0.25,
        },
        Pose::without(4, PoseStatus::Lost),
        Pose::without(5, PoseStatus::Rejected),
    ];
    let poses = PoseFrame { seq: 7, number: 6, device_ticks: 70_000, poses: &of_bodies };
    let poses_end = EndOfPoses { seq: 1200, number: 1190, device_ticks: 171_000 };
    let near =
        [seen(0, 12, [812.5, -40.25, 1604.0]), occluded(1), seen(2, 0, [800.0, -40.0, 1600.0])];
    let far = [
        seen(4, 0, [1.0, 0.0, -1.0]),
        seen(5, 0, [9000.0, 0.0, 0.0]),
        seen(9, 0, [9000.001, 0.0, 0.0]),
    ];
    let status = Status { frames_produced: 1200, frames_dropped: 3, temperature_c_100: 4125 };
    let trigger = Trigger { device_ticks: 70_500, input: 1, kind: 0 };
    let pong = Pong { host_ns: 1_000_000_000, device_ticks: 71_000 };
    // 40 markers at 120 Hz, on a line of 3 Mbaud and on one of 115200 baud.
    let frame_bytes = frame_bytes_in_volume(FrameForm::Compact, 40);
    let started = link_budget(frame_bytes, 120_000, 1_000_000, 0, 300_000);
    let refused = link_budget(frame_bytes, 120_000, 1_000_000, 0, 11_520);
    assert!(started.fits() && !refused.fits());
    vec![
        from_device("hello", DeviceEvent::Hello(&hello), |l, o| l.hello(&hello, o).unwrap()),
        from_device("markers", DeviceEvent::Markers(&table), |l, o| l.markers(&table, o).unwrap()),
        from_device("sampled-group", DeviceEvent::SampledGroup(&group), |l, o| {
            l.sampled_group(&group, o).unwrap();
        }),
        from_device("force-plate", DeviceEvent::ForcePlate(&plate), |l, o| {
            l.force_plate(&plate, o).unwrap();
        }),
        from_device("samples", DeviceEvent::Samples(batch), |l, o| l.samples(&batch, o).unwrap()),
        from_device("samples-float", DeviceEvent::Samples(of_floats), |l, o| {
            l.samples(&of_floats, o).unwrap();
        }),
        from_device("bodies", DeviceEvent::Bodies(&bodies), |l, o| l.bodies(&bodies, o).unwrap()),
        from_device("poses", DeviceEvent::Poses(poses), |l, o| l.poses(&poses, o).unwrap()),
        from_device("poses-end", DeviceEvent::EndOfPoses(poses_end), |l, o| {
            l.end_of_poses(poses_end, o);
        }),
        frame("frame-float", FrameForm::Float, None, &near),
        frame("frame-micrometres", FrameForm::Micrometres, Some([10, 59, 30, 11]), &near),
        frame("frame-compact", FrameForm::Compact, None, &near),
        frame("frame-compact-escape", FrameForm::Compact, None, &far),
        from_device("trigger", DeviceEvent::Trigger(trigger), |l, o| l.trigger(trigger, o)),
        from_device("status", DeviceEvent::Status(status), |l, o| l.status(status, o)),
        from_device("pong", DeviceEvent::Pong(pong), |l, o| l.pong(pong, o)),
        from_device("started", DeviceEvent::Started(started), |l, o| l.started(started, o)),
        from_device("refused", DeviceEvent::Refused(refused), |l, o| l.refused(refused, o)),
        from_device("rate-set", DeviceEvent::RateSet(250_000), |l, o| l.rate_set(250_000, o)),
        from_device("end-of-stream", DeviceEvent::EndOfStream(status), |l, o| {
            l.end_of_stream(status, o);
        }),
        from_host("identify", Command::Identify),
        from_host("start", Command::Start { line_bytes_per_s: 300_000 }),
        from_host("stop", Command::Stop),
        from_host("set-rate", Command::SetRate(250_000)),
        from_host("ping", Command::Ping { host_ns: 1_000_000_000 }),
    ]
}

/// The messages that devices send.
pub(crate) fn of_devices() -> Vec<Example> {
    all().into_iter().filter(|example| !example.is_command).collect()
}
