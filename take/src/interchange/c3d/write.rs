//! Export to C3D: Intel order, floats, millimetres.

use std::io::{self, Write};

use super::{
    analog::{self, ANALOG},
    columns,
    foreign::{PartSamples, kept_parameters, residual_scale},
    gap_coordinates::PartCoordinates,
    groups::{self, ROTATION, Rotations},
    header::{BLOCK, C3dHeader, is_counted_by_length},
    is_missing,
    parameters::{DIMENSION_MAX, Parameter, Parameters, encode_records, is_unsigned},
    recorded::{RecordedAnalog, of_take},
};
use crate::{
    interchange::{InterchangeError, Result, check_frame_count, counted, write_frames},
    motion::{FrameSource, GAP, Marker, MotionInfo, Position, UpAxis, is_gap},
    sampled::{GroupSamples, RESIDUAL_SCALE, RecordedResiduals},
};

/// The parameter section's processor code for Intel.
const INTEL: u8 = 84;

/// Writes a whole file. Returns remarks on the sampled channels of a recording, one sentence each.
pub(crate) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<Vec<String>> {
    let info = frames.info().clone();
    let (mut header, mut parameters) = kept_parameters(&info.foreign)?.unwrap_or_default();
    let mut body = Body::new(&info, &parameters)?;
    fill_parameters(&mut parameters, &info, &mut body)?;
    set_header(&mut header, &parameters, &info, &body);
    let rotations = body.rotations.take();
    let leading_blocks = leading_blocks(header, parameters, rotations.as_ref())?;
    let mut n_bytes = leading_blocks.len() as u64;
    out.write_all(&leading_blocks)?;
    if let Some(rotations) = rotations.as_ref().filter(|rotations| !rotations.is_behind()) {
        rotations.write(out)?;
        n_bytes += rotations.n_bytes();
    }
    // The file is padded to whole blocks, unless a reader counts the frames by its length.
    let n_written = write_frames(frames, out, Vec::new(), |buffer, _, row| {
        let before = buffer.len();
        body.push_frame(row, buffer)?;
        n_bytes += (buffer.len() - before) as u64;
        Ok(())
    })?;
    check_frame_count(info.n_frames, n_written)?;
    if !is_counted_by_length(&info) {
        let padding = n_bytes.next_multiple_of(BLOCK as u64) - n_bytes;
        out.write_all(&[0; BLOCK][..padding as usize])?;
        if let Some(rotations) = rotations.filter(Rotations::is_behind) {
            rotations.write(out)?;
        }
        out.flush()?;
    }
    Ok(body.remarks())
}

/// The labels of all points of the written file.
fn labels(parameters: &Parameters, info: &MotionInfo, points: &[Point]) -> Vec<String> {
    let source = parameters.texts("POINT", "LABELS");
    let label = |(place, point): (usize, &Point)| match *point {
        Point::Marker(index) => info.markers.get(index).map(|marker| marker.label.clone()),
        Point::ModelOutput(_) => source.get(place).cloned(),
    };
    points.iter().enumerate().map(|at| label(at).unwrap_or_default()).collect()
}

