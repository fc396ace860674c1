//! `plot analog`, `plot forces` and `plot bodies`: the sampled channels of an imported C3D file or of a recording, and its
//! rigid bodies.

use std::time::Duration;

use anyhow::bail;
use mocapd::outcome::{Outcome, UsageError};
use mocapd_report::plot::{
    AnalogPlot, BODIES_MAX, BodiesPlot, CHANNELS_MAX, ForcesPlot, analog, bodies, forces,
    plot_bodies, plot_channels,
};
use mocapd_service::units;
use mocapd_take::motion::{MotionInfo, frame_at};

use super::{Picture, PictureArgs, TimeSpan, marker, pose::up};
use crate::cli::{motion_files::read_analog_info, paths::InputFormat, values::count};

#[derive(Debug, clap::Args)]
pub(crate) struct AnalogArgs {
    #[command(flatten)]
    picture: PictureArgs,
    /// Labels of the channels, or their numbers from 1, up to 12 [default: the first twelve]
    #[arg(long, value_name = "LABEL,...", value_delimiter = ',')]
    channels: Vec<String>,
    /// Plot frames from this time on: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
}

#[derive(Debug, clap::Args)]
pub(crate) struct ForcesArgs {
    #[command(flatten)]
    picture: PictureArgs,
    /// Numbers of the force plates in the file or of the device, from 1, up to 4 [default: the first four]
    #[arg(long, value_name = "NUMBER,...", value_delimiter = ',')]
    plates: Vec<usize>,
    /// Label of the marker whose trajectory is drawn, too [default: the marker with the longest path]
    #[arg(long, value_name = "LABEL")]
    marker: Option<String>,
    /// Labels of channels to plot below, or their numbers from 1, up to 12
    #[arg(long, value_name = "LABEL,...", value_delimiter = ',')]
    channels: Vec<String>,
    /// Plot frames from this time on: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
}

#[derive(Debug, clap::Args)]
pub(crate) struct BodiesArgs {
    #[command(flatten)]
    picture: PictureArgs,
    /// Names of the rigid bodies, or their numbers from 1, up to 6 [default: the first four]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    bodies: Vec<String>,
    /// Label of the marker whose trajectory is drawn above [default: the marker with the longest path]
    #[arg(long, value_name = "LABEL")]
    marker: Option<String>,
    /// Plot frames from this time on: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", value_parser = units::duration, allow_hyphen_values = true)]
    from: Option<Duration>,
}

pub(super) fn run_analog(args: &AnalogArgs) -> anyhow::Result<Outcome> {
    refuse_original(&args.picture)?;
    args.picture.run(TimeSpan::Range, |picture| {
        let info = kept_info(picture)?;
        let channels = channels(&info, &args.channels)?;
        let rows = rows(picture, args.from)?;
        Ok(analog(&AnalogPlot { name: &picture.name, info: &info, channels: &channels, rows })?)
    })
}

pub(super) fn run_forces(args: &ForcesArgs) -> anyhow::Result<Outcome> {
    refuse_original(&args.picture)?;
    args.picture.run(TimeSpan::Range, |picture| {
        let info = kept_info(picture)?;
        let motion = &picture.take.motion;
        let channels = match args.channels.as_slice() {
            [] => Vec::new(),
            given => channels(&info, given)?,
        };
        Ok(forces(&ForcesPlot {
            name: &picture.name,
            info: &info,
            motion,
            plates: &args.plates,
            marker: marker(&picture.take, args.marker.as_deref())?,
            channels: &channels,
            rows: rows(picture, args.from)?,
            up: up(motion),
        })?)
    })
}

pub(super) fn run_bodies(args: &BodiesArgs) -> anyhow::Result<Outcome> {
    refuse_original(&args.picture)?;
    if args.bodies.len() > BODIES_MAX {
        let n = args.bodies.len();
        bail!(UsageError(format!("--bodies has {n} rigid bodies: give up to {BODIES_MAX}")));
    }
    args.picture.run(TimeSpan::Range, |picture| {
        let info = kept_info(picture)?;
        let motion = &picture.take.motion;
        let names = plot_bodies(&info);
        let has_marker = !motion.info.markers.is_empty() || args.marker.is_some();
        let marker =
            has_marker.then(|| marker(&picture.take, args.marker.as_deref())).transpose()?;
        Ok(bodies(&BodiesPlot {
            name: &picture.name,
            info: &info,
            motion,
            bodies: &indices_of(&args.bodies, &names, "rigid body")?,
            marker,
            rows: rows(picture, args.from)?,
        })?)
    })
}

fn refuse_original(args: &PictureArgs) -> anyhow::Result<()> {
    if args.against.is_some() {
        bail!(UsageError("--against is for positions: omit it".to_owned()));
    }
    Ok(())
}

/// The description of a take or a motion file with what it kept of the analog channels.
fn kept_info(picture: &Picture<'_>) -> anyhow::Result<MotionInfo> {
    let input = &picture.job.input;
    if let InputFormat::MotionFile(_) = input.format()? {
        return Ok(picture.take.motion.info.clone());
    }
    read_analog_info(&input.path)
}

/// The frames of the plot.
fn rows(picture: &Picture<'_>, from: Option<Duration>) -> anyhow::Result<(u64, u64)> {
    let motion = &picture.take.motion;
    let (n_frames, rate_hz) = (motion.n_frames() as u64, motion.info.rate_hz);
    let row = |time: Duration| frame_at(time, rate_hz);
    let rows = (from.map_or(0, row), picture.end.map_or(n_frames, row).min(n_frames));
    if rows.0 >= rows.1 {
        let length_s = n_frames as f64 / rate_hz;
        bail!(UsageError(format!(
            "no frames between --from and --to: the take has {n_frames} frames, {length_s:.3} s"
        )));
    }
    Ok(rows)
}

/// The indices of the channels with these labels or numbers; the first ones if none is given.
fn channels(info: &MotionInfo, given: &[String]) -> anyhow::Result<Vec<usize>> {
    let all = plot_channels(info)?;
    if given.is_empty() || all.is_empty() {
        return Ok((0..all.len().min(CHANNELS_MAX)).collect());
    }
    let names: Vec<String> = all.into_iter().map(|channel| channel.name).collect();
    indices_of(given, &names, "analog channel")
}

/// The indices of things with these names, or with these numbers from 1; none of an empty list, of which a plot says so.
fn indices_of(given: &[String], names: &[String], what: &str) -> anyhow::Result<Vec<usize>> {
    let index = |wanted: &String| {
        let by_name = names.iter().position(|name| name == wanted.trim());
        let number = wanted.trim().parse::<usize>().ok().and_then(|number| number.checked_sub(1));
        by_name.or(number.filter(|&index| index < names.len())).ok_or_else(|| {
            let listed: Vec<&str> = names.iter().take(CHANNELS_MAX).map(String::as_str).collect();
            let others = match names.len().saturating_sub(listed.len()) {
                0 => String::new(),
                n => format!(" and {}", count(n as u64, "other")),
            };
            let message =
                format!("no {what} is called '{wanted}': there are {}{others}", listed.join(", "));
            UsageError(message).into()
        })
    };
    if names.is_empty() { Ok(Vec::new()) } else { given.iter().map(index).collect() }
}
