//! Where the samples of a file are, and how many: settled between header, parameters and the bytes present.

use super::bytes::ByteOrder;
use super::header::{BLOCK, Header};
use super::parameters::Parameters;
use crate::interchange::InterchangeError;

/// Largest value of a word: where a count is this, it may have been larger.
const SATURATED: u64 = 65535;

/// What the data section holds.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// Byte order of the samples.
    pub(super) order: ByteOrder,
    /// Points a frame, model outputs included.
    pub(super) n_points: usize,
    /// Analog samples a frame, all channels together.
    pub(super) analog_per_frame: usize,
    /// Analog samples a frame and channel.
    pub(super) analog_ratio: usize,
    /// Whether samples are floats (else 16-bit integers).
    pub(super) float: bool,
    /// Factor of integer coordinates and of residuals, positive.
    pub(super) scale: f32,
    /// Frames present in whole.
    pub(super) n_frames: usize,
    /// Announced, and not in the file.
    pub(super) frames_missing: u64,
    /// Number of the first frame.
    pub(super) first_frame: u64,
    /// Frames a second.
    pub(super) rate_hz: f64,
    /// Offset of the first frame in the file.
    pub(super) data_start: usize,
}

impl Layout {
    /// Bytes of a sample word.
    pub(super) fn word_bytes(&self) -> usize {
        if self.float { 4 } else { 2 }
    }

    /// Bytes of a frame.
    pub(super) fn frame_bytes(&self) -> usize {
        (4 * self.n_points + self.analog_per_frame) * self.word_bytes()
    }

    /// Analog channels.
    pub(super) fn n_channels(&self) -> usize {
        self.analog_per_frame.checked_div(self.analog_ratio).unwrap_or(0)
    }

    /// Settles what header and parameters say of a file of `n_bytes` bytes.
    pub(super) fn settle(
        header: &Header,
        parameters: &Parameters,
        order: ByteOrder,
        n_bytes: usize,
        warnings: &mut Vec<String>,
    ) -> Result<Self, InterchangeError> {
        let number = |group: &str, name: &str| parameters.number(group, name);
        let n_points = agreed(
            "number of points",
            u64::from(header.n_points),
            number("POINT", "USED").and_then(as_count),
            warnings,
        );
        let data_start = data_start(
            header,
            number("POINT", "DATA_START").and_then(as_count),
            n_bytes,
            warnings,
        )?;
        let stated_scale = parameters
            .get("POINT", "SCALE")
            .and_then(|p| p.floats().first().copied())
            .unwrap_or(header.scale);
        let mut layout = Self {
            order,
            n_points: n_points as usize,
            analog_per_frame: usize::from(header.analog_per_frame),
            analog_ratio: usize::from(header.analog_ratio),
            float: stated_scale < 0.0,
            scale: stated_scale.abs(),
            n_frames: 0,
            frames_missing: 0,
            first_frame: u64::from(header.first_frame),
            rate_hz: rate(header, number("POINT", "RATE"), warnings),
            data_start,
        };
        layout.check_analog(number("ANALOG", "USED").and_then(as_count), warnings);
        layout.settle_frames(
            header,
            parameters,
            n_bytes.saturating_sub(data_start),
            stated_scale,
            warnings,
        );
        Ok(layout)
    }

    /// Compares the header's count of analog samples with the number of channels.
    fn check_analog(&mut self, n_channels: Option<u64>, warnings: &mut Vec<String>) {
        if self.analog_per_frame == 0 {
            return;
        }
        if self.analog_ratio == 0 || !self.analog_per_frame.is_multiple_of(self.analog_ratio) {
            warnings.push(format!(
                "The header announces {} analog samples a frame, {} for each channel; they were read as one sample \
                 for each of {} channels.",
                self.analog_per_frame, self.analog_ratio, self.analog_per_frame
            ));
            self.analog_ratio = 1;
        }
        if let Some(n_channels) = n_channels
            && n_channels != self.n_channels() as u64
        {
            warnings.push(format!(
                "ANALOG:USED is {n_channels}, the header has room for {} channels; the header counts.",
                self.n_channels()
            ));
        }
    }

    /// Settles the number of frames: by the parameters made for it, by the header, and by the bytes present.
    fn settle_frames(
        &mut self,
        header: &Header,
        parameters: &Parameters,
        available: usize,
        stated_scale: f32,
        warnings: &mut Vec<String>,
    ) {
        let announced = self.announced_frames(header, parameters, available, warnings);
        if !(stated_scale.is_finite() && stated_scale != 0.0) {
            self.scale = 1.0;
            self.float = true;
            let needed = (announced as usize).saturating_mul(self.frame_bytes());
            self.float = needed <= available;
            warnings.push(format!(
                "POINT:SCALE is {stated_scale}; samples were read as {}.",
                if self.float { "floats" } else { "integers with a factor of 1" }
            ));
        }
        let present = available.checked_div(self.frame_bytes()).unwrap_or(0);
        self.n_frames = present.min(usize::try_from(announced).unwrap_or(usize::MAX));
        if announced == SATURATED
            && self.is_saturated(header, parameters)
            && present > self.n_frames
        {
            self.n_frames = present - (BLOCK - 1) / self.frame_bytes().max(1);
            warnings.push(format!(
                "The number of frames does not fit its 16-bit field; {} whole frames are present.",
                self.n_frames
            ));
        } else if (self.n_frames as u64) < announced {
            self.frames_missing = announced - self.n_frames as u64;
            warnings.push(format!("{announced} frames announced, {} present.", self.n_frames));
        }
    }