/// Sets all parameters that describe the written file; the others stay as they were imported.
fn fill_parameters(
    parameters: &mut Parameters,
    info: &MotionInfo,
    body: &mut Body<'_>,
) -> Result<()> {
    let n_points = u16::try_from(body.points.len()).map_err(|_| {
        InterchangeError::Unsupported(format!(
            "C3D holds at most 65535 points, the take has {}",
            body.points.len()
        ))
    })?;
    let last = last_frame(info).ok_or_else(|| {
        InterchangeError::Unsupported(format!(
            "C3D frame numbers have 32 bits: {} frames from number {} on are too many",
            info.n_frames, info.source.first_frame
        ))
    })?;
    // Events outside of the written frames are kept only in an export of all frames.
    let kept_frames = parameters.number("POINT", "FRAMES");
    let whole = kept_frames.is_some_and(|n| n as u64 == info.n_frames.min(u64::from(u16::MAX)));
    let labels = labels(parameters, info, &body.points);
    let mut descriptions = parameters.texts("POINT", "DESCRIPTIONS");
    parameters.set_integer("POINT", "USED", n_points);
    let scale = match body.recorded_residuals {
        Some(_) => RESIDUAL_SCALE as f32,
        None => residual_scale(parameters, info.source.factor),
    };
    parameters.set_float("POINT", "SCALE", -scale);
    parameters.set_float("POINT", "RATE", info.rate_hz as f32);
    parameters.set_integer("POINT", "DATA_START", 0);
    parameters.set_integer("POINT", "FRAMES", u16::try_from(info.n_frames).unwrap_or(u16::MAX));
    if info.n_frames > u64::from(u16::MAX) || parameters.get("POINT", "LONG_FRAMES").is_some() {
        parameters.set_float("POINT", "LONG_FRAMES", info.n_frames as f32);
    }
    if parameters.get("POINT", "UNITS").is_some() && info.source.factor != 1.0 {
        // These parameters are in POINT:UNITS, which becomes mm.
        parameters.scale_floats("FORCE_PLATFORM", "CORNERS", info.source.factor);
        parameters.scale_floats("FORCE_PLATFORM", "ORIGIN", info.source.factor);
    }
    parameters.set_text("POINT", "UNITS", "mm");
    parameters.set_texts("POINT", "LABELS", &labels).map_err(|label| {
        InterchangeError::Unsupported(format!(
            "C3D labels have at most 255 bytes, but `{label}` has {}",
            label.len()
        ))
    })?;
    if descriptions.len() != labels.len() {
        descriptions.resize(labels.len(), String::new());
        // Fails, and leaves the list as it is, only for a text of Latin-1 that exceeds 255 bytes as UTF-8.
        parameters.set_texts("POINT", "DESCRIPTIONS", &descriptions).unwrap_or_default();
    }
    set_screen(parameters, info.up);
    set_manufacturer(parameters);
    fill_subjects(parameters, &info.markers);
    groups::fill(parameters, info, whole);
    if let (Some(recorded), Some(recording)) = (&body.recorded, &info.recording)
        && recorded.n_channels() > 0
    {
        recorded.fill_parameters(parameters, recording)?;
    }
    match &body.rotations {
        Some(rotations) => rotations.fill_parameters(parameters)?,
        // The data of an imported file's section is not kept.
        None => parameters.remove_group(ROTATION),
    }
    let (ratio, n_channels) = body.analog_shape();
    if n_channels == 0 {
        set_no_analog(parameters);
    } else {
        body.analog_offsets = complete_analog(parameters, n_channels, ratio, info.rate_hz);
    }
    parameters.set_long_integer("TRIAL", "ACTUAL_START_FIELD", first_frame(info));
    parameters.set_long_integer("TRIAL", "ACTUAL_END_FIELD", last);
    Ok(())
}

/// Sets the screen axes for a known up axis, unless the parameters have it already.
fn set_screen(parameters: &mut Parameters, up: UpAxis) {
    let (right, up) = match up {
        _ if up == parameters.up_axis() => return,
        UpAxis::Unknown => return,
        UpAxis::X => ("+Y", "+X"),
        UpAxis::Y => ("+X", "+Y"),
        UpAxis::Z => ("+X", "+Z"),
    };
    parameters.set_text("POINT", "X_SCREEN", right);
    parameters.set_text("POINT", "Y_SCREEN", up);
}

/// Adds a MANUFACTURER group that names mocapd, unless the file has one.
fn set_manufacturer(parameters: &mut Parameters) {
    if parameters.group_id("MANUFACTURER").is_none() {
        parameters.set_text("MANUFACTURER", "COMPANY", "mocapd");
        parameters.set_text("MANUFACTURER", "SOFTWARE", "mocapd");
        parameters.set_text("MANUFACTURER", "VERSION_LABEL", env!("CARGO_PKG_VERSION"));
    }
}

