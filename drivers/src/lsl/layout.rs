//! What streams become: markers of frames, groups of sampled channels, or events.

use std::collections::HashMap;

use super::{
    description::{ChannelDescription, StreamDescription, length_unit, marker_of, position_axis},
    values::ValueFormat,
};
use crate::{
    device::{Hello, MarkerInfo, SampleForm, SampledChannelInfo, SampledGroupInfo},
    link::{
        GROUPS_MAX, LABEL_BYTES_MAX, SAMPLE_VALUES_PER_S_MAX, SAMPLED_CHANNELS_MAX, TEXT_BYTES_MAX,
        UNIT_BYTES_MAX,
    },
    uri::StreamQuery,
};

/// Ticks of a device's clock in a second: time stamps are 64-bit floats of seconds, and in nanoseconds none of them loses
/// what a clock resolves.
pub(super) const TICK_HZ: u64 = 1_000_000_000;

/// Without markers, frames without markers are the time axis of a take: its events, gaps and length are counted in them. One
/// comes with every so many samples of the first stream of numbers, so that they have about this rate.
const EMPTY_FRAMES_MILLIHERTZ: u32 = 100_000;

/// The channels that hold a marker's position.
#[derive(Debug, Clone, PartialEq)]
pub struct MarkerColumns {
    /// Its label.
    pub label: String,
    /// Channels of x, y and z.
    pub columns: [usize; 3],
    /// Millimetres of a value.
    pub factor: f64,
}

/// The channels of a group.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupLayout {
    /// The group.
    pub info: SampledGroupInfo,
    /// Its channels in the stream.
    pub columns: Vec<usize>,
}

/// What a stream becomes.
#[derive(Debug, Clone, PartialEq)]
pub enum StreamRole {
    /// Each sample is an event.
    Events,
    /// Positions are markers, and all other channels are sampled channels.
    Numbers {
        /// Markers of frames.
        markers: Vec<MarkerColumns>,
        /// Groups of sampled channels.
        groups: Vec<GroupLayout>,
        /// Samples per second in thousandths.
        rate_millihertz: u32,
        /// Whether the stream itself states this rate, so that its time stamps show missing samples.
        is_regular: bool,
    },
}

/// What all streams of a recording become.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// What the recorder knows of them as a device.
    pub hello: Hello,
    /// The markers.
    pub markers: Vec<MarkerInfo>,
    /// One role for each stream.
    pub roles: Vec<StreamRole>,
    /// The stream whose samples are frames, and how many samples a frame has: several only if there are no markers.
    pub frames: (usize, u64),
    /// One line of text for each thing about them that a user should know.
    pub remarks: Vec<String>,
}

impl Layout {
    /// Decides what streams become.
    ///
    /// # Errors
    /// One line that says why they cannot be recorded, or not together, and what to do.
    pub fn new(query: &StreamQuery, streams: &[StreamDescription]) -> Result<Self, String> {
        check_clocks(streams)?;
        let mut layout = Self {
            hello: hello(streams),
            markers: Vec::new(),
            roles: Vec::new(),
            frames: (0, 1),
            remarks: Vec::new(),
        };
        let mut n_groups = 0;
        for stream in streams {
            let role = layout.role(query, stream, &mut n_groups)?;
            layout.roles.push(role);
        }
        layout.find_frames(streams)?;
        Ok(layout)
    }

    /// Decides which samples are frames.
    fn find_frames(&mut self, streams: &[StreamDescription]) -> Result<(), String> {
        let numbers = self.roles.iter().enumerate().filter_map(|(at, role)| match role {
            StreamRole::Numbers { markers, rate_millihertz, .. } => {
                Some((markers.is_empty(), at, *rate_millihertz))
            }
            StreamRole::Events => None,
        });
        // The one with markers, or else the first.
        let Some((has_no_markers, at, rate_millihertz)) =
            numbers.min_by_key(|(none, at, _)| (*none, *at))
        else {
            let names =
                streams.iter().map(StreamDescription::summary).collect::<Vec<_>>().join(", ");
            return Err(format!(
                "{names}: events alone are no recording: name a stream with markers or samples as well, as in lsl:EEG,{}",
                streams.first().map_or("Markers", |stream| &stream.name)
            ));
        };
        let every = if has_no_markers {
            rate_millihertz.div_ceil(EMPTY_FRAMES_MILLIHERTZ).max(1)
        } else {
            1
        };
        self.frames = (at, u64::from(every));
        let rate_millihertz = rate_millihertz / every;
        let hello = &mut self.hello;
        hello.rate_millihertz = rate_millihertz;
        (hello.rate_min_millihertz, hello.rate_max_millihertz) = (rate_millihertz, rate_millihertz);
        Ok(())
    }

    /// The groups of all streams.
    pub fn groups(&self) -> impl Iterator<Item = &SampledGroupInfo> {
        let groups = self.roles.iter().filter_map(|role| match role {
            StreamRole::Numbers { groups, .. } => Some(groups),
            StreamRole::Events => None,
        });
        groups.flatten().map(|group| &group.info)
    }

