//! What is published of a device: its topics, and the messages of its frames and samples.

use std::sync::Arc;

use mocapd_acquire::pipeline::{TappedBatch, TappedFrame, lock};
use mocapd_drivers::device::{SampledChannelInfo, SampledGroupInfo};
use mocapd_report::labels::marker_lines;
use mocapd_take::{
    foreign::force_plates::ForcePlate,
    interchange::{
        SampledKind,
        foxglove::{self, ForceArrow, PlacedBody},
        plate_columns, plates_of_group,
    },
    motion::{Position, UpAxis},
    poses::PoseState,
    record::Subject,
};

use super::{
    protocol::Channel,
    server::FoxgloveServer,
    stream_time::{StreamTime, unix_now_ns, unix_ns_of},
};
use crate::{
    live::LiveFace,
    publish::{PublishedDevice, group_record},
    subject::{FaceOverlay, live_limbs, with_limbs},
};

/// Labels in a second: as texts they are larger than the points, and people read them.
const NAMES_HZ: u64 = 10;

/// Faces and forces to look at in a second, as often as a display shows them; the samples of forces are all sent.
const DISPLAYED_HZ: u64 = 60;

/// The topics of a frame, whose messages a client gets for every frame, or misses.
const MARKERS: &str = "/markers";
const SPHERES: &str = "/spheres";
const LINES: &str = "/lines";
pub(super) const TRANSFORMS: &str = "/tf";
const OF_EVERY_FRAME: [&str; 4] = [MARKERS, SPHERES, LINES, TRANSFORMS];

/// Those that are sent less often.
const NAMES: &str = "/names";
const FACE: &str = "/face";
const FORCES: &str = "/forces";

/// Log entries, which need no device.
pub(super) const LOG: &str = "/log";

const SCENE: &str = "foxglove.SceneUpdate";

/// The topics of a device that is armed.
#[derive(Debug)]
pub(super) struct DeviceTopics {
    up: UpAxis,
    time: StreamTime,
    subject: Option<Arc<Subject>>,
    labels: Vec<String>,
    is_labelled: Vec<bool>,
    lines: Vec<[u16; 2]>,
    face: Option<(FaceOverlay, LiveFace)>,
    /// The frames of reference of the rigid bodies.
    bodies: Vec<String>,
    groups: Vec<GroupTopics>,
    row: Vec<Position>,
    names_due_ns: u64,
    face_due_ns: u64,
}

/// The topics of a group of sampled channels.
#[derive(Debug)]
struct GroupTopics {
    number: u8,
    kind: SampledKind,
    topic: String,
    interval_ns: f64,
    channels: Vec<SampledChannelInfo>,
    plates: Vec<ForcePlate>,
    /// The kind and topic of their loads.
    loads: SampledKind,
    loads_topic: String,
    arrows: Vec<ForceArrow>,
    due_ns: u64,
}

impl DeviceTopics {
    pub(super) fn new(device: &PublishedDevice, subject: Option<Arc<Subject>>) -> Self {
        let tick_hz = device.header.device.as_ref().map_or(1_000_000, |device| device.tick_hz);
        let mut topics = Self {
            up: device.header.up_axis,
            time: StreamTime::new(tick_hz),
            subject,
            labels: Vec::new(),
            is_labelled: Vec::new(),
            lines: Vec::new(),
            face: None,
            bodies: foxglove::child_frames(device.body_names()),
            groups: group_topics(device),
            row: Vec::new(),
            names_due_ns: 0,
            face_due_ns: 0,
        };
        topics.follow_markers(device.header.channels.len(), device);
        topics
    }