/// Adds a SUBJECTS group from the prefixes of the labels, unless the file has one or a label has no prefix.
fn fill_subjects(parameters: &mut Parameters, markers: &[Marker]) {
    if parameters.group_id("SUBJECTS").is_some() {
        return;
    }
    let Some(names) = prefixes(markers) else { return };
    let prefixes: Vec<String> = names.iter().map(|name| format!("{name}:")).collect();
    parameters.set_integer("SUBJECTS", "USED", names.len() as u16);
    parameters.set_integer_list("SUBJECTS", "IS_STATIC", &vec![0; names.len()]);
    parameters.set_integer_list("SUBJECTS", "USES_PREFIXES", &vec![1; names.len()]);
    // Cannot fail: a prefix is shorter than its label, which was written already.
    parameters.set_texts("SUBJECTS", "NAMES", &names).unwrap_or_default();
    parameters.set_texts("SUBJECTS", "LABEL_PREFIXES", &prefixes).unwrap_or_default();
}

/// The distinct label prefixes before the last `:`, in order of markers; `None` unless every labelled marker has one.
fn prefixes(markers: &[Marker]) -> Option<Vec<String>> {
    let mut names: Vec<String> = Vec::new();
    for marker in markers.iter().filter(|marker| marker.labelled) {
        let (name, rest) = marker.label.rsplit_once(':')?;
        if name.trim().is_empty() || rest.trim().is_empty() {
            return None;
        }
        if !names.iter().any(|known| known == name) {
            names.push(name.to_owned());
        }
    }
    (1..=DIMENSION_MAX).contains(&names.len()).then_some(names)
}

// The ANALOG group is completed, with the types that other readers expect. ezc3d reads past the end of lists shorter
// than the number of channels, and computes the samples in a frame from the two rates, rounded down. py-c3d reads
// OFFSET as 16-bit integers, whatever type it has.

/// Completes the ANALOG group of a file without analog samples.
fn set_no_analog(parameters: &mut Parameters) {
    parameters.set_integer(ANALOG, "USED", 0);
    for (name, kind, dimensions, data) in [
        ("LABELS", -1, vec![0, 0], Vec::new()),
        ("DESCRIPTIONS", -1, vec![0, 0], Vec::new()),
        ("UNITS", -1, vec![0, 0], Vec::new()),
        ("SCALE", 4, vec![0], Vec::new()),
        ("OFFSET", 2, vec![0], Vec::new()),
        ("GEN_SCALE", 4, Vec::new(), 1f32.to_le_bytes().to_vec()),
        ("RATE", 4, Vec::new(), 0f32.to_le_bytes().to_vec()),
    ] {
        if parameters.get(ANALOG, name).is_none() {
            parameters.set(ANALOG, name, kind, dimensions, data);
        }
    }
}

/// Completes the ANALOG group for `n_channels` channels with `ratio` samples in a frame each. Returns the offsets that
/// must be subtracted from the samples of each channel because a 16-bit integer cannot hold them; empty if there are
/// none.
fn complete_analog(
    parameters: &mut Parameters,
    n_channels: usize,
    ratio: usize,
    rate_hz: f64,
) -> Vec<f64> {
    parameters.set_integer(ANALOG, "USED", u16::try_from(n_channels).unwrap_or(u16::MAX));
    set_rate(parameters, ratio, rate_hz);
    if !has_floats(parameters.get(ANALOG, "GEN_SCALE"), 1) {
        let value = parameters.number(ANALOG, "GEN_SCALE").unwrap_or(1.0);
        parameters.set_float(ANALOG, "GEN_SCALE", value as f32);
    }
    if !has_floats(parameters.get(ANALOG, "SCALE"), n_channels.min(255)) {
        let known = analog::scales(parameters);
        let scales: Vec<f32> =
            (0..n_channels).map(|i| known.get(i).map_or(1.0, |&scale| scale as f32)).collect();
        parameters.set_float_list(ANALOG, "SCALE", &scales);
    }
    for name in ["LABELS", "UNITS", "DESCRIPTIONS"] {
        let mut texts = parameters.texts(ANALOG, name);
        if texts.len() >= n_channels {
            continue;
        }
        for index in texts.len()..n_channels {
            let is_label = name == "LABELS";
            texts.push(if is_label { analog::unlabelled_name(index) } else { String::new() });
        }
        // Fails, and leaves the list as it is, only for a text of Latin-1 that exceeds 255 bytes as UTF-8.
        parameters.set_texts(ANALOG, name, &texts).unwrap_or_default();
    }
    set_offsets(parameters, n_channels)
}