    fn role(
        &mut self,
        query: &StreamQuery,
        stream: &StreamDescription,
        n_groups: &mut usize,
    ) -> Result<StreamRole, String> {
        let name = &stream.name;
        if stream.source_id.is_empty() {
            self.remarks.push(format!(
                "the stream '{name}' has no source_id: after an outage it is known by its name alone"
            ));
        }
        if let Some(rate) = &stream.odd_rate {
            self.remarks.push(format!(
                "the stream '{name}' states a rate of '{rate}' Hz, which counts as no fixed rate"
            ));
        }
        if stream.format == ValueFormat::Text {
            return Ok(StreamRole::Events);
        }
        let columns = marker_columns(stream, query)?;
        let n_positions = stream.channels.iter().filter(|c| position_axis(c).is_some()).count();
        if n_positions > 3 * columns.len() {
            self.remarks.push(format!(
                "the stream '{name}' has {} channels of positions without the two other axes of their marker: they are \
                 recorded as sampled channels",
                n_positions - 3 * columns.len()
            ));
        }
        let is_regular = stream.rate_hz > 0.0;
        let rate_millihertz = match query
            .rate_millihertz
            .filter(|_| !is_regular && !columns.is_empty())
        {
            Some(rate) => rate,
            None if is_regular => (stream.rate_hz * 1000.0).round() as u32,
            None if columns.is_empty() => {
                self.remarks.push(format!(
                    "the stream '{name}' states no rate: its samples are recorded as events"
                ));
                return Ok(StreamRole::Events);
            }
            None => {
                return Err(format!(
                    "the stream {} has markers and no fixed rate: state about how many frames come in a second, as in \
                     lsl:{name}?rate=120",
                    stream.summary()
                ));
            }
        };
        if !columns.is_empty() {
            self.add_markers(stream, &columns)?;
        }
        let is_position = |at: &usize| columns.iter().any(|marker| marker.columns.contains(at));
        let rest: Vec<usize> = (0..stream.n_channels).filter(|at| !is_position(at)).collect();
        let groups = groups(stream, &rest, rate_millihertz, n_groups)?;
        if !groups.is_empty()
            && matches!(
                stream.format,
                ValueFormat::Double64 | ValueFormat::Int32 | ValueFormat::Int64
            )
        {
            let format = stream.format.name();
            self.remarks
                .push(format!("the stream '{name}' is {format}: it is recorded as float32"));
        }
        Ok(StreamRole::Numbers { markers: columns, groups, rate_millihertz, is_regular })
    }

    fn add_markers(
        &mut self,
        stream: &StreamDescription,
        columns: &[MarkerColumns],
    ) -> Result<(), String> {
        if !self.markers.is_empty() {
            return Err(format!(
                "two streams have markers, and a take has frames of one: record '{}' on its own",
                stream.name
            ));
        }
        for (id, marker) in columns.iter().enumerate() {
            let label = marker.label.clone();
            self.markers.push(MarkerInfo { id: id as u16, label, labelled: true });
        }
        self.hello.markers_max = columns.len() as u16;
        Ok(())
    }
}

/// Streams of one recording share a clock: those of one machine do.
fn check_clocks(streams: &[StreamDescription]) -> Result<(), String> {
    let Some(first) = streams.first() else { return Err("no stream was named".to_owned()) };
    match streams.iter().find(|stream| stream.hostname != first.hostname) {
        Some(other) => Err(format!(
            "'{}' comes from {} and '{}' from {}, whose clocks differ: record each on its own",
            first.name, first.hostname, other.name, other.hostname
        )),
        None => Ok(()),
    }
}

fn hello(streams: &[StreamDescription]) -> Hello {
    let joined = |of: fn(&StreamDescription) -> &str| {
        streams.iter().map(of).filter(|text| !text.is_empty()).collect::<Vec<_>>().join("+")
    };
    Hello {
        model: format!("LSL {}", joined(|stream| &stream.name)),
        serial: joined(|stream| &stream.source_id),
        firmware: joined(|stream| &stream.kind),
        tick_hz: TICK_HZ,
        ..Hello::default()
    }
}

