//! The sampled channels of the golden takes that have poses: nine rigid bodies in two groups, and the force plates of
//! every type in a group of their own.

use mocapd_codec::{
    Tolerance,
    poses::{
        GROUP_BODIES, POSE_CHANNELS, PoseBounds, PoseErrors, PoseQuantiser, PoseRow,
        RESIDUAL_NOT_REPORTED, without_pose,
    },
    sampled::SampledEncoder,
};
use mocapd_take::{
    TakeWriter,
    poses::{CHANNEL_NAMES, CHANNEL_UNITS},
    record::{
        GroupLedger, MeasuredErrors, SampleForm, SampleLedger, SampledChannel, SampledGroup,
        StatedPlate,
    },
    sampled::{POSES, SampleAnchor, SampleContent, SampleSpan},
    timeline::{LossCauses, Timeline},
};

use super::{
    motion::Random,
    times::{RATE_HZ, TICK_HZ},
};

const BODIES: usize = 9;

/// Number of the first group of poses.
const FIRST_GROUP: u32 = 16;

/// Samples of the plates in a row.
const PLATE_RATIO: u64 = 2;

/// The stretch whose poses were lost on the link, and the one in which the device dropped some.
const LOST: usize = 1;

/// Plates of the types 1, 2 and 3, whose axes point up and down.
pub(crate) fn plates() -> [StatedPlate; 3] {
    let corners = |x: f64, down: bool| {
        let corners = [[x + 400.0, 600.0], [x, 600.0], [x, 0.0], [x + 400.0, 0.0]];
        let mut corners = corners.map(|[x, y]| [x, y, 0.0]);
        if !down {
            corners.reverse();
        }
        corners
    };
    let plate = |number: u8, first: usize, n: usize, origin_mm| StatedPlate {
        number,
        code: number,
        group: 0,
        channels: (first..first + n).collect(),
        corners_mm: corners(500.0 * f64::from(number), number == 2),
        origin_mm,
    };
    [
        plate(1, 0, 6, [0.0, 0.0, 0.0]),
        plate(2, 6, 6, [1.5, -2.0, -41.0]),
        plate(3, 12, 8, [120.0, 200.0, 37.5]),
    ]
}

/// Writes the groups, and after each stretch its samples.
pub(crate) struct SampledParts {
    random: Random,
    /// By body: position in thousandths of a millimetre, and four integers that a quaternion is in proportion to.
    walks: Vec<([i64; 3], [i64; 4])>,
    quantisers: Option<Vec<PoseQuantiser>>,
    groups: Vec<(SampledGroup, SampledEncoder, GroupLedger)>,
    errors: [PoseErrors; 2],
    loads: [i64; 20],
    last: Vec<PoseRow>,
}

impl SampledParts {
    /// `tolerance`: `None` for poses as the device sent them.
    pub(crate) fn new(tolerance: Option<Tolerance>) -> Self {
        let bounds = tolerance.map(|tolerance| PoseBounds::new(tolerance, 0.25).unwrap());
        let plates = SampledGroup {
            form: SampleForm::Int16,
            rate_hz: (RATE_HZ * PLATE_RATIO) as f64,
            channels: (0..20).map(plate_channel).collect(),
            part_channels: 20,
            ..SampledGroup::default()
        };
        let poses = (0..BODIES).step_by(GROUP_BODIES).map(|first| {
            let bodies = first..(first + GROUP_BODIES).min(BODIES);
            let channels: Vec<SampledChannel> = bodies.flat_map(body_channels).collect();
            let mut group = SampledGroup {
                number: FIRST_GROUP + (first / GROUP_BODIES) as u32,
                kind: POSES.to_owned(),
                rate_hz: RATE_HZ as f64,
                part_channels: channels.len() as u32,
                channels,
                ..SampledGroup::default()
            };
            bounds.iter().for_each(|bounds| group.set_pose_bounds(bounds));
            group
        });
        let groups = [plates].into_iter().chain(poses).map(|group| {
            let ledger = GroupLedger { group: group.number, ..GroupLedger::default() };
            (group, SampledEncoder::new(), ledger)
        });
        Self {
            groups: groups.collect(),
            random: Random(23),
            walks: (0..BODIES as i64)
                .map(|i| ([i * 90_000, -i * 500, 900_000], [i, 9, 3 - i, 5]))
                .collect(),
            quantisers: bounds
                .map(|bounds| (0..BODIES).map(|_| PoseQuantiser::new(bounds)).collect()),
            errors: Default::default(),
            loads: [0; 20],
            last: vec![[0.0; POSE_CHANNELS]; BODIES],
        }
    }

    pub(crate) fn begin(&self, take: &mut TakeWriter<Vec<u8>>) {
        self.groups.iter().for_each(|(group, ..)| take.sampled_group(group).unwrap());
    }