    /// Whether nothing wider than 16 bits says how many frames there are.
    fn is_saturated(&self, header: &Header, parameters: &Parameters) -> bool {
        header.last_frame == u16::MAX
            && parameters.get("POINT", "LONG_FRAMES").is_none()
            && parameters.get("TRIAL", "ACTUAL_END_FIELD").is_none()
    }

    /// The number of frames that the file announces. Where several places disagree, the first that the bytes
    /// present can hold, in the order: TRIAL fields, `LONG_FRAMES`, FRAMES, header.
    fn announced_frames(
        &mut self,
        header: &Header,
        parameters: &Parameters,
        available: usize,
        warnings: &mut Vec<String>,
    ) -> u64 {
        let field = |name: &str| match parameters.get("TRIAL", name)?.words()[..] {
            [low] => Some(u64::from(low)),
            [low, high, ..] => Some(u64::from(low) | u64::from(high) << 16),
            [] => None,
        };
        let start = field("ACTUAL_START_FIELD");
        let trial = start.zip(field("ACTUAL_END_FIELD")).and_then(|(s, e)| (e + 1).checked_sub(s));
        let count = |name: &str| parameters.number("POINT", name).and_then(as_count);
        let (first, last) = (u64::from(header.first_frame), u64::from(header.last_frame));
        let stated = [
            ("TRIAL:ACTUAL_END_FIELD", trial),
            ("POINT:LONG_FRAMES", count("LONG_FRAMES")),
            ("POINT:FRAMES", count("FRAMES")),
            ("the header", (last + 1).checked_sub(first)),
        ];
        let fits = |n: u64| {
            usize::try_from(n).is_ok_and(|n| n.saturating_mul(self.frame_bytes()) <= available)
        };
        let known = || stated.iter().filter_map(|&(place, n)| Some((place, n.filter(|&n| n > 0)?)));
        let Some((place, n_frames)) = known().find(|&(_, n)| fits(n)).or_else(|| known().next())
        else {
            warnings.push("The number of frames is stated nowhere.".to_owned());
            return 0;
        };
        for (other, n) in known() {
            // A 16-bit field that says 65535, or the count modulo 65536, agrees as well as it can.
            let agrees = n == n_frames
                || n_frames > SATURATED && (n == SATURATED || n == n_frames & 0xFFFF)
                || n_frames >= SATURATED && last == SATURATED && other == "the header";
            if !agrees {
                warnings.push(format!(
                    "{other} says {n} frames, {place} {n_frames}; {n_frames} was taken."
                ));
            }
        }
        if let Some(start) = start
            && trial == Some(n_frames)
        {
            self.first_frame = start;
        }
        n_frames
    }
}

/// A count stored as a number: whole and not negative.
fn as_count(value: f64) -> Option<u64> {
    (0.0..4_294_967_296.0).contains(&value).then_some(value as u64)
}

/// The parameter's number where there is one, with a warning when the header has another.
fn agreed(what: &str, header: u64, parameter: Option<u64>, warnings: &mut Vec<String>) -> u64 {
    match parameter {
        Some(parameter) if parameter != header => {
            warnings.push(format!("The {what} is {parameter} by POINT:USED and {header} by the header; {parameter} was taken."));
            parameter.min(u64::from(u16::MAX))
        }
        _ => header,
    }
}

/// Frames a second: the parameter's, or the header's.
fn rate(header: &Header, parameter: Option<f64>, warnings: &mut Vec<String>) -> f64 {
    let usable = |rate: &f64| rate.is_finite() && *rate > 0.0;
    let stated = f64::from(header.rate_hz);
    match (parameter.filter(usable), Some(stated).filter(usable)) {
        (Some(rate), Some(header)) => {
            if (rate - header).abs() > rate * 1e-6 {
                warnings.push(format!(
                    "The rate is {rate} Hz by POINT:RATE and {header} Hz by the header; {rate} Hz was taken."
                ));
            }
            rate
        }
        (Some(rate), None) => rate,
        (None, Some(rate)) => {
            warnings.push(format!("POINT:RATE is missing; the header's {rate} Hz was taken."));
            rate
        }
        (None, None) => {
            warnings.push("No usable rate is stated; 100 Hz was taken.".to_owned());
            100.0
        }
    }
}

/// Offset of the first frame: the header's, or the parameter's where the header's cannot be.
fn data_start(
    header: &Header,
    parameter: Option<u64>,
    n_bytes: usize,
    warnings: &mut Vec<String>,
) -> Result<usize, InterchangeError> {
    let offset = |block: u64| {
        usize::try_from(block.saturating_sub(1)).unwrap_or(usize::MAX).saturating_mul(BLOCK)
    };
    let possible =
        |block: &u64| *block > u64::from(header.parameter_block) && offset(*block) <= n_bytes;
    let stated = u64::from(header.data_block);
    match (Some(stated).filter(possible), parameter.filter(possible)) {
        (Some(block), other) => {
            if other.is_some_and(|other| other != block) {
                warnings.push(format!(
                    "POINT:DATA_START is not the header's block {block}; the header counts."
                ));
            }
            Ok(offset(block))
        }
        (None, Some(block)) => {
            warnings.push(format!(
                "The header's first data block, {stated}, cannot be; POINT:DATA_START {block} was taken."
            ));
            Ok(offset(block))
        }
        (None, None) => Err(InterchangeError::Malformed {
            format: "c3d",
            place: "byte 16".to_owned(),
            message: format!(
                "the data begin at block {stated}, the file has {}: it was cut off before its data",
                n_bytes.div_ceil(BLOCK)
            ),
        }),
    }
}