    /// The channels of these topics.
    pub(super) fn channels(&self) -> Vec<Channel> {
        let of = |topic: &str, schema_name: &'static str| Channel {
            topic: topic.to_owned(),
            schema_name: schema_name.to_owned(),
            schema: foxglove::descriptor_set(schema_name),
        };
        let mut all = vec![
            of(MARKERS, "foxglove.PointCloud"),
            of(SPHERES, SCENE),
            of(LINES, SCENE),
            of(TRANSFORMS, "foxglove.FrameTransforms"),
            of(NAMES, SCENE),
        ];
        if FaceOverlay::new(self.subject.as_deref(), &[]).is_some() {
            all.push(of(FACE, SCENE));
        }
        if self.groups.iter().any(|group| !group.plates.is_empty()) {
            all.push(of(FORCES, SCENE));
        }
        for group in &self.groups {
            let names: Vec<&str> = group.channels.iter().map(|c| c.name.as_str()).collect();
            all.push(sampled_channel(group.kind, &names));
            if !group.plates.is_empty() {
                let columns = plate_columns(&group.plates);
                let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
                all.push(sampled_channel(group.loads, &names));
            }
        }
        all
    }

    /// Whether frames are wanted, and samples.
    pub(super) fn wanted(&self, server: &FoxgloveServer) -> [bool; 2] {
        let is_wanted = |topic: &str| server.is_wanted(topic);
        let frames = OF_EVERY_FRAME.into_iter().chain([NAMES, FACE]).any(is_wanted);
        let mut topics = self.groups.iter().flat_map(|group| [&group.topic, &group.loads_topic]);
        [frames, is_wanted(FORCES) || topics.any(|topic| is_wanted(topic))]
    }

    /// Passes a frame on to the clients that want parts of it.
    pub(super) fn frame(
        &mut self,
        device: &PublishedDevice,
        frame: &TappedFrame,
        server: &mut FoxgloveServer,
    ) {
        server.frames_left_out(frame.frames_left_out);
        self.follow_markers(frame.markers.len(), device);
        self.row.clear();
        self.row.extend(frame.markers.iter().map(|marker| marker.position_mm));
        let arrival_unix_ns = unix_ns_of(frame.arrival_ns);
        let (time_ns, has_jumped) = self.time.of_frame(frame.device_ticks, arrival_unix_ns);
        if has_jumped {
            server.restart_time();
        }
        let row = &self.row;
        server.message(MARKERS, time_ns, || foxglove::cloud(row, time_ns));
        server
            .message(SPHERES, time_ns, || foxglove::marker_scene(row, &self.is_labelled, time_ns));
        server.message(LINES, time_ns, || foxglove::line_scene(row, &self.lines, time_ns));
        // A frame from before the first client wanted bodies has none, which would look like bodies that are not tracked.
        if self.bodies.is_empty() || frame.wants_poses {
            server.message(TRANSFORMS, time_ns, || {
                let bodies = self.bodies.iter().zip(&frame.poses);
                let tracked = bodies.filter(|(_, pose)| pose.state == PoseState::Tracked);
                let placed = tracked.map(|(name, pose)| PlacedBody {
                    name,
                    position_mm: pose.position_mm,
                    quaternion: pose.quaternion,
                });
                foxglove::transforms(Some(self.up), &placed.collect::<Vec<_>>(), time_ns)
            });
        }
        if is_due(&mut self.names_due_ns, time_ns, NAMES_HZ) {
            server.message(NAMES, time_ns, || foxglove::label_scene(row, &self.labels, time_ns));
        }
        if let Some((overlay, wireframe)) = &self.face
            && is_due(&mut self.face_due_ns, time_ns, DISPLAYED_HZ)
        {
            server.message(FACE, time_ns, || {
                let pose = overlay.pose(row);
                let placed = |at: [f32; 3]| {
                    pose.map(|pose| {
                        pose.map(|[x, y, z, to]| x * at[0] + y * at[1] + z * at[2] + to)
                    })
                };
                let vertices: Vec<_> = wireframe.vertices_mm.iter().map(|at| placed(*at)).collect();
                let pairs = wireframe
                    .lines
                    .iter()
                    .filter_map(|[a, b]| Some([(*vertices.get(*a)?)?, (*vertices.get(*b)?)?]));
                foxglove::face_scene(pairs, time_ns)
            });
        }
        server.end_frame();
    }

    /// Passes a batch of samples on to the clients that want them, and what their forces look like.
    pub(super) fn samples(&mut self, batch: &TappedBatch, server: &mut FoxgloveServer) {
        server.batches_left_out(batch.batches_left_out);
        let Some(group) = self.groups.iter_mut().find(|group| group.number == batch.group) else {
            return;
        };
        let n_samples = batch.samples.len() / usize::from(batch.n_channels).max(1);
        let length_ns = (n_samples as f64 * group.interval_ns) as u64;
        let taken_ns = unix_now_ns().saturating_sub(length_ns);
        let start_ns = self.time.of_samples(batch.device_ticks, taken_ns);
        let last_ns = group.send(batch, start_ns, server);
        let is_displayed = !group.plates.is_empty()
            && server.is_wanted(FORCES)
            && is_due(&mut group.due_ns, last_ns, DISPLAYED_HZ);
        if is_displayed {
            let arrows: Vec<ForceArrow> =
                self.groups.iter().flat_map(|group| group.arrows.iter().copied()).collect();
            server.message(FORCES, last_ns, || foxglove::force_scene(&arrows, last_ns));
        }
        server.end_batch();
    }

    /// Takes the markers over if there are others now.
    fn follow_markers(&mut self, n_channels: usize, device: &PublishedDevice) {
        if self.labels.len() == n_channels {
            return;
        }
        // A marker that has just appeared is here once the writer knows it.
        let channels = lock(&device.progress.channels);
        if channels.len() == self.labels.len() {
            return;
        }
        self.labels = channels.iter().map(|channel| channel.label.clone()).collect();
        self.is_labelled = channels.iter().map(|channel| channel.labelled).collect();
        drop(channels);
        let subject = self.subject.as_deref();
        self.lines = with_limbs(marker_lines(&self.labels), &live_limbs(subject, &self.labels));
        self.face = FaceOverlay::new(subject, &self.labels).map(|face| {
            let wireframe = face.wireframe();
            (face, wireframe)
        });
        self.names_due_ns = 0;
    }
}