    /// The poses of the rows of a stretch, and of those lost before it, and the samples of the plates meanwhile.
    pub(crate) fn stretch(
        &mut self,
        number: usize,
        timeline: &Timeline,
        take: &mut TakeWriter<Vec<u8>>,
    ) {
        let rows = timeline.first_row..timeline.first_row + timeline.n_rows();
        if rows.is_empty() {
            return;
        }
        // Poses of rows that were not recorded came all the same; their times are those of recorded rows only.
        let times: Vec<(u64, u64)> =
            timeline.recorded().map(|(row, time)| (row, time.device_ticks)).collect();
        let n = rows.end - rows.start;
        let poses: Vec<Vec<PoseRow>> = rows.clone().map(|row| self.poses(row)).collect();
        let loads: Vec<[f32; 20]> = (0..PLATE_RATIO * n).map(|_| self.loads()).collect();
        for index in 0..self.groups.len() {
            let (group, encoder, ledger) = &mut self.groups[index];
            let ratio = if index == 0 { PLATE_RATIO } else { 1 };
            let (first, n) = (ratio * rows.start, ratio * n);
            let is_lost = number == LOST;
            let before = [LOST + 1, 5].contains(&number) || number == 0;
            let content = match (is_lost, before) {
                (true, _) => SampleContent::Lost(LossCauses::NOT_RECEIVED),
                (false, true) => SampleContent::Key,
                (false, false) => SampleContent::Continued,
            };
            let mut block = Vec::new();
            if is_lost {
                ledger.lost_on_link += n;
            } else {
                let columns: Vec<Vec<f32>> = match index {
                    0 => (0..20).map(|i| loads.iter().map(|load| load[i]).collect()).collect(),
                    _ => (0..group.channels.len())
                        .map(|channel| {
                            let body = (index - 1) * GROUP_BODIES + channel / POSE_CHANNELS;
                            poses.iter().map(|row| row[body][channel % POSE_CHANNELS]).collect()
                        })
                        .collect(),
                };
                let columns: Vec<&[f32]> = columns.iter().map(Vec::as_slice).collect();
                encoder.encode(&columns, before, &mut block).unwrap();
                ledger.stored += n;
                if let (Some(&(row, ticks)), Some(&(last, last_ticks))) =
                    (times.first(), times.last())
                {
                    let anchor = SampleAnchor {
                        number: ratio * row,
                        run_start: 0,
                        device_ticks: ticks,
                        segment: 0,
                    };
                    let later = (ratio * last, last_ticks);
                    take.sample_time(group.number, &anchor, Some(later)).unwrap();
                }
            }
            ledger.taken += n;
            take.samples(&SampleSpan { group: group.number, first, n, content }, &block).unwrap();
        }
    }

    pub(crate) fn finish(&self, take: &mut TakeWriter<Vec<u8>>) {
        let mut ledger =
            SampleLedger { finished: true, batches_refused: 2, ..SampleLedger::default() };
        for (index, (_, _, counts)) in self.groups.iter().enumerate() {
            let errors =
                self.quantisers.is_some().then_some(()).and(index.checked_sub(1)).map(|of| {
                    let mut errors = MeasuredErrors::default();
                    errors.add(&self.errors[of]);
                    errors
                });
            ledger.groups.push(GroupLedger { errors, ..*counts });
        }
        take.sample_ledger(&ledger).unwrap();
    }

    fn poses(&mut self, row: u64) -> Vec<PoseRow> {
        let mut rows = Vec::new();
        for body in 0..BODIES {
            let (at, turn) = &mut self.walks[body];
            at.iter_mut().for_each(|x| *x += self.random.below(801) as i64 - 400);
            turn.iter_mut().for_each(|x| *x += self.random.below(5) as i64 - 2);
            let length = turn.iter().map(|&x| (x * x) as f64).sum::<f64>().max(1.0).sqrt();
            let sign = if self.random.below(7) == 0 { -1.0 } else { 1.0 };
            let [w, x, y, z] = turn.map(|x| (sign * x as f64 / length) as f32);
            let [px, py, pz] = at.map(|x| (x as f64 / 1000.0) as f32);
            let residual = match body {
                3 => RESIDUAL_NOT_REPORTED,
                _ => (self.random.below(900) as f64 / 1000.0) as f32,
            };
            let mut numbers = [px, py, pz, w, x, y, z, residual];
            let code = match (row + 13 * body as u64) % 61 {
                7..=9 => Some(1),
                10 => Some(2),
                11 => Some(77),
                12 => Some(254),
                13 => Some(255),
                _ => None,
            };
            let is_turned = turn.iter().any(|&x| x != 0);
            match code.or((!is_turned).then_some(2)) {
                Some(code) => numbers = without_pose(&self.last[body], code),
                None => {
                    if let Some(quantisers) = &mut self.quantisers {
                        quantisers[body].round(&mut numbers);
                        self.errors[body / GROUP_BODIES].add(&quantisers[body].take_errors());
                    }
                }
            }
            self.last[body] = numbers;
            rows.push(numbers);
        }
        rows
    }

    fn loads(&mut self) -> [f32; 20] {
        for load in &mut self.loads {
            *load = (*load + self.random.below(61) as i64 - 30).clamp(-32_768, 32_767);
        }
        self.loads.map(|load| load as f32)
    }
}

fn plate_channel(index: u32) -> SampledChannel {
    let of_type = [["Fx", "Fy", "Fz", "Mx", "My", "Mz"], ["Fx", "Fy", "Fz", "ax", "ay", "Tz"]];
    let (name, unit) = match index {
        0..6 => (
            of_type[1][index as usize].to_owned(),
            ["N", "N", "N", "mm", "mm", "Nmm"][index as usize],
        ),
        6..12 => (
            format!("{}2", of_type[0][index as usize - 6]),
            ["N", "N", "N", "Nm", "Nm", "Nm"][index as usize - 6],
        ),
        _ => (format!("f{}", index - 11), "N"),
    };
    SampledChannel { name, unit: unit.to_owned(), index, scale: 0.125, offset: f64::from(index) }
}

fn body_channels(body: usize) -> Vec<SampledChannel> {
    let name = if body == 4 { String::new() } else { format!("body {}", body % 7) };
    let channel = |(channel, unit): (&str, &str)| SampledChannel {
        name: format!("{name}.{channel}"),
        unit: unit.to_owned(),
        index: 100 + 3 * body as u32,
        scale: 1.0,
        offset: 0.0,
    };
    CHANNEL_NAMES.into_iter().zip(CHANNEL_UNITS).map(channel).collect()
}

/// The ticks of the golden recordings are microseconds.
const _: () = assert!(TICK_HZ == 1_000_000);
