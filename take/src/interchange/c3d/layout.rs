//! The layout of the data section: where frames begin, what a frame holds, how many there are, and their rate. Header
//! and parameters state most of this twice; where they disagree, the data decides.

use std::collections::BTreeSet;

use super::{
    header::{BLOCK, ByteOrder, C3dHeader},
    malformed,
    parameters::Parameters,
    stride::{self, CANDIDATES_MAX, FileBytes, SizeFit, Stride, StrideCandidate},
};
use crate::{
    interchange::{Result, counted, source_file::SourceFile},
    motion::{Ambiguity, FrameLayout, Notes},
};

/// The layout of the data section.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// Byte order of the samples.
    pub(super) order: ByteOrder,
    /// The content of a frame. Points include model outputs.
    pub(super) stride: Stride,
    /// Analog samples of one channel in a frame.
    pub(super) analog_ratio: usize,
    /// Scale factor of integer coordinates and of residuals, positive.
    pub(super) scale: f32,
    /// Number of complete frames.
    pub(super) n_frames: usize,
    /// Number of announced frames that are not in the file.
    pub(super) frames_missing: u64,
    /// Number of the first frame.
    pub(super) first_frame: u64,
    /// Frames a second.
    pub(super) rate_hz: f64,
}

impl Layout {
    /// Number of analog channels.
    pub(super) fn n_channels(&self) -> usize {
        self.stride.analog_per_frame.checked_div(self.analog_ratio).unwrap_or(0)
    }

    /// The factor from stored coordinates to the file's unit.
    pub(super) fn coordinate_scale(&self) -> f64 {
        if self.stride.float { 1.0 } else { f64::from(self.scale) }
    }

    /// Determines the layout from header and parameters, and from the data where they disagree.
    ///
    /// # Errors
    /// `Malformed` if the data section is outside of the file, or if no combination of the stated values fits the data;
    /// `Io` if the file cannot be read.
    pub(super) fn resolve(
        header: &C3dHeader,
        parameters: &Parameters,
        order: ByteOrder,
        source: &mut SourceFile<'_>,
        notes: &mut Notes,
    ) -> Result<Self> {
        let file = &mut FileBytes::new(source, order)?;
        let starts = data_starts(header, parameters, file.len)?;
        // Behind the points may be a section of poses. A file without poses may state a place for them, too: ezc3d does, and
        // behind more than 65535 blocks that is a place amid the points.
        let n_bodies = parameters.number("ROTATION", "USED").filter(|n| *n >= 1.0);
        let rotations = parameters.get("ROTATION", "DATA_START").filter(|_| n_bodies.is_some());
        let rotations = rotations.and_then(|blocks| blocks.integers().first().copied());
        let rotations = usize::from(rotations.unwrap_or(0)).saturating_sub(1) * BLOCK;
        if starts.iter().all(|start| *start < rotations) {
            (file.len, file.filled) = (file.len.min(rotations), file.filled.min(rotations));
        }
        let rate_hz = rate(header, parameters.number("POINT", "RATE"), &mut notes.warnings);
        if let Some(n) = n_bodies {
            notes
                .warnings
                .push(format!("The poses of {n} rigid bodies (ROTATION) were not imported."));
        }
        let stated = StatedLayout::of(header, parameters, rate_hz);
        let counts = FrameCounts::of(header, parameters);
        let (stride, n_candidates) = stated.choose(file, &starts, &counts)?;
        let count = counts.for_stride(file, &stride);
        let mut layout = Self {
            order,
            stride,
            analog_ratio: stated.analog_ratio(stride.analog_per_frame, &mut notes.warnings),
            scale: if stated.scale_is_usable() { stated.scale.abs() } else { 1.0 },
            n_frames: 0,
            frames_missing: 0,
            first_frame: counts.first_frame(&count),
            rate_hz,
        };
        if n_candidates > 1 {
            let taken = FrameLayout {
                points: stride.n_points as u64,
                analog_per_frame: stride.analog_per_frame as u64,
                data_offset: stride.data_start as u64,
                integers: !stride.float,
            };
            notes.ambiguous(Ambiguity::FrameLayout { stated: stated.describe(&starts), taken });
        }
        counts.report(&count, &mut notes.warnings);
        layout.set_frames(file, &count, &mut notes.warnings);
        Ok(layout)
    }