/// Whether a parameter holds at least `n` floats.
fn has_floats(parameter: Option<&Parameter>, n: usize) -> bool {
    parameter.is_some_and(|parameter| parameter.floats().len() >= n)
}

/// Sets ANALOG:RATE, unless it gives the samples in a frame already. The quotient of the rates is never below `ratio`,
/// whatever the rounding to f32.
fn set_rate(parameters: &mut Parameters, ratio: usize, rate_hz: f64) {
    let point_hz = f64::from(rate_hz as f32);
    let gives_ratio = |analog_hz: f64| (analog_hz / point_hz) as usize == ratio;
    let kept = parameters.float(ANALOG, "RATE");
    if kept.is_some_and(|kept| gives_ratio(f64::from(kept))) {
        return;
    }
    let mut analog_hz = (point_hz * ratio as f64) as f32;
    if !gives_ratio(f64::from(analog_hz)) {
        analog_hz = analog_hz.next_up();
    }
    parameters.set_float(ANALOG, "RATE", analog_hz);
}

/// Sets OFFSET as one 16-bit integer for each channel, also from OFFSETS, as some software calls it. Returns the
/// offsets that a 16-bit integer cannot hold, 0 for the others; empty if all fit.
fn set_offsets(parameters: &mut Parameters, n_channels: usize) -> Vec<f64> {
    let is_unsigned = is_unsigned(parameters);
    let offset = parameters.get(ANALOG, "OFFSET");
    let known = analog::offsets(parameters);
    if offset.is_some_and(|p| p.kind == 2 && p.integers().len() >= n_channels.min(255)) {
        return Vec::new();
    }
    let range = if is_unsigned { 0.0..=65535.0 } else { -32768.0..=32767.0 };
    let mut words = Vec::with_capacity(n_channels);
    let mut rest = Vec::with_capacity(n_channels);
    for channel in 0..n_channels {
        let offset = known.get(channel).copied().filter(|v| v.is_finite()).unwrap_or(0.0);
        let fits = offset.fract() == 0.0 && range.contains(&offset);
        words.push(if fits { offset as i32 as u16 } else { 0 });
        rest.push(if fits { 0.0 } else { offset });
    }
    parameters.set_integer_list(ANALOG, "OFFSET", &words);
    if rest.iter().all(|&offset| offset == 0.0) { Vec::new() } else { rest }
}

/// The number of the first frame; C3D counts from 1.
fn first_frame(info: &MotionInfo) -> u32 {
    u32::try_from(info.source.first_frame).unwrap_or(u32::MAX).max(1)
}

/// The number of the last frame; `None` if it exceeds 32 bits.
fn last_frame(info: &MotionInfo) -> Option<u32> {
    let last = info.source.first_frame.max(1).checked_add(info.n_frames)?.checked_sub(1)?;
    u32::try_from(last).ok()
}

/// The residuals of the frames of a recording; `None` if it has none.
fn recorded_residuals(info: &MotionInfo) -> Result<Option<RecordedResiduals<'_>>> {
    let recording = info.recording.as_ref().filter(|recording| recording.has_residuals());
    let residuals =
        recording.map(|recording| recording.residuals(&info.rows(), info.markers.len()));
    residuals.transpose().map_err(of_take)
}