/// The markers of a stream, in the order of their first channels: those with three axes.
fn marker_columns(
    stream: &StreamDescription,
    query: &StreamQuery,
) -> Result<Vec<MarkerColumns>, String> {
    let mut found: Vec<(&str, [Option<usize>; 3])> = Vec::new();
    for (at, channel) in stream.channels.iter().enumerate() {
        let Some(axis) = position_axis(channel) else { continue };
        let marker = marker_of(channel, axis);
        // The last one first: channels of a marker follow each other. One whose axis is there already begins another marker.
        let known = found.iter_mut().rev().find(|(name, columns)| {
            *name == marker && columns.get(axis).is_some_and(Option::is_none)
        });
        let place = match known {
            Some((_, columns)) => columns.get_mut(axis),
            None => {
                found.push((marker, [None; 3]));
                found.last_mut().and_then(|(_, columns)| columns.get_mut(axis))
            }
        };
        if let Some(place) = place {
            *place = Some(at);
        }
    }
    let mut markers: Vec<MarkerColumns> = Vec::new();
    let mut names = Names::default();
    for (name, columns) in found {
        let [Some(x), Some(y), Some(z)] = columns else { continue };
        let factor = factor(stream, query, [x, y, z])?;
        let name = if name.is_empty() { "marker" } else { name };
        let label = names.unique(name, LABEL_BYTES_MAX);
        markers.push(MarkerColumns { label, columns: [x, y, z], factor });
    }
    Ok(markers)
}

/// Millimetres of a value of these channels.
fn factor(
    stream: &StreamDescription,
    query: &StreamQuery,
    columns: [usize; 3],
) -> Result<f64, String> {
    let units = columns.map(|at| stream.channels.get(at).map_or("", |channel| &channel.unit));
    let name = &stream.name;
    if units.iter().any(|unit| *unit != units[0]) {
        return Err(format!(
            "the axes of a marker of the stream '{name}' have different units, {}: correct its description",
            units.join(", ")
        ));
    }
    match length_unit(units[0]).or(query.unit.filter(|_| units[0].is_empty())) {
        Some(unit) => Ok(unit.mm()),
        None if units[0].is_empty() => Err(format!(
            "the stream '{name}' does not state the unit of its positions: state it, as in lsl:{name}?unit=m (or cm, mm)"
        )),
        None => Err(format!(
            "the stream '{name}' has positions in '{}': expected meters, centimeters or millimeters",
            units[0]
        )),
    }
}

/// The groups of a stream's channels, as few as hold them.
fn groups(
    stream: &StreamDescription,
    columns: &[usize],
    rate_millihertz: u32,
    n_groups: &mut usize,
) -> Result<Vec<GroupLayout>, String> {
    let per_s = u64::from(rate_millihertz) * columns.len().min(SAMPLED_CHANNELS_MAX) as u64 / 1000;
    if per_s > SAMPLE_VALUES_PER_S_MAX {
        return Err(format!(
            "{} has more than {SAMPLE_VALUES_PER_S_MAX} values a second",
            stream.summary()
        ));
    }
    let mut groups = Vec::new();
    let mut names = Names::default();
    for columns in columns.chunks(SAMPLED_CHANNELS_MAX) {
        if *n_groups >= GROUPS_MAX {
            return Err(format!(
                "these streams have more channels than {GROUPS_MAX} groups of {SAMPLED_CHANNELS_MAX}: record fewer of them"
            ));
        }
        let channels = columns.iter().map(|&at| {
            let unnamed = ChannelDescription::default();
            let stated = stream.channels.get(at).unwrap_or(&unnamed);
            let name = if stated.label.is_empty() {
                format!("{} {}", stream.name, at + 1)
            } else {
                stated.label.clone()
            };
            let name = names.unique(&name, TEXT_BYTES_MAX);
            SampledChannelInfo {
                name,
                unit: shortened(&stated.unit, UNIT_BYTES_MAX),
                scale: 1.0,
                offset: 0.0,
            }
        });
        let info = SampledGroupInfo {
            id: *n_groups as u8,
            form: match stream.format {
                ValueFormat::Int8 | ValueFormat::Int16 => SampleForm::Int16,
                _ => SampleForm::Float32,
            },
            rate_millihertz,
            channels: channels.collect(),
        };
        groups.push(GroupLayout { info, columns: columns.to_vec() });
        *n_groups += 1;
    }
    Ok(groups)
}

/// A text of at most so many bytes.
fn shortened(text: &str, bytes_max: usize) -> String {
    let end = (0..=bytes_max.min(text.len())).rev().find(|end| text.is_char_boundary(*end));
    text.get(..end.unwrap_or(0)).unwrap_or_default().to_owned()
}

/// Names that are taken, each with the number of the last one that had to differ from it.
#[derive(Debug, Default)]
struct Names(HashMap<String, usize>);

impl Names {
    /// A name of at most so many bytes that is not taken yet: as it is, or with a number.
    fn unique(&mut self, name: &str, bytes_max: usize) -> String {
        let name = shortened(name, bytes_max);
        let mut last = match self.0.get(&name) {
            Some(last) => *last,
            None => {
                self.0.insert(name.clone(), 1);
                return name;
            }
        };
        loop {
            last += 1;
            let suffix = format!(" ({last})");
            let numbered = shortened(&name, bytes_max.saturating_sub(suffix.len())) + &suffix;
            if !self.0.contains_key(&numbered) {
                self.0.insert(name, last);
                self.0.insert(numbered.clone(), 1);
                return numbered;
            }
        }
    }
}