    /// Sets the number of frames to those that are announced and present. Warns of missing frames and of surplus data.
    fn set_frames(
        &mut self,
        file: &FileBytes<'_, '_>,
        count: &FrameCount,
        warnings: &mut Vec<String>,
    ) {
        let announced = usize::try_from(count.n_frames).unwrap_or(usize::MAX);
        self.n_frames = file.present(&self.stride).min(announced);
        if (self.n_frames as u64) < count.n_frames {
            self.frames_missing = count.n_frames - self.n_frames as u64;
            let (announced, n) = (counted(count.n_frames, "frame"), self.n_frames);
            warnings.push(format!("The header announces {announced}, the file has {n}."));
            return;
        }
        let end = self.stride.data_start + self.n_frames * self.stride.frame_bytes();
        let n_left = file.len.saturating_sub(end);
        if self.n_frames > 0 && n_left >= BLOCK && file.filled > end {
            warnings.push(format!("{n_left} bytes after the last frame were ignored."));
        }
    }
}

/// The content of a frame as header and parameters state it.
struct StatedLayout<'a> {
    header: &'a C3dHeader,
    points_used: Option<u64>,
    channels_used: Option<u64>,
    /// ANALOG:RATE divided by POINT:RATE, if that is a whole number.
    rate_ratio: Option<u64>,
    scale: f32,
}

impl<'a> StatedLayout<'a> {
    fn of(header: &'a C3dHeader, parameters: &Parameters, rate_hz: f64) -> Self {
        let number = |group: &str, name: &str| parameters.number(group, name);
        let ratio = number("ANALOG", "RATE").map(|analog_hz| analog_hz / rate_hz);
        let scale = parameters.float("POINT", "SCALE");
        let points_used = number("POINT", "USED").and_then(as_count);
        Self {
            header,
            points_used: points_used.map(|n| n.min(u64::from(u16::MAX))),
            channels_used: number("ANALOG", "USED").and_then(as_count),
            rate_ratio: ratio.and_then(near_whole),
            scale: scale.unwrap_or(header.scale),
        }
    }

    fn scale_is_usable(&self) -> bool {
        self.scale.is_finite() && self.scale != 0.0
    }

    /// The analog samples in a frame by every source in the file, the header first.
    fn analog(&self) -> Vec<u64> {
        let mut all = vec![u64::from(self.header.analog_per_frame)];
        if let Some(used) = self.channels_used {
            let ratios = [Some(u64::from(self.header.analog_ratio)), self.rate_ratio];
            let ratios: Vec<u64> = ratios.into_iter().flatten().filter(|&n| n > 0).collect();
            // These also count if the header has another number: some software writes the number of channels there.
            all.extend(ratios.iter().map(|ratio| used.saturating_mul(*ratio)));
            if ratios.is_empty() {
                all.push(used);
            }
        }
        all.retain(|&n| n <= stride::ANALOG_MAX);
        all
    }

    /// Whether samples are floats: by the sign of POINT:SCALE, and also by that of the header's scale if it differs.
    fn floats(&self) -> Vec<bool> {
        if !self.scale_is_usable() {
            return vec![true, false];
        }
        let other = Some(self.header.scale).filter(|scale| scale.is_finite() && *scale != 0.0);
        let mut floats = vec![self.scale < 0.0];
        floats.extend(other.map(|scale| scale < 0.0).filter(|float| *float != (self.scale < 0.0)));
        floats
    }