impl GroupTopics {
    /// Sends the samples, and returns the time of the last one.
    fn send(&mut self, batch: &TappedBatch, start_ns: u64, server: &mut FoxgloveServer) -> u64 {
        let mut last_ns = start_ns;
        let has_samples = server.is_wanted(&self.topic);
        let has_loads = server.is_wanted(&self.loads_topic) || server.is_wanted(FORCES);
        if !has_samples && !has_loads {
            return last_ns;
        }
        let mut values = Vec::with_capacity(self.channels.len());
        let mut row = Vec::new();
        let sent = batch.samples.chunks_exact(usize::from(batch.n_channels).max(1));
        for (index, sample) in sent.enumerate() {
            let time_ns = start_ns + (index as f64 * self.interval_ns).round() as u64;
            last_ns = time_ns;
            let value = |(sent, channel): (&f32, &SampledChannelInfo)| channel.value(*sent);
            values.clear();
            values.extend(sample.iter().zip(&self.channels).map(value));
            row.clear();
            row.extend(values.iter().map(|value| *value as f32));
            server.message(&self.topic, time_ns, || foxglove::sampled(&row, time_ns));
            if !has_loads || self.plates.is_empty() {
                continue;
            }
            row.clear();
            for (plate, arrow) in self.plates.iter().zip(&mut self.arrows) {
                let of_plate = plate.channels.iter().map(|channel| values.get(*channel).copied());
                let of_plate: Vec<f64> = of_plate.map(|value| value.unwrap_or(f64::NAN)).collect();
                let load = plate.load(&of_plate);
                (arrow.force_n, arrow.cop_mm) = (load.force_n, load.cop_mm);
                row.extend(load.values().map(|value| value as f32));
            }
            server.message(&self.loads_topic, time_ns, || foxglove::sampled(&row, time_ns));
        }
        last_ns
    }
}

/// Whether a message that is sent so often is due, and if so, when the next one is.
fn is_due(due_ns: &mut u64, time_ns: u64, rate_hz: u64) -> bool {
    let interval_ns = 1_000_000_000 / rate_hz;
    // A time that is far ahead is of before a jump.
    if time_ns < *due_ns && *due_ns - time_ns <= interval_ns {
        return false;
    }
    // Due at even times, so that the rate is kept whatever that of the frames is.
    *due_ns = (time_ns / interval_ns + 1) * interval_ns;
    true
}

