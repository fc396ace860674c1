//! Imports of motion files: the settings, the header of the take, and the encoding on one thread.

use std::{
    io::{self, Write},
    sync::{Arc, atomic::AtomicU64},
};

use mocapd_codec::{Effort, Settings};

use crate::{
    TakeError,
    foreign::{content::ScratchFile, tolerance::AnalogTolerance},
    interchange::ReadOptions,
    motion::{FrameSource, MotionInfo},
    motion_encoder::{
        EncodePart, EncodePlan, EncodedPart, MotionWriter, channels,
        ordering::{self, HeldTake, ThisThread},
        stretch_rows,
    },
    record::{CODEC_VERSION, Header, ImportSource, KeyDistance, Subject},
};

/// The version of what an import writes: readers of motion files, encoders and the writer of takes. Every change after
/// which a file may give other bytes with the same settings raises it, because archives name takes by it.
pub const IMPORTER_VERSION: u32 = 2;

/// Plausible frame rates, Hz: from time lapse to ballistics.
pub const RATE_HZ: std::ops::RangeInclusive<f64> = 0.001..=1e6;

/// How files are imported: everything besides a file's bytes on which the bytes of its take depend.
#[derive(Debug, Clone)]
pub struct ImportSettings {
    /// Resampler and tolerance.
    pub codec: Settings,
    /// Effort of the encoder.
    pub effort: Effort,
    /// Distance of key stretches, where it was chosen.
    pub key_distance: Option<KeyDistance>,
    /// Tolerances of analog channels.
    pub analog: AnalogTolerance,
    /// Unit and up axis.
    pub options: ReadOptions,
    /// Whether everything but trajectories is left out.
    pub drops_foreign: bool,
    /// The subject of the takes.
    pub subject: Option<Subject>,
}

impl ImportSettings {
    /// Applies the settings to the description of a file that was opened. Returns the kinds of the foreign parts that are
    /// left out.
    ///
    /// # Errors
    /// Those of [`AnalogTolerance::apply`].
    pub fn apply(
        &self,
        info: &mut MotionInfo,
        new_scratch: impl Fn() -> io::Result<Arc<dyn ScratchFile>>,
    ) -> Result<Vec<String>, TakeError> {
        let mut dropped = Vec::new();
        if self.drops_foreign {
            dropped.extend(info.foreign.drain(..).map(|part| part.kind));
        }
        self.analog.apply(info, new_scratch)?;
        info.subject.clone_from(&self.subject);
        Ok(dropped)
    }

    /// The header of a take, without the size of its source and its id, which are set last
    /// ([`Header::set_import_id`]). `software` and `file` are the names of the importer and of the file.
    #[must_use]
    pub fn header(&self, info: &MotionInfo, software: &str, file: String) -> Header {
        let mut header = header_of(info, &self.codec, software, file);
        header.set_effort(self.effort);
        if let Some(distance) = self.key_distance {
            header.set_key_distance(distance, info.n_frames);
        }
        header.set_analog_tolerances(self.analog.0.iter().map(ToString::to_string));
        header.settings.extend(self.options.settings());
        if self.drops_foreign {
            header.settings.push(("drop_foreign".to_owned(), "true".to_owned()));
        }
        header
    }
}

/// The header of a take made from a file, with no settings besides those of the codec.
#[must_use]
pub fn header_of(info: &MotionInfo, codec: &Settings, software: &str, file: String) -> Header {
    let n_frames = usize::try_from(info.n_frames).unwrap_or(usize::MAX);
    let mut header = Header {
        software: software.to_owned(),
        codec_version: CODEC_VERSION,
        rate_hz: info.rate_hz,
        up_axis: info.up,
        stretch_rows: stretch_rows(codec, info.rate_hz, n_frames, info.markers.len()) as u32,
        channels: channels(&info.markers),
        source: Some(ImportSource {
            format: info.source.format.clone(),
            file,
            unit: info.source.unit.clone(),
            factor: info.source.factor,
            first_frame: info.source.first_frame,
            warnings: info.source.warnings.clone(),
        }),
        ..Header::default()
    };
    header.set_codec(codec);
    header
}

/// Checks that there is something to import. `name` begins the message.
///
/// # Errors
/// `InvalidArgument` for a file without markers or frames, or with an implausible frame rate.
pub fn check(info: &MotionInfo, name: &str) -> Result<(), TakeError> {
    let refuse = |what: String| Err(TakeError::InvalidArgument(format!("{name} has {what}")));
    if info.markers.is_empty() {
        return refuse("no markers: nothing to import".to_owned());
    }
    if info.n_frames == 0 {
        return refuse("no frames: nothing to import".to_owned());
    }
    if !RATE_HZ.contains(&info.rate_hz) {
        return refuse(format!(
            "a rate of {:e} Hz, expected {} to {}: correct the rate in the file",
            info.rate_hz,
            RATE_HZ.start(),
            RATE_HZ.end()
        ));
    }
    Ok(())
}

/// Encodes all frames of a source with the settings in `header` on this thread, and writes a whole take: the bytes are
/// those that several threads write. Calls `check` before each part. Returns the output and the largest error, in
/// millimetres.
///
/// # Errors
/// Those of [`EncodePlan::new`], of the codec, of `check`, and of writing.
pub fn write<W: Write>(
    frames: &mut dyn FrameSource,
    header: &Header,
    out: W,
    check: impl Fn() -> io::Result<()>,
) -> Result<(W, f64), TakeError> {
    let (plan, mut parts) = EncodePlan::new(frames, header)?;
    let mut max_error_mm = 0.0_f64;
    let mut push = |take: &mut MotionWriter<'_, W>, part: &EncodePart, coded: &EncodedPart| {
        let errors = coded.reports.iter().map(|report| report.max_error_mm);
        max_error_mm = errors.fold(max_error_mm, f64::max);
        take.push(part, coded)
    };
    let take = if plan.searches_order() {
        let held: Vec<EncodePart> = parts.by_ref().collect::<Result<_, _>>()?;
        let info = parts.info();
        let held_take = HeldTake { plan: &plan, parts: &held, info, header };
        let (order, coded) = ordering::encode(held_take, &ThisThread(check), &AtomicU64::new(0))?;
        let mut take = MotionWriter::new_in(&plan, (info, header), order, out)?;
        let mut coded = held.iter().zip(&coded);
        coded.try_for_each(|(part, coded)| push(&mut take, part, coded))?;
        take
    } else {
        let mut take = MotionWriter::new(&plan, parts.info(), header, out)?;
        let mut encoder = plan.encoder();
        for part in parts {
            check()?;
            let part = part?;
            push(&mut take, &part, &encoder.encode(&part)?)?;
        }
        take
    };
    Ok((take.finish()?.1, max_error_mm))
}