fn set_header(header: &mut C3dHeader, parameters: &Parameters, info: &MotionInfo, body: &Body<'_>) {
    let word = |value: u32| u16::try_from(value).unwrap_or(u16::MAX);
    let (ratio, n_channels) = body.analog_shape();
    header.parameter_block = 2;
    header.n_points = body.points.len() as u16;
    header.first_frame = word(first_frame(info));
    header.last_frame = word(last_frame(info).unwrap_or(u32::MAX));
    header.scale = parameters.float("POINT", "SCALE").unwrap_or(-1.0);
    header.rate_hz = parameters.float("POINT", "RATE").unwrap_or(0.0);
    header.analog_per_frame = word((ratio * n_channels) as u32);
    header.analog_ratio =
        if n_channels > 0 { word(ratio as u32) } else { analog_ratio_without_channels(parameters) };
}

/// The header's analog ratio without analog channels: the quotient of the two rates, so that readers find them
/// consistent.
fn analog_ratio_without_channels(parameters: &Parameters) -> u16 {
    let analog = parameters.number("ANALOG", "RATE").unwrap_or(0.0);
    let ratio = analog / parameters.number("POINT", "RATE").unwrap_or(0.0);
    if ratio.fract() == 0.0 && (0.0..65536.0).contains(&ratio) { ratio as u16 } else { 0 }
}

/// Encodes header and parameter section. Drops POINT:DESCRIPTIONS if the section would exceed 255 blocks.
///
/// # Errors
/// `Unsupported` if the section exceeds 255 blocks even so.
fn leading_blocks(
    mut header: C3dHeader,
    mut parameters: Parameters,
    rotations: Option<&Rotations<'_>>,
) -> Result<Vec<u8>> {
    let mut records = Vec::new();
    encode_records(&parameters, &mut records);
    if section_blocks(&records) > 255 {
        parameters.remove_list("POINT", "DESCRIPTIONS");
        records.clear();
        encode_records(&parameters, &mut records);
    }
    let n_blocks = u8::try_from(section_blocks(&records)).map_err(|_| {
        InterchangeError::Unsupported(format!(
            "C3D holds at most {} bytes of parameters including labels, the take has {}",
            255 * BLOCK,
            records.len()
        ))
    })?;
    header.data_block = u16::from(n_blocks) + 2;
    if let Some(rotations) = rotations {
        header.data_block = rotations.set_place(&mut parameters, header.data_block);
    }
    parameters.set_integer("POINT", "DATA_START", header.data_block);
    records.clear();
    encode_records(&parameters, &mut records);
    let mut leading_blocks = header.to_bytes().to_vec();
    leading_blocks.extend([1, 0x50, n_blocks, INTEL]);
    leading_blocks.extend(records);
    leading_blocks.resize((usize::from(n_blocks) + 1) * BLOCK, 0);
    Ok(leading_blocks)
}

/// Number of blocks of a section with these records.
fn section_blocks(records: &[u8]) -> usize {
    (records.len() + 4).div_ceil(BLOCK)
}

/// The words of a missing sample.
const MISSING: [f32; 4] = [0.0, 0.0, 0.0, -1.0];

/// A point of the written file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Point {
    Marker(usize),
    ModelOutput(usize),
}

/// The sources of the content of each frame.
struct Body<'a> {
    points: Vec<Point>,
    analog: Option<PartSamples<'a>>,
    /// The sampled channels of a recording, which has no kept analog samples.
    recorded: Option<RecordedAnalog<'a>>,
    /// The poses of a recording, unless they do not fit.
    rotations: Option<Rotations<'a>>,
    residuals: Option<PartSamples<'a>>,
    /// The residuals of a recording, in units of POINT:SCALE. None where the take has kept those of a file, too: a point has one,
    /// and POINT:SCALE is that of the file.
    recorded_residuals: Option<RecordedResiduals<'a>>,
    /// Samples of markers whose residuals the recording lost.
    n_lost_residuals: u64,
    /// What was left out for the content of a file, one sentence each.
    remarks: Vec<String>,
    outputs: Option<PartSamples<'a>>,
    gap_coordinates: Option<PartCoordinates<'a>>,
    /// For each marker the kept words of a missing sample in the current frame; all `None` between frames.
    gap_words: Vec<Option<[f32; 4]>>,
    unsigned_analog: bool,
    /// Offsets to subtract from the analog samples of each channel; empty for none.
    analog_offsets: Vec<f64>,
}