fn sampled_channel(kind: SampledKind, names: &[&str]) -> Channel {
    let schema_name = kind.message_name();
    let fields = foxglove::field_names(names);
    let schema = foxglove::sampled_descriptor(&schema_name, &fields);
    Channel { topic: topic_of(kind), schema_name, schema }
}

/// The topic that an export to MCAP has, too.
fn topic_of(kind: SampledKind) -> String {
    format!("/{}", kind.name())
}

fn group_topics(device: &PublishedDevice) -> Vec<GroupTopics> {
    let (plates, _) = device.header.force_plates();
    let plates_of = |group: &SampledGroupInfo| plates_of_group(&plates, &group_record(group));
    let n_with_plates = device.sampled.iter().filter(|group| !plates_of(group).is_empty()).count();
    let topics = |group: &SampledGroupInfo| {
        let (number, plates) = (u32::from(group.id), plates_of(group));
        let loads = SampledKind::ForcePlates(Some(number).filter(|_| n_with_plates > 1));
        let arrow = |plate: &ForcePlate| ForceArrow {
            corners_mm: plate.geometry.corners_mm(),
            force_n: [f64::NAN; 3],
            cop_mm: [f64::NAN; 3],
        };
        let kind = SampledKind::Group(number);
        GroupTopics {
            number: group.id,
            kind,
            topic: topic_of(kind),
            interval_ns: 1e12 / f64::from(group.rate_millihertz.max(1)),
            channels: group.channels.clone(),
            loads,
            loads_topic: topic_of(loads),
            arrows: plates.iter().map(arrow).collect(),
            plates,
            due_ns: 0,
        }
    };
    device.sampled.iter().map(topics).collect()
}

#[cfg(test)]
mod tests {
    use mocapd_acquire::{
        header,
        pipeline::{Pipeline, PipelineConfig},
    };
    use mocapd_codec::{ResamplerKind, Settings, Tolerance};
    use mocapd_drivers::device::BodyInfo;

    use super::*;

    #[test]
    fn every_body_has_a_frame_of_reference_of_its_own_named_as_in_an_export() {
        let codec =
            Settings { kind: ResamplerKind::Lossless, tolerance: Tolerance::from_mm(1.0).unwrap() };
        let config = PipelineConfig::new(codec, 100.0, 1_000_000, Vec::new());
        let header = header::new(&codec, 100.0).unwrap();
        let (_, pipeline, _) = Pipeline::arm(&config, &header).unwrap();
        let body = |(id, name): (u16, &str)| BodyInfo { id, name: name.to_owned() };
        let names = ["hand", "", "world", "hand", "hand #9", "body 1"];
        let device = PublishedDevice {
            progress: Arc::clone(pipeline.progress()),
            header,
            bodies: (6..).zip(names).map(body).collect(),
            sampled: Vec::new(),
            plates: Vec::new(),
            subject: None,
        };
        let found = DeviceTopics::new(&device, None).bodies;
        assert_eq!(found, ["hand", "body7", "world#2", "hand#2", "hand #9", "body 1"]);
    }

    #[test]
    fn messages_that_are_sent_less_often_keep_their_rate() {
        for (frames_hz, expected) in [(240, 60), (60, 60), (50, 50), (1000, 60)] {
            let mut due_ns = 0;
            let times = (0..10 * frames_hz).map(|n| 7_000_000_123 + n * 1_000_000_000 / frames_hz);
            let n = times.filter(|time| is_due(&mut due_ns, *time, 60)).count() as u64;
            assert!(n.abs_diff(10 * expected) <= 1, "{n} of {expected} Hz at {frames_hz} Hz");
        }
        let mut due_ns = 0;
        assert!(is_due(&mut due_ns, 1 << 60, 10), "before a jump");
        assert!(is_due(&mut due_ns, 1 << 50, 10), "behind it");
    }
}