    /// Chooses the combination of stated values that fits the data. Returns it with the number of different
    /// combinations that are stated.
    fn choose(
        &self,
        file: &mut FileBytes<'_, '_>,
        starts: &[usize],
        counts: &FrameCounts<'_>,
    ) -> Result<(Stride, usize)> {
        let points: Vec<u64> =
            self.points_used.into_iter().chain([self.header.n_points.into()]).collect();
        let strides = stride::combine(&points, &self.analog(), &self.floats(), starts);
        let mut candidates: Vec<StrideCandidate> = Vec::new();
        for &stride in &strides {
            let n_frames = counts.for_stride(file, &stride).n_frames;
            candidates.push(StrideCandidate::new(file, stride, n_frames, true)?);
        }
        let n_stated = candidates.len();
        let only = candidates.first().copied().filter(|_| n_stated == 1);
        if let Some(only) = only.filter(StrideCandidate::is_acceptable) {
            return Ok((only.stride, 1));
        }
        let cut_off = only.filter(StrideCandidate::is_short);
        if !candidates.iter().any(StrideCandidate::is_plausible) {
            let mut more: Vec<(Stride, u64)> = Vec::new();
            for n_frames in counts.all() {
                for &stride in &strides {
                    let sizes = stride::by_size(file, stride, n_frames, self.channels_used);
                    more.extend(sizes.map(|stride| (stride, n_frames)));
                    more.dedup();
                    more.truncate(CANDIDATES_MAX);
                }
            }
            for (stride, n_frames) in more {
                candidates.push(StrideCandidate::new(file, stride, n_frames, false)?);
            }
            if self.channels_used.is_none_or(|used| used == 0) {
                // A file without ANALOG:USED may have no analog samples, whatever its header states.
                let none = strides.iter().map(|&stride| Stride { analog_per_frame: 0, ..stride });
                for stride in none.filter(|stride| !strides.contains(stride)) {
                    let n_frames = counts.for_stride(file, &stride).n_frames;
                    candidates.push(StrideCandidate::new(file, stride, n_frames, true)?);
                }
            }
        }
        let mut chosen = stride::choose(&candidates);
        if let Some((best, only)) = chosen.zip(cut_off)
            && !(best.is_much_smoother(&only) && best.begins_smoothly(file)?)
        {
            chosen = None;
        }
        match (chosen, strides.first()) {
            (Some(chosen), _) => {
                let is_other = strides.first() != Some(&chosen.stride);
                Ok((chosen.stride, n_stated.max(1 + usize::from(is_other))))
            }
            (None, Some(&only)) if n_stated == 1 => Ok((only, 1)),
            _ => Err(malformed(
                "byte 2",
                format!(
                    "{}; no combination of these fits the {} bytes of data or gives continuous motion: correct the \
                     header or the parameters, or export the file again",
                    self.describe(starts),
                    file.len.saturating_sub(starts.first().copied().unwrap_or(0))
                ),
            )),
        }
    }

    /// Determines the analog samples of one channel in a frame. Warns if header and parameters disagree.
    fn analog_ratio(&self, per_frame: usize, warnings: &mut Vec<String>) -> usize {
        let per_frame = per_frame as u64;
        let header_ratio = u64::from(self.header.analog_ratio);
        if per_frame == 0 {
            return usize::try_from(header_ratio).unwrap_or(0);
        }
        let used = self.channels_used;
        let agrees = |ratio: u64| used.is_none_or(|n| n.checked_mul(ratio) == Some(per_frame));
        let divides = |n: u64| n > 0 && per_frame.is_multiple_of(n);
        let mut stated = [Some(header_ratio), self.rate_ratio].into_iter().flatten();
        let ratio = stated
            .find(|&ratio| agrees(ratio) && divides(ratio))
            .or_else(|| Some(header_ratio).filter(|&ratio| divides(ratio)))
            .or_else(|| used.filter(|&used| divides(used)).map(|used| per_frame / used))
            .unwrap_or(1);
        let n_channels = per_frame / ratio;
        if used.is_some_and(|used| used != n_channels) || !divides(header_ratio) {
            warnings.push(format!(
                "{per_frame} analog samples in a frame were read as {n_channels} channels with {ratio} each: \
                 ANALOG:USED is {}, the header states {} for each channel.",
                used.map_or_else(|| "missing".to_owned(), |used| used.to_string()),
                header_ratio
            ));
        }
        usize::try_from(ratio).unwrap_or(1)
    }