impl<'a> Body<'a> {
    /// # Errors
    /// Those of reading the foreign parts.
    fn new(info: &'a MotionInfo, parameters: &Parameters) -> Result<Self> {
        let (foreign, first_frame) = (&info.foreign, info.source.first_frame);
        let outputs = PartSamples::outputs(foreign, first_frame)?;
        let n_markers = info.markers.len();
        let residuals = PartSamples::residuals(foreign, first_frame)?
            .filter(|kept| kept.header.n_signals == n_markers);
        let recorded_residuals = if residuals.is_none() { recorded_residuals(info)? } else { None };
        let analog = PartSamples::analog(foreign, first_frame)?;
        let recorded = if analog.is_none() { RecordedAnalog::open(info)? } else { None };
        let remarks = remarks_on_kept(info, analog.is_some(), residuals.is_some());
        let mut body = Self {
            gap_coordinates: PartCoordinates::parse(foreign, n_markers, first_frame)?,
            gap_words: vec![None; n_markers],
            analog_offsets: Vec::new(),
            points: ordered_points(n_markers, outputs.as_ref().map_or(&[], |kept| &kept.points)),
            analog,
            recorded,
            rotations: None,
            residuals,
            recorded_residuals,
            n_lost_residuals: 0,
            remarks,
            outputs,
            unsigned_analog: is_unsigned(parameters),
        };
        body.rotations = Rotations::of(info, body.bytes_per_frame());
        Ok(body)
    }

    /// The analog samples of a channel in a frame, and the number of channels.
    fn analog_shape(&self) -> (usize, usize) {
        let of_recording = self.recorded.as_ref().map(|all| (all.ratio, all.n_channels()));
        let kept = self.analog.as_ref().map(|kept| (kept.header.ratio, kept.header.n_signals));
        kept.or(of_recording.filter(|(_, n)| *n > 0)).unwrap_or((0, 0))
    }

    /// Bytes of a frame: four floats for each point, and one for each analog sample.
    fn bytes_per_frame(&self) -> u64 {
        let (ratio, n_channels) = self.analog_shape();
        16 * self.points.len() as u64 + 4 * ratio as u64 * n_channels as u64
    }