    /// The stated values as text for the user.
    fn describe(&self, starts: &[usize]) -> String {
        let or_none = |n: Option<u64>| n.map_or_else(|| "missing".to_owned(), |n| n.to_string());
        let mut text = format!(
            "points: POINT:USED {}, header {}; analog samples in a frame: header {}, ANALOG:USED {} times {} from the \
             header or {} from ANALOG:RATE over POINT:RATE",
            or_none(self.points_used),
            self.header.n_points,
            self.header.analog_per_frame,
            or_none(self.channels_used),
            self.header.analog_ratio,
            or_none(self.rate_ratio)
        );
        if self.floats().len() > 1 {
            text += &format!("; scale: POINT:SCALE {}, header {}", self.scale, self.header.scale);
        }
        if starts.len() > 1 {
            let blocks: Vec<_> = starts.iter().map(|at| (at / BLOCK + 1).to_string()).collect();
            text += &format!("; first block of the data: {}", blocks.join(" or "));
        }
        text
    }
}

/// The ratio of two rates as a whole number; `None` if it differs from one by more than the rounding of the rates to
/// f32.
fn near_whole(ratio: f64) -> Option<u64> {
    let whole = ratio.round();
    ((ratio - whole).abs() <= 1e-3 * whole && (1.0..65536.0).contains(&whole))
        .then_some(whole as u64)
}

/// A stored number as a count, rounded down; `None` if it is negative or exceeds 32 bits.
fn as_count(value: f64) -> Option<u64> {
    (0.0..4_294_967_296.0).contains(&value).then_some(value as u64)
}

/// The rate in frames a second: POINT:RATE, or the header's, or 100 Hz. Warns unless both agree.
fn rate(header: &C3dHeader, parameter: Option<f64>, warnings: &mut Vec<String>) -> f64 {
    let usable = |rate: &f64| rate.is_finite() && *rate > 0.0;
    let stated = f64::from(header.rate_hz);
    match (parameter.filter(usable), Some(stated).filter(usable)) {
        (Some(rate), Some(header)) => {
            if (rate - header).abs() > rate * 1e-6 {
                warnings.push(format!(
                    "POINT:RATE is {rate} Hz, but the header states {header} Hz; {rate} Hz was used."
                ));
            }
            rate
        }
        (Some(rate), None) => rate,
        (None, Some(rate)) => {
            warnings.push(format!("POINT:RATE is missing; the header's {rate} Hz was used."));
            rate
        }
        (None, None) => {
            warnings.push("The file states no usable rate; 100 Hz was assumed.".to_owned());
            100.0
        }
    }
}

/// Possible offsets of the first frame: that of the header, and that of `POINT:DATA_START` if it differs.
fn data_starts(header: &C3dHeader, parameters: &Parameters, n_bytes: usize) -> Result<Vec<usize>> {
    let offset = |block: u64| {
        usize::try_from(block.saturating_sub(1)).unwrap_or(usize::MAX).saturating_mul(BLOCK)
    };
    let fits = |&block: &u64| block > u64::from(header.parameter_block) && offset(block) <= n_bytes;
    let stated = u64::from(header.data_block);
    let parameter = parameters.number("POINT", "DATA_START").and_then(as_count);
    let mut starts: Vec<usize> =
        [Some(stated), parameter].into_iter().flatten().filter(fits).map(offset).collect();
    starts.dedup();
    if starts.is_empty() {
        return Err(malformed(
            "byte 16",
            format!(
                "the data begins at block {stated}, but the file has only {}: it was cut off before its data",
                n_bytes.div_ceil(BLOCK)
            ),
        ));
    }
    Ok(starts)
}

/// Largest value of a 16-bit count: the actual count may be larger.
const SATURATED: u64 = 65535;

/// A number of frames and its source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct FrameCount {
    n_frames: u64,
    source: Option<CountSource>,
}

/// The sources of the number of frames, the most trusted first. The first three may exceed 16 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CountSource {
    Trial,
    LongFrames,
    Frames,
    Header,
    /// The size of the file, if 16 bits are not enough and the file has no wider count.
    Size,
}

impl CountSource {
    fn name(self) -> &'static str {
        match self {
            Self::Trial => "TRIAL:ACTUAL_END_FIELD",
            Self::LongFrames => "POINT:LONG_FRAMES",
            Self::Frames => "POINT:FRAMES",
            Self::Header => "the header",
            Self::Size => "the file's size",
        }
    }
}

/// All numbers of frames that a file states.
struct FrameCounts<'a> {
    header: &'a C3dHeader,
    stated: Vec<(CountSource, u64)>,
    trial_start: Option<u64>,
    /// Whether the file has no count wider than 16 bits.
    is_narrow: bool,
}

impl<'a> FrameCounts<'a> {
    fn of(header: &'a C3dHeader, parameters: &Parameters) -> Self {
        let field = |name: &str| match parameters.get("TRIAL", name)?.integers()[..] {
            [low] => Some(u64::from(low)),
            [low, high, ..] => Some(u64::from(low) | u64::from(high) << 16),
            [] => None,
        };
        let start = field("ACTUAL_START_FIELD");
        let trial = start.zip(field("ACTUAL_END_FIELD")).and_then(|(s, e)| (e + 1).checked_sub(s));
        let count = |name: &str| parameters.number("POINT", name).and_then(as_count);
        let (first, last) = (u64::from(header.first_frame), u64::from(header.last_frame));
        let stated = [
            (CountSource::Trial, trial),
            (CountSource::LongFrames, count("LONG_FRAMES")),
            (CountSource::Frames, count("FRAMES")),
            (CountSource::Header, (last + 1).checked_sub(first)),
        ];
        let stated = stated.into_iter();
        let has = |group: &str, name: &str| parameters.get(group, name).is_some();
        Self {
            header,
            stated: stated.filter_map(|(of, n)| Some((of, n.filter(|&n| n > 0)?))).collect(),
            trial_start: start,
            is_narrow: !has("POINT", "LONG_FRAMES") && !has("TRIAL", "ACTUAL_END_FIELD"),
        }
    }

    /// The distinct counts.
    fn all(&self) -> BTreeSet<u64> {
        self.stated.iter().map(|&(_, n)| n).collect()
    }

    /// The count for frames of a stride: the most trusted one that fits the data exactly, otherwise the most trusted
    /// one for which there is enough data, otherwise the most trusted one.
    fn for_stride(&self, file: &FileBytes<'_, '_>, stride: &Stride) -> FrameCount {
        let fits = |wanted: &dyn Fn(SizeFit) -> bool| {
            self.stated.iter().find(|&&(_, n)| wanted(file.fit(stride, n)))
        };
        let found = fits(&|fit| fit == SizeFit::Exact);
        let is_saturated = self.is_narrow && self.header.last_frame == u16::MAX;
        if found.is_none() && is_saturated {
            // Frames that fit in the padding of the last block are not counted.
            let padding = (BLOCK - 1) / stride.frame_bytes().max(1);
            let n_frames = file.present(stride).saturating_sub(padding) as u64;
            if self.stated.iter().all(|&(_, n)| n < n_frames) {
                return FrameCount { n_frames, source: Some(CountSource::Size) };
            }
        }
        let found = found.or_else(|| fits(&|fit| fit != SizeFit::Short)).or(self.stated.first());
        let (source, n_frames) = found.map_or((None, 0), |&(source, n)| (Some(source), n));
        FrameCount { n_frames, source }
    }

    /// The number of the first frame: from the TRIAL group if its count was used, otherwise from the header.
    fn first_frame(&self, used: &FrameCount) -> u64 {
        let trial = self.stated.iter().find(|(source, _)| *source == CountSource::Trial);
        match (self.trial_start, trial) {
            (Some(start), Some(&(_, n))) if n == used.n_frames => start,
            _ => self.header.first_frame.into(),
        }
    }

    /// Warns of sources that disagree with the count in use.
    fn report(&self, used: &FrameCount, warnings: &mut Vec<String>) {
        let n_frames = used.n_frames;
        let Some(source) = used.source else {
            warnings.push("The file states no number of frames.".to_owned());
            return;
        };
        if source == CountSource::Size {
            warnings.push(format!(
                "The number of frames exceeds its 16-bit field; the file has {n_frames} complete frames."
            ));
            return;
        }
        for &(other, n) in &self.stated {
            // A 16-bit field with 65535, or with the count modulo 65536, agrees as far as it can.
            let agrees = n == n_frames
                || n_frames > SATURATED && (n == SATURATED || n == n_frames & 0xFFFF)
                || other == CountSource::Header
                    && self.header.last_frame == u16::MAX
                    && n < n_frames;
            if !agrees {
                warnings.push(format!(
                    "{} states {n} frames, but {} {n_frames}; {n_frames} was used.",
                    other.name(),
                    source.name()
                ));
            }
        }
    }
}