    /// What happened to the sampled channels of a recording, one sentence each. Complete after the last frame.
    fn remarks(mut self) -> Vec<String> {
        self.remarks.extend(self.recorded.map(|all| all.remarks()).unwrap_or_default());
        if self.n_lost_residuals > 0 {
            self.remarks.push(format!(
                "{} of markers lack the residual, which the recording lost; it was written as 0, which is none.",
                counted(self.n_lost_residuals, "sample")
            ));
        }
        self.remarks
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// Those of reading the foreign parts.
    fn push_frame(&mut self, row: &[Position], buffer: &mut Vec<u8>) -> io::Result<()> {
        let width = self.residuals.as_ref().map_or(0, |kept| kept.header.width);
        let residuals = self.residuals.as_mut().map(PartSamples::next_frame).transpose()?.flatten();
        let outputs = self.outputs.as_mut().map(PartSamples::next_frame).transpose()?.flatten();
        let recorded = self.recorded_residuals.as_mut();
        let recorded = match recorded {
            Some(residuals) => {
                residuals.next_row()?;
                let is_seen = |index: &usize| row.get(*index).is_some_and(|at| !is_gap(*at));
                self.n_lost_residuals += residuals.missing().filter(is_seen).count() as u64;
                Some(residuals.row())
            }
            None => None,
        };
        if let Some(kept) = &mut self.gap_coordinates {
            for &(marker, words) in kept.next_frame()? {
                if let Some(place) = self.gap_words.get_mut(marker) {
                    *place = Some(words);
                }
            }
        }
        for &point in &self.points {
            let words = match point {
                Point::Marker(index) => {
                    let position = row.get(index).copied().unwrap_or(GAP);
                    let fourth = residuals.and_then(|words| words.get(index));
                    let fourth = fourth.map(|&word| columns::value(width, word, false));
                    let recorded = recorded.and_then(|counts| counts.get(index));
                    let fourth = fourth.or(recorded.map(|&count| count.into()));
                    let gap_words = self.gap_words.get_mut(index).and_then(Option::take);
                    marker_words(position, fourth, gap_words)
                }
                Point::ModelOutput(index) => outputs
                    .and_then(|words| words.as_chunks::<4>().0.get(index))
                    .map_or(MISSING, |words| words.map(|word| columns::value(4, word, false))),
            };
            words.iter().for_each(|word| buffer.extend(word.to_le_bytes()));
        }
        let (ratio, n_channels) = self.analog_shape();
        let Some(kept) = self.analog.as_mut() else {
            let recorded = self.recorded.as_mut();
            return recorded.map_or(Ok(()), |all| all.push_frame(&self.analog_offsets, buffer));
        };
        let present = kept.begin_frame();
        let width = kept.header.width;
        for _ in 0..ratio {
            match if present { kept.next()? } else { None } {
                Some(words) => words.iter().enumerate().for_each(|(channel, &word)| {
                    let mut value = columns::value(width, word, self.unsigned_analog);
                    if let Some(offset) = self.analog_offsets.get(channel) {
                        value = (f64::from(value) - offset) as f32;
                    }
                    buffer.extend(value.to_le_bytes());
                }),
                None => buffer.extend(std::iter::repeat_n(0, 4 * n_channels)),
            }
        }
        Ok(())
    }
}

/// What of a recording is left out of a file that has the same content of the file that was imported, one sentence each.
fn remarks_on_kept(info: &MotionInfo, has_analog: bool, has_residuals: bool) -> Vec<String> {
    let Some(recording) = &info.recording else { return Vec::new() };
    let is_analog = |found: &GroupSamples| !found.group.has_residuals();
    let mut remarks = Vec::new();
    if has_analog && recording.groups().iter().any(is_analog) {
        remarks.push(
            "The sampled channels of the recording were left out: the take has the analog samples of an imported file, and C3D \
             has one set of them."
                .to_owned(),
        );
    }
    if has_residuals && recording.has_residuals() {
        remarks.push(
            "The residuals of the recording were left out: the take has those of an imported file, and a point of C3D has one."
                .to_owned(),
        );
    }
    remarks
}

/// The four words of a marker. A fourth word that means "missing" is replaced by 0 for a present sample; a missing
/// sample gets back its kept words.
fn marker_words(position: Position, fourth: Option<f32>, gap_words: Option<[f32; 4]>) -> [f32; 4] {
    if is_gap(position) {
        return gap_words.unwrap_or(MISSING);
    }
    let [x, y, z] = position;
    [x, y, z, fourth.filter(|&word| !is_missing(word)).unwrap_or(0.0)]
}

/// The points in file order: model outputs at their original indices, markers in between.
fn ordered_points(n_markers: usize, outputs: &[usize]) -> Vec<Point> {
    let mut markers = (0..n_markers).map(Point::Marker);
    let mut outputs_left = outputs.iter().enumerate().peekable();
    let n_points = n_markers + outputs.len();
    let point = |place: usize| {
        let output = outputs_left.next_if(|&(_, &at)| at <= place || markers.len() == 0);
        output.map(|(index, _)| Point::ModelOutput(index)).or_else(|| markers.next())
    };
    (0..n_points).filter_map(point).collect()
}
